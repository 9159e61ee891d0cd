"""Fusion of maps that any programs made: at every pixel the one that is most likely right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionPixels
from depthcli.algorithms.segmentation.felzenszwalb import Felzenszwalb
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.result import Clock
from depthcli.methods.fusion.choice.network import MAX_MAPS as MAX_PROPOSALS
from depthcli.methods.fusion.choice.network import likeliest
from depthcli.methods.given_maps import Judged, MapJudgment, UsesNetworks, judged_maps, odds_of, with_reasons
from depthcli.methods.given_maps._planes import Evidence, hidden_by_map
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian
from depthcli.methods.stereo.volume import RefinementContext

_SEGMENTATION = Felzenszwalb(scale=300.0, min_size=200)
_PLANES = SegmentPlaneFit(tolerance=1.0, trials=100, flatness=0.9)
_REFINEMENT = SlantedMedian(radius=3, color_scale=10, distance_scale=3)

MAX_MAPS = MAX_PROPOSALS - 2
"""Most maps that are fused, beside that of stereo fast and planes."""


class GivenMapsFusion(UsesNetworks):
    """Fuses maps of one pair.

    Proposed are the given maps, the map of the preset ``stereo fast``, and, if asked for, planes of segments, fitted
    where the best of these is likely right. The network of :mod:`depthcli.methods.given_maps` gives the log odds of
    each; their softmax is averaged over neighbors of similar color, and the largest share wins. A map that has gaps is
    completed on the way.
    """

    surfaces: bool = Field(False, description="whether planes of segments are proposed, too")

    def __call__(
        self, pair: StereoPair, maps: Sequence[NDArray[np.float32]], max_disparity: int
    ) -> tuple[DisparityMap, MapJudgment]:
        """Fuse at most ``MAX_MAPS`` maps of a pair, (H, W) float32, pixels, NaN = no value; complete and correct one.

        Returns a map that has a value everywhere, and how likely every pixel is right within ``within``. Costs are
        computed up to ``max_disparity``. ValueError: too few or many maps, or one has not the size of the images.
        """
        if not 1 <= len(maps) <= MAX_MAPS:
            raise ValueError(f"expected 1 to {MAX_MAPS} maps, got {len(maps)}")
        clock = Clock()
        evidence = Evidence.of(pair, max_disparity, clock)
        clock.start("planes")
        judged = judged_maps(evidence, [*maps, evidence.reference.values])
        clock.start("choice")
        values, probability = self._chosen(evidence, judged)
        if self.surfaces:
            clock.start("surfaces")
            labels = _SEGMENTATION(evidence.pair.color8[0])
            count = int(labels.max()) + 1
            planes = _PLANES(values, RegionPixels.of(labels, (probability > 0.5).ravel(), count), np.arange(count))
            surfaces = planes.at(labels, evidence.volume.n_disparities - 1)
            values, probability = self._chosen(evidence, judged_maps(evidence, [surfaces], known=judged))
        clock.start("refinement")
        context = RefinementContext(evidence.pair, evidence.optimized, evidence.right)
        values = _REFINEMENT(DisparityMap(values, np.zeros(pair.shape, np.uint8)), context).values
        status = with_reasons(values, np.zeros(pair.shape, np.bool_), probability, hidden_by_map(values))
        judgment = MapJudgment(seconds=clock.seconds, probability=probability, status=status)
        return DisparityMap(values, status), judgment

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int, count: int) -> int:
        """Estimate the peak working memory for ``count`` maps of (H, W) ``shape``, bytes; two more are proposed."""
        return super().peak_bytes(shape, max_disparity, count + 2)

    def _chosen(self, evidence: Evidence, judged: Sequence[Judged]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        # The map of the largest shares, and the probability that its values are right.
        odds = np.stack([odds_of(self.networks, one, self.within) for one in judged])
        chosen = likeliest(np.stack([one.values for one in judged]), odds, evidence.narrow)
        assert chosen.probability is not None
        return chosen.values, chosen.probability
