"""Rooms of analytic surfaces, furnished by positions in the left image.

World frame: X right, Y down, Z forward; the left camera at the origin, the right one at (1, 0, 0), so
that lengths are in baselines and a point at depth Z has disparity ``f / Z`` (f in pixels).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Doubles, Floats, Mask
from depthcli.simulate import textures
from depthcli.simulate.textures import TextureMaker

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
    gloss: float = 0.0  # share of the mirrored far surroundings, which appear at the same pixel in both views

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
        """Return a picture for a surface of (width, height) baselines, with one texel per pixel at ``disparity``."""
        columns, rows = (int(np.clip(round(s * disparity), 8, 4096)) for s in size)
        return maker(self.rng, rows, columns, self.feature * feature)

    def pick(self, makers: tuple[TextureMaker, ...] = textures.OBJECT_TEXTURES) -> TextureMaker:
        """Return one of the functions that make textures."""
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
