"""The two views of a furnished room: which surface every ray hits, and in what light."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.data.generated.stage import Stage
from depthcli.data.generated.surfaces import Array, Surface, Vector

_AMBIENT = 0.45
_BAND = 32
_LIGHTMAP = 72


def _rays(stage: Stage, columns: Array, rows: Array, right: bool) -> tuple[Vector, Vector]:
    """(origin, direction) of the rays through pixel positions; t along them is the depth Z."""
    kind = np.result_type(columns, rows)
    one = np.ones((1, 1), kind)
    direction = ((columns - stage.center[0]) / stage.focal, (rows - stage.center[1]) / stage.focal, one)
    return (one * right, one * 0, one * 0), direction


def trace(stage: Stage, columns: Array, rows: Array, right: bool) -> tuple[Array, NDArray[np.int16]]:
    """Depth and index of the nearest surface along rays: ``columns`` (1, W) or (H, W), ``rows`` (H, 1)."""
    shape = np.broadcast_shapes(columns.shape, rows.shape)
    depth = np.full(shape, np.inf, np.result_type(columns, rows))
    owner = np.full(shape, -1, np.int16)
    for index, surface in enumerate(stage.surfaces):
        bounds = _bounds(stage, surface, right)
        y = np.flatnonzero((rows[:, 0] >= bounds[2]) & (rows[:, 0] <= bounds[3]))
        x = (
            np.flatnonzero((columns[0] >= bounds[0]) & (columns[0] <= bounds[1]))
            if columns.shape[0] == 1
            else np.arange(shape[1])
        )
        if not y.size or not x.size:
            continue
        part = np.s_[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
        some_columns = columns[:, part[1]] if columns.shape[0] == 1 else columns[part]
        t = surface.hit(*_rays(stage, some_columns, rows[part[0]], right))
        closer = t < depth[part]
        depth[part][closer] = t[closer]
        owner[part][closer] = index
    return depth, owner


def _bounds(stage: Stage, surface: Surface, right: bool) -> tuple[float, float, float, float]:
    """Pixels that a surface can cover: first and last column, first and last row."""
    if surface.unbounded:
        return -np.inf, np.inf, -np.inf, np.inf
    corners = surface.corners()
    columns = (corners[:, 0] - right) / corners[:, 2] * stage.focal + stage.center[0]
    rows = corners[:, 1] / corners[:, 2] * stage.focal + stage.center[1]
    return columns.min() - 1, columns.max() + 1, rows.min() - 1, rows.max() + 1


def light_maps(stage: Stage) -> list[NDArray[np.float32] | None]:
    """The light on every plane, as :func:`render` wants it; None for other shapes."""
    return [_lightmap(stage, i) if s.shape == "plane" else None for i, s in enumerate(stage.surfaces)]


def _lightmap(stage: Stage, index: int) -> NDArray[np.float32]:
    """Light on a plane, with the soft shadows of the other surfaces, over its square: (n, n) float32."""
    surface = stage.surfaces[index]
    side = np.linspace(-1, 1, _LIGHTMAP)
    a, b = np.meshgrid(side * surface.half_size[0], side * surface.half_size[1])
    x, y, z = (surface.center[i] + a * surface.axes[0, i] + b * surface.axes[1, i] for i in range(3))
    to_light: Vector = (stage.light[0] - x, stage.light[1] - y, stage.light[2] - z)
    length = np.sqrt(to_light[0] ** 2 + to_light[1] ** 2 + to_light[2] ** 2)
    normal = surface.axes[2]
    facing = np.abs(normal[0] * to_light[0] + normal[1] * to_light[1] + normal[2] * to_light[2]) / length
    lit = np.ones_like(facing)
    for other, caster in enumerate(stage.surfaces):
        if other != index and not caster.unbounded:
            t = caster.hit((x, y, z), to_light)
            lit[(t > 1e-3) & (t < 1)] = 0.0
    soft = cv2.GaussianBlur(lit, (0, 0), 1.3) if not lit.all() else lit
    return np.asarray(_AMBIENT + (1.15 - _AMBIENT) * np.sqrt(facing) * (0.35 + 0.65 * soft), np.float32)


def render(stage: Stage, lightmaps: list[NDArray[np.float32] | None], right: bool, rays: int) -> NDArray[np.float32]:
    """One view, (H, W, 3) float32, nominally in [0, 1]."""
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    columns = (np.arange(stage.width)[:, None] + offsets).ravel()[None].astype(np.float32)
    image = np.empty((stage.height, stage.width, 3), np.float32)
    for top in range(0, stage.height, _BAND):
        bottom = min(top + _BAND, stage.height)
        rows = (np.arange(top, bottom)[:, None] + offsets).ravel()[:, None].astype(np.float32)
        depth, owner = trace(stage, columns, rows, right)
        colors = np.zeros((*owner.shape, 3), np.float32)
        for index, surface in enumerate(stage.surfaces):
            mine = owner == index
            y, x = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
            if not y.size:
                continue
            part = np.s_[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
            (ox, _, _), (dx, dy, _) = _rays(stage, columns[:, part[1]], rows[part[0]], right)
            z = depth[part]
            shaded = _shade(stage, surface, lightmaps[index], (ox + z * dx, z * dy, z))
            colors[part][mine[part]] = shaded[mine[part]]
            if surface.gloss and stage.surroundings is not None:
                mirrored = np.repeat(np.repeat(stage.surroundings[top:bottom], rays, axis=0), rays, axis=1)
                colors[mine] += np.float32(surface.gloss) * mirrored[mine]
        image[top:bottom] = cv2.resize(colors, (stage.width, bottom - top), interpolation=cv2.INTER_AREA)
    return image


def _shade(stage: Stage, surface: Surface, lightmap: NDArray[np.float32] | None, point: Vector) -> NDArray[np.float32]:
    """Colors of points that lie on a surface (others in the rectangle get some color)."""
    column, row = surface.picture_position(point)
    # Rays of the rectangle that hit something else can lie far off, beyond what remap can index.
    column, row = np.clip(column, -20000, 20000), np.clip(row, -20000, 20000)
    paint = cv2.remap(surface.texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    if lightmap is not None:
        height, width = surface.texture.shape[:2]
        side = _LIGHTMAP - 1
        light = cv2.remap(
            lightmap,
            column * np.float32(side / max(width - 1, 1)),
            row * np.float32(side / max(height - 1, 1)),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    else:
        nx, ny, nz = surface.normal(point)
        lx, ly, lz = (np.float32(stage.light[i]) - point[i] for i in range(3))
        facing = np.maximum(0.0, (nx * lx + ny * ly + nz * lz) / np.sqrt(lx * lx + ly * ly + lz * lz))
        light = np.asarray(_AMBIENT + (1.15 - _AMBIENT) * np.sqrt(facing), np.float32)
    shaded: NDArray[np.float32] = np.asarray(paint * light[:, :, None], np.float32)
    return shaded
