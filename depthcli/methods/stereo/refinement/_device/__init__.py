"""Device implementations of the refinement steps; see :mod:`depthcli.methods.stereo.on_device`."""
