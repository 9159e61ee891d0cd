"""Rectified stereo scenes with exact ground truth in both views.

Every scene is a room of analytic surfaces, seen by two pinhole cameras. Disparity and visibility come
from the ray through each pixel's center, not from a warped map, so they are exact to rounding; colors are
the mean over a grid of rays per pixel (a box filter) of pictures attached to the surfaces, so that both
views see the same continuous picture at their own sub-pixel positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.filters import discontinuity_mask
from depthcli.simulate.arrays.rendering import light_maps, render, trace
from depthcli.simulate.arrays.room import Room
from depthcli.simulate.arrays.stereo_kinds import FURNISH, Kind

KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class SyntheticScene:
    """A rectified pair and everything known about it.

    Attributes
    ----------
    left, right : (H, W, 3) uint8 RGB
    disparity_left, disparity_right : (H, W) float32, pixels, at pixel centers; every pixel has a value
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
        """Return a change from 0 (both cameras alike) to 1 (another exposure, gamma 0.8, dark corners)."""
        return cls(1 + 0.25 * strength, -12 * strength, 1 - 0.2 * strength, 0.35 * strength)

    def apply(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
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
    seed : chooses the scene
    width, height : pixels, at least 16
    max_disparity : pixels, at least 4 and at most ``width / 2``; nothing in the scene is nearer
    noise : standard deviation in grey levels of the noise of each camera
    radiometry : of the right camera; None = both cameras are alike
    wall_contrast : contrast of the walls' pictures: 1 = full, 0 = walls without texture (the repeated pattern
        of ``repetitive`` stays as it is)
    brightness : factor on the levels of both views, before noise is added; 0.08: levels up to about 20
    supersampling : rays per pixel, along each axis

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
    if noise < 0 or not 0 <= wall_contrast <= 1 or not 0 <= brightness <= 1 or supersampling < 1:
        raise ValueError("want noise >= 0, wall_contrast and brightness in 0 .. 1 and supersampling >= 1")
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    room = Room(rng, width, height, max_disparity, wall_contrast)
    FURNISH[kind](room)
    return _photograph(room, radiometry or Radiometry(), brightness, noise, supersampling)


def _photograph(room: Room, radiometry: Radiometry, brightness: float, noise: float, rays: int) -> SyntheticScene:
    lightmaps = light_maps(room)
    left = render(room, lightmaps, False, rays)
    right = radiometry.apply(render(room, lightmaps, True, rays))

    columns, rows = np.arange(room.width, dtype=np.float64)[None], np.arange(room.height, dtype=np.float64)[:, None]
    depth, owner = trace(room, columns, rows, False)
    disparity = room.focal / depth
    depth_right, _ = trace(room, columns, rows, True)
    matched = columns - disparity
    visible_depth, _ = trace(room, matched, rows, True)
    nonocc = (matched >= 0) & (visible_depth >= depth * (1 - 1e-9))
    periods = np.array([s.period for s in room.surfaces])[owner]
    repetition = np.where(periods > 0, periods * disparity, np.nan)
    return SyntheticScene(
        left=_developed(room, left, brightness, noise),
        right=_developed(room, right, brightness, noise),
        disparity_left=disparity.astype(np.float32),
        disparity_right=(room.focal / depth_right).astype(np.float32),
        nonocc=nonocc,
        disc=discontinuity_mask(disparity, nonocc),
        repetition=repetition.astype(np.float32),
        max_disparity=room.max_disparity,
    )


def _developed(room: Room, image: NDArray[np.float32], brightness: float, noise: float) -> NDArray[np.uint8]:
    grey_levels = image * np.float32(255 * brightness)
    if noise > 0:
        grey_levels = grey_levels + noise * room.rng.standard_normal(image.shape, np.float32)
    return np.asarray(np.clip(np.rint(grey_levels), 0, 255), np.uint8)
