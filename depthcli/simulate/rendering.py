"""Rendering of the two views of a room: the surface that every ray hits, and its light."""

from __future__ import annotations

import itertools
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Floats, Image8
from depthcli.simulate.room import Array, Room, Surface, Vector

_AMBIENT_LIGHT = 0.45  # share of the brightness that needs no lamp; set by eye
_BAND_ROWS = 32  # rendered at a time, which bounds the memory
_LIGHTMAP_SIDE = 72  # samples of the light on a plane along each side; shadows are blurred


def _rays(room: Room, columns: Array, rows: Array, right: bool) -> tuple[Vector, Vector]:
    """Return origin and direction of the rays through pixel positions; t along them is the depth Z."""
    kind = np.result_type(columns, rows)
    one = np.ones((1, 1), kind)
    direction = ((columns - room.center[0]) / room.focal, (rows - room.center[1]) / room.focal, one)
    return (one * right, one * 0, one * 0), direction


def disparities(room: Room, right: bool = False) -> tuple[Array, NDArray[np.int16]]:
    """Return disparity and index of the surface at the centers of one view's pixels, (H, W) float64 and int16."""
    columns, rows = np.arange(room.width, dtype=np.float64)[None], np.arange(room.height, dtype=np.float64)[:, None]
    depth, owner = trace(room, columns, rows, right)
    return room.focal / depth, owner


def levels8(image: Array) -> Image8:
    """Return grey levels as 8-bit numbers."""
    return np.asarray(np.clip(np.rint(image), 0, 255), np.uint8)


def trace(room: Room, columns: Array, rows: Array, right: bool) -> tuple[Array, NDArray[np.int16]]:
    """Return depth and index of the nearest surface along rays: ``columns`` (1, W) or (H, W), ``rows`` (H, 1)."""
    shape = np.broadcast_shapes(columns.shape, rows.shape)
    depth = np.full(shape, np.inf, np.result_type(columns, rows))
    owner = np.full(shape, -1, np.int16)
    for index, surface in enumerate(room.surfaces):
        bounds = (-np.inf, np.inf, -np.inf, np.inf)  # first and last column, first and last row
        if not surface.unbounded:
            corners = surface.corners()
            u = (corners[:, 0] - right) / corners[:, 2] * room.focal + room.center[0]
            v = corners[:, 1] / corners[:, 2] * room.focal + room.center[1]
            bounds = (u.min() - 1, u.max() + 1, v.min() - 1, v.max() + 1)
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


def render(room: Room, rays: int) -> tuple[Floats, Floats]:
    """Return the left and the right view, (H, W, 3) float32, nominally in [0, 1], ``rays`` x ``rays`` per pixel."""
    light_maps = [_light_map(room, each) if each.shape == "plane" else None for each in room.surfaces]
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    columns = (np.arange(room.width)[:, None] + offsets).ravel()[None].astype(np.float32)
    views = [np.empty((room.height, room.width, 3), np.float32) for _ in range(2)]
    for view, top in itertools.product((0, 1), range(0, room.height, _BAND_ROWS)):
        bottom = min(top + _BAND_ROWS, room.height)
        rows = (np.arange(top, bottom)[:, None] + offsets).ravel()[:, None].astype(np.float32)
        depth, owner = trace(room, columns, rows, bool(view))
        colors = np.zeros((*owner.shape, 3), np.float32)
        for index, (surface, light_map) in enumerate(zip(room.surfaces, light_maps, strict=True)):
            mine = owner == index
            y, x = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
            if not y.size:
                continue
            part = np.s_[y[0] : y[-1] + 1, x[0] : x[-1] + 1]
            (ox, _, _), (dx, dy, _) = _rays(room, columns[:, part[1]], rows[part[0]], bool(view))
            z = depth[part]
            shaded = _shade(room, surface, light_map, (ox + z * dx, z * dy, z))
            colors[part][mine[part]] = shaded[mine[part]]
            if surface.gloss and room.surroundings is not None:
                mirrored = np.repeat(np.repeat(room.surroundings[top:bottom], rays, axis=0), rays, axis=1)
                colors[mine] += np.float32(surface.gloss) * mirrored[mine]
        views[view][top:bottom] = cv2.resize(colors, (room.width, bottom - top), interpolation=cv2.INTER_AREA)
    return views[0], views[1]


def _light_map(room: Room, plane: Surface) -> Floats:
    """Return the light on the square of a plane, with the soft shadows on it, (n, n) float32."""
    side = np.linspace(-1, 1, _LIGHTMAP_SIDE)
    a, b = np.meshgrid(side * plane.half_size[0], side * plane.half_size[1])
    x, y, z = (plane.center[i] + a * plane.axes[0, i] + b * plane.axes[1, i] for i in range(3))
    to_light: Vector = (room.light[0] - x, room.light[1] - y, room.light[2] - z)
    lit = np.ones_like(x)
    for caster in room.surfaces:
        if caster is not plane and not caster.unbounded:
            t = caster.hit((x, y, z), to_light)
            lit[(t > 1e-3) & (t < 1)] = 0.0
    soft = cv2.GaussianBlur(lit, (0, 0), 1.3) if not lit.all() else lit
    return _light(np.abs(_facing(plane.axes[2], to_light)), 0.35 + 0.65 * soft)


def _facing(normal: Any, to_light: Vector) -> Array:
    x, y, z = to_light
    return np.asarray((normal[0] * x + normal[1] * y + normal[2] * z) / np.sqrt(x * x + y * y + z * z))


def _light(facing: Array, lit: Array | float = 1.0) -> Floats:
    """Return the light on points that face the lamp, by the cosine ``facing``, and get the share ``lit`` of it."""
    return np.asarray(_AMBIENT_LIGHT + (1.15 - _AMBIENT_LIGHT) * np.sqrt(facing) * lit, np.float32)


def _shade(room: Room, surface: Surface, light_map: Floats | None, point: Vector) -> Floats:
    """Return the colors of the points on a surface (other points in the rectangle get an arbitrary color)."""
    x, y, z = surface.local(point)
    if surface.shape != "plane":
        x = np.arctan2(x, -z) / np.pi
        if surface.shape == "sphere":
            y = np.arcsin(np.clip(y, -1, 1)) * (2 / np.pi)
    height, width = surface.texture.shape[:2]
    column, row = (((part + 1) * ((size - 1) / 2)).astype(np.float32) for part, size in ((x, width), (y, height)))
    # Rays that hit another surface can be far outside the picture, beyond the indices that remap supports.
    column, row = np.clip(column, -20000, 20000), np.clip(row, -20000, 20000)
    paint = cv2.remap(surface.texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    if light_map is not None:
        down, across = (np.float32((_LIGHTMAP_SIDE - 1) / max(side - 1, 1)) for side in (height, width))
        light = cv2.remap(light_map, column * across, row * down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    else:
        lx, ly, lz = (np.float32(room.light[i]) - point[i] for i in range(3))
        light = _light(np.maximum(0.0, _facing(surface.normal(point), (lx, ly, lz))))
    return np.asarray(paint * light[:, :, None], np.float32)
