"""Twins of the refinement steps for devices; see :mod:`depthcli.stereo.on_device`."""
