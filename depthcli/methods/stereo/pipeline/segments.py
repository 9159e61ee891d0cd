"""Segment-based stereo with key points and graph cuts (thesis, chapter 2)."""

from __future__ import annotations

from pydantic import Field

from depthcli.core.context import Clock, Context
from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.adjustment import AdjustingMatcher, adjusted
from depthcli.methods.stereo.cost import Cost
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.segments.steps import SegmentSteps
from depthcli.methods.stereo.volume import StereoResult


class Segments(SegmentSteps, AdjustingMatcher, StereoPipeline):
    """Every segment of the left image gets a plane; the planes of all segments are chosen together.

    Additions to the method (thesis, chapter 2), all off by default; each preset names those that it uses:

    - ``optimization`` between window and selection, so that more disparities are trusted;
    - ``split``: segments that are not planar are cut along a grid;
    - ``rounds``: planes are fitted again to groups of segments that share one;
    - ``visibility``: a plane costs more if it puts occluded pixels in front of the right view's surface;
    - ``restoration``: first disparities replace planes on surfaces that no plane fits.
    """

    cost: Cost = Field(description="matching cost of two pixels")

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Match the whole pair over disparities 0 .. ``max_disparity`` inclusive."""
        clock = Clock()
        pair = adjusted(pair, max_disparity, self.adjust, context, clock)
        clock.start("cost")
        volume = self.cost.checked_costs(pair, max_disparity + 1)
        return self.from_volume(pair, volume, max_disparity, clock)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Estimate: raw costs, the window's means (a byte more each) and two sums of path costs (2 bytes each)."""
        optimized = not isinstance(self.optimization, WinnerTakesAll)
        raw = self.cost.bytes_per_cost
        per_cell = max(2 + raw, 1 + raw + (1 + raw if self.window_radius else 0) + (4 if optimized else 0))
        per_pixel = (max_disparity + 1) * per_cell + 300 + self.cost.pixel_bytes()
        return shape[0] * shape[1] * per_pixel + (64 << 20)
