"""Scenes with transparent objects for a color camera, an infrared camera and a depth sensor, with ground truth.

Disparities are exact. The background shines through an object, displaced as by a lens, mixed with a faint picture of
the object itself. The sensor measures the surface behind the object, or nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from depthcli.core.frames import Image, StereoPair, color8
from depthcli.core.maps import Floats, Image8, Mask
from depthcli.simulate.rendering import disparities, levels8, render
from depthcli.simulate.room import Room, rotation

_OWN_SHARE = 0.55  # share of an object's own picture in its visible color
_LENS = 0.35  # how far the picture behind is drawn towards an object's center
_BLIND, _SENSOR_NOISE = 0.5, 0.1  # share of an object where the sensor measures nothing; deviation, pixels
_BLOB = 0.02  # size of the spots where the sensor sees through or nothing, over the image's width
# Of the model in :func:`infrared_like`, set by hand: red counts most, and the gain changes across the image.
_RGB_WEIGHTS = np.array([0.6, 0.3, 0.1], np.float32)
_GAMMA = 0.7
_GAIN_RANGE = (0.7, 1.3)
_NOISE_SIGMA = 4.0  # grey levels


@dataclass(frozen=True)
class TransparentScene:
    """A rectified pair of a color and an infrared camera, and a sensor registered to the color; all (H, W)."""

    color: Image8  # (H, W, 3), left view
    infrared: Image8  # right view
    disparity: Floats  # true, of the left view, pixels; NaN = unknown
    sensor: Floats  # disparity measured by the sensor; NaN = no measurement
    mask: Mask  # transparent


def make_transparent_scene(
    seed: int = 0, width: int = 320, height: int = 240, max_disparity: int = 40, speckles: float = 0.0
) -> TransparentScene:
    """Render a room with two opaque and two transparent objects; the same arguments give the same scene.

    Nothing is nearer than ``max_disparity`` pixels; a share ``speckles`` of the infrared image's pixels has a projected
    dot.
    """
    rng = np.random.default_rng([seed, 0x61A5])
    room = Room(rng, width, height, max_disparity, 1.0)
    room.add_walls()
    for x, d in room.spread(2):
        size = (width * rng.uniform(0.2, 0.3), height * rng.uniform(0.25, 0.4))
        turn = rotation(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(-0.3, 0.3))
        room.board(x, height * rng.uniform(0.25, 0.5), 0.5 * (d + room.far), size, turn)
    views, behind, opaque = render(room, 2), disparities(room)[0], len(room.surfaces)
    radius = 0.16 * height
    room.stand("sphere", width * rng.uniform(0.3, 0.45), 0.6 * max_disparity, (radius, 2 * radius))
    room.stand("cylinder", width * rng.uniform(0.6, 0.75), 0.7 * max_disparity, (0.06 * width, 0.3 * height))
    mixed, seen = [], [disparities(room, right) for right in (False, True)]
    for view, front, (_, owner) in zip(views, render(room, 2), seen, strict=True):
        image = np.where((owner >= opaque)[:, :, None], front, view)
        for index in range(opaque, int(owner.max()) + 1):
            v, u = np.nonzero(owner == index)
            if v.size:  # a lens displaces the background towards its center
                down, across = ((part + _LENS * (part.mean() - part)).astype(np.float32)[:, None] for part in (v, u))
                shifted = cv2.remap(view, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                image[v, u] = _OWN_SHARE * front[v, u] + (1 - _OWN_SHARE) * shifted[:, 0]
        mixed.append(levels8(255 * image))
    disparity, owner = seen[0]
    truth, mask = disparity.astype(np.float32), owner >= opaque
    sensor = sensor_through(truth, behind.astype(np.float32), mask, seed)
    return TransparentScene(mixed[0], infrared_like(mixed[1], seed, speckles), truth, sensor, mask)


def sensor_through(truth: Floats, behind: Floats, mask: Mask, seed: int) -> Floats:
    """Return the disparity that a sensor measures: the background or nothing in spots of the mask, otherwise the truth.

    ``truth`` is the disparity with the object ``mask``, ``behind`` the disparity without the object.
    """
    rng = np.random.default_rng([seed, 0xB1])
    height, width = truth.shape
    spots = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), max(1.0, _BLOB * width))
    measured = np.where(mask, behind, truth)
    if mask.any():
        measured = np.where(mask & (spots <= np.quantile(spots[mask], _BLIND)), np.nan, measured)
    measured = measured + _SENSOR_NOISE * rng.standard_normal((height, width))
    return np.where(measured > 0, measured, np.nan).astype(np.float32)


def glass_of_pair(
    left: Image, right: Image, disparity: Floats, seed: int = 0, speckles: float = 0.0
) -> TransparentScene:
    """Return a pair with known disparity as color and infrared; to the sensor, one of its surfaces is glass.

    The surface is connected (by steps of at most one pixel), covers 1 to 15 % of the image, is visible in both views,
    and is in front of most of its surroundings. If there is no such surface, an ellipse in the middle is used. The
    background is a plane through the farther third of the surroundings.

    ``left`` and ``right`` are (H, W) grey or (H, W, 3) RGB, uint8 or uint16. ``disparity`` (H, W) belongs to the left
    view, pixels, NaN = unknown. A share ``speckles`` of the infrared image's pixels has a projected dot.
    """
    mask, best_share = np.zeros(disparity.shape, np.bool_), 0.4
    for surface in _surfaces(disparity):
        around = disparity[_ring(surface, disparity)]
        share = float(np.mean(around < np.median(disparity[surface]) - 2)) if around.size else 0.0
        if share > best_share:
            mask, best_share = surface, share
    if not mask.any():
        height, width = disparity.shape
        y, x = np.mgrid[:height, :width]
        at = np.random.default_rng([seed, 0xE1]).uniform(0.4, 0.6, 2) * (height, width)
        mask = (((x - at[1]) / (0.12 * width)) ** 2 + ((y - at[0]) / (0.16 * height)) ** 2 < 1) & np.isfinite(disparity)
    sensor = sensor_through(disparity, _behind(disparity, mask), mask, seed)
    return TransparentScene(color8(left), infrared_like(right, seed, speckles), disparity, sensor, mask)


def _surfaces(disparity: Floats) -> Iterator[Mask]:
    known = np.isfinite(disparity)
    # A grid of twice the size: pixels at even places, and between two of them a bridge where they are alike.
    grid = np.zeros((2 * disparity.shape[0] - 1, 2 * disparity.shape[1] - 1), np.uint8)
    grid[::2, ::2] = known
    grid[::2, 1::2] = np.abs(np.diff(disparity, axis=1)) <= 1
    grid[1::2, ::2] = np.abs(np.diff(disparity, axis=0)) <= 1
    _, labels, facts, _ = cv2.connectedComponentsWithStats(grid, connectivity=4)
    large = np.flatnonzero(facts[:, cv2.CC_STAT_AREA] >= 0.02 * disparity.size)
    square, visible = np.ones((5, 5), np.uint8), np.arange(disparity.shape[1]) >= disparity
    for label in large[large > 0]:
        plane = (labels[::2, ::2] == label).astype(np.uint8)
        mask = cv2.morphologyEx(cv2.morphologyEx(plane, cv2.MORPH_OPEN, square), cv2.MORPH_CLOSE, square) > 0
        mask &= known
        if 0.01 <= mask.mean() <= 0.15 and np.mean(visible[mask]) > 0.9:
            yield mask


def _ring(mask: Mask, disparity: Floats) -> Mask:
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    return np.asarray(wide & ~mask & np.isfinite(disparity), np.bool_)


def _behind(disparity: Floats, mask: Mask) -> Floats:
    y, x = np.nonzero(_ring(mask, disparity))
    values = disparity[y, x].astype(np.float64)
    nearest = float(np.median(disparity[mask]))
    depth = min(float(np.quantile(values, 1 / 3)), 0.8 * nearest) if values.size else 0.6 * nearest
    far = np.abs(values - depth) < 3
    plane = np.array([0.0, 0.0, depth])
    if np.count_nonzero(far) > 50:
        fitted = np.linalg.lstsq(np.stack([x[far], y[far], np.ones(far.sum())], axis=1), values[far], rcond=None)[0]
        plane = fitted if np.abs(fitted[:2]).max() < 0.15 else plane
    rows, columns = np.mgrid[: disparity.shape[0], : disparity.shape[1]]
    behind = plane[0] * columns + plane[1] * rows + plane[2]
    return np.asarray(np.clip(behind, 0.5, max(depth + 3, 0.5)), np.float32)


def sparse_samples(
    depth: Floats,
    color: Image8,
    share: float,
    noise: float = 0.008,
    outliers: float = 0.1,
    clustered: bool = False,
    seed: int = 0,
) -> Floats:
    """Return some pixels of ``depth``, (H, W) float32, meters, NaN = none, with Gaussian noise and outliers.

    Parameters
    ----------
    depth, color : (H, W) float32, meters, NaN = unknown (never chosen); (H, W, 3) uint8
    share, noise : share of all pixels that get a sample, in [0, 1]; standard deviation, meters
    outliers : share of the samples that are uniform between the 1st and the 99th percentile of ``depth`` instead
    clustered : a pixel's chance grows with the 1.5th power of the color's gradient, since stereo finds texture there
    """
    rng = np.random.default_rng([seed, 0x5A])
    known = np.flatnonzero(np.isfinite(depth))
    count = min(round(share * depth.size), known.size)
    chance = None
    if clustered:
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32)
        gradient = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)).ravel()[known]
        chance = (gradient.astype(np.float64) + 1e-3) ** 1.5
        chance /= chance.sum()
    chosen = rng.choice(known, count, replace=False, p=chance)
    values = depth.ravel()[chosen] + noise * rng.standard_normal(count)
    wrong = rng.random(count) < outliers
    if wrong.any():
        low, high = np.nanquantile(depth, [0.01, 0.99])
        values[wrong] = rng.uniform(low, high, int(wrong.sum()))
    sparse = np.full(depth.size, np.nan, np.float32)
    sparse[chosen] = np.where(values > 0, values, np.nan)
    return sparse.reshape(depth.shape)


def infrared_like(image: Image, seed: int = 0, speckles: float = 0.0) -> Image8:
    """Return an infrared camera's image, (H, W) uint8: ``255 * (0.6 R + 0.3 G + 0.1 B) ** 0.7 * gain + noise``.

    The power is taken on the range [0, 1]. The gain is a smooth field that fills [0.7, 1.3]; the noise is Gaussian with
    sigma 4 grey levels; the result is clipped. ``image`` is (H, W, 3) RGB or (H, W) grey, uint8 or uint16; the share
    ``speckles`` of the pixels get a bright projected dot, as of a depth camera's pattern.
    """
    rng = np.random.default_rng([seed, 0x17])
    top = np.float32(np.iinfo(image.dtype).max)
    light = image.astype(np.float32) / top
    if light.ndim == 3:
        light = light @ _RGB_WEIGHTS
    height, width = light.shape
    grid = rng.standard_normal((5, 6)).astype(np.float32)
    field = cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
    scaled = (field - field.min()) / max(float(field.max()) - float(field.min()), 1e-6)
    gain = (_GAIN_RANGE[0] + (_GAIN_RANGE[1] - _GAIN_RANGE[0]) * scaled).astype(np.float32)
    result = 255 * np.power(light, np.float32(_GAMMA)) * gain
    if speckles > 0:
        dots = (rng.random((height, width)) < speckles).astype(np.float32)
        result += 400 * cv2.GaussianBlur(dots, (0, 0), 0.7)
    result += _NOISE_SIGMA * rng.standard_normal((height, width), np.float32)
    return levels8(result)


def cross_modal_pair(left: Image, right: Image, seed: int = 0, speckles: float = 0.0) -> tuple[Image8, Image8]:
    """Return the left picture as grey, the right picture as infrared, (H, W) uint8; see :func:`infrared_like`."""
    return StereoPair(left, right).grey8[0], infrared_like(right, seed, speckles)
