"""Frames of a camera that moves little: segments are carried on, not computed anew (thesis chapter 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.core.result import Clock
from depthcli.kernels.jit import parallel_jit, prange
from depthcli.methods.kinect.layer import Evidence, Layer, combine, evidence
from depthcli.methods.kinect.pipeline import SequencePipeline
from depthcli.methods.kinect.pipeline.dsrm import Dsrm, filled, in_meters
from depthcli.methods.kinect.result import RefinedDepth
from depthcli.methods.kinect.sequence import SequenceState, carried_labels, still_pixels

_FILLED, _FALLBACK, _CARRIED = int(DepthStatus.GAP_FILLED), int(DepthStatus.FALLBACK), int(DepthStatus.CARRIED)


class Sequence(SequencePipeline, Dsrm):
    """The first frame as in ``dsrm``; then every pixel that is still keeps its segment, and surfaces are refitted.

    What has changed joins the segment that is nearest in color and depth. Too much change, or age, starts anew.
    """

    color_change: int = Field(
        10, ge=0, le=255, description="a still pixel's color changes by at most this, grey levels"
    )
    most_changed: float = Field(0.3, ge=0, le=1, description="share of changed pixels that starts anew")
    longest: int = Field(30, ge=1, description="frames after which segments are computed anew")
    drift: float = Field(
        1.0, ge=0, description="scale by which a filled value is trusted less a frame later, multiples of the noise"
    )

    def step(self, frame: RgbdFrame, state: SequenceState | None) -> tuple[RefinedDepth, SequenceState]:
        """Refine the next frame; the state is a :class:`SequenceState`, None before the first.

        Raises
        ------
        ValueError
            Where no pixel of the frame has a depth, or its size is another than before.
        """
        if state is None:
            return self.start(frame)
        if state.color.shape != frame.color.shape:
            raise ValueError(f"the frame's size {frame.shape} is not that of the frames before {state.color.shape[:2]}")
        clock = Clock()
        seen = evidence(frame, self.jump, self.row_band, self.column_band, state.noise)
        still = still_pixels(
            frame.color, state.color, seen.trusted, state.disparity, self.color_change, self.tolerance * state.noise
        )
        clock.stop("suspects")
        if state.age + 1 >= self.longest or 1 - still.mean() > self.most_changed:
            return self.start(frame)
        layers = [self._carried(layer, seen, still, frame.color) for layer in state.layers]
        clock.stop("model")
        refined = combine(layers, seen, self.detail_reach, self.tolerance, self.smooth)
        _blend(
            refined.disparity, refined.scale, refined.status, state.disparity, still,
            np.float32(self.drift * state.noise),
        )  # fmt: skip
        refined = filled(refined, frame, seen)
        clock.stop("refinement")
        result = in_meters(refined, frame)
        clock.stop("result")
        result.seconds = clock.seconds
        return result, SequenceState(tuple(layers), frame.color, refined.disparity, state.noise, state.age + 1)

    def start(self, frame: RgbdFrame) -> tuple[RefinedDepth, SequenceState]:
        """Refine a frame as if none had been before."""
        result, seen, layers, disparity = self.refine(frame)
        return result, SequenceState(tuple(layers), frame.color, disparity, seen.noise, 0)

    def _carried(self, layer: Layer, seen: Evidence, still: NDArray[np.bool_], color: NDArray[np.uint8]) -> Layer:
        """The layer in this frame: labels moved, surfaces refitted from where they were."""
        labels, own = carried_labels(layer, still, color, seen, self.jump * seen.noise)
        return Layer(labels, self.model(seen.trusted, labels, seen.noise, layer.surfaces), own)


@parallel_jit
def _blend(disparity, scale, status, before, still, drift):  # type: ignore[no-untyped-def]
    """Filled values of still pixels: weighted mean with those before, which are as sure but for the drift."""
    height, width = disparity.shape
    for y in prange(height):
        for x in range(width):
            if (status[y, x] == _FILLED or status[y, x] == _FALLBACK) and still[y, x] and not np.isnan(before[y, x]):
                variance = scale[y, x] * scale[y, x]
                now, then = np.float32(1) / variance, np.float32(1) / (variance + drift * drift)
                disparity[y, x] = (now * disparity[y, x] + then * before[y, x]) / (now + then)
                status[y, x] = _CARRIED
