"""Rectified stereo scenes with exact ground truth in both views.

Every scene is a toy room of analytic surfaces, seen by two pinhole cameras. Disparity and visibility come
from the ray through each pixel's centre, not from a warped map, so they are exact to rounding; colours are
the mean over a grid of rays a pixel (a box filter) of pictures that stick to the surfaces, so that both
views see the same continuous picture at their own sub-pixel positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.filtering.discontinuity import discontinuity_mask
from depthcli.synthetic import textures
from depthcli.synthetic.surfaces import Array, Outline, Surface, Vector, rotation
from depthcli.synthetic.textures import Texture, TextureMaker

Kind = Literal["planes", "foreground", "repetitive", "curved"]
KINDS: tuple[Kind, ...] = get_args(Kind)

_AMBIENT = 0.45
_BAND = 32
_LIGHTMAP = 72
_MISS = np.inf


@dataclass(frozen=True)
class SyntheticScene:
    """A rectified pair and everything known about it.

    Attributes
    ----------
    left, right : (H, W, 3) uint8 RGB
    disparity_left, disparity_right : (H, W) float32, pixels, at pixel centres; every pixel has a value
    nonocc : (H, W) bool: the left pixel's surface point lies in the right image and is visible there
    disc : (H, W) bool: non-occluded and near a depth discontinuity or an occlusion
    repetition : (H, W) float32: after how many pixels along x the left picture repeats; NaN = it does not
    max_disparity : largest disparity to search, inclusive
    """

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    disparity_left: NDArray[np.float32]
    disparity_right: NDArray[np.float32]
    nonocc: NDArray[np.bool_]
    disc: NDArray[np.bool_]
    repetition: NDArray[np.float32]
    max_disparity: int


@dataclass(frozen=True)
class Radiometry:
    """How the right camera sees the same light: ``255 * (gain * v ** gamma * fall-off) + bias``, v in [0, 1].

    Attributes
    ----------
    gain, gamma : factor and exponent, > 0
    bias : grey levels of 255
    vignetting : share of the light that the corners lose, in [0, 1)
    """

    gain: float = 1.0
    bias: float = 0.0
    gamma: float = 1.0
    vignetting: float = 0.0

    @classmethod
    def of_strength(cls, strength: float) -> Radiometry:
        """From 0 (both cameras alike) to 1 (another exposure, gamma 0.8, dark corners)."""
        return cls(1 + 0.25 * strength, -12 * strength, 1 - 0.2 * strength, 0.35 * strength)

    def apply(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """(H, W, 3) float32 in [0, 1] -> the same, as the right camera records it (not clipped)."""
        if self == Radiometry():
            return image
        height, width = image.shape[:2]
        y, x = np.linspace(-1, 1, height), np.linspace(-1, 1, width)
        fall_off = 1 - self.vignetting * (y[:, None] ** 2 + x[None, :] ** 2) / 2
        changed = self.gain * np.power(np.clip(image, 0, 1), self.gamma) * fall_off[:, :, None] + self.bias / 255
        return changed.astype(np.float32)


def make_scene(
    kind: Kind,
    seed: int = 0,
    width: int = 400,
    height: int = 300,
    max_disparity: int = 48,
    *,
    noise: float = 0.0,
    radiometry: Radiometry | None = None,
    wall_contrast: float = 1.0,
    supersampling: int = 3,
) -> SyntheticScene:
    """Render one scene; the same arguments give the same scene.

    Parameters
    ----------
    kind : ``planes`` (a room of slanted boards and boxes), ``foreground`` (cut-out boards before a wall),
        ``repetitive`` (a wall whose pattern repeats inside the search range, with unique stickers here and
        there), ``curved`` (balls, cones, tubs)
    seed : chooses the scene
    width, height : pixels, at least 16
    max_disparity : pixels, at least 4 and at most ``width / 2``; nothing in the scene is nearer
    noise : standard deviation in grey levels of the noise of each camera
    radiometry : of the right camera; None = both cameras are alike
    wall_contrast : contrast of the walls' pictures: 1 = full, 0 = walls without texture (the repeated pattern
        of ``repetitive`` stays as it is)
    supersampling : rays a pixel, along each axis

    Raises
    ------
    ValueError
        For an unknown kind or an impossible size, range or amount.
    """
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    if width < 16 or height < 16:
        raise ValueError(f"a scene is at least 16 x 16 pixels, got {width} x {height}")
    if not 4 <= max_disparity <= width / 2:
        raise ValueError(f"max_disparity must lie in 4 .. width / 2 = {width // 2}, got {max_disparity}")
    if noise < 0 or not 0 <= wall_contrast <= 1 or supersampling < 1:
        raise ValueError("want noise >= 0, 0 <= wall_contrast <= 1 and supersampling >= 1")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    stage = _Stage(rng, width, height, max_disparity, wall_contrast)
    _BUILDERS[kind](stage)
    return _photograph(stage, radiometry or Radiometry(), noise, supersampling)


# ---------------------------------------------------------------------------------------------------------
# Building a room


@dataclass
class _Stage:
    """The room while it is furnished; positions are given in left-image pixels and disparities."""

    rng: np.random.Generator
    width: int
    height: int
    max_disparity: int
    wall_contrast: float
    surfaces: list[Surface] = field(default_factory=list)

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
        """World point that the left camera sees at pixel (x, y) with this disparity."""
        return np.array([x - self.center[0], y - self.center[1], self.focal]) / disparity

    def on_floor(self, x: float, disparity: float) -> NDArray[np.float64]:
        """World point of the floor at column x and this disparity."""
        point = self.at(x, 0, disparity)
        point[1] = self.floor
        return point

    def paint(self, maker: TextureMaker, size: tuple[float, float], disparity: float, feature: float = 1.0) -> Texture:
        """A picture for a surface of this (width, height) in baselines: one texel a pixel at ``disparity``."""
        columns, rows = (int(np.clip(round(s * disparity), 8, 4096)) for s in size)
        return maker(self.rng, rows, columns, self.feature * feature)

    def pick(self, makers: tuple[TextureMaker, ...]) -> TextureMaker:
        return makers[int(self.rng.integers(len(makers)))]

    def add(self, surface: Surface) -> None:
        """Put a finite surface in, moved back where it would come nearer than the search range allows."""
        short = self.focal / (0.97 * self.max_disparity) - float(surface.corners()[:, 2].min())
        if short > 0:
            surface = _moved(surface, np.array([0.0, 0.0, short]))
        self.surfaces.append(surface)

    def room(self, wall: TextureMaker | None = None) -> None:
        """Floor and back wall, and sometimes a side wall."""
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
        """A wall that comes forward out of the picture; at its edge (in both views) still within the range."""
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
        """The floor alone."""
        deep, near = self.focal / self.far, self.focal / self.max_disparity
        half = np.array([0.75 * self.width / self.far, (deep - near) * 0.6, 1.0])
        maker = self.pick(textures.FLOOR_TEXTURES)
        picture = self.paint(maker, (2 * half[0], 1.2 * half[1]), self.far * 1.5, 1.3)
        middle = np.array([0.5, self.floor, (deep + near) / 2])
        self.surfaces.append(Surface("plane", middle, rotation(pitch=np.pi / 2), half, picture, unbounded=True))

    def faded(self, picture: Texture) -> Texture:
        """A wall's picture with the contrast asked for."""
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
        """A flat board centred at a pixel; ``size`` in pixels."""
        wide, tall = size[0] / disparity, size[1] / disparity
        picture = self.paint(maker or self.pick(textures.OBJECT_TEXTURES), (wide, tall), disparity)
        half = np.array([wide / 2, tall / 2, 1.0])
        self.add(Surface("plane", self.at(x, y, disparity), turn, half, picture, outline))

    def box(self, x: float, disparity: float, size: tuple[float, float, float]) -> None:
        """A box on the floor, turned about its upright axis; ``size`` (width, height, depth) in pixels."""
        wide, tall, deep = (s / disparity for s in size)
        turn = rotation(self.rng.uniform(-0.6, 0.6))
        maker = self.pick(textures.OBJECT_TEXTURES)
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
            self.surfaces.append(Surface("plane", middle + shift, axes, half, picture))

    def ball(self, x: float, disparity: float, radius: float) -> None:
        """A ball on the floor; ``radius`` in pixels."""
        r = radius / disparity
        middle = self.on_floor(x, disparity)
        middle[1] -= r
        picture = self.paint(self.pick(textures.OBJECT_TEXTURES), (2 * np.pi * r, np.pi * r), disparity)
        turn = rotation(roll=self.rng.uniform(-0.5, 0.5))
        self.add(Surface("sphere", middle, turn, np.full(3, r), picture))

    def cone(self, x: float, disparity: float, size: tuple[float, float]) -> None:
        """A cone on the floor; ``size`` (radius, height) in pixels."""
        r, tall = size[0] / disparity, size[1] / disparity
        middle = self.on_floor(x, disparity)
        middle[1] -= tall / 2
        picture = self.paint(self.pick(textures.OBJECT_TEXTURES), (2 * np.pi * r, tall), disparity)
        self.add(Surface("cone", middle, rotation(), np.array([r, tall / 2, r]), picture))

    def tub(self, x: float, disparity: float, size: tuple[float, float]) -> None:
        """An open cylinder on the floor; ``size`` (radius, height) in pixels."""
        r, tall = size[0] / disparity, size[1] / disparity
        middle = self.on_floor(x, disparity)
        middle[1] -= tall / 2
        picture = self.paint(self.pick(textures.OBJECT_TEXTURES), (2 * np.pi * r, tall), disparity)
        self.add(Surface("cylinder", middle, rotation(), np.array([r, tall / 2, r]), picture))

    def spread(self, count: int) -> list[tuple[float, float]]:
        """(column, disparity) of ``count`` places side by side, at mixed depths."""
        columns = (np.arange(count) + self.rng.uniform(0.25, 0.75, count)) / count * self.width
        depths = self.far + (self.near - self.far) * (self.rng.permutation(count) + 0.6) / (count + 0.4)
        return [(float(x), float(d)) for x, d in zip(columns, depths, strict=True)]


