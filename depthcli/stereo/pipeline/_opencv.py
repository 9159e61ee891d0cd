"""What the two OpenCV matchers share: padding, WLS filter, filling, and the way back to our maps."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from depthcli.core.maps import DisparityMap, Status
from depthcli.stereo.volume import StereoResult

_FRACTIONS = 16  # OpenCV's disparities are int16 sixteenths


class Wls(BaseModel):
    """Edge-preserving smoothing and filling, guided by the left image and by a right-to-left match."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    lambda_: float = Field(8000.0, alias="lambda", gt=0, description="strength of the smoothing")
    sigma_color: float = Field(1.5, gt=0, description="color sensitivity; smaller keeps more edges")


def search_range(max_disparity: int) -> int:
    """OpenCV's number of disparities for 0 .. ``max_disparity``: a multiple of 16."""
    if max_disparity < 0:
        raise ValueError(f"max_disparity must be >= 0, got {max_disparity}")
    return (max_disparity // 16 + 1) * 16


def match(
    matcher: Any,
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    max_disparity: int,
    margin: int,
    wls: Wls | None,
    fill: bool,
) -> StereoResult:
    """Run ``matcher`` on the padded pair.

    The matchers never answer in the first ``search_range`` columns, so the pair is padded on the left by
    repeating its border, and the answer is cropped.

    Parameters
    ----------
    matcher : cv2.StereoSGBM or cv2.StereoBM
    left, right : (H, W) or (H, W, 3) uint8
    margin : padding on every side beside that, pixels
    """
    height, width = left.shape[:2]
    lead = search_range(max_disparity) + margin
    seconds: dict[str, float] = {}
    start = time.perf_counter()
    padded_left, padded_right = (
        cv2.copyMakeBorder(image, margin, margin, lead, margin, cv2.BORDER_REPLICATE) for image in (left, right)
    )
    raw = matcher.compute(padded_left, padded_right)
    values, status = _to_map(raw[margin : margin + height, lead : lead + width], max_disparity)
    start = _lap(seconds, "matching", start)
    if wls is not None:
        mirrored = cv2.ximgproc.createRightMatcher(matcher).compute(padded_right, padded_left)
        smoother = cv2.ximgproc.createDisparityWLSFilter(matcher)
        smoother.setLambda(wls.lambda_)
        smoother.setSigmaColor(wls.sigma_color)
        smooth = smoother.filter(raw, padded_left, None, mirrored)
        values, beyond = _to_map(smooth[margin : margin + height, lead : lead + width], max_disparity)
        answered = ~np.isnan(values)
        status = np.where(answered, status | Status.SMOOTHED, status | beyond).astype(np.uint8)
        status[answered & (status != Status.SMOOTHED)] |= np.uint8(Status.FILLED)
        start = _lap(seconds, "wls", start)
    if fill:
        values, status = _fill_background(values, status)
        _lap(seconds, "fill", start)
    return StereoResult(DisparityMap(values, status), seconds=seconds)


def _to_map(raw: NDArray[Any], max_disparity: int) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Pixels and reasons of (H, W) int16; what lies more than a step beyond the range was not asked for."""
    status = np.zeros(raw.shape, np.uint8)
    status[raw >= (max_disparity + 1) * _FRACTIONS] = Status.OUT_OF_RANGE
    status[raw < 0] = Status.MISMATCH
    values = np.where(status == 0, raw.astype(np.float32) / _FRACTIONS, np.float32(np.nan))
    return values.astype(np.float32), status


def _fill_background(
    values: NDArray[np.float32], status: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Give pixels without a value the smaller of the nearest values left and right of them in their row."""
    width = values.shape[1]
    known = ~np.isnan(values)
    columns = np.arange(width)
    before = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    rows = np.arange(values.shape[0])[:, None]
    nearest = np.fmin(
        np.where(before >= 0, values[rows, np.maximum(before, 0)], np.float32(np.nan)),
        np.where(after < width, values[rows, np.minimum(after, width - 1)], np.float32(np.nan)),
    )
    filled = np.where(known, values, nearest).astype(np.float32)
    return filled, np.where(~known & ~np.isnan(filled), status | Status.FILLED, status).astype(np.uint8)


def _lap(seconds: dict[str, float], stage: str, start: float) -> float:
    now = time.perf_counter()
    seconds[stage] = now - start
    return now
