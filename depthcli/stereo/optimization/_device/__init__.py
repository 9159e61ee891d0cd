"""Twins of the optimizations for devices; see :mod:`depthcli.stereo.on_device`."""