def _moved(surface: Surface, shift: NDArray[np.float64]) -> Surface:
    return Surface(
        surface.shape,
        surface.center + shift,
        surface.axes,
        surface.half_size,
        surface.texture,
        surface.outline,
        surface.unbounded,
        surface.period,
    )


def _blob(rng: np.random.Generator) -> Outline:
    """A wavy round outline."""
    waves = np.arange(2, 7)
    amounts = rng.uniform(0.02, 0.3, waves.size) / waves**0.7
    phases = rng.uniform(0, 2 * np.pi, waves.size)

    def inside(x: Array, y: Array) -> NDArray[np.bool_]:
        angle = np.arctan2(y, x)
        edge = sum(a * np.cos(k * angle + p) for k, a, p in zip(waves, amounts, phases, strict=True))
        kept: NDArray[np.bool_] = np.hypot(x, y) < 0.78 * (1 + edge)
        return kept

    return inside


def _saw(rng: np.random.Generator) -> Outline:
    """A board with a toothed upper edge."""
    teeth, depth = int(rng.integers(2, 5)), rng.uniform(0.3, 0.7)

    def inside(x: Array, y: Array) -> NDArray[np.bool_]:
        saw = np.abs(np.mod(x * teeth / 2, 1.0) - 0.5) * 2
        kept: NDArray[np.bool_] = y > -1 + depth * saw
        return kept

    return inside


