"""The third Middlebury evaluation, as the SDK's ``evaldisp`` computes its metrics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.evaluation.benchmarks import BENCHMARKS, MIDDLEBURY_FACTORS, TRAINING, middlebury_resolution
from depthcli.evaluation.protocols._disparity import (
    PRESENTATION,
    Disparity,
    DisparityProtocol,
    DisparityTruth,
    Masks,
    size,
)
from depthcli.evaluation.protocols.middlebury_v2 import derive_masks
from depthcli.evaluation.scores import MISSING_APART, MISSING_IS_BAD, Metric, Score, float_sum
from depthcli.io.formats.disparity import read_plane
from depthcli.io.scenes import Scene
from depthcli.io.stereo_pairs import StereoTruth

# The site's average weighs the hard scenes with 4 % and the other ten with 8 %.
_HARD = ("PianoL", "Playroom", "Playtable", "Shelves", "Vintage")
_MAX_RANGES = 1000  # a value beyond so many search ranges is no value, as the SDK's "infinite" ones


class MiddleburyV3Protocol(DisparityProtocol):
    """The metrics of the SDK.

    Maps of half or quarter size are scaled up; values are clipped to the search range at their own size, and rounded
    if the ground truth is in whole pixels. ``bad`` counts incorrect values and ``invalid`` missing values, both over
    all pixels; ``totbad`` is their sum. ``avgerr`` (summed in single precision, as in the SDK), ``rms`` and the
    quantiles ``A50`` ... are over the valid pixels; +inf and NaN are missing, -inf is the low end of the range. The
    quantile A_q is the smallest error that at least q percent of the valid pixels do not exceed. Thresholds are pixels
    of the full size: at quarter size 2.0 is applied as 0.5, so that the headline means the same at every size.
    """

    presentation = replace(
        PRESENTATION,
        title="Middlebury v3: bad pixels, missing ones included, %",
        note=(
            "thresholds: px of the full size (in brackets: of this size); bad, invalid, totbad: % of all pixels; "
            "avgerr, rms, A50 ...: px of this size, valid pixels only; "
            "PianoL, Playroom, Playtable, Shelves, Vintage count half"
        ),
        threshold_axis="threshold, px of the full size",
    )
    thresholds = (0.5, 1.0, 2.0, 4.0)
    default_threshold = 2.0
    takes = ("scale", "threshold", "invalid", "resolution")
    weights: ClassVar[Mapping[str, float]] = dict.fromkeys(_HARD, 0.5)
    thresholded_metric = Metric("totbad", "%", convention=MISSING_IS_BAD, worst=100.0)

    def masks(self, stored: StereoTruth) -> Masks:
        """Return the masks of the files; without ``nonocc``, as in the sets of 2014 and 2021, it is derived.

        It is derived from the truth of both views, as in Middlebury v2.
        """
        masks = super().masks(stored)
        if "nonocc" not in masks and stored.right is not None and stored.right.shape == stored.disparity.shape:
            masks["nonocc"] = derive_masks(stored.disparity, stored.right)["nonocc"]
        return masks

    def truth(self, scene: Scene) -> DisparityTruth:
        """Return the ground truth with the factor to the benchmark's full size.

        The factor follows from the setting ``resolution``; without it, from the width of a training scene of the
        benchmark. Other scenes count as full size.
        """
        truth = super().truth(scene)
        name, resolution = scene.name.rpartition("/")[2], self.settings.resolution or "F"
        if self.settings.resolution is None and name in BENCHMARKS["middlebury-v3"].scenes[TRAINING]:
            resolution = middlebury_resolution(name, truth.values.shape[1])
        return replace(truth, factor=MIDDLEBURY_FACTORS[resolution])

    def read(self, path: Path, scene: Scene, truth: DisparityTruth) -> Disparity:
        """Return the map in pixels. -inf of a PFM stays, because the SDK clips it to the range like any number."""
        estimate = super().read(path, scene, truth)
        if path.suffix.lower() == ".pfm":
            estimate[np.isneginf(read_plane(path))] = -np.inf
        return estimate

    def resized(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the estimate enlarged from half or a quarter to the size of the ground truth, by nearest neighbor."""
        factor = truth.values.shape[1] // estimate.shape[1]
        if factor not in (1, 2, 4) or truth.values.shape != tuple(factor * n for n in estimate.shape):
            raise ValueError(
                f"the map is {size(estimate)}, the truth {size(truth.values)} "
                "(the same, or exactly half or a quarter of the size can be evaluated)"
            )
        with np.errstate(over="ignore"):
            return np.repeat(np.repeat(estimate * np.float32(factor), factor, axis=0), factor, axis=1)

    def values(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """Return the estimate scaled up, clipped to the range as by the SDK, and rounded if the ground truth is."""
        fitted = self.resized(estimate, truth)
        if truth.max_disparity is not None:
            factor = truth.values.shape[1] // estimate.shape[1]
            # The range of the smaller image, rounded up to whole pixels, at the truth's size.
            top = np.float32(factor * math.ceil(truth.max_disparity / factor))
            fitted[fitted > max(abs(float(top)), 1.0) * _MAX_RANGES] = np.nan
            fitted = np.minimum(fitted, top)
        # The truth is negative in pairs that are cropped or converge.
        fitted = np.maximum(fitted, np.nanmin(truth.values, initial=np.float32(0)))
        return np.floor(fitted + np.float32(0.5)) if truth.round_disparity else fitted

    def wrong(self, estimate: Disparity, truth: DisparityTruth) -> NDArray[np.bool_]:
        """Return True for pixels whose error exceeds the headline's threshold at this size."""
        assert self.headline.threshold is not None
        return self.error(estimate, truth) > np.float32(self.headline.threshold / truth.factor)

    def scores(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        scores = []
        for tally in self.tallies(estimate, truth):
            missing = np.isnan(tally.error)
            for name, convention, counted in (("bad", MISSING_APART, False), ("totbad", MISSING_IS_BAD, missing)):
                for t in self.all_thresholds:
                    here = t / truth.factor
                    label = f"{name} {t:g}" + (f" ({here:g})" if truth.factor > 1 else "")
                    wrong = (tally.error > np.float32(here)) | counted
                    scores.append(tally.rate(Metric(name, "%", t, convention, 100.0, label=label), wrong))
            scores.append(tally.rate(Metric("invalid", "%", None, MISSING_APART, 100.0), missing))
            mean, rms = tally.means()
            n_valid = tally.valid.size
            average = float_sum(tally.valid.astype(np.float32)) / n_valid if n_valid else math.nan
            scores += [replace(mean, value=average), rms]
            scores += tally.quantiles(lambda q, n: max(0, -(-q * n // 100) - 1))
        return scores
