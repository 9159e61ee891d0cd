"""Fusion of maps that any programs made: at every pixel the one that is most likely right."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionPixels
from depthcli.algorithms.segmentation.felzenszwalb import Felzenszwalb
from depthcli.core import memory
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap
from depthcli.core.result import Clock
from depthcli.methods.fusion.choice.network import softmax, take_largest
from depthcli.methods.fusion.votes import BLOCK_DEPTH
from depthcli.methods.given_maps import MapJudgment, UsesNetworks, judged_maps, odds_of, with_reasons
from depthcli.methods.given_maps._evidence import Evidence
from depthcli.methods.given_maps._planes import hidden_by_map
from depthcli.methods.given_maps.measures import Judged
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian
from depthcli.methods.stereo.volume import RefinementContext

_SEGMENTATIONS = (Felzenszwalb(scale=300.0, min_size=200),)
_PLANES = SegmentPlaneFit(tolerance=1.0, trials=100, flatness=0.9)
_REFINEMENT = SlantedMedian(radius=3, color_scale=10, distance_scale=3)

MAX_MAPS = BLOCK_DEPTH - 1 - len(_SEGMENTATIONS)
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
        """Fuse the maps of a pair; one alone is completed and corrected.

        Parameters
        ----------
        maps : (H, W) float32 disparities each, pixels from 0 on, NaN = no value; at most ``MAX_MAPS``
        max_disparity : largest disparity whose costs are computed, pixels

        Returns
        -------
        The map, which has a value everywhere, and how likely every pixel is right within ``within``.

        Raises
        ------
        ValueError
            There is no map, too many, or one has not the size of the images.
        """
        if not 1 <= len(maps) <= MAX_MAPS:
            raise ValueError(f"want 1 to {MAX_MAPS} maps, got {len(maps)}")
        clock = Clock()
        evidence = Evidence.of(pair, max_disparity, clock)
        clock.start("planes")
        judged = judged_maps(evidence, [*maps, evidence.reference.values])
        clock.start("choice")
        values, probability = self._chosen(evidence, judged)
        if self.surfaces:
            clock.start("surfaces")
            planes = self._surfaces(evidence, values, probability)
            values, probability = self._chosen(evidence, judged_maps(evidence, planes, known=judged))
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
        height, width = evidence.pair.shape
        shares = memory.empty((height, width, BLOCK_DEPTH), np.float32)
        softmax(odds, shares)
        evidence.narrow.sum(shares)
        values = np.empty((height, width), np.float32)
        probability = np.empty((height, width), np.float32)
        take_largest(np.stack([one.values for one in judged]), odds, shares, values, probability)
        return values, probability

    @staticmethod
    def _surfaces(
        evidence: Evidence, values: NDArray[np.float32], probability: NDArray[np.float32]
    ) -> list[NDArray[np.float32]]:
        made = []
        for segmentation in _SEGMENTATIONS:
            labels = segmentation(evidence.pair.color8[0])
            count = int(labels.max()) + 1
            members = RegionPixels.of(labels, (probability > 0.5).ravel(), count)
            planes = _PLANES(values, members, np.arange(count))
            made.append(planes.at(labels, evidence.volume.n_disparities - 1))
        return made
