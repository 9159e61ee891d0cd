"""Methods: what is computed from arrays, one package a problem."""
