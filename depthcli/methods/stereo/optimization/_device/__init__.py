"""Twins of the optimizations for devices; see :mod:`depthcli.methods.stereo.on_device`."""
