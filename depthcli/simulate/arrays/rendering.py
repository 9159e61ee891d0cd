"""The two views of a furnished room: which surface every ray hits, and in what light."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.simulate.arrays.room import Room
from depthcli.simulate.arrays.surfaces import Array, Surface, Vector

_AMBIENT_LIGHT = 0.45  # share of the brightness that needs no lamp; set by eye
_BAND_ROWS = 32  # rendered at a time, which bounds the memory
_LIGHTMAP_SIDE = 72  # samples of the light on a plane along each side; shadows are blurred


def _rays(room: Room, columns: Array, rows: Array, right: bool) -> tuple[Vector, Vector]:
    """(origin, direction) of the rays through pixel positions; t along them is the depth Z."""
    kind = np.result_type(columns, rows)
    one = np.ones((1, 1), kind)
    direction = ((columns - room.center[0]) / room.focal, (rows - room.center[1]) / room.focal, one)
    return (one * right, one * 0, one * 0), direction


def trace(room: Room, columns: Array, rows: Array, right: bool) -> tuple[Array, NDArray[np.int16]]:
    """Return depth and index of the nearest surface along rays: ``columns`` (1, W) or (H, W), ``rows`` (H, 1)."""
    shape = np.broadcast_shapes(columns.shape, rows.shape)
    depth = np.full(shape, np.inf, np.result_type(columns, rows))
    owner = np.full(shape, -1, np.int16)
    for index, surface in enumerate(room.surfaces):
        bounds = _bounds(room, surface, right)
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
        t = surface.hit(*_rays(room, some_columns, rows[part[0]], right))
        closer = t < depth[part]
        depth[part][closer] = t[closer]
        owner[part][closer] = index
    return depth, owner


def _bounds(room: Room, surface: Surface, right: bool) -> tuple[float, float, float, float]:
    """Pixels that a surface can cover: first and last column, first and last row."""
    if surface.unbounded:
        return -np.inf, np.inf, -np.inf, np.inf
    corners = surface.corners()
    columns = (corners[:, 0] - right) / corners[:, 2] * room.focal + room.center[0]
    rows = corners[:, 1] / corners[:, 2] * room.focal + room.center[1]
    return columns.min() - 1, columns.max() + 1, rows.min() - 1, rows.max() + 1


def light_maps(room: Room) -> list[NDArray[np.float32] | None]:
    """Return the light on every plane, as :func:`render` wants it; None for other shapes."""
    return [_lightmap(room, i) if s.shape == "plane" else None for i, s in enumerate(room.surfaces)]


def _lightmap(room: Room, index: int) -> NDArray[np.float32]:
    """Light on a plane, with the soft shadows of the other surfaces, over its square: (n, n) float32."""
    surface = room.surfaces[index]
    side = np.linspace(-1, 1, _LIGHTMAP_SIDE)
    a, b = np.meshgrid(side * surface.half_size[0], side * surface.half_size[1])
    x, y, z = (surface.center[i] + a * surface.axes[0, i] + b * surface.axes[1, i] for i in range(3))
    to_light: Vector = (room.light[0] - x, room.light[1] - y, room.light[2] - z)
    length = np.sqrt(to_light[0] ** 2 + to_light[1] ** 2 + to_light[2] ** 2)
    normal = surface.axes[2]
    facing = np.abs(normal[0] * to_light[0] + normal[1] * to_light[1] + normal[2] * to_light[2]) / length
    lit = np.ones_like(facing)
    for other, caster in enumerate(room.surfaces):
        if other != index and not caster.unbounded:
            t = caster.hit((x, y, z), to_light)
            lit[(t > 1e-3) & (t < 1)] = 0.0
    soft = cv2.GaussianBlur(lit, (0, 0), 1.3) if not lit.all() else lit
    return np.asarray(_AMBIENT_LIGHT + (1.15 - _AMBIENT_LIGHT) * np.sqrt(facing) * (0.35 + 0.65 * soft), np.float32)


def render(room: Room, lightmaps: list[NDArray[np.float32] | None], right: bool, rays: int) -> NDArray[np.float32]:
    """Return one view, (H, W, 3) float32, nominally in [0, 1]."""
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    columns = (np.arange(room.width)[:, None] + offsets).ravel()[None].astype(np.float32)
    image = np.empty((room.height, room.width, 3), np.float32)
    for top in range(0, room.height, _BAND_ROWS):
        bottom = min(top + _BAND_ROWS, room.height)
        rows = (np.arange(top, bottom)[:, None] + offsets).ravel()[:, None].astype(np.float32)
        depth, owner = trace(room, columns, rows, right)
        colors = np.zeros((*owner.shape, 3), np.float32)
        for index, surface in enumerate(room.surfaces):
            mine = owner == index
            y, x = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
            if not y.size:
                continue
            part = np.s_[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
            (ox, _, _), (dx, dy, _) = _rays(room, columns[:, part[1]], rows[part[0]], right)
            z = depth[part]
            shaded = _shade(room, surface, lightmaps[index], (ox + z * dx, z * dy, z))
            colors[part][mine[part]] = shaded[mine[part]]
            if surface.gloss and room.surroundings is not None:
                mirrored = np.repeat(np.repeat(room.surroundings[top:bottom], rays, axis=0), rays, axis=1)
                colors[mine] += np.float32(surface.gloss) * mirrored[mine]
        image[top:bottom] = cv2.resize(colors, (room.width, bottom - top), interpolation=cv2.INTER_AREA)
    return image


def _shade(room: Room, surface: Surface, lightmap: NDArray[np.float32] | None, point: Vector) -> NDArray[np.float32]:
    """Colors of points that lie on a surface (others in the rectangle get some color)."""
    column, row = surface.picture_position(point)
    # Rays of the rectangle that hit something else can lie far off, beyond what remap can index.
    column, row = np.clip(column, -20000, 20000), np.clip(row, -20000, 20000)
    paint = cv2.remap(surface.texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    if lightmap is not None:
        y, x = (np.float32((_LIGHTMAP_SIDE - 1) / max(side - 1, 1)) for side in surface.texture.shape[:2])
        light = cv2.remap(lightmap, column * x, row * y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    else:
        nx, ny, nz = surface.normal(point)
        lx, ly, lz = (np.float32(room.light[i]) - point[i] for i in range(3))
        facing = np.maximum(0.0, (nx * lx + ny * ly + nz * lz) / np.sqrt(lx * lx + ly * ly + lz * lz))
        light = np.asarray(_AMBIENT_LIGHT + (1.15 - _AMBIENT_LIGHT) * np.sqrt(facing), np.float32)
    shaded: NDArray[np.float32] = np.asarray(paint * light[:, :, None], np.float32)
    return shaded
