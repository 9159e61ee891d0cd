"""The post-processing chain of librealsense, with its parameters' names and defaults, for comparison."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus, Floats, Image8
from depthcli.core.result import DepthResult
from depthcli.kernels.jit import jit, run_bands
from depthcli.methods.kinect.disparity import measured_disparity, noise_level, refined_depth
from depthcli.methods.kinect.pipeline import SequencePipeline

_FRACTION = 32  # unit of the deltas: 1/32 pixel of disparity, as in librealsense
# Persistency -> (m, n): a pixel is carried over if it was valid in m of the last n frames (librealsense).
_PERSISTENCE = {1: (8, 8), 2: (2, 3), 3: (2, 4), 4: (2, 8), 5: (1, 2), 6: (1, 5), 7: (1, 8)}
_HOLES = {"left": 0, "farthest": 1, "nearest": 2}


class RealsenseState(NamedTuple):
    """State of the temporal filter."""

    last: Floats  # (H, W), filtered disparity, pixels; NaN = never known
    history: Image8  # (H, W), bit k: valid and in agreement k + 1 frames ago


class Realsense(SequencePipeline):
    """Spatial, temporal and hole-filling filter of librealsense, in this order, on disparity; without the color image.

    The spatial filter is recursive and preserves edges: along rows and columns, in both directions, a value is averaged
    with the filter's state if its step from the previous value is smaller than ``spatial_delta``.
    """

    magnitude: int = Field(2, ge=0, le=5, description="passes of the spatial filter; 0: off")
    spatial_alpha: float = Field(0.5, ge=0.25, le=1, description="weight of the value against the filter's state")
    spatial_delta: int = Field(20, ge=1, le=50, description="larger steps are edges, 32nds of a pixel")
    temporal_alpha: float = Field(0.4, gt=0, le=1, description="weight of the frame against the previous ones")
    temporal_delta: int = Field(20, ge=1, le=100, description="larger changes are motion, 32nds of a pixel")
    persistency: int = Field(
        3,
        ge=0,
        le=8,
        description="carry a value over gaps if valid in (1) 8 of 8, 2 of 3, 2 of 4, 2 of 8, 1 of 2, "
        "1 of 5, 1 of 8 last frames, (8) always; 0: never",
    )
    hole_filling: Literal["off", "left", "farthest", "nearest"] = Field(
        "farthest", description="gaps take the value on their left, or the farthest or nearest of those around"
    )

    def step(self, frame: RgbdFrame, state: RealsenseState | None) -> tuple[DepthResult, RealsenseState]:
        """Filter the next frame; ValueError if it has no depth, or another size than the previous frames."""
        clock = Clock()
        clock.start("spatial")
        measured = measured_disparity(frame)
        if state is None:
            state = RealsenseState(np.full(frame.shape, np.nan, np.float32), np.zeros(frame.shape, np.uint8))
        self.check_size(frame, state.last.shape)
        values = measured.copy()
        for _ in range(self.magnitude):
            for lines in (values, values.T):
                run_bands(
                    _smooth_lines,
                    len(lines),
                    lines,
                    np.float32(self.spatial_alpha),
                    np.float32(self.spatial_delta / _FRACTION),
                )
        clock.start("temporal")
        last, history = state.last.copy(), state.history.copy()
        min_valid, n_frames = (9, 8) if self.persistency == 0 else _PERSISTENCE.get(self.persistency, (0, 8))
        alpha, delta = np.float32(self.temporal_alpha), np.float32(self.temporal_delta / _FRACTION)
        carried = np.zeros(frame.shape, np.bool_)
        run_bands(_temporal, len(values), values, last, history, alpha, delta, min_valid, n_frames, carried)
        clock.start("holes")
        if self.hole_filling != "off":
            _fill(values, _HOLES[self.hole_filling])
        noise = noise_level(measured)
        result = refined_depth(frame, values, noise, clock)
        result.depth.status[carried] = DepthStatus.CARRIED
        return result, RealsenseState(last, history)


@jit
def _smooth_lines(begin, end, values, alpha, delta):
    # Filter every row in both directions. As in librealsense, edges are steps between the values before each pass.
    for y in range(begin, end):
        line = values[y]
        for back in range(2):
            previous = state = np.float32(np.nan)
            for k in range(line.size):
                i = line.size - 1 - k if back else k
                value = line[i]
                if not np.isnan(value):
                    if abs(previous - value) < delta:
                        state = alpha * value + (np.float32(1) - alpha) * state
                        line[i] = state
                    else:
                        state = value
                previous = value


@jit
def _temporal(begin, end, values, last, history, alpha, delta, min_valid, n_frames, carried):
    width = values.shape[1]
    for y in range(begin, end):
        for x in range(width):
            value, previous, bits = values[y, x], last[y, x], np.int64(history[y, x])
            if np.isnan(value):
                valid = np.int64(0)
                for k in range(n_frames):
                    valid += (bits >> k) & 1
                if not np.isnan(previous) and valid >= min_valid:
                    values[y, x] = previous
                    carried[y, x] = True
                history[y, x] = np.uint8((bits << 1) & 255)
            elif abs(value - previous) < delta:
                value = alpha * value + (np.float32(1) - alpha) * previous
                values[y, x] = value
                last[y, x] = value
                history[y, x] = np.uint8(((bits << 1) | 1) & 255)
            else:  # first value, or motion
                last[y, x] = value
                history[y, x] = np.uint8(1)


@jit
def _fill(values, mode):
    # In raster order: filled values count as known for later pixels. The farthest value is the smallest disparity.
    height, width = values.shape
    for y in range(height):
        for x in range(width):
            if not np.isnan(values[y, x]):
                continue
            best = values[y, x]
            for k in range(5):
                # left; above, above left, below left, below
                dy = 0 if k == 0 else (-1 if k < 3 else 1)
                dx = 0 if k == 1 or k == 4 else -1
                v, u = y + dy, x + dx
                if (mode == 0 and k > 0) or u < 0 or v < 0 or v >= height or np.isnan(values[v, u]):
                    continue
                other = values[v, u]
                if np.isnan(best) or (other < best if mode == 1 else other > best):
                    best = other
            values[y, x] = best