def _disk(x: Array, y: Array) -> NDArray[np.bool_]:
    kept: NDArray[np.bool_] = x * x + y * y < 1
    return kept


def _planes(stage: _Stage) -> None:
    rng, w, h = stage.rng, stage.width, stage.height
    stage.room()
    for x, d in stage.spread(3):
        size = (w * rng.uniform(0.22, 0.34), h * rng.uniform(0.35, 0.6))
        turn = rotation(rng.uniform(-0.7, 0.7), rng.uniform(-0.5, 0.5), rng.uniform(-0.3, 0.3))
        outline = _saw(rng) if rng.random() < 0.6 else None
        stage.board(x, h * rng.uniform(0.3, 0.65), 0.5 * (d + stage.far), size, turn, outline)
    for x, d in stage.spread(2):
        stage.box(x, d, (w * rng.uniform(0.12, 0.22), h * rng.uniform(0.12, 0.28), w * rng.uniform(0.1, 0.2)))


def _foreground(stage: _Stage) -> None:
    rng, w, h = stage.rng, stage.width, stage.height
    stage.room()
    for x, d in stage.spread(4):
        outline = (_blob(rng), _disk, None)[int(rng.integers(3))]
        size = (w * rng.uniform(0.16, 0.26), h * rng.uniform(0.25, 0.42))
        turn = rotation(rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15), rng.uniform(-0.6, 0.6))
        stage.board(x, h * rng.uniform(0.2, 0.8), d, size, turn, outline)
    for x, d in stage.spread(2):
        stage.box(x, d, (w * rng.uniform(0.08, 0.14), h * rng.uniform(0.2, 0.45), w * rng.uniform(0.05, 0.12)))


