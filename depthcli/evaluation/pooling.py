"""Scores of several scenes put together: the means of a run, and the regions of its single figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import ClassVar

from depthcli.evaluation.results import MapResult
from depthcli.evaluation.scores import Key, Score, percent


class Pooling:
    """How the scores of several scenes become one: here the mean, in which every scene counts by its weight.

    A protocol overrides ``weight``, ``pool`` or ``mean`` where its benchmark has another rule.

    Attributes
    ----------
    region_order : names of regions in the order of tables; the first one present is the main region
    averages_regions : the single figure of a run is the mean over all regions, not the main region's
    """

    region_order: ClassVar[tuple[str, ...]] = ("nonocc", "all", "disc")
    averages_regions: ClassVar[bool] = False

    def figure_regions(self, regions: Sequence[str]) -> list[str]:
        """Return the regions that the single figure of a run is taken over, of those present."""
        return list(regions) if self.averages_regions else list(regions[:1])

    def ordered(self, regions: Iterable[str]) -> list[str]:
        """Return names of regions in the order of ``region_order``, then all others by name."""
        present = set(regions)
        return [name for name in self.region_order if name in present] + sorted(present - set(self.region_order))

    def weight(self, scene: str) -> float:
        """Return the weight of a scene in means."""
        return 1.0

    def pool(self, scores: Sequence[Score], weights: Sequence[float]) -> Score:
        """Compute one score from those of one metric and region in several scenes.

        Empty regions are left out. A region in which a map has no value counts as the metric's worst; where the
        metric has no bound the mean is NaN.
        """
        pairs = [(s, w) for s, w in zip(scores, weights, strict=True) if not math.isnan(s.density)]
        metric, total = scores[0].metric, math.fsum(w for _, w in pairs)
        worst = math.nan if metric.worst is None else metric.worst
        value, density = math.nan, math.nan
        if total:
            value = math.fsum(w * (worst if math.isnan(s.value) else s.value) for s, w in pairs) / total
            density = math.fsum(w * s.density for s, w in pairs) / total
        return Score(metric, scores[0].region, value, sum(s.pixels for s, _ in pairs), density)

    def pooled(self, scored: Iterable[tuple[Sequence[Score], str]]) -> list[Score]:
        """Compute one score for every metric and region out of (scores, scene) of several scenes."""
        groups: dict[Key, list[tuple[Score, float]]] = {}
        for scores, scene in scored:
            for score in scores:
                groups.setdefault(score.key, []).append((score, self.weight(scene)))
        return [self.pool(*zip(*group, strict=True)) for group in groups.values()]

    def mean(self, results: Sequence[MapResult]) -> list[Score]:
        """Compute every metric in every region over the scenes of one run."""
        return self.pooled((result.scores, result.scene) for result in results)


def pool_pixels(scores: Sequence[Score], nothing: float = math.nan) -> Score:
    """Return one metric over all pixels of all frames: wrong pixels / all pixels, or the mean error.

    ``nothing`` is its value where pixels count, but no frame has an estimate at any.
    """
    pixels, n_region = sum(s.pixels for s in scores), sum(s.region_pixels for s in scores)
    counts = [s.wrong for s in scores if s.wrong is not None]
    value = density = math.nan
    if n_region:
        density = math.fsum(s.region_pixels * s.density for s in scores if s.region_pixels) / n_region
        if not pixels:
            value = nothing
        elif counts:
            value = percent(sum(counts), pixels)
        else:
            value = math.fsum(s.value * s.pixels for s in scores if s.pixels) / pixels
    wrong = sum(counts) if counts else None
    return Score(scores[0].metric, scores[0].region, value, pixels, density, wrong, n_region)
