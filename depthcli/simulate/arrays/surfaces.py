"""Analytic surfaces and the rays that meet them.

World frame: X right, Y down, Z forward; the left camera at the origin, the right one at (1, 0, 0), so
that lengths are in baselines and a point at depth Z has disparity ``f / Z`` (f in pixels).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Vector = tuple[Array, Array, Array]
Outline = Callable[[Array, Array], NDArray[np.bool_]]
Shape = Literal["plane", "sphere", "cylinder", "cone"]


def rotation(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> NDArray[np.float64]:
    """(3, 3) float64 rows = local axes in the world; angles in radians about Y, X and Z, in this order."""
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    rows: NDArray[np.float64] = (about_y @ about_x @ about_z).T
    return rows


@dataclass(frozen=True, eq=False)
class Surface:
    """One textured surface.

    In its own frame, scaled by ``half_size``, it is the plane square ``|x|, |y| <= 1, z = 0``, the unit
    sphere, the unit cylinder ``|y| <= 1`` or the cone from the apex ``y = -1`` to the unit circle at
    ``y = 1``; its picture is stretched over (x, y), or over the angle (seam behind) and y.

    Attributes
    ----------
    center : (3,) float64, world
    axes : (3, 3) float64, rows = local axes in the world; local -z faces the camera
    half_size : (3,) float64, baselines
    texture : (h, w, 3) float32 RGB in [0, 1]
    outline : which (x, y) of a plane belong to it; None = the whole square
    unbounded : an infinite plane (its picture is repeated, mirrored each time)
    period : width of one repetition of the picture along local x, in baselines; 0 = does not repeat
    gloss : share of the far surroundings that is mirrored; they lie at the same pixel of both views
    """

    shape: Shape
    center: NDArray[np.float64]
    axes: NDArray[np.float64]
    half_size: NDArray[np.float64]
    texture: NDArray[np.float32]
    outline: Outline | None = None
    unbounded: bool = False
    period: float = 0.0
    gloss: float = 0.0

    def local(self, vector: Vector, point: bool = True) -> Vector:
        """World points (or, with ``point=False``, directions) in the scaled local frame."""
        shift = self.axes @ self.center if point else np.zeros(3)
        rows = self.axes / self.half_size[:, None]
        shift = shift / self.half_size
        x, y, z = vector
        kind = np.result_type(x, y, z)
        rows, shift = rows.astype(kind), shift.astype(kind)
        a, b, c = (rows[i, 0] * x + (rows[i, 1] * y + (rows[i, 2] * z - shift[i])) for i in range(3))
        return a, b, c

    def hit(self, origin: Vector, direction: Vector) -> Array:
        """Smallest t > 0 with ``origin + t * direction`` on the surface; inf where the ray misses it."""
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
            return self._hit_quadric(o, d)

    def _hit_quadric(self, o: Vector, d: Vector) -> Array:
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

    def picture_position(self, point: Vector) -> tuple[Array, Array]:
        """World points on the surface -> (column, row) of the texture, float32."""
        x, y, z = self.local(point)
        if self.shape != "plane":
            x = np.arctan2(x, -z) / np.pi
            if self.shape == "sphere":
                y = np.arcsin(np.clip(y, -1, 1)) * (2 / np.pi)
        height, width = self.texture.shape[:2]
        column, row = (x + 1) * ((width - 1) / 2), (y + 1) * ((height - 1) / 2)
        return column.astype(np.float32), row.astype(np.float32)

    def normal(self, point: Vector) -> Vector:
        """Unit normals at world points of the surface, turned to either side."""
        if self.shape == "plane":
            x, y, z = (self.axes[2, i] * np.ones_like(point[2]) for i in range(3))
            return x, y, z
        a, b, c = self.local(point)
        if self.shape == "cylinder":
            b = np.zeros_like(b)
        elif self.shape == "cone":
            b = -0.25 * (b + 1)
        rows = (self.axes / self.half_size[:, None]).astype(a.dtype)
        x, y, z = (rows[0, i] * a + rows[1, i] * b + rows[2, i] * c for i in range(3))
        length = np.sqrt(x * x + y * y + z * z) + 1e-12
        return x / length, y / length, z / length

    def corners(self) -> NDArray[np.float64]:
        """(8, 3) world corners of a box around the surface."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        if self.shape == "plane":
            signs[:, 2] = 0
        box: NDArray[np.float64] = self.center + (signs * self.half_size) @ self.axes
        return box
