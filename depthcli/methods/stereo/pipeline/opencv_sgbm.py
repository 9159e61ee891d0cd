"""OpenCV's semi-global matching, for comparison."""

from __future__ import annotations

from typing import Literal

import cv2
from pydantic import Field

from depthcli.core.context import Context
from depthcli.core.frames import StereoPair
from depthcli.core.method import Odd
from depthcli.methods.stereo.pipeline._opencv import OpencvMatcher, opencv_disparities
from depthcli.methods.stereo.volume import StereoResult

_MODES = {
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "hh": cv2.STEREO_SGBM_MODE_HH,
    "hh4": cv2.STEREO_SGBM_MODE_HH4,
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
}


class OpencvSgbm(OpencvMatcher):
    """``cv2.StereoSGBM``, padded to give values at the left border too, with optional WLS filter and fill.

    Pixels that OpenCV rejects are ``MISMATCH``, whatever the reason (uniqueness, left-right check, speckles).
    """

    aliases = ("SGBM",)

    mode: Literal["sgbm", "hh", "hh4", "3way"] = Field(
        "sgbm", description="paths per pixel: sgbm 5, hh 8, hh4 4, 3way 3"
    )
    block: Odd = Field(5, ge=1, le=11, description="side of the matched block, pixels, odd")
    p1: int | None = Field(None, ge=0, le=32000, description="penalty of a step of 1; null: 8 x channels x block^2")
    p2: int | None = Field(
        None, ge=1, le=32000, description="penalty of a step above 1, above p1; null: 32 x channels x block^2"
    )
    pre_filter_cap: int = Field(0, ge=0, le=63, description="truncation of the pre-filtered gradients, grey levels")

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Match on 8 bits; color pairs are matched in color."""
        left, right = pair.color8 if pair.left.ndim == 3 else pair.grey8
        area = self.block**2 * (3 if pair.left.ndim == 3 else 1)
        p1 = 8 * area if self.p1 is None else self.p1
        matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=opencv_disparities(max_disparity),
            blockSize=self.block,
            P1=p1,
            P2=max(p1 + 1, 32 * area) if self.p2 is None else self.p2,
            preFilterCap=self.pre_filter_cap,
            mode=_MODES[self.mode],
        )
        # OpenCV fails for images no wider than half a block.
        margin = 0 if left.shape[1] > self.block else self.block
        return self.matched(matcher, left, right, max_disparity, margin)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of the maps and of int16 costs and sums: volumes in modes hh and hh4, otherwise rows."""
        height, width = shape
        n_disparities = opencv_disparities(max_disparity)
        rows, columns = height if self.mode in ("hh", "hh4") else 4, width + n_disparities
        return 4 * rows * columns * n_disparities + height * columns * (60 if self.wls else 30)
