"""Point clouds, and what the result classes have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, color8
from depthcli.core.maps import DepthMap, MatchedMap
from depthcli.io.formats.depth import write_points


@dataclass(frozen=True, eq=False, repr=False)
class PointCloud:
    """Points in the frame of a camera: x right, y down, z forward.

    Attributes
    ----------
    points : (N, 3) float32, meters
    color : (N, 3) uint8, RGB
    """

    points: NDArray[np.float32]
    color: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points)"

    def save(self, path: str | Path) -> None:
        """Write the points as PLY, binary little endian; OutputError where that cannot be."""
        write_points(path, self.points, self.color)


def chosen_pixels(mask: str | ArrayLike, named: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return the pixels that a mask chooses, by one of the names or as an array of their shape."""
    if isinstance(mask, str):
        if mask not in named:
            raise ConfigError(f"mask: must be {', '.join(named)}, or an array of bool (got {mask!r})")
        return named[mask]
    pixels, shape = np.asarray(mask), next(iter(named.values())).shape
    if pixels.shape != shape or pixels.dtype != np.bool_:
        raise InputError(f"mask: want bool of shape {shape} (got {pixels.dtype} {pixels.shape})")
    return pixels


def points_of(
    depth: NDArray[np.float32],
    camera: Intrinsics,
    image: Image,
    chosen: NDArray[np.bool_],
    near: float,
    far: float,
) -> PointCloud:
    """Return the colored points of the chosen pixels from ``near`` to ``far``, meters."""
    chosen = chosen & (depth >= near) & (depth <= far)
    return PointCloud(camera.points(depth, chosen), color8(image)[chosen])


def shown_range(values: NDArray[np.float32], unit: str) -> str:
    """Return the smallest and largest value as text."""
    known = values[np.isfinite(values)]
    return f"{known.min():.4g} to {known.max():.4g} {unit}" if known.size else "no value"


def described(found: MatchedMap | DepthMap, text: str) -> str:
    """Return the ``repr`` of a map: class, size, ``text`` and density."""
    height, width = found.values.shape
    return f"{type(found).__name__}({width} x {height}, {text}, {100 * found.density:.1f} % with a value)"
