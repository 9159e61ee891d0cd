"""Scenes with exact truth: ``arrays`` makes them as numpy arrays, ``samples`` as files, one module a kind of sample."""
