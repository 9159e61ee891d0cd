"""Scenes with transparent objects, as a color camera, an infrared camera and a depth sensor see them, with truth.

Disparities are exact. What is behind an object shines through, displaced as by a lens; of the object itself a faint
picture is seen. The sensor measures what lies behind the object, or nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.synthetic.camera import light_maps, render, trace
from depthcli.synthetic.cross_modal import infrared_like
from depthcli.synthetic.stage import Stage
from depthcli.synthetic.surfaces import rotation

_OWN = 0.55  # share of an object's own picture in what is seen of it
_LENS = 0.35  # how far the picture behind is drawn towards an object's center
_BLOB = 0.02  # size of the spots where the sensor sees through or nothing, over the image's width


@dataclass(frozen=True)
class TransparentScene:
    """A rectified pair of a color and an infrared camera, and a sensor registered to the color.

    Attributes
    ----------
    color : (H, W, 3) uint8, left view
    infrared : (H, W) uint8, right view
    disparity : (H, W) float32, true disparity of the left view, pixels; NaN = unknown
    sensor : (H, W) float32, what the sensor measured, as disparity; NaN = nothing
    mask : (H, W) bool, transparent
    """

    color: NDArray[np.uint8]
    infrared: NDArray[np.uint8]
    disparity: NDArray[np.float32]
    sensor: NDArray[np.float32]
    mask: NDArray[np.bool_]


def make_transparent_scene(
    seed: int = 0, width: int = 320, height: int = 240, max_disparity: int = 40, speckles: float = 0.0
) -> TransparentScene:
    """Render a room with two opaque and two transparent objects; the same arguments give the same scene.

    Parameters
    ----------
    width, height : pixels
    max_disparity : nothing is nearer, pixels
    speckles : share of the infrared image's pixels with a projected dot, in [0, 1]
    """
    rng = np.random.default_rng([seed, 0x61A5])
    stage = Stage(rng, width, height, max_disparity, 1.0)
    stage.room()
    places = stage.spread(2)
    for x, d in places:
        size = (width * rng.uniform(0.2, 0.3), height * rng.uniform(0.25, 0.4))
        turn = rotation(rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), rng.uniform(-0.3, 0.3))
        stage.board(x, height * rng.uniform(0.25, 0.5), 0.5 * (d + stage.far), size, turn)
    views = [render(stage, light_maps(stage), right, 2) for right in (False, True)]
    columns, rows = np.arange(width, dtype=np.float64)[None], np.arange(height, dtype=np.float64)[:, None]
    behind = stage.focal / trace(stage, columns, rows, False)[0]
    opaque = len(stage.surfaces)
    stage.ball(width * rng.uniform(0.3, 0.45), 0.6 * max_disparity, 0.16 * height)
    stage.tub(width * rng.uniform(0.6, 0.75), 0.7 * max_disparity, (0.06 * width, 0.3 * height))
    lights = light_maps(stage)
    mixed = []
    for right, view in zip((False, True), views, strict=True):
        owner = trace(stage, columns, rows, right)[1]
        mixed.append(_see_through(view, render(stage, lights, right, 2), owner, opaque))
    depth, owner = trace(stage, columns, rows, False)
    truth, mask = (stage.focal / depth).astype(np.float32), owner >= opaque
    left, right_view = (np.clip(np.rint(255 * image), 0, 255).astype(np.uint8) for image in mixed)
    sensor = sensor_through(truth, behind.astype(np.float32), mask, seed)
    return TransparentScene(left, infrared_like(right_view, seed, speckles), truth, sensor, mask)


def sensor_through(
    truth: NDArray[np.float32],
    behind: NDArray[np.float32],
    mask: NDArray[np.bool_],
    seed: int = 0,
    blind: float = 0.5,
    noise: float = 0.1,
) -> NDArray[np.float32]:
    """Disparity that a sensor measures: the truth, and in spots of the mask what lies behind it, or nothing.

    Parameters
    ----------
    truth, behind : (H, W) float32, pixels, NaN = unknown; with the object and without it
    mask : (H, W) bool, the object
    blind : share of the mask where nothing is measured, in [0, 1]
    noise : standard deviation, pixels
    """
    rng = np.random.default_rng([seed, 0xB1])
    height, width = truth.shape
    spots = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), max(1.0, _BLOB * width))
    seen = np.where(mask, behind, truth)
    if mask.any():
        seen = np.where(mask & (spots <= np.quantile(spots[mask], blind)), np.nan, seen)
    seen = seen + noise * rng.standard_normal((height, width))
    return np.where(seen > 0, seen, np.nan).astype(np.float32)


def _see_through(
    behind: NDArray[np.float32], front: NDArray[np.float32], owner: NDArray[np.int16], opaque: int
) -> NDArray[np.float32]:
    """A view of the objects from ``opaque`` on, in front of the view without them."""
    image = np.where((owner >= opaque)[:, :, None], front, behind)
    for index in range(opaque, int(owner.max()) + 1):
        rows, columns = np.nonzero(owner == index)
        if rows.size == 0:
            continue
        # A lens shows what is behind it turned towards its center.
        y = (rows + _LENS * (rows.mean() - rows)).astype(np.float32)
        x = (columns + _LENS * (columns.mean() - columns)).astype(np.float32)
        shifted = cv2.remap(behind, x[:, None], y[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        image[rows, columns] = _OWN * front[rows, columns] + (1 - _OWN) * shifted[:, 0]
    return np.asarray(image, np.float32)
