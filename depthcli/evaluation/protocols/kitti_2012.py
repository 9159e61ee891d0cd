"""The stereo evaluation of KITTI 2012, as its development kit's ``evaluate_stereo`` computes its metrics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.protocols._disparity import (
    PRESENTATION,
    Disparity,
    DisparityProtocol,
    DisparityTruth,
    Masks,
    difference,
)
from depthcli.evaluation.scores import ESTIMATED_ONLY, Metric, Score, Tally, float_sum, mean_of_scenes
from depthcli.io.formats.disparity import KITTI_SCALE
from depthcli.io.scenes import Scene
from depthcli.io.stereo_pairs import StereoTruth

INTERPOLATED = "background-interpolated"
NOTHING_ESTIMATED = 0.0
"""Figure of the estimated pixels without any: the kits divide no error by no less than one pixel."""

_EMPTY = np.float32(-1)  # value of a row without any, as the kit writes it


def mean_of_frames(scores: Sequence[Score], weights: Sequence[float]) -> Score:
    """Return the mean over the frames, summed in single precision as by the kit."""
    mean = mean_of_scenes(scores, weights)
    unit = 100.0 if mean.metric.unit == "%" else 1.0
    values = np.array([s.value / unit for s in scores if not math.isnan(s.density)], np.float32)
    value = unit * float_sum(values) / max(values.size, 1)
    return mean if math.isnan(mean.value + value) else replace(mean, value=value)


class Kitti2012Protocol(DisparityProtocol):
    """Outliers and average errors, on the map filled from the background and on estimated pixels; means over frames.

    The map is scored like the 16-bit PNG of a submission: in multiples of 1/256 px, with negative values missing.
    ``noc`` is compared with the values of ``disp_noc``. A row that is still empty after the interpolation has the
    value -1, as in the kit: its pixels are incorrect, and this value enters the average error. A map without any value
    in a region scores 0 on its estimated pixels, as in the kit, and counts as 0 in the mean; its density shows this.
    All pixels of a missing map are incorrect, as in all protocols.
    """

    presentation = replace(
        PRESENTATION,
        title="KITTI 2012: outliers > 3 px, %; background-interpolated maps",
        note=(
            "out, avgerr: background-interpolated maps; est: estimated pixels only, 0 without any; "
            "means: every frame counts once"
        ),
        visible_region="noc",
    )
    kitti_codes = True
    region_order: ClassVar[tuple[str, ...]] = ("noc", "occ")
    curve_regions = ("noc", "occ")
    pool = staticmethod(mean_of_frames)
    thresholds = (2.0, 3.0, 4.0, 5.0)
    default_threshold = 3.0
    thresholded_metric = Metric("out", "%", convention=INTERPOLATED, worst=100.0)

    def masks(self, stored: StereoTruth) -> Masks:
        """Return ``noc``, the visible pixels, if there is such a file, and ``occ``, all pixels."""
        known = {"occ": known_kitti(stored.disparity)}
        return known if stored.noc is None else {"noc": known_kitti(stored.noc), **known}

    def truth(self, scene: Scene) -> DisparityTruth:
        """Return the ground truth; no other protocol fits it better."""
        return replace(super().truth(scene), looks_like="")

    def values(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the values that a 16-bit PNG can store: codes 1 to 65535, 256 a pixel."""
        values = self.resized(estimate, truth)
        codes = np.clip(np.rint(values.astype(np.float64) * KITTI_SCALE), 1, 65535) / KITTI_SCALE
        return np.where(known_kitti(values), codes, np.nan).astype(np.float32)

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """Compute every metric on the interpolated map, then on the estimated pixels."""
        as_is = self.values(estimate, truth)
        filled = interpolate_background(as_is)
        filled[np.isnan(filled)] = _EMPTY
        scores = []
        for name, region in truth.regions.items():
            reference = truth.reference(name)
            # Column after column, the order of the kit's loops: its sums are in single precision.
            inside, known = region.T, ~np.isnan(as_is.T)
            tally = Tally(name, difference(as_is, reference).T[inside])
            for convention, pixels in ((INTERPOLATED, inside), (ESTIMATED_ONLY, inside & known)):
                error = difference(filled, reference).T[pixels]
                scores += self.metrics(tally, error, reference.T[pixels], convention)
        return [replace(s, value=NOTHING_ESTIMATED) if s.region_pixels and not s.pixels else s for s in scores]

    def metrics(self, tally: Tally, error: Disparity, truth: Disparity, convention: str) -> list[Score]:
        """Compute ``out`` at the thresholds and ``avgerr`` from the errors and the true values of a region."""
        est = "est " if convention == ESTIMATED_ONLY else ""
        scores = [
            tally.rate(Metric("out", "%", t, convention, 100.0, label=f"{est}out {t:g}"), error > np.float32(t))
            for t in self.all_thresholds
        ]
        value = float_sum(error) / error.size if error.size else math.nan
        average = Metric("avgerr", "px", convention=convention, label=f"{est}avgerr")
        return [*scores, tally.number(average, value, error.size)]


def known_kitti(disparity: Disparity) -> NDArray[np.bool_]:
    """Return True for pixels with a value; negative numbers are none."""
    with np.errstate(invalid="ignore"):
        return disparity >= 0


def interpolate_background(disparity: Disparity) -> Disparity:
    """Fill missing values as the KITTI development kit does before it takes D1.

    First, a gap between two values of a row gets the smaller value. Second, the first and last value of a row are
    extended to its borders. Third, the first and last filled row of a column are extended to top and bottom. Only rows
    without any value between other rows stay empty.
    """
    known = ~np.isnan(disparity)
    width = disparity.shape[1]
    column = np.arange(width)
    left = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, column, width)[:, ::-1], axis=1)[:, ::-1]
    from_left = np.take_along_axis(disparity, np.maximum(left, 0), axis=1)
    from_right = np.take_along_axis(disparity, np.minimum(right, width - 1), axis=1)
    filled = np.fmin(np.where(left >= 0, from_left, np.nan), np.where(right < width, from_right, np.nan))
    rows = np.flatnonzero(~np.isnan(filled[:, 0]))
    if rows.size:
        filled[: rows[0]] = filled[rows[0]]
        filled[rows[-1] + 1 :] = filled[rows[-1]]
    return filled.astype(np.float32)
