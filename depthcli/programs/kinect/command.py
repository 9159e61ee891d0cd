"""Any program that refines the depth map of a frame."""

from __future__ import annotations

import numpy as np

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock, DepthResult
from depthcli.methods.kinect.disparity import measured_disparity, noise_level, refined_depth
from depthcli.methods.kinect.pipeline import KinectPipeline
from depthcli.programs.depth import MAP_BYTES, DepthProgram


class Command(DepthProgram, KinectPipeline):
    """A program of others: color and depth in, a depth map out.

    The status of a measured pixel says how far the program moved its value: within the noise ``SMOOTHED``, farther
    ``CORRECTED``.
    """

    bytes_per_pixel = MAP_BYTES

    def __call__(self, frame: RgbdFrame) -> DepthResult:
        """Write the frame, run the program, read its map; ProgramError where it failed."""
        clock = Clock()
        noise = noise_level(measured_disparity(frame))
        depth = self.new_depth(frame, {}, clock)
        disparity = (np.float32(frame.fb) / depth).astype(np.float32)
        return refined_depth(frame, disparity, np.full(frame.shape, np.nan, np.float32), noise, clock)
