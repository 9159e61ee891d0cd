"""Label maps and solvers of labelling problems: energies on graphs, no image semantics."""
