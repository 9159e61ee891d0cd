"""Common parts of the two OpenCV matchers: fields, padding, WLS filter, filling, and conversion to disparity maps."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.filters import single_thread
from depthcli.core.context import Clock
from depthcli.core.maps import DisparityMap, Floats, Image8, Status
from depthcli.core.method import ConfigModel
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.refinement.background_fill import fill_background
from depthcli.methods.stereo.volume import StereoResult

_FRACTIONS = 16  # OpenCV's disparities are int16 sixteenths


class Wls(ConfigModel):
    """Edge-preserving smoothing and filling, guided by the left image and by a right-to-left match."""

    lambda_: float = Field(
        8000.0, alias="lambda", gt=0, le=1e9, description="strength of the weighted-least-squares smoothing"
    )
    sigma_color: float = Field(1.5, gt=0, le=1e4, description="color scale of the smoothing; smaller keeps more edges")


class OpencvMatcher(StereoPipeline):
    """A matcher of OpenCV, padded so that it gives values up to the border, with optional WLS filter and fill."""

    uniqueness: int = Field(10, ge=0, le=100, description="margin that the best cost needs over the second best, %")
    left_right: int = Field(1, ge=-1, le=16384, description="largest left-right difference, pixels; -1: no check")
    speckle_size: int = Field(100, ge=0, le=10**8, description="speckles of fewer pixels are rejected; 0: none")
    speckle_range: int = Field(2, ge=0, le=16384, description="largest disparity step inside a speckle, pixels")
    wls: Wls | None = Field(None, description="weighted-least-squares filter of cv2.ximgproc; null: off")
    fill: bool = Field(True, description="fill pixels without a value with the background of their row")

    def matched(self, matcher: Any, left: Image8, right: Image8, max_disparity: int, margin: int) -> StereoResult:
        """Run ``matcher``, cv2.StereoSGBM or cv2.StereoBM, on a pair of (H, W) or (H, W, 3) uint8, padded.

        The matchers give no value in the first ``opencv_disparities`` columns. So the pair is padded on the left by
        repeating its border, and by ``margin`` more pixels on every side. The result is cropped.
        """
        matcher.setUniquenessRatio(self.uniqueness)
        matcher.setDisp12MaxDiff(self.left_right)
        matcher.setSpeckleWindowSize(self.speckle_size)
        matcher.setSpeckleRange(self.speckle_range)
        height, width = left.shape[:2]
        lead = opencv_disparities(max_disparity) + margin
        clock = Clock()
        clock.start("matching")
        padded_left, padded_right = (
            cv2.copyMakeBorder(image, margin, margin, lead, margin, cv2.BORDER_REPLICATE) for image in (left, right)
        )
        raw = matcher.compute(padded_left, padded_right)
        values, status = _to_map(raw[margin : margin + height, lead : lead + width], max_disparity)
        if self.wls is not None:
            clock.start("wls")
            mirrored = cv2.ximgproc.createRightMatcher(matcher).compute(padded_right, padded_left)
            smoother = cv2.ximgproc.createDisparityWLSFilter(matcher)
            smoother.setLambda(self.wls.lambda_)
            smoother.setSigmaColor(self.wls.sigma_color)
            with single_thread():
                smooth = smoother.filter(raw, padded_left, None, mirrored)
            values, beyond = _to_map(smooth[margin : margin + height, lead : lead + width], max_disparity)
            answered = ~np.isnan(values)
            status = np.where(answered, status | Status.SMOOTHED, status | beyond).astype(np.uint8)
            status[answered & (status != Status.SMOOTHED)] |= np.uint8(Status.FILLED)
        disparity = DisparityMap(values, status)
        if self.fill:
            clock.start("fill")
            disparity = fill_background(disparity)
        return StereoResult(disparity, seconds=clock.seconds)


def opencv_disparities(max_disparity: int) -> int:
    """Return OpenCV's number of disparities for 0 .. ``max_disparity``: a multiple of 16."""
    return (max_disparity // 16 + 1) * 16


def _to_map(raw: NDArray[Any], max_disparity: int) -> tuple[Floats, Image8]:
    # Values and status of (H, W) int16; a pixel or more beyond the range is OUT_OF_RANGE.
    status = np.zeros(raw.shape, np.uint8)
    status[raw >= (max_disparity + 1) * _FRACTIONS] = Status.OUT_OF_RANGE
    status[raw < 0] = Status.MISMATCH
    values = np.where(status == 0, raw.astype(np.float32) / _FRACTIONS, np.float32(np.nan))
    return values.astype(np.float32), status