def _curved(stage: _Stage) -> None:
    rng, w, h = stage.rng, stage.width, stage.height
    stage.room()
    for index, (x, d) in enumerate(stage.spread(6)):
        match index % 3:
            case 0:
                stage.ball(x, d, 0.5 * min(w * 0.75, h) * rng.uniform(0.2, 0.36))
            case 1:
                stage.cone(x, d, (w * rng.uniform(0.07, 0.1), h * rng.uniform(0.35, 0.6)))
            case _:
                stage.tub(x, d, (w * rng.uniform(0.05, 0.09), h * rng.uniform(0.15, 0.3)))


def _repetitive(stage: _Stage) -> None:
    """The pattern's wall leans about the X axis only: one period and one disparity a row."""
    rng, w, h = stage.rng, stage.width, stage.height
    stage.far = stage.max_disparity * rng.uniform(0.4, 0.5)
    texels = stage.far
    # In baselines the period is the share of the disparity by which a wrong match is off: below 1, d - period
    # is a disparity, and at these depths so is d + period.
    tile = max(4, round(texels * rng.uniform(0.5, 0.75)))
    period = tile / texels
    # The picture covers what the two views see of the wall and little more, so that its stickers are seen.
    skirting = stage.center[1] + stage.floor * texels
    wide, tall = int(w + 3 * texels), int(skirting * 1.15)
    picture = textures.repeated(rng, tall, wide, tile, int(rng.integers(16, 25)), min(w, h) * 0.13)
    half = np.array([(wide - 1) / 2 / texels, (tall - 1) / 2 / texels, 1.0])
    middle = stage.at((w + texels) / 2, skirting * 0.5, texels)
    lean = rotation(pitch=rng.uniform(-0.25, 0.25))
    stage.surfaces.append(Surface("plane", middle, lean, half, picture, unbounded=True, period=period))
    stage.lay_floor()
    for x, d in stage.spread(2):
        size = (w * rng.uniform(0.14, 0.22), h * rng.uniform(0.25, 0.4))
        turn = rotation(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(-0.4, 0.4))
        stage.board(x, h * rng.uniform(0.4, 0.75), d, size, turn, _blob(rng))
    x, d = stage.spread(1)[0]
    stage.box(x, d, (w * 0.12, h * rng.uniform(0.12, 0.25), w * 0.1))


_BUILDERS: dict[Kind, Callable[[_Stage], None]] = {
    "planes": _planes,
    "foreground": _foreground,
    "repetitive": _repetitive,
    "curved": _curved,
}


# ---------------------------------------------------------------------------------------------------------
# Taking the pictures


def _rays(stage: _Stage, columns: Array, rows: Array, right: bool) -> tuple[Vector, Vector]:
    """(origin, direction) of the rays through pixel positions; t along them is the depth Z."""
    kind = np.result_type(columns, rows)
    one = np.ones((1, 1), kind)
    direction = ((columns - stage.center[0]) / stage.focal, (rows - stage.center[1]) / stage.focal, one)
    return (one * right, one * 0, one * 0), direction


