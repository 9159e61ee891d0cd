"""The problems that commands and the functions for Python solve, one file each."""
