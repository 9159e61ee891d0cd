"""Limits of point clouds: what the commands that write them have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError


def check_limits(near: float, far: float | None) -> None:
    """Raise ConfigError where no depth lies between ``--near`` and ``--far``, meters; ``far`` None: no limit."""
    if far is not None and near >= far:
        raise ConfigError(f"--near {near:g}, --far {far:g}: no depth lies between them")


def empty_cloud(depth: NDArray[np.float32], cloud: NDArray[np.bool_]) -> list[str]:
    """Return a warning where none of the pixels ``cloud`` has a depth, else no line."""
    known = np.isfinite(depth)
    if np.any(known & cloud):
        return []
    if not known.any():
        return ["points.ply has no points: no depth is known"]
    low, high = float(depth[known].min()), float(depth[known].max())
    return [f"points.ply has no points, the depths are {low:.3g} to {high:.3g} m; see --near, --far, --mask"]
