"""OpenCV's block matching, for comparison."""

from __future__ import annotations

import cv2
from pydantic import Field

from depthcli.core.context import Context
from depthcli.core.frames import StereoPair
from depthcli.core.method import Odd
from depthcli.methods.stereo.pipeline._opencv import OpencvMatcher, opencv_disparities
from depthcli.methods.stereo.volume import StereoResult


class OpencvBm(OpencvMatcher):
    """``cv2.StereoBM`` on grey images, padded to give values up to the border, with optional WLS filter and fill.

    Pixels that OpenCV rejects are ``MISMATCH``, whatever the reason (texture, uniqueness, left-right check, speckles).
    """

    aliases = ("BM",)

    block: Odd = Field(15, ge=5, le=255, description="side of the matched block, pixels, odd")
    pre_filter_cap: int = Field(31, ge=1, le=63, description="truncation of the pre-filtered gradients, grey levels")
    texture: int = Field(10, ge=0, le=10**6, description="smallest sum of gradients of a block that is matched")

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        matcher = cv2.StereoBM.create(opencv_disparities(max_disparity), self.block)
        matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_XSOBEL)
        matcher.setPreFilterCap(self.pre_filter_cap)
        matcher.setTextureThreshold(self.texture)
        left, right = pair.grey8
        # Blocks must fit into the image. OpenCV gives no value where they reach beyond it.
        return self.matched(matcher, left, right, max_disparity, self.block // 2 + 1)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of a few rows of sums, and of the maps."""
        height, width = shape
        n_disparities = opencv_disparities(max_disparity)
        pixels = (height + self.block) * (width + n_disparities + self.block)
        return 8 * (width + n_disparities) * n_disparities + pixels * (60 if self.wls else 30)
