"""Any program that completes the depth map of a frame with transparent objects."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from depthcli.core.frames import SparseFrame
from depthcli.core.result import Clock, DepthResult
from depthcli.methods.transparent.fitted_frame import inverse_depth, refined_depth
from depthcli.methods.transparent.pipeline import TransparentPipeline
from depthcli.programs.depth import MAP_BYTES, DepthProgram


class Command(DepthProgram, TransparentPipeline):
    """A program of others: color, depth and sparse depth in, a depth map out."""

    placeholders: ClassVar[tuple[str, ...]] = ("sparse", *DepthProgram.placeholders)

    tolerance: float = Field(
        0.01, ge=0, le=10, description="difference from the sensor above which its value counts as replaced, meters"
    )

    def __call__(self, frame: SparseFrame) -> DepthResult:
        """Write the frame, run the program, read its map; ProgramError where it failed."""
        clock = Clock()
        depth = self.new_depth(frame, {"sparse": frame.sparse}, clock)
        with np.errstate(invalid="ignore"):
            replaced = np.abs(depth - frame.depth) > self.tolerance
        kept = np.isfinite(depth) & np.isfinite(frame.depth) & ~replaced
        values = np.where(kept, inverse_depth(frame.depth), inverse_depth(depth))
        return refined_depth(frame, values, replaced, clock)

    def peak_bytes(self, shape: tuple[int, int]) -> int:
        """Return the memory of the images and maps, bytes; what the program takes is not known before."""
        return MAP_BYTES * shape[0] * shape[1]
