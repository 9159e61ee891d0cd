"""Disparity of a frame: the measured values, their noise, the reliable pixels, and conversion to refined depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from depthcli.algorithms.plane_fitting.least_squares import MAD_TO_SIGMA
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthMap, DepthStatus, Floats, Image8, Mask
from depthcli.core.result import DepthResult
from depthcli.methods.kinect.color import frame_lab
from depthcli.methods.kinect.depth_edges import correct_probability
from depthcli.methods.kinect.gap_limits import max_disparity_in_gaps
from depthcli.methods.kinect.shadows import Shadows, Side, shadows_of

_NOISE_SAMPLES = 60_000  # second differences along either axis: enough for the median within a percent
_NOISE_REACH = 3  # distance between the values of a wide second difference, pixels: shows noise that neighbors share
_MAX_NOISE = 3.0  # standard deviations: a measurement that moves by more was incorrect, not noisy
_CORE_PROBABILITY = 0.6  # smallest probability of a core pixel, e.g. on thin objects
_MIN_RELATIVE_DISPARITY = np.float32(1e-3)  # share of the smallest measured disparity; smaller values count as none


def measured_disparity(frame: RgbdFrame) -> Floats:
    """Return the frame's disparity, (H, W) float32 pixels, NaN = unknown; ValueError if no pixel is known."""
    disparity = frame.disparity
    if np.isnan(disparity).all():
        raise ValueError("no pixel of the frame has a depth")
    return disparity


def noise_level(disparity: Floats, floor: float = 0.1) -> float:
    """Estimate the standard deviation of a disparity map's noise, in pixels: the unit of thresholds on disparities.

    The estimate comes from the median second difference along rows and columns. Slopes do not change the median, and
    edges hardly do. If it is 0, the values are rounded, and the estimate is the rounding error for their median step.
    The result is at least ``floor``: triangulating sensors interpolate and smooth to about 1/8 pixel, and second
    differences hardly show noise that neighbors share.
    """
    every = max(1, disparity.size // _NOISE_SAMPLES)
    lines = disparity[::every], disparity[:, ::every].T
    near, wide = (
        np.concatenate([np.abs(a[:, 2 * k :] - 2 * a[:, k:-k] + a[:, : -2 * k]).ravel() for a in lines])
        for k in (1, _NOISE_REACH)
    )
    steps = np.concatenate([np.abs(np.diff(a)).ravel() for a in lines])
    step = steps[steps > 0]
    middle = float(np.median(near[~np.isnan(near)]) if not np.isnan(near).all() else 0)
    if not np.isnan(wide).all():
        middle = max(middle, float(np.median(wide[~np.isnan(wide)])))
    rounded = float(np.median(step)) / 12**0.5 if step.size and middle == 0 else 0.0
    return max(MAD_TO_SIGMA * middle / 6**0.5, rounded, floor)


@dataclass(frozen=True)
class Measurement:
    """The measured disparity of a frame, and where it is reliable; maps are (H, W), in pixels."""

    lab: Image8  # (H, W, 3), the color image
    disparity: Floats
    noise: float  # standard deviation
    jump: float  # larger steps are depth edges
    shadows: Shadows
    probability: Floats  # that a measured value belongs to the surface of its pixel; 1 without colors
    reliable: Floats  # the disparity without unreliable pixels
    core: Mask  # the more probable unreliable pixels; thin objects have no others
    limit: Floats  # largest disparity that a shadow allows, inf outside shadows

    @classmethod
    def of(
        cls, frame: RgbdFrame, jump: float, min_probability: float, where: bool | Side, noise: float | None = None
    ) -> Measurement:
        """Classify the pixels of a frame; ValueError if none has a depth.

        Parameters
        ----------
        jump : larger steps are depth edges, multiples of the noise
        min_probability : measurements with a smaller probability of being correct are unreliable; 0: none
        where : sides of the shadows, see :func:`shadows_of`
        noise : standard deviation of the disparity, pixels; None: estimated
        """
        disparity = measured_disparity(frame)
        noise = noise_level(disparity) if noise is None else noise
        shadows = shadows_of(disparity, jump * noise, where)
        lab, probability = frame_lab(frame), np.ones_like(disparity)
        if min_probability and frame.has_color:  # without colors, true outlines are unknown
            probability = correct_probability(lab, disparity, jump * noise, shadows)
        unreliable = ~np.isnan(disparity) & (probability < min_probability)
        reliable = np.where(unreliable, np.float32(np.nan), disparity)
        core = unreliable & (probability > _CORE_PROBABILITY)
        limit = max_disparity_in_gaps(disparity, jump * noise, shadows.likely())
        return cls(lab, disparity, noise, jump * noise, shadows, probability, reliable, core, limit)


def nearest_fill(values: Floats) -> Floats:
    """Fill unknown values with the nearest known value, by the approximate Euclidean distance of OpenCV."""
    unknown = np.isnan(values)
    if not unknown.any() or unknown.all():
        return values.copy()
    _, label = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.full(int(label.max()) + 1, np.nan, np.float32)
    table[label[~unknown]] = values[~unknown]
    return np.asarray(table[label], np.float32)


def refined_depth(
    frame: RgbdFrame, disparity: Floats, noise: float, clock: Clock, fallback: Mask | None = None
) -> DepthResult:
    """Convert a refined disparity to depth, with the status of every pixel.

    Parameters
    ----------
    disparity : (H, W) float32 refined, pixels, NaN = none. Values that are not positive, or farther than 1000 times
        the farthest measurement, count as none
    noise : standard deviation of the measurement, pixels. A measured value that moved by more than three times the
        noise is ``CORRECTED``, by less ``SMOOTHED``
    fallback : (H, W) bool, gaps filled from neighbors instead of by the model
    """
    clock.start("result")
    measured = frame.disparity
    known = ~np.isnan(measured)
    values = np.where(disparity > np.nanmin(measured) * _MIN_RELATIVE_DISPARITY, disparity, np.float32(np.nan))
    depth = depth_of_disparity(values, frame.fb)
    same = values == measured
    depth[same] = frame.depth[same]
    status = np.zeros(frame.shape, np.uint8)
    status[known & ~same] = DepthStatus.SMOOTHED
    status[known & (np.abs(values - measured) > _MAX_NOISE * noise)] = DepthStatus.CORRECTED
    status[~known] = DepthStatus.GAP_FILLED
    if fallback is not None:
        status[~known & fallback] = DepthStatus.FALLBACK
    status[np.isnan(depth)] = DepthStatus.EMPTY
    return DepthResult(seconds=clock.seconds, depth=DepthMap(depth, status))
