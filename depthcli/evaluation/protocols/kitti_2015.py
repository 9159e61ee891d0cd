"""The stereo evaluation of KITTI 2015, as its development kit's ``evaluate_scene_flow`` computes its metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols._disparity import (
    PRESENTATION,
    Disparity,
    DisparityTruth,
    Masks,
    difference,
)
from depthcli.evaluation.protocols.kitti_2012 import INTERPOLATED, NOTHING_ESTIMATED, Kitti2012Protocol
from depthcli.evaluation.scores import ESTIMATED_ONLY, Metric, Score, Tally, percent
from depthcli.io.stereo_pairs import StereoTruth


def pool_pixels(scores: Sequence[Score], weights: Sequence[float]) -> Score:
    """Return a score over all pixels of all frames: incorrect pixels / all pixels, or the mean error."""
    pixels, n_region = sum(s.pixels for s in scores), sum(s.region_pixels for s in scores)
    counts = [s.wrong for s in scores if s.wrong is not None]
    value = density = math.nan
    if n_region:
        density = math.fsum(s.region_pixels * s.density for s in scores if s.region_pixels) / n_region
        if not pixels:
            value = NOTHING_ESTIMATED
        elif counts:
            value = percent(sum(counts), pixels)
        else:
            value = math.fsum(s.value * s.pixels for s in scores if s.pixels) / pixels
    wrong = sum(counts) if counts else None
    return Score(scores[0].metric, scores[0].region, value, pixels, density, wrong, n_region)


class Kitti2015Protocol(Kitti2012Protocol):
    """D1: the share of pixels off by more than 3 px and at least 5 % of the ground truth, pooled over all frames.

    An error of exactly 5 % counts as incorrect, because in single precision it is a little larger. ``occ_bg`` and
    ``occ_fg`` are the background and the objects of ``occ``, likewise for ``noc``; they are never averaged into one
    figure. The outliers and average errors of KITTI 2012 are also reported, pooled in the same way. The pooled density
    counts all pixels of frames without any estimate, like the kit's sums. If no frame has an estimate, the estimated
    pixels score 0.
    """

    presentation = replace(
        PRESENTATION,
        title="KITTI 2015: D1, %; background-interpolated maps",
        note=(
            "D1: > 3 px and >= 5 %; out, avgerr: as KITTI 2012; est: estimated pixels only, 0 without any; "
            "pooled: over the pixels of all frames"
        ),
        visible_region="noc",
        mean_heading="pooled",
    )
    region_order = ("occ", "occ_bg", "occ_fg", "noc", "noc_bg", "noc_fg")
    curve_regions = ("occ", "noc")
    pool = staticmethod(pool_pixels)

    def __init__(self, settings: Settings | None = None) -> None:
        super().__init__(settings)
        if self.settings.threshold is None:  # else plain outliers above the user's
            self.headline = _d1(INTERPOLATED)

    def masks(self, stored: StereoTruth) -> Masks:
        """Return all pixels of ``occ`` and ``noc``, and, if there is an object map, their background and objects."""
        masks = super().masks(stored)
        if stored.objects is not None:
            for name in list(masks):
                masks[f"{name}_bg"], masks[f"{name}_fg"] = masks[name] & ~stored.objects, masks[name] & stored.objects
        return masks

    def wrong(self, estimate: Disparity, truth: DisparityTruth) -> NDArray[np.bool_]:
        """Return True for pixels that are incorrect by the D1 rule or the user's threshold."""
        if self.settings.threshold is not None:
            return super().wrong(estimate, truth)
        return is_d1(difference(self.values(estimate, truth), truth.values), truth.values)

    def metrics(self, tally: Tally, error: Disparity, truth: Disparity, convention: str) -> list[Score]:
        return [tally.rate(_d1(convention), is_d1(error, truth)), *super().metrics(tally, error, truth, convention)]


def is_d1(error: Disparity, truth: Disparity) -> NDArray[np.bool_]:
    """Return True for errors above 3 px and at least 5 % of the ground truth, which may be 0; False for NaN."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return (error > 3) & ((error / np.abs(truth)).astype(np.float64) > 0.05)


def _d1(convention: str) -> Metric:
    label = "est D1" if convention == ESTIMATED_ONLY else "D1"
    return Metric("D1", "%", 3.0, convention, 100.0, label=label)
