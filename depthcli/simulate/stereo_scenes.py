"""Rectified stereo scenes with exact ground truth in both views.

Every scene is a room of analytic surfaces, seen by two pinhole cameras. Disparity and visibility come
from the ray through each pixel's center, not from a warped map, so they are exact to rounding; colors are
the mean over a grid of rays per pixel (a box filter) of pictures attached to the surfaces, so that both
views see the same continuous picture at their own sub-pixel positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from depthcli.algorithms.filters import discontinuity_mask
from depthcli.core.maps import Floats, Image8, Mask
from depthcli.simulate import textures
from depthcli.simulate.rendering import disparities, levels8, render, trace
from depthcli.simulate.room import Array, Outline, Room, rotation

Kind = Literal["planes", "foreground", "repetitive", "curved", "street"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class SyntheticScene:
    """A rectified pair with its ground truth; all maps are (H, W)."""

    left: Image8  # (H, W, 3) RGB
    right: Image8
    disparity_left: Floats  # pixels, at pixel centers; every pixel has a value
    disparity_right: Floats
    nonocc: Mask  # the left pixel's surface point is inside the right image and visible there
    disc: Mask  # non-occluded and near a depth discontinuity or an occlusion
    repetition: Floats  # after how many pixels along x the left picture repeats; NaN = it does not
    max_disparity: int  # to search, inclusive


@dataclass(frozen=True)
class Radiometry:
    """Response of the right camera to the same light: ``255 * (gain * v ** gamma * fall-off) + bias``, v in [0, 1]."""

    gain: float = 1.0
    bias: float = 0.0  # grey levels of 255
    gamma: float = 1.0
    vignetting: float = 0.0  # share of the light that the corners lose, in [0, 1)

    @classmethod
    def of_strength(cls, strength: float) -> Radiometry:
        """Return a change from 0 (both cameras alike) to 1 (another exposure, gamma 0.8, dark corners)."""
        return cls(1 + 0.25 * strength, -12 * strength, 1 - 0.2 * strength, 0.35 * strength)

    def apply(self, image: Floats) -> Floats:
        """Return an image, (H, W, 3) float32 in [0, 1], as the right camera records it (not clipped)."""
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
    brightness: float = 1.0,
    supersampling: int = 3,
) -> SyntheticScene:
    """Render one scene; the same arguments give the same scene.

    Parameters
    ----------
    kind : ``planes`` (a room of slanted boards and boxes), ``foreground`` (cut-out boards before a wall),
        ``repetitive`` (a wall whose pattern repeats inside the search range, with unique stickers here and
        there), ``curved`` (balls, cones, tubs), ``street`` (a road between house fronts, cars, poles and trees under
        a bare sky: large slopes, and depths from the nearest to almost infinity)
    width, height : pixels, at least 16, otherwise ValueError
    max_disparity : pixels, at least 4 and at most ``width / 2``, otherwise ValueError; no surface is nearer
    noise : standard deviation in grey levels of the noise of each camera
    radiometry : response of the right camera; None = both cameras are alike
    wall_contrast : contrast of the walls' pictures: 1 = full, 0 = walls without texture (the repeated pattern
        of ``repetitive`` stays as it is)
    brightness : factor on the levels of both views, before noise is added; 0.08: levels up to about 20
    supersampling : rays per pixel, along each axis
    """
    if width < 16 or height < 16 or not 4 <= max_disparity <= width / 2:
        got = f"{width} x {height}, {max_disparity}"
        raise ValueError(f"expected 16 x 16 pixels or more, max_disparity in 4 .. {width // 2}, got {got}")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    room = Room(rng, width, height, max_disparity, wall_contrast)
    _FURNISH[kind](room)
    left, right = render(room, supersampling)
    right = (radiometry or Radiometry()).apply(right)
    disparity, owner = disparities(room)
    disparity_right, _ = disparities(room, right=True)
    matched = np.arange(width) - disparity
    visible_depth, _ = trace(room, matched, np.arange(height, dtype=np.float64)[:, None], True)
    nonocc = (matched >= 0) & (visible_depth >= room.focal / disparity * (1 - 1e-9))
    periods = np.array([s.period for s in room.surfaces])[owner]
    views = [image * np.float32(255 * brightness) for image in (left, right)]
    if noise > 0:
        views = [image + noise * rng.standard_normal(image.shape, np.float32) for image in views]
    return SyntheticScene(
        left=levels8(views[0]),
        right=levels8(views[1]),
        disparity_left=disparity.astype(np.float32),
        disparity_right=disparity_right.astype(np.float32),
        nonocc=nonocc,
        disc=discontinuity_mask(disparity, nonocc),
        repetition=np.where(periods > 0, periods * disparity, np.nan).astype(np.float32),
        max_disparity=max_disparity,
    )


def _blob(rng: np.random.Generator) -> Outline:
    waves = np.arange(2, 7)
    amounts = rng.uniform(0.02, 0.3, waves.size) / waves**0.7
    phases = rng.uniform(0, 2 * np.pi, waves.size)

    def inside(x: Array, y: Array) -> Mask:
        angle = np.arctan2(y, x)
        edge = sum(a * np.cos(k * angle + p) for k, a, p in zip(waves, amounts, phases, strict=True))
        return np.asarray(np.hypot(x, y) < 0.78 * (1 + edge), np.bool_)

    return inside


def _saw(rng: np.random.Generator) -> Outline:
    teeth, depth = int(rng.integers(2, 5)), rng.uniform(0.3, 0.7)
    return lambda x, y: np.asarray(y > -1 + depth * np.abs(np.mod(x * teeth / 2, 1.0) - 0.5) * 2, np.bool_)


def _disk(x: Array, y: Array) -> Mask:
    return np.asarray(x * x + y * y < 1, np.bool_)


def _planes(room: Room) -> None:
    rng, w, h = room.rng, room.width, room.height
    room.add_walls()
    for x, d in room.spread(3):
        size = (w * rng.uniform(0.22, 0.34), h * rng.uniform(0.35, 0.6))
        turn = rotation(rng.uniform(-0.7, 0.7), rng.uniform(-0.5, 0.5), rng.uniform(-0.3, 0.3))
        outline = _saw(rng) if rng.random() < 0.6 else None
        room.board(x, h * rng.uniform(0.3, 0.65), 0.5 * (d + room.far), size, turn, outline)
    for x, d in room.spread(2):
        room.box(x, d, (w * rng.uniform(0.12, 0.22), h * rng.uniform(0.12, 0.28), w * rng.uniform(0.1, 0.2)))


def _foreground(room: Room) -> None:
    rng, w, h = room.rng, room.width, room.height
    room.add_walls()
    for x, d in room.spread(4):
        outline = (_blob(rng), _disk, None)[int(rng.integers(3))]
        size = (w * rng.uniform(0.16, 0.26), h * rng.uniform(0.25, 0.42))
        turn = rotation(rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15), rng.uniform(-0.6, 0.6))
        room.board(x, h * rng.uniform(0.2, 0.8), d, size, turn, outline)
    for x, d in room.spread(2):
        room.box(x, d, (w * rng.uniform(0.08, 0.14), h * rng.uniform(0.2, 0.45), w * rng.uniform(0.05, 0.12)))


def _curved(room: Room) -> None:
    rng, w, h = room.rng, room.width, room.height
    room.add_walls()
    for index, (x, d) in enumerate(room.spread(6)):
        if index % 3 == 0:
            radius = 0.5 * min(w * 0.75, h) * rng.uniform(0.2, 0.36)
            room.stand("sphere", x, d, (radius, 2 * radius))
        elif index % 3 == 1:
            room.stand("cone", x, d, (w * rng.uniform(0.07, 0.1), h * rng.uniform(0.35, 0.6)))
        else:
            room.stand("cylinder", x, d, (w * rng.uniform(0.05, 0.09), h * rng.uniform(0.15, 0.3)))


def _repetitive(room: Room) -> None:
    """Add a wall with a pattern that leans about the X axis only: one period and one disparity a row."""
    rng, w, h = room.rng, room.width, room.height
    room.far = texels = room.max_disparity * rng.uniform(0.4, 0.5)
    # In baselines the period is the share of the disparity by which a wrong match is off: below 1, d - period
    # is a disparity, and at these depths so is d + period.
    tile = max(4, round(texels * rng.uniform(0.5, 0.75)))
    # The picture covers little more than the visible part of the wall, so that the stickers are visible.
    skirting = room.center[1] + room.floor * texels
    wide, tall = int(w + 3 * texels), int(skirting * 1.15)
    picture = textures.repeated(rng, tall, wide, tile, int(rng.integers(16, 25)), min(w, h) * 0.13)
    middle = room.at((w + texels) / 2, skirting * 0.5, texels)
    lean, size = rotation(pitch=rng.uniform(-0.25, 0.25)), ((wide - 1) / texels, (tall - 1) / texels)
    room.plane(middle, lean, size, picture, unbounded=True, period=tile / texels)
    room.add_floor()
    for x, d in room.spread(2):
        size = (w * rng.uniform(0.14, 0.22), h * rng.uniform(0.25, 0.4))
        turn = rotation(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(-0.4, 0.4))
        room.board(x, h * rng.uniform(0.4, 0.75), d, size, turn, _blob(rng))
    x, d = room.spread(1)[0]
    room.box(x, d, (w * 0.12, h * rng.uniform(0.12, 0.25), w * 0.1))


def _street(room: Room) -> None:
    rng, w, h, max_disparity = room.rng, room.width, room.height, room.max_disparity
    room.center = (w * rng.uniform(0.4, 0.6), h * rng.uniform(0.35, 0.48))
    room.floor = (h - room.center[1]) / (max_disparity * rng.uniform(0.4, 0.85))
    room.far = max(0.5, 0.02 * max_disparity)
    sky, behind = np.full((8, 8, 3), rng.uniform(0.75, 0.97), np.float32), room.focal / room.far
    room.plane(np.array([0.0, 0.0, behind]), rotation(), (4 * w / room.far, 4 * h / room.far), sky, unbounded=True)
    room.light = np.array([rng.uniform(-40, 40), -60.0, rng.uniform(0, 30)])
    first, last = room.focal / max_disparity, room.focal / (0.1 * max_disparity)
    size = (4 * w / max_disparity, last - first)
    picture = room.paint(textures.asphalt, size, 0.4 * max_disparity)
    middle = np.array([rng.uniform(-1, 1), room.floor, (first + last) / 2])
    room.plane(middle, rotation(pitch=np.pi / 2), size, picture, unbounded=True)
    # How far the house fronts on the left and on the right are from the camera, baselines.
    fronts = [side / (max_disparity * rng.uniform(0.25, 0.7)) for side in (room.center[0], w - room.center[0])]
    _houses(room, fronts)
    room.surroundings = textures.surroundings(rng, h, w, room.feature)
    _cars(room, fronts)
    _poles(room, fronts)


def _houses(room: Room, fronts: list[float]) -> None:
    rng, max_disparity = room.rng, room.max_disparity
    for sign, away in zip((-1, 1), fronts, strict=True):
        z, end = room.focal / (0.97 * max_disparity), room.focal / (0.05 * max_disparity)
        while z < end:
            long, tall = z * rng.uniform(0.5, 1.2), room.floor * rng.uniform(2.5, 9)
            near = room.focal / (z + 0.3 * long)
            middle = np.array([sign * away * rng.uniform(1, 1.08), room.floor - tall / 2, z + long / 2])
            maker = room.pick((*textures.WALL_TEXTURES, textures.windows, textures.windows, textures.windows))
            picture = room.faded(room.paint(maker, (long, tall), min(near, 0.5 * max_disparity)))
            room.plane(middle, rotation(sign * np.pi / 2), (long, tall), picture)
            z += long * rng.uniform(1.0, 1.15)


def _cars(room: Room, fronts: list[float]) -> None:
    rng, max_disparity = room.rng, room.max_disparity
    gloss = rng.uniform(0.05, 0.35)
    # The nearest cars are cut off by the border of the image, on either side.
    for k, d in enumerate(max_disparity * np.array([0.93, 0.8, 0.5, 0.3, 0.17]) * rng.uniform(0.75, 1.0, 5)):
        sign, unit = (-1) ** (k + int(rng.integers(2))), room.floor * d
        away = fronts[(sign + 1) // 2] * rng.uniform(0.55, 0.8)
        measures = (unit * rng.uniform(0.9, 1.1), unit * rng.uniform(0.75, 0.95), unit * rng.uniform(1.8, 2.4))
        room.box(room.center[0] + sign * away * d, d, measures, textures.bodywork, rng.uniform(-0.08, 0.08), gloss)


def _poles(room: Room, fronts: list[float]) -> None:
    rng = room.rng
    for _ in range(int(rng.integers(3, 7))):
        d = room.max_disparity * rng.uniform(0.12, 0.6)
        sign = 1 if rng.random() < 0.5 else -1
        x = room.center[0] + sign * fronts[(sign + 1) // 2] * rng.uniform(0.75, 0.95) * d
        tall, thin = room.floor * d * rng.uniform(0.6, 2.6), max(2.0, d * rng.uniform(0.04, 0.12))
        y = room.center[1] + room.floor * d - tall / 2
        room.board(x, y, d, (thin, tall), rotation(), maker=textures.plaster)
        if rng.random() < 0.5:  # a crown, or a sign
            wide = room.floor * d * rng.uniform(0.25, 1.2)
            outline, maker = (_blob(rng), textures.camouflage) if rng.random() < 0.6 else (_disk, textures.poster)
            room.board(x, y - tall / 2, d * 1.01, (wide, wide), rotation(), outline, maker)


_FURNISH: dict[Kind, Callable[[Room], None]] = {
    "planes": _planes,
    "foreground": _foreground,
    "repetitive": _repetitive,
    "curved": _curved,
    "street": _street,
}
"""Kind of scene -> function that adds its surfaces to an empty room."""
