"""Fusion of maps from any programs: at every pixel, the value that is most likely correct."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlaneFit
from depthcli.algorithms.regions import RegionPixels
from depthcli.algorithms.segmentation.felzenszwalb import Felzenszwalb
from depthcli.core.context import Clock
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.fusion.choice.network import MAX_MAPS as MAX_PROPOSALS
from depthcli.methods.fusion.choice.network import likeliest
from depthcli.methods.given_maps import Judged, Networks, judged_maps, odds_of, promised_of, with_reasons
from depthcli.methods.given_maps._planes import Evidence, hidden_by_map
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian
from depthcli.methods.stereo.volume import RefinementContext

_SEGMENTATION = Felzenszwalb(scale=300.0, min_size=200)
_PLANES = SegmentPlaneFit(tolerance=1.0, trials=100, flatness=0.9)
_REFINEMENT = SlantedMedian(radius=3, color_scale=10, distance_scale=3)

N_ADDED = 2
"""Number of proposals besides the given maps: the map of stereo fast, and planes."""
MAX_MAPS = MAX_PROPOSALS - N_ADDED
"""Largest number of given maps."""


class Fused(NamedTuple):
    """A fused map, which has a value everywhere."""

    disparity: DisparityMap
    seconds: dict[str, float]  # by stage
    probability: NDArray[np.float32]  # (H, W), probability of an error up to ``within``
    bound: NDArray[np.float32] | None  # (H, W), error bound, pixels; None: not requested


def fuse(
    networks: Networks,
    pair: StereoPair,
    maps: Sequence[NDArray[np.float32]],
    max_disparity: int,
    within: float = 1.0,
    surfaces: bool = False,
    measured: Sequence[NDArray[np.bool_]] = (),
    level: float | None = None,
) -> Fused:
    """Fuse 1 to ``MAX_MAPS`` maps of a pair, (H, W) float32, pixels, NaN = no value; a single map is completed.

    The proposals are the given maps, the map of the preset ``stereo fast``, and, with ``surfaces``, planes of segments,
    fitted to the pixels where the best of the others is probably correct. The network of
    :mod:`depthcli.methods.given_maps` gives the log odds of each proposal. Their softmax is averaged over neighbors of
    similar color, and the largest share wins.

    ``measured``, (H, W) bool for each map, are pixels that were measured, not filled; empty: all pixels with a value. A
    pixel is ``FILLED`` if neither a given map nor ``stereo fast`` measured a value within a pixel of the chosen one.

    Returns a map that has a value everywhere, and the probability that the error of a pixel is up to ``within`` pixels.
    With ``level``, the coverage, the fused map is judged by itself for its bound and this probability. Costs are
    computed up to ``max_disparity``. Callers check the number of maps. ValueError: a map does not have the size of the
    images.
    """
    clock, measured = Clock(), measured or [np.isfinite(one) for one in maps]
    evidence = Evidence.of(pair, max_disparity, clock)

    def chosen(judged: Sequence[Judged]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        odds = np.stack([odds_of(networks, one, within) for one in judged])
        return likeliest(np.stack([one.values for one in judged]), odds, evidence.narrow)

    clock.start("planes")
    judged = judged_maps(evidence, [*maps, evidence.reference.values])
    clock.start("choice")
    values, probability = chosen(judged)
    if surfaces:
        clock.start("surfaces")
        labels = _SEGMENTATION(evidence.pair.color8[0])
        count = int(labels.max()) + 1
        planes = _PLANES(values, RegionPixels.of(labels, (probability > 0.5).ravel(), count), np.arange(count))
        fitted = planes.at(labels, max_disparity)
        values, probability = chosen(judged_maps(evidence, [fitted], known=judged))
    clock.start("refinement")
    context = RefinementContext(evidence.pair, evidence.optimized, evidence.right)
    values = _REFINEMENT(DisparityMap(values, np.zeros(pair.shape, np.uint8)), context).values
    status = with_reasons(values, np.zeros(pair.shape, np.bool_), probability, hidden_by_map(values))
    sources = zip([*maps, evidence.reference.values], [*measured, evidence.reference.measured], strict=True)
    with np.errstate(invalid="ignore"):  # NaN supports nothing
        supported = np.any([there & (np.abs(one - values) <= 1) for one, there in sources], axis=0)
    status[~supported] |= np.uint8(Status.FILLED)
    bound = None
    if level is not None:
        clock.start("bound")
        filled = (status & np.uint8(Status.FILLED)) > 0
        probability, bound = promised_of(networks, judged_maps(evidence, [values])[0], within, level, filled)
    return Fused(DisparityMap(values, status), clock.seconds, probability, bound)
