"""Rooms of analytic surfaces, and their two views: which surface every ray hits, and in what light.

World frame: X right, Y down, Z forward; the left camera at the origin, the right one at (1, 0, 0), so
that lengths are in baselines and a point at depth Z has disparity ``f / Z`` (f in pixels).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.arrays import Doubles, Floats, Image8, Mask
from depthcli.simulate import textures
from depthcli.simulate.textures import TextureMaker

_AMBIENT_LIGHT = 0.45  # share of the brightness that needs no lamp; set by eye
_BAND_ROWS = 32  # rendered at a time, which bounds the memory
_LIGHTMAP_SIDE = 72  # samples of the light on a plane along each side; shadows are blurred
Array = NDArray[Any]
Vector = tuple[Array, Array, Array]
Outline = Callable[[Array, Array], Mask]
Shape = Literal["plane", "sphere", "cylinder", "cone"]


def rotation(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> Doubles:
    """Return the local axes in the world, rows of (3, 3) float64; radians about Y, X and Z, in this order."""
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray((about_y @ about_x @ about_z).T)


@dataclass(frozen=True, eq=False)
class Surface:
    """One textured surface.

    In its own frame, scaled by ``half_size``, it is the plane square ``|x|, |y| <= 1, z = 0``, the unit
    sphere, the unit cylinder ``|y| <= 1`` or the cone from the apex ``y = -1`` to the unit circle at
    ``y = 1``; its picture is stretched over (x, y), or over the angle (seam behind) and y.
    """

    shape: Shape
    center: Doubles  # (3,), world
    axes: Doubles  # (3, 3), rows = local axes in the world; local -z faces the camera
    half_size: Doubles  # (3,), baselines
    texture: Floats
    outline: Outline | None = None  # which (x, y) of a plane belong to it; None = the whole square
    unbounded: bool = False  # an infinite plane (its picture is repeated, mirrored each time)
    period: float = 0.0  # width of one repetition of the picture along local x, in baselines; 0 = none
    gloss: float = 0.0  # share of the far surroundings that is mirrored; they lie at the same pixel of both views

    def local(self, vector: Vector, point: bool = True) -> Vector:
        """Return world points (or, with ``point=False``, directions) in the scaled local frame."""
        kind = np.result_type(*vector)
        rows = (self.axes / self.half_size[:, None]).astype(kind)
        shift = (self.axes @ self.center / self.half_size if point else np.zeros(3)).astype(kind)
        x, y, z = vector
        a, b, c = (rows[i, 0] * x + (rows[i, 1] * y + (rows[i, 2] * z - shift[i])) for i in range(3))
        return a, b, c

    def hit(self, origin: Vector, direction: Vector) -> Array:
        """Return the smallest t > 0 with ``origin + t * direction`` on the surface; inf where the ray misses it."""
        o, d = self.local(origin), self.local(direction, point=False)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if self.shape == "plane":
                t = -o[2] / d[2]
                if self.unbounded:
                    inside = t > 0
                else:
                    x, y = o[0] + t * d[0], o[1] + t * d[1]
                    inside = (np.abs(x) <= 1) & (np.abs(y) <= 1) & (t > 0)
                    if self.outline is not None:
                        inside &= self.outline(x, y)
                return np.where(inside, t, np.inf)
            weight = {"sphere": 1.0, "cylinder": 0.0, "cone": -0.25}[self.shape]
            apex = o[1] + 1 if self.shape == "cone" else o[1]
            a = d[0] * d[0] + d[2] * d[2] + weight * d[1] * d[1]
            b = o[0] * d[0] + o[2] * d[2] + weight * apex * d[1]
            c = o[0] * o[0] + o[2] * o[2] + weight * apex * apex - (0 if self.shape == "cone" else 1)
            root = np.sqrt(b * b - a * c)
            near, far = (-b - root) / a, (-b + root) / a
            near, far = np.minimum(near, far), np.maximum(near, far)
            if self.shape == "sphere":
                return np.where(near > 0, near, np.inf)
            near_ok = (np.abs(o[1] + near * d[1]) <= 1) & (near > 0)
            far_ok = (np.abs(o[1] + far * d[1]) <= 1) & (far > 0)
            return np.where(near_ok, near, np.where(far_ok, far, np.inf))

    def normal(self, point: Vector) -> Vector:
        """Return unit normals at world points of a sphere, cylinder or cone."""
        a, b, c = self.local(point)
        if self.shape == "cylinder":
            b = np.zeros_like(b)
        elif self.shape == "cone":
            b = -0.25 * (b + 1)
        rows = (self.axes / self.half_size[:, None]).astype(a.dtype)
        x, y, z = (rows[0, i] * a + rows[1, i] * b + rows[2, i] * c for i in range(3))
        length = np.sqrt(x * x + y * y + z * z) + 1e-12
        return x / length, y / length, z / length

    def corners(self) -> Doubles:
        """Return the (8, 3) world corners of a box around the surface."""
        signs = np.array(list(itertools.product((-1, 1), (-1, 1), (0, 0) if self.shape == "plane" else (-1, 1))), float)
        return np.asarray(self.center + (signs * self.half_size) @ self.axes)


@dataclass
class Room:
    """Surfaces, cameras and light; positions are given in left-image pixels and disparities."""

    rng: np.random.Generator
    width: int
    height: int
    max_disparity: int
    wall_contrast: float
    surfaces: list[Surface] = field(default_factory=list)
    surroundings: Floats | None = None

    def __post_init__(self) -> None:
        self.focal = 0.85 * self.width
        self.center = (self.width / 2 - 0.5, 0.3 * self.height)
        self.near = 0.9 * self.max_disparity
        self.far = self.max_disparity * self.rng.uniform(0.28, 0.36)
        self.feature = float(np.clip(self.width / 18, 7, 40))
        # The floor reaches the lower edge of the image at the nearest disparity allowed there.
        self.floor = (self.height - self.center[1]) / (0.8 * self.max_disparity)
        light = (-0.35 * self.width, -1.1 * self.height)
        self.light = np.array([light[0] / self.far, light[1] / self.far, 0.35 * self.focal / self.near])

    def at(self, x: float, y: float, disparity: float) -> Doubles:
        """Return the world point that the left camera sees at pixel (x, y) with this disparity."""
        return np.array([x - self.center[0], y - self.center[1], self.focal]) / disparity

    def above_floor(self, x: float, disparity: float, height: float) -> Doubles:
        """Return the world point at column x and this disparity, ``height`` baselines above the floor."""
        point = self.at(x, 0, disparity)
        point[1] = self.floor - height
        return point

    def paint(self, maker: TextureMaker, size: tuple[float, float], disparity: float, feature: float = 1.0) -> Floats:
        """Return a picture for a surface of this (width, height) in baselines: one texel a pixel at ``disparity``."""
        columns, rows = (int(np.clip(round(s * disparity), 8, 4096)) for s in size)
        return maker(self.rng, rows, columns, self.feature * feature)

    def pick(self, makers: tuple[TextureMaker, ...] = textures.OBJECT_TEXTURES) -> TextureMaker:
        """Return one of the makers of textures."""
        return makers[int(self.rng.integers(len(makers)))]

    def faded(self, picture: Floats) -> Floats:
        """Return a wall's picture with the contrast ``wall_contrast``."""
        mean = picture.mean(axis=(0, 1), keepdims=True)
        return np.asarray(mean + self.wall_contrast * (picture - mean), np.float32)

    def plane(self, center: Array, axes: Array, size: tuple[float, float], picture: Floats, **more: Any) -> None:
        """Add a rectangle of this (width, height) in baselines; ``more`` are attributes of :class:`Surface`."""
        self.surfaces.append(Surface("plane", center, axes, np.array([*size, 2.0]) / 2, picture, **more))

    def board(
        self,
        x: float,
        y: float,
        disparity: float,
        size: tuple[float, float],
        turn: Doubles,
        outline: Outline | None = None,
        maker: TextureMaker | None = None,
    ) -> None:
        """Add a flat board centered at a pixel; ``size`` in pixels."""
        wide, tall = size[0] / disparity, size[1] / disparity
        picture = self.paint(maker or self.pick(), (wide, tall), disparity)
        self.plane(self.at(x, y, disparity), turn, (wide, tall), picture, outline=outline)
        self._move_back()

    def stand(self, shape: Shape, x: float, disparity: float, size: tuple[float, float]) -> None:
        """Add a ball, a cone or an open cylinder on the floor; ``size`` (radius, height) in pixels."""
        r, tall = size[0] / disparity, size[1] / disparity
        picture = self.paint(self.pick(), (2 * np.pi * r, np.pi * r if shape == "sphere" else tall), disparity)
        turn = rotation(roll=self.rng.uniform(-0.5, 0.5)) if shape == "sphere" else rotation()
        center, half = self.above_floor(x, disparity, tall / 2), np.array([r, tall / 2, r])
        self.surfaces.append(Surface(shape, center, turn, half, picture))
        self._move_back()

    def _move_back(self) -> None:
        """Move the last surface back where it comes nearer than the search range allows."""
        last = self.surfaces[-1]
        short = self.focal / (0.97 * self.max_disparity) - float(last.corners()[:, 2].min())
        if short > 0:
            self.surfaces[-1] = replace(last, center=last.center + np.array([0.0, 0.0, short]))

    def box(
        self,
        x: float,
        disparity: float,
        size: tuple[float, float, float],
        maker: TextureMaker | None = None,
        yaw: float | None = None,
        gloss: float = 0.0,
    ) -> None:
        """Add a box on the floor, turned about its upright axis; ``size`` (width, height, depth) in pixels."""
        wide, tall, deep = (s / disparity for s in size)
        turn = rotation(self.rng.uniform(-0.6, 0.6) if yaw is None else yaw)
        maker = maker or self.pick()
        middle = self.above_floor(x, disparity, tall / 2)
        reach = 0.5 * (abs(turn[0, 2]) * wide + abs(turn[2, 2]) * deep)
        middle[2] += max(0.0, self.focal / (0.97 * self.max_disparity) - (middle[2] - reach))
        quarter, up = rotation(np.pi / 2), rotation(pitch=np.pi / 2)
        for axes, side, shift in (
            (turn, (wide, tall), -turn[2] * deep / 2),
            (quarter @ turn, (deep, tall), -(quarter @ turn)[2] * wide / 2),
            (quarter.T @ turn, (deep, tall), -(quarter.T @ turn)[2] * wide / 2),
            (up @ turn, (wide, deep), np.array([0.0, -tall / 2, 0.0])),
        ):
            self.plane(middle + shift, axes, side, self.paint(maker, side, disparity), gloss=gloss)

    def spread(self, count: int) -> list[tuple[float, float]]:
        """Return (column, disparity) of ``count`` places side by side, at mixed depths."""
        columns = (np.arange(count) + self.rng.uniform(0.25, 0.75, count)) / count * self.width
        depths = self.far + (self.near - self.far) * (self.rng.permutation(count) + 0.6) / (count + 0.4)
        return [(float(x), float(d)) for x, d in zip(columns, depths, strict=True)]

    def add_walls(self) -> None:
        """Add floor and back wall, and sometimes a side wall, which comes forward out of the picture."""
        yaw, tall = self.rng.uniform(-0.25, 0.25), 1.5 * self.height / self.far
        size = (2 * (0.75 * self.width / self.far + 2), tall)
        picture = self.faded(self.paint(self.pick(textures.WALL_TEXTURES), size, self.far * 1.2))
        center = np.array([0.0, 0.0, self.focal / self.far])
        self.plane(center, rotation(yaw), size, picture, unbounded=True)
        self.add_floor()
        if self.rng.random() >= 0.5:
            return
        on_right = self.rng.random() < 0.5
        near, share = 0.7 * self.max_disparity, self.rng.uniform(0.08, 0.2)
        if on_right:  # at its edge, in both views, still within the range
            first, last = self.at(self.width * (1 - share), 0, self.far), self.at(self.width + near, 0, near)
        else:
            first, last = self.at(0, 0, near), self.at(self.width * share, 0, self.far)
        along, middle = last - first, (first + last) / 2
        middle[1] = 0.0
        size = (2 * float(np.hypot(along[0], along[2])), tall)
        picture = self.faded(self.paint(self.pick(textures.WALL_TEXTURES), size, self.far * 1.2))
        self.plane(middle, rotation(-np.arctan2(along[2], along[0])), size, picture, unbounded=True)

    def add_floor(self) -> None:
        """Add the floor."""
        deep, near = self.focal / self.far, self.focal / self.max_disparity
        wide, long = 1.5 * self.width / self.far, (deep - near) * 1.2
        picture = self.paint(self.pick(textures.FLOOR_TEXTURES), (wide, 0.6 * long), self.far * 1.5, 1.3)
        center = np.array([0.5, self.floor, (deep + near) / 2])
        self.plane(center, rotation(pitch=np.pi / 2), (wide, long), picture, unbounded=True)


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
    """Return the left and the right view, (H, W, 3) float32, nominally in [0, 1], of ``rays`` x ``rays`` a pixel."""
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
    """Return the colors of points that lie on a surface (others in the rectangle get some color)."""
    x, y, z = surface.local(point)
    if surface.shape != "plane":
        x = np.arctan2(x, -z) / np.pi
        if surface.shape == "sphere":
            y = np.arcsin(np.clip(y, -1, 1)) * (2 / np.pi)
    height, width = surface.texture.shape[:2]
    column, row = (((part + 1) * ((size - 1) / 2)).astype(np.float32) for part, size in ((x, width), (y, height)))
    # Rays of the rectangle that hit something else can lie far off, beyond what remap can index.
    column, row = np.clip(column, -20000, 20000), np.clip(row, -20000, 20000)
    paint = cv2.remap(surface.texture, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    if light_map is not None:
        down, across = (np.float32((_LIGHTMAP_SIDE - 1) / max(side - 1, 1)) for side in (height, width))
        light = cv2.remap(light_map, column * across, row * down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    else:
        lx, ly, lz = (np.float32(room.light[i]) - point[i] for i in range(3))
        light = _light(np.maximum(0.0, _facing(surface.normal(point), (lx, ly, lz))))
    return np.asarray(paint * light[:, :, None], np.float32)
