"""Simulate a Kinect-like sensor on a scene with known disparity.

The sensor measures at the color camera's pixels. Triangulating sensors have two systematic faults. Near surfaces look
wider than they are, since a matching window that sees both surfaces takes the better textured or nearer one (mismatch).
The far side of every left edge is in the projector's shadow (gap). Sensors differ in both faults, in their noise, and
in the registration of color and depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Doubles, Floats, Image8, Mask

_JUMP = 1.0  # pixels of disparity between neighbors; smaller steps are slopes


@dataclass(frozen=True)
class KinectSample:
    """A simulated frame with its ground truth. Masks contain only pixels with known ground truth."""

    color: Image8  # (H, W, 3) RGB
    disparity: Floats  # as measured by the sensor
    truth: Floats
    occluded: Mask  # in the shadow of something nearer, without a measurement
    specular: Mask  # in a disc without a measurement, and not in shadow
    mismatch: Mask  # measured, but the value of the surface in front
    measured: Mask  # measured rightly, up to noise
    intrinsics: Intrinsics | None = None
    pose: Doubles | None = None  # (4, 4), from the camera's coordinates to the world's, meters

    @property
    def gap(self) -> Mask:
        """Pixels without a measurement but with known ground truth."""
        return self.occluded | self.specular

    def frame(self, fb: float = RgbdFrame.fb) -> RgbdFrame:
        """Return the measurement as a frame in meters; ``fb`` in pixel meters."""
        return RgbdFrame(self.color, depth_of_disparity(self.disparity, fb), fb, self.intrinsics, pose=self.pose)

    def depth_true(self, fb: float = RgbdFrame.fb) -> Floats:
        """Return the true depth, (H, W) float32, meters, NaN = unknown."""
        return depth_of_disparity(self.truth, fb)


@dataclass(frozen=True)
class Sensor:
    """Parameters of a simulated depth sensor. Lengths are in pixels, along the rows unless stated otherwise."""

    fattening: int = 4  # width by which nearer surfaces grow over farther ones
    sides: Literal["both", "left", "right"] = "both"  # of near surfaces, on which they grow
    noise: float = 0.3  # standard deviation of the disparity
    correlation: float = 0.0  # standard deviation of the Gaussian that smooths the noise; 0: white noise
    shadows: Literal["left", "right", "none"] = "left"  # of near surfaces; a time-of-flight sensor has none
    covered: bool = False  # True: the near surface grows over its shadow; False: the shadow moves
    baseline: float = 1.0  # width of a shadow / the disparity step at its edge
    step: float = 0.0  # disparities are rounded to multiples of this; 0: not rounded
    # Pixels on both sides of a step, along rows and columns, with any value between both surfaces: time of flight.
    mixed: int = 0
    color_shift: tuple[int, int] = (0, 0)  # of the color image to the right and down against the depth
    discs: int = 8  # number of specular spots without a measurement
    disc_radius: tuple[float, float] = (8.0, 22.0)  # smallest and largest
    farthest: float = 0.0  # smallest disparity that is measured, as a share of the scene's largest; 0: no limit


def simulate_kinect(
    color: Image8,
    truth: NDArray[np.floating[Any]],
    seed: int = 0,
    *,
    sensor: Sensor | None = None,
    **changed: Any,
) -> KinectSample:
    """Return a Kinect-like measurement of a scene.

    At every step of more than a pixel between neighbors in a row, the edge value of the nearer surface replaces some
    pixels of the farther one. Then the shadow is removed: as many pixels left of every such edge as the disparity
    jumps (a pixel is in shadow if its ``x - d`` is not left of the ``x - d`` of every nearer pixel to its right). Some
    random discs are removed, too. The remaining pixels get Gaussian noise. Pixels with unknown truth are not measured.

    Parameters
    ----------
    color : (H, W, 3) uint8 RGB
    truth : (H, W) float, pixels of disparity, NaN or infinite = unknown; ValueError if no pixel is known
    seed : seed of discs and noise
    sensor : parameters of the sensor; None: a Kinect
    changed : attributes of ``sensor`` that differ, such as ``fattening=2``
    """
    sensor = replace(sensor or Sensor(), **changed)
    known = np.isfinite(truth)
    if not known.any():
        raise ValueError("no pixel has a true disparity")
    surface = _behind(np.where(known, truth, np.nan).astype(np.float32))
    fattened = _fattened(surface, sensor.fattening, sensor.sides)
    shadow = np.zeros(truth.shape, bool)
    if sensor.shadows != "none":
        turn = np.s_[:, ::-1] if sensor.shadows == "right" else np.s_[:, :]
        shadow = _shadow((surface if sensor.covered else fattened)[turn], sensor.baseline)[turn]
        if sensor.covered:
            shadow &= np.abs(fattened - surface) <= _JUMP
    rng = np.random.Generator(np.random.PCG64([seed, 0x4B1]))
    spots = discs(rng, truth.shape, sensor.discs, sensor.disc_radius)
    grain = rng.standard_normal(truth.shape, np.float32)
    if sensor.correlation:
        smooth = cv2.GaussianBlur(grain, (0, 0), sensor.correlation, borderType=cv2.BORDER_REFLECT)
        grain = np.asarray(smooth / smooth.std(), np.float32)
    values = fattened
    if sensor.mixed:
        kernel = np.ones((2 * sensor.mixed + 1, 2 * sensor.mixed + 1), np.uint8)
        near, far = cv2.dilate(fattened, kernel), cv2.erode(fattened, kernel)
        share = rng.random(fattened.shape, np.float32)
        values = np.asarray(np.where(near - far > _JUMP, far + share * (near - far), fattened), np.float32)
    values = values + sensor.noise * grain
    if sensor.step:
        values = np.rint(values / sensor.step) * sensor.step
    wrong = np.abs(fattened - surface) > _JUMP
    wrong |= np.abs(values - surface) > np.float32(_JUMP + 4 * sensor.noise + sensor.step)
    too_far = surface < sensor.farthest * surface.max()
    missing = shadow | spots | too_far | (values <= 0)
    rows, columns = (
        np.clip(np.arange(size) - moved, 0, size - 1)
        for size, moved in zip(truth.shape, reversed(sensor.color_shift), strict=True)
    )
    return KinectSample(
        color=np.ascontiguousarray(color[rows[:, None], columns]),
        disparity=np.where(known & ~missing, values, np.nan).astype(np.float32),
        truth=np.where(known, truth, np.nan).astype(np.float32),
        occluded=known & shadow,
        specular=known & missing & ~shadow,
        mismatch=known & wrong & ~missing,
        measured=known & ~wrong & ~missing,
    )


def _behind(truth: Floats) -> Floats:
    """Fill unknown runs of each row with the smaller value at their ends, empty rows with the nearest row."""
    left, right = truth.copy(), truth.copy()
    for x in range(1, truth.shape[1]):
        left[:, x] = np.where(np.isnan(left[:, x]), left[:, x - 1], left[:, x])
        right[:, -x - 1] = np.where(np.isnan(right[:, -x - 1]), right[:, -x], right[:, -x - 1])
    filled: Floats = np.fmin(left, right)
    empty = np.isnan(filled[:, 0])
    if empty.any():
        given = np.flatnonzero(~empty)
        filled = filled[given[np.abs(np.arange(len(filled))[:, None] - given).argmin(axis=1)]]
    return filled


def _fattened(surface: Floats, width: int, sides: str) -> Floats:
    """Return the disparity with surfaces in front spread over ``width`` pixels on their sides along the rows."""
    step = np.diff(surface, axis=1)
    faces_left, faces_right = np.full_like(surface, -np.inf), np.full_like(surface, -np.inf)
    faces_left[:, 1:] = np.where(step > _JUMP, surface[:, 1:], -np.inf)
    faces_right[:, :-1] = np.where(step < -_JUMP, surface[:, :-1], -np.inf)
    result = surface.copy()
    for k in range(1, min(width, surface.shape[1] - 1) + 1):
        if sides != "right":
            np.maximum(result[:, :-k], faces_left[:, k:], out=result[:, :-k])
        if sides != "left":
            np.maximum(result[:, k:], faces_right[:, :-k], out=result[:, k:])
    return result


def _shadow(fattened: Floats, baseline: float) -> Mask:
    """Select pixels whose projected position ``x - d`` a surface on their right hides, which is nearer."""
    position = np.arange(fattened.shape[1], dtype=np.float32) - np.float32(baseline) * fattened
    shadow = np.zeros(fattened.shape, bool)
    front = position[:, -1].copy()
    front_value = fattened[:, -1].copy()
    for x in range(fattened.shape[1] - 2, -1, -1):
        shadow[:, x] = (position[:, x] >= front) & (front_value - fattened[:, x] > _JUMP)
        ahead = position[:, x] < front
        front = np.where(ahead, position[:, x], front)
        front_value = np.where(ahead, fattened[:, x], front_value)
    return shadow


def discs(rng: np.random.Generator, shape: tuple[int, ...], count: int, radius: tuple[float, float]) -> Mask:
    """Return the pixels of ``count`` random discs, whose radius is in a range of pixels."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    spots = np.zeros(rows.shape, bool)
    for _ in range(count):
        y, x, r = rng.uniform(0, shape[0]), rng.uniform(0, shape[1]), rng.uniform(*radius)
        spots |= (rows - y) ** 2 + (columns - x) ** 2 <= r * r
    return spots
