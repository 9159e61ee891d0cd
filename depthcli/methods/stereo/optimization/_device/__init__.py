"""Device implementations of the optimizations; see :mod:`depthcli.methods.stereo.on_device`."""
