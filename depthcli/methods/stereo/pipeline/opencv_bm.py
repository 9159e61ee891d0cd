"""OpenCV's block matching, to compare with."""

from __future__ import annotations

import cv2
from pydantic import Field

from depthcli.core.frames import StereoPair
from depthcli.core.method import Odd
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.pipeline._opencv import Wls, match, opencv_disparities
from depthcli.methods.stereo.volume import StereoResult


class OpencvBm(StereoPipeline):
    """``cv2.StereoBM`` on grey images, padded so that it answers up to the border, with optional WLS filter and fill.

    Pixels that OpenCV rejects (texture, uniqueness, left-right check, speckles: it does not say which)
    are ``MISMATCH``.
    """

    aliases = ("BM",)

    block: Odd = Field(15, ge=5, le=255, description="side of the matched block, pixels, odd")
    pre_filter_cap: int = Field(31, ge=1, le=63, description="truncation of the pre-filtered gradients, grey levels")
    texture: int = Field(10, ge=0, le=10**6, description="smallest sum of gradients of a block, else it is rejected")
    uniqueness: int = Field(10, ge=0, le=100, description="margin that the best cost needs over the second best, %")
    left_right: int = Field(1, ge=-1, le=16384, description="largest left-right difference, pixels; -1: no check")
    speckle_size: int = Field(100, ge=0, le=10**8, description="speckles of fewer pixels are rejected; 0: none")
    speckle_range: int = Field(2, ge=0, le=16384, description="largest disparity step inside a speckle, pixels")
    wls: Wls | None = Field(None, description="weighted-least-squares filter of cv2.ximgproc; null: off")
    fill: bool = Field(True, description="fill pixels without a value with the background of their row")

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        matcher = cv2.StereoBM.create(opencv_disparities(max_disparity), self.block)
        matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_XSOBEL)
        matcher.setPreFilterCap(self.pre_filter_cap)
        matcher.setTextureThreshold(self.texture)
        matcher.setUniquenessRatio(self.uniqueness)
        matcher.setDisp12MaxDiff(self.left_right)
        matcher.setSpeckleWindowSize(self.speckle_size)
        matcher.setSpeckleRange(self.speckle_range)
        left, right = pair.grey8
        # Blocks must fit into the image, and no answer is given where they reach beyond it.
        return match(matcher, left, right, max_disparity, self.block // 2 + 1, self.wls, self.fill)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate the bytes of a few rows of sums, and of the maps."""
        height, width = shape
        n_disparities = opencv_disparities(max_disparity)
        pixels = (height + self.block) * (width + n_disparities + self.block)
        return 8 * (width + n_disparities) * n_disparities + pixels * (60 if self.wls else 30)