def _trace(stage: _Stage, columns: Array, rows: Array, right: bool) -> tuple[Array, NDArray[np.int16]]:
    """Depth and index of the nearest surface along rays: ``columns`` (1, W) or (H, W), ``rows`` (H, 1)."""
    shape = np.broadcast_shapes(columns.shape, rows.shape)
    depth = np.full(shape, _MISS, np.result_type(columns, rows))
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


def _bounds(stage: _Stage, surface: Surface, right: bool) -> tuple[float, float, float, float]:
    """Pixels that a surface can cover: first and last column, first and last row."""
    if surface.unbounded:
        return -np.inf, np.inf, -np.inf, np.inf
    corners = surface.corners()
    columns = (corners[:, 0] - right) / corners[:, 2] * stage.focal + stage.center[0]
    rows = corners[:, 1] / corners[:, 2] * stage.focal + stage.center[1]
    return columns.min() - 1, columns.max() + 1, rows.min() - 1, rows.max() + 1


def _lightmap(stage: _Stage, index: int) -> NDArray[np.float32]:
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


def _render(stage: _Stage, lightmaps: list[NDArray[np.float32] | None], right: bool, rays: int) -> NDArray[np.float32]:
    """One view, (H, W, 3) float32, nominally in [0, 1]."""
    offsets = (np.arange(rays) + 0.5) / rays - 0.5
    columns = (np.arange(stage.width)[:, None] + offsets).ravel()[None].astype(np.float32)
    image = np.empty((stage.height, stage.width, 3), np.float32)
    for top in range(0, stage.height, _BAND):
        bottom = min(top + _BAND, stage.height)
        rows = (np.arange(top, bottom)[:, None] + offsets).ravel()[:, None].astype(np.float32)
        depth, owner = _trace(stage, columns, rows, right)
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
        image[top:bottom] = cv2.resize(colors, (stage.width, bottom - top), interpolation=cv2.INTER_AREA)
    return image


def _shade(stage: _Stage, surface: Surface, lightmap: NDArray[np.float32] | None, point: Vector) -> NDArray[np.float32]:
    """Colours of points that lie on a surface (others in the rectangle get some colour)."""
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


def _photograph(stage: _Stage, radiometry: Radiometry, noise: float, rays: int) -> SyntheticScene:
    lightmaps = [_lightmap(stage, i) if s.shape == "plane" else None for i, s in enumerate(stage.surfaces)]
    left = _render(stage, lightmaps, False, rays)
    right = radiometry.apply(_render(stage, lightmaps, True, rays))

    columns, rows = np.arange(stage.width, dtype=np.float64)[None], np.arange(stage.height, dtype=np.float64)[:, None]
    depth, owner = _trace(stage, columns, rows, False)
    disparity = stage.focal / depth
    depth_right, _ = _trace(stage, columns, rows, True)
    matched = columns - disparity
    seen, _ = _trace(stage, matched, rows, True)
    nonocc = (matched >= 0) & (seen >= depth * (1 - 1e-9))
    periods = np.array([s.period for s in stage.surfaces])[owner]
    repetition = np.where(periods > 0, periods * disparity, np.nan)
    return SyntheticScene(
        left=_developed(stage, left, noise),
        right=_developed(stage, right, noise),
        disparity_left=disparity.astype(np.float32),
        disparity_right=(stage.focal / depth_right).astype(np.float32),
        nonocc=nonocc,
        disc=discontinuity_mask(disparity, nonocc),
        repetition=repetition.astype(np.float32),
        max_disparity=stage.max_disparity,
    )


def _developed(stage: _Stage, image: NDArray[np.float32], noise: float) -> NDArray[np.uint8]:
    grey_levels = image * 255
    if noise > 0:
        grey_levels = grey_levels + noise * stage.rng.standard_normal(image.shape, np.float32)
    return np.clip(np.rint(grey_levels), 0, 255).astype(np.uint8)
