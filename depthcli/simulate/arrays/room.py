"""The room of a generated scene while it is furnished."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from depthcli.simulate.arrays import textures
from depthcli.simulate.arrays.surfaces import Outline, Shape, Surface, rotation
from depthcli.simulate.arrays.textures import Texture, TextureMaker


@dataclass
class Room:
    """Surfaces, cameras and light; positions are given in left-image pixels and disparities."""

    rng: np.random.Generator
    width: int
    height: int
    max_disparity: int
    wall_contrast: float
    surfaces: list[Surface] = field(default_factory=list)
    surroundings: Texture | None = None

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

    def at(self, x: float, y: float, disparity: float) -> NDArray[np.float64]:
        """Return the world point that the left camera sees at pixel (x, y) with this disparity."""
        return np.array([x - self.center[0], y - self.center[1], self.focal]) / disparity

    def on_floor(self, x: float, disparity: float) -> NDArray[np.float64]:
        """Return the world point of the floor at column x and this disparity."""
        point = self.at(x, 0, disparity)
        point[1] = self.floor
        return point

    def paint(self, maker: TextureMaker, size: tuple[float, float], disparity: float, feature: float = 1.0) -> Texture:
        """Return a picture for a surface of this (width, height) in baselines: one texel a pixel at ``disparity``."""
        columns, rows = (int(np.clip(round(s * disparity), 8, 4096)) for s in size)
        return maker(self.rng, rows, columns, self.feature * feature)

    def pick(self, makers: tuple[TextureMaker, ...]) -> TextureMaker:
        return makers[int(self.rng.integers(len(makers)))]

    def add(self, surface: Surface) -> None:
        """Add a finite surface, moved back where it would come nearer than the search range allows."""
        short = self.focal / (0.97 * self.max_disparity) - float(surface.corners()[:, 2].min())
        if short > 0:
            surface = replace(surface, center=surface.center + np.array([0.0, 0.0, short]))
        self.surfaces.append(surface)

    def add_walls(self, wall: TextureMaker | None = None) -> None:
        """Add floor and back wall, and sometimes a side wall."""
        yaw = self.rng.uniform(-0.25, 0.25)
        deep = self.focal / self.far
        half = np.array([0.75 * self.width / self.far + 2, 0.75 * self.height / self.far, 1.0])
        picture = self.paint(wall or self.pick(textures.WALL_TEXTURES), (2 * half[0], 2 * half[1]), self.far * 1.2)
        self.surfaces.append(
            Surface("plane", np.array([0.0, 0.0, deep]), rotation(yaw), half, self.faded(picture), unbounded=True)
        )
        self.lay_floor()
        if self.rng.random() < 0.5:
            self.side_wall(on_right=self.rng.random() < 0.5)

    def side_wall(self, on_right: bool) -> None:
        """Add a wall that comes forward out of the picture; at its edge (in both views) still within the range."""
        near, share = 0.7 * self.max_disparity, self.rng.uniform(0.08, 0.2)
        if on_right:
            first, last = self.at(self.width * (1 - share), 0, self.far), self.at(self.width + near, 0, near)
        else:
            first, last = self.at(0, 0, near), self.at(self.width * share, 0, self.far)
        along = last - first
        length = float(np.hypot(along[0], along[2]))
        half = np.array([length, 0.75 * self.height / self.far, 1.0])
        picture = self.paint(self.pick(textures.WALL_TEXTURES), (2 * half[0], 2 * half[1]), self.far * 1.2)
        middle = (first + last) / 2
        middle[1] = 0.0
        turn = rotation(-np.arctan2(along[2], along[0]))
        self.surfaces.append(Surface("plane", middle, turn, half, self.faded(picture), unbounded=True))

    def lay_floor(self) -> None:
        """Add the floor alone."""
        deep, near = self.focal / self.far, self.focal / self.max_disparity
        half = np.array([0.75 * self.width / self.far, (deep - near) * 0.6, 1.0])
        maker = self.pick(textures.FLOOR_TEXTURES)
        picture = self.paint(maker, (2 * half[0], 1.2 * half[1]), self.far * 1.5, 1.3)
        middle = np.array([0.5, self.floor, (deep + near) / 2])
        self.surfaces.append(Surface("plane", middle, rotation(pitch=np.pi / 2), half, picture, unbounded=True))

    def faded(self, picture: Texture) -> Texture:
        """Return a wall's picture with the contrast ``wall_contrast``."""
        mean = picture.mean(axis=(0, 1), keepdims=True)
        return np.asarray(mean + self.wall_contrast * (picture - mean), np.float32)

    def board(
        self,
        x: float,
        y: float,
        disparity: float,
        size: tuple[float, float],
        turn: NDArray[np.float64],
        outline: Outline | None = None,
        maker: TextureMaker | None = None,
    ) -> None:
        """Add a flat board centered at a pixel; ``size`` in pixels."""
        wide, tall = size[0] / disparity, size[1] / disparity
        picture = self.paint(maker or self.pick(textures.OBJECT_TEXTURES), (wide, tall), disparity)
        half = np.array([wide / 2, tall / 2, 1.0])
        self.add(Surface("plane", self.at(x, y, disparity), turn, half, picture, outline))

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
        maker = maker or self.pick(textures.OBJECT_TEXTURES)
        middle = self.on_floor(x, disparity)
        middle[1] -= tall / 2
        reach = 0.5 * (abs(turn[0, 2]) * wide + abs(turn[2, 2]) * deep)
        middle[2] += max(0.0, self.focal / (0.97 * self.max_disparity) - (middle[2] - reach))
        quarter, up = rotation(np.pi / 2), rotation(pitch=np.pi / 2)
        sides = (
            (turn, (wide, tall), -turn[2] * deep / 2),
            (quarter @ turn, (deep, tall), -(quarter @ turn)[2] * wide / 2),
            (quarter.T @ turn, (deep, tall), -(quarter.T @ turn)[2] * wide / 2),
            (up @ turn, (wide, deep), np.array([0.0, -tall / 2, 0.0])),
        )
        for axes, (a, b), shift in sides:
            picture = self.paint(maker, (a, b), disparity)
            half = np.array([a / 2, b / 2, 1.0])
            self.surfaces.append(Surface("plane", middle + shift, axes, half, picture, gloss=gloss))

    def ball(self, x: float, disparity: float, radius: float) -> None:
        """Add a ball on the floor; ``radius`` in pixels."""
        r = radius / disparity
        middle = self.on_floor(x, disparity)
        middle[1] -= r
        picture = self.paint(self.pick(textures.OBJECT_TEXTURES), (2 * np.pi * r, np.pi * r), disparity)
        turn = rotation(roll=self.rng.uniform(-0.5, 0.5))
        self.add(Surface("sphere", middle, turn, np.full(3, r), picture))

    def cone(self, x: float, disparity: float, size: tuple[float, float]) -> None:
        """Add a cone on the floor; ``size`` (radius, height) in pixels."""
        self._stand("cone", x, disparity, size)

    def tub(self, x: float, disparity: float, size: tuple[float, float]) -> None:
        """Add an open cylinder on the floor; ``size`` (radius, height) in pixels."""
        self._stand("cylinder", x, disparity, size)

    def _stand(self, shape: Shape, x: float, disparity: float, size: tuple[float, float]) -> None:
        r, tall = size[0] / disparity, size[1] / disparity
        middle = self.on_floor(x, disparity)
        middle[1] -= tall / 2
        picture = self.paint(self.pick(textures.OBJECT_TEXTURES), (2 * np.pi * r, tall), disparity)
        self.add(Surface(shape, middle, rotation(), np.array([r, tall / 2, r]), picture))

    def spread(self, count: int) -> list[tuple[float, float]]:
        """Return (column, disparity) of ``count`` places side by side, at mixed depths."""
        columns = (np.arange(count) + self.rng.uniform(0.25, 0.75, count)) / count * self.width
        depths = self.far + (self.near - self.far) * (self.rng.permutation(count) + 0.6) / (count + 0.4)
        return [(float(x), float(d)) for x, d in zip(columns, depths, strict=True)]
