"""What the stereo protocols share: disparity maps and their truth, files, error pictures, suspicions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.data.formats.disparity import MAP_SUFFIXES, read_disparity
from depthcli.data.formats.pictures import STATUS_PALETTE
from depthcli.data.scenes import Scene
from depthcli.data.scenes.stereo import StereoScene, StereoTruth
from depthcli.evaluation.pictures import LEGEND_TEXT, error_picture
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.scores import MISSING_IS_BAD, Measure, Score, Tally

Disparity = NDArray[np.float32]
Masks = dict[str, NDArray[np.bool_]]

_DENSE, _DENSE_TOP = 24, 6.0  # thresholds of a plot, and the largest, pixels


@dataclass(frozen=True)
class DisparityTruth:
    """Ground truth of the left view, ready to be compared with.

    Attributes
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    masks : name -> (H, W) bool, True = evaluate
    noc : (H, W) float32, values of the visible pixels where they have their own (KITTI), or None
    scale : codes per pixel of the truth's files, or None
    max_disparity, round_disparity : values of an estimate are clipped, and rounded (Middlebury v3)
    factor : size of the benchmark's full image / size of this one (Middlebury v3)
    """

    disparity: Disparity
    masks: Mapping[str, NDArray[np.bool_]]
    noc: Disparity | None = None
    scale: float | None = None
    max_disparity: int | None = None
    round_disparity: bool = False
    factor: int = 1


class DisparityProtocol(Protocol[Disparity, DisparityTruth]):
    """A protocol for (H, W) float32 disparity maps in pixels, NaN = no value."""

    unit = "px"
    kind = StereoScene
    places = ("{scene}/disp_left", "{scene}", "disp_0/{scene}", "low_res_two_view/{scene}")
    suffixes = MAP_SUFFIXES
    curve_masks: ClassVar[tuple[str, ...]] = ("nonocc", "all")
    legend = LEGEND_TEXT
    quantity = "disparity"
    threshold_axis = "threshold, px"
    visible = "nonocc"
    palette = STATUS_PALETTE
    thresholds: ClassVar[tuple[float, ...]]
    """Pixels; the one of the settings is added."""
    default_threshold: ClassVar[float]
    """Of the headline."""
    rule: ClassVar[Measure] = Measure("bad", "%", convention=MISSING_IS_BAD, worst=100.0)
    """The headline, but for its threshold."""

    @property
    def headline(self) -> Measure:
        """The benchmark's own, or the same with the user's threshold."""
        return self.at(self.settings.threshold or self.default_threshold)

    def at(self, threshold: float) -> Measure:
        """The headline's measure at another threshold."""
        return replace(self.rule, threshold=threshold)

    chosen: tuple[float, ...] | None = None
    """Instead of ``thresholds``, for a plot."""

    @property
    def all_thresholds(self) -> list[float]:
        """The benchmark's and the user's."""
        if self.chosen is not None:
            return list(self.chosen)
        own = [] if self.settings.threshold is None else [self.settings.threshold]
        return sorted({*self.thresholds, *own})

    def masks(self, stored: StereoTruth) -> Masks:
        """Masks of the evaluation, from what the files give: those of ``mask_order``, and any other."""
        return {**stored.masks, "all": stored.masks.get("all", ~np.isnan(stored.disparity))}

    def truth(self, scene: Scene) -> DisparityTruth:
        """Ground truth with masks."""
        scene.check()
        if not isinstance(scene, StereoScene):
            raise InputError(f"{scene.folder}: {scene.name} is no stereo pair, which {self.name} scores")
        stored = scene.truth()
        if np.isnan(stored.disparity).all():
            raise InputError(f"{scene.disparity_left}: the ground truth has no known pixel")
        masks = self.masks(stored)
        return DisparityTruth(
            stored.disparity,
            {name: masks[name] for name in self.ordered(masks)},
            stored.noc,
            stored.scale,
            scene.max_disparity,
            scene.round_disparity,
        )

    def single(self, truth: Path) -> Scene:
        """A disparity map alone, without masks; integer codes have the scale of the settings."""
        scale = None if truth.suffix.lower() == ".pfm" else self.settings.scale
        return StereoScene(
            name=truth.stem,
            folder=truth.parent,
            protocol=self.name,
            left=truth,
            disparity_left=truth,
            disparity_scale=scale,
        )

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Also result files of the Middlebury v3 kit: ``disp0METHOD.pfm``, ``..._s.pfm`` where only that is there."""
        yield from super().candidates(folder, scene)
        inside = folder / scene
        kit = sorted(path for path in inside.glob("disp0*.pfm") if not path.stem.startswith("disp0GT"))
        dense = [path for path in kit if not path.stem.endswith("_s")] or kit
        named = [path for path in dense if path.stem == f"disp0{folder.resolve().name}"] or dense
        if len(named) > 1:
            raise InputError(f"{inside}: both {named[0].name} and {named[1].name}; keep one method in a folder")
        yield from named

    def looked_for(self, names: Sequence[str]) -> str:
        """The kit's names too."""
        return super().looked_for(names).replace("(looked for ", "(looked for SCENE/disp0METHOD.pfm, ")

    def read(self, path: Path, scene: Scene, truth: DisparityTruth) -> Disparity:
        """The map in pixels: a PFM as it is; 8-bit codes have the truth's scale where the settings have none."""
        codes = truth.scale if truth.scale is not None and truth.scale < 256 else None
        scale = None if path.suffix.lower() == ".pfm" else self.settings.scale
        estimate = read_disparity(path, scale, scale_8bit=codes)
        try:
            self.resized(estimate, truth)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
        return estimate

    def resized(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """The estimate on the truth's grid.

        Raises
        ------
        ValueError
            The size does not fit.
        """
        if estimate.shape != truth.disparity.shape:
            raise ValueError(f"the map is {size(estimate)}, the truth {size(truth.disparity)}")
        return estimate

    def fit(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """The values that are compared: here as they are."""
        return self.resized(estimate, truth)

    def nothing(self, truth: DisparityTruth) -> Disparity:
        """A map of NaN."""
        return np.full_like(truth.disparity, np.nan)

    def reference(self, truth: DisparityTruth, mask: str) -> Disparity:
        """The truth that a region is compared with."""
        return truth.disparity

    def regions(self, truth: DisparityTruth) -> Masks:
        """Pixels of the masks whose truth is known."""
        return {name: mask & ~np.isnan(self.reference(truth, name)) for name, mask in truth.masks.items()}

    def error(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """(H, W) float32, pixels: single precision, as in the benchmarks' programs."""
        return difference(self.fit(estimate, truth), truth.disparity)

    def values(self, estimate: Disparity, truth: DisparityTruth) -> Disparity:
        """(H, W) float32, pixels."""
        return self.fit(estimate, truth)

    def true_values(self, truth: DisparityTruth) -> Disparity:
        """(H, W) float32, pixels."""
        return truth.disparity

    def tallies(self, estimate: Disparity, truth: DisparityTruth) -> list[Tally]:
        """The errors by region."""
        error = self.error(estimate, truth)
        return [Tally(name, error[region]) for name, region in self.regions(truth).items()]

    def dense(self, estimate: Disparity, truth: DisparityTruth) -> list[Score]:
        """The headline's measure at its thresholds and others up to 6 px, or twice the user's."""
        many, mask = copy(self), next(iter(self.regions(truth)))
        top = max(_DENSE_TOP, 2 * (self.settings.threshold or 0.0))
        many.chosen = tuple(sorted({*self.all_thresholds, *(top * k / _DENSE for k in range(1, _DENSE + 1))}))
        scores = many.scores(estimate, replace(truth, masks={mask: truth.masks[mask]}))
        return [s for s in scores if s.measure.threshold is not None and s.measure == self.at(s.measure.threshold)]

    def picture(self, estimate: Disparity, truth: DisparityTruth) -> NDArray[np.uint8]:
        """(H, W, 3) RGB: right and wrong by the headline's rule."""
        regions = self.regions(truth)
        everything = regions.get("all", ~np.isnan(truth.disparity))
        fitted, wrong = self.fit(estimate, truth), self.wrong(estimate, truth)
        return error_picture(fitted, wrong, everything, truth.masks.get(self.visible))

    def warnings(self, estimate: Disparity, truth: DisparityTruth) -> list[str]:
        """A scale that looks wrong."""
        said = scale_warning(self.resized(estimate, truth), truth.disparity)
        return [] if said is None else [said]


def difference(estimate: Disparity, truth: Disparity) -> Disparity:
    """Absolute difference in single precision; NaN where one of the two has no value."""
    with np.errstate(over="ignore", invalid="ignore"):
        error: Disparity = np.abs(estimate - truth)
    return error


def size(array: NDArray[Any]) -> str:
    """Width x height."""
    return f"{array.shape[1]} x {array.shape[0]}"


_HINTS = {
    256.0: "KITTI codes read as pixels?",
    16.0: "OpenCV's fixed-point disparities, or Middlebury codes?",
    64.0: "fixed-point codes read as pixels?",
    2.0: "a map of twice the size?",
    0.5: "computed at half size?",
    0.25: "computed at quarter size?",
}


def scale_warning(estimate: Disparity, truth: Disparity) -> str | None:
    """Say so where the estimate looks like the truth in another unit, the most frequent mistake.

    Looks at the ratio estimate / truth: a warning needs half of the pixels within 8 % of one of the usual
    factors (16, 4, 256, 1/2 ...; -1 for a swapped sign).

    Parameters
    ----------
    estimate, truth : (H, W) float32, pixels, NaN = none
    """
    with np.errstate(invalid="ignore"):
        both = ~np.isnan(estimate) & (truth > 0.5)
    if np.count_nonzero(both) < 50:
        return None
    ratio = estimate[both].astype(np.float64) / truth[both]
    middle = float(np.median(ratio))
    factors = [float(f) for f in (2, 3, 4, 8, 16, 32, 64, 128, 256)]
    for factor in [-1.0, *factors, *(1 / f for f in factors)]:
        if abs(middle / factor - 1) < 0.08 and np.mean(np.abs(ratio / factor - 1) < 0.08) >= 0.5:
            if factor == -1:
                return "the values are about -1 times the truth: the sign is swapped"
            said = f"{factor:g}" if factor >= 1 else f"1/{1 / factor:g}"
            hint = _HINTS.get(factor, "")
            return (
                f"the values are about {said} times the truth (median ratio {middle:.3g}): "
                f"a wrong scale?{' ' + hint if hint else ''}"
            )
    return None
