"""Twins of the refinement steps for devices; see :mod:`depthcli.methods.stereo.on_device`."""
