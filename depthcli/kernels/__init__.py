"""Numba kernels on plain arrays that two or more packages share."""
