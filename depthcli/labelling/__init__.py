"""Solvers of labelling problems: energies on graphs, no image semantics."""
