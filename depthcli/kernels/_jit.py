"""Former name of :mod:`depthcli.kernels.jit`."""

from depthcli.kernels.jit import *  # noqa: F403
