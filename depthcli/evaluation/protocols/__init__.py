"""Protocols: how a benchmark, or a kind of ground truth, scores a map; one file each, the folder is the registry."""

from __future__ import annotations

import importlib
import math
import pkgutil
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import color8
from depthcli.data.formats.disparity import read_plane
from depthcli.data.formats.images import read_image
from depthcli.data.formats.pictures import Palette
from depthcli.data.scenes import Scene
from depthcli.evaluation.curves import sparsifications
from depthcli.evaluation.results import Curve, Result
from depthcli.evaluation.scores import Measure, Score

if TYPE_CHECKING:
    from depthcli.evaluation.report import Table
    from depthcli.evaluation.results import Section

Estimate = TypeVar("Estimate")
Truth = TypeVar("Truth")


@dataclass(frozen=True)
class Settings:
    """What a user may say about an evaluation; a protocol takes what concerns it.

    Attributes
    ----------
    scale : codes per unit of the maps' files that hold codes; None: what the file's kind and the scene say
    resolution : size of the ground truth where a benchmark has several (Middlebury v3: F, H or Q)
    threshold : of the headline, instead of the benchmark's; in the protocol's unit
    resize : (width, height) that depth maps and their truth are brought to, nearest neighbor, as ClearGrasp does
    """

    scale: float | None = None
    resolution: str | None = None
    threshold: float | None = None
    resize: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if self.resolution not in (None, "F", "H", "Q"):
            raise ConfigError(f"resolution: want F, H or Q (got {self.resolution!r})")


def parse_size(text: str | None) -> tuple[int, int] | None:
    """``640x480`` as (640, 480), None as it is; ConfigError for anything else."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", (text or "1x1").strip().lower())
    if not found:
        raise ConfigError(f"--resize: want WIDTHxHEIGHT, such as 256x144 (got {text!r})")
    return (int(found[1]), int(found[2])) if text else None


class Protocol(ABC, Generic[Estimate, Truth]):
    """One way to score; subclasses are found by their file.

    ``truth`` prepares an item's ground truth once; ``read`` gives one run's estimate for it; ``scores``, ``error``,
    ``wrong`` and ``picture`` compare the two and open nothing. ``error`` and ``wrong`` have the shape of the masks
    of ``regions``, whatever the number of axes.

    Attributes
    ----------
    title, unit, note : for tables: name, unit of the errors, what the numbers mean
    kind : kind of scene that it scores
    places : where a run folder may hold the map of ``{scene}``, without the file's ending, the likeliest first
    suffixes : endings of a map, the likeliest first
    mask_order : names of regions in the order of tables; the first one present stands for a scene
    curve_masks : regions of the confidence curves; empty: the one that stands for a scene
    averages_masks : one figure may be taken over all of the regions ("mean of all figures")
    scene_rows : tables show every measure of every scene, not of the means alone
    legend : what the colors of ``picture`` mean
    quantity : what a map holds, in a word
    visible : region of the pixels that both views see, where the others are occluded; empty: not told apart
    palette : colors and words of the status map beside a map
    opacity : of a map's colors over ``image``, to begin with; below 1 the image shows where nothing is known
    verdicts : what a person is told of a pixel that is not among ``wrong``, and of one that is
    threshold_axis : what the thresholds of ``dense`` are
    pooling : heading of what ``mean`` takes over the scenes
    takes : names of the settings that make a difference
    """

    title: ClassVar[str]
    unit: ClassVar[str]
    note: ClassVar[str] = ""
    kind: ClassVar[type[Scene]]
    places: ClassVar[tuple[str, ...]]
    suffixes: ClassVar[tuple[str, ...]]
    mask_order: ClassVar[tuple[str, ...]] = ("nonocc", "all", "disc")
    curve_masks: ClassVar[tuple[str, ...]] = ()
    averages_masks: ClassVar[bool] = False
    scene_rows: ClassVar[bool] = True
    legend: ClassVar[str] = ""
    quantity: ClassVar[str] = "value"
    visible: ClassVar[str] = ""
    palette: ClassVar[Palette] = {}
    opacity: ClassVar[float] = 1.0
    verdicts: ClassVar[tuple[str, str]] = ("right", "wrong")
    threshold_axis: ClassVar[str] = "threshold"
    pooling: ClassVar[str] = "mean"
    takes: ClassVar[tuple[str, ...]] = ("scale", "threshold")

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    @property
    def name(self) -> str:
        """Its module's name."""
        return type(self).__module__.rpartition(".")[2]

    @property
    @abstractmethod
    def headline(self) -> Measure:
        """The measure that stands for a map; ``scores`` has it for every region."""

    @abstractmethod
    def truth(self, scene: Scene) -> Truth:
        """The item's ground truth, checked and prepared.

        Raises
        ------
        InputError
            Not an scene of this kind, no ground truth, or it cannot be used.
        """

    @abstractmethod
    def read(self, path: Path, scene: Scene, truth: Truth) -> Estimate:
        """One run's estimate; InputError where the file is damaged or does not fit the truth."""

    @abstractmethod
    def nothing(self, truth: Truth) -> Estimate:
        """The estimate that answers no pixel."""

    @abstractmethod
    def regions(self, truth: Truth) -> dict[str, NDArray[np.bool_]]:
        """Name -> pixels (or voxels) with known truth, in the order of ``mask_order``."""

    @abstractmethod
    def error(self, estimate: Estimate, truth: Truth) -> NDArray[np.floating[Any]]:
        """Absolute error of every pixel, in ``unit``; NaN where there is no estimate or no truth."""

    @abstractmethod
    def scores(self, estimate: Estimate, truth: Truth) -> list[Score]:
        """Every measure in every region."""

    def dense(self, estimate: Estimate, truth: Truth) -> list[Score]:
        """One measure at many thresholds, in the main region, by the rules of ``scores``; empty: it has no such."""
        return []

    def wrong(self, estimate: Estimate, truth: Truth) -> NDArray[np.bool_]:
        """Pixels whose error is above the headline's threshold; those without an estimate are not among them."""
        if self.headline.threshold is None:
            raise NotImplementedError(f"{self.name} has no headline threshold: say what is wrong")
        wrong: NDArray[np.bool_] = self.error(estimate, truth) > self.headline.threshold
        return wrong

    def picture(self, estimate: Estimate, truth: Truth) -> NDArray[np.uint8] | None:
        """(H, W, 3) RGB picture of where the estimate is wrong, or None."""
        return None

    # For people who look at a map

    def values(self, estimate: Estimate, truth: Truth) -> NDArray[np.floating[Any]] | None:
        """What is compared, in ``unit``, NaN where there is nothing; None: no single number stands for a pixel."""
        return None

    def true_values(self, truth: Truth) -> NDArray[np.floating[Any]] | None:
        """The same of the truth."""
        return None

    def laid_out(self, points: NDArray[Any], truth: Truth) -> NDArray[Any] | None:
        """An array of the masks' shape as an image or volume to look at (outside of the points NaN, or False).

        None: the points lie on no grid, there is nothing to look at.
        """
        return points if points.ndim > 1 else None

    def size(self, truth: Truth) -> int:
        """Pixels or voxels that a run goes through, by which its seconds are divided."""
        return next(region.size for region in self.regions(truth).values())

    def spacing(self, truth: Truth) -> tuple[float, ...] | None:
        """Size of a pixel or voxel along the axes of what is laid out; None: all are alike."""
        return None

    def image(self, scene: Scene) -> NDArray[np.uint8] | None:
        """What the maps describe: (H, W, 3) RGB, or (Z, Y, X) grey levels of a volume; None: nothing to look at.

        Here the first of the item's input files, where that is a picture.
        """
        try:
            return color8(read_image(next(iter(scene.input_files.values()))))
        except (InputError, StopIteration):
            return None

    def headlines(self, estimate: Estimate, truth: Truth) -> dict[str, float]:
        """The headline by region."""
        return {s.mask: s.value for s in self.scores(estimate, truth) if s.measure == self.headline}

    def warnings(self, estimate: Estimate, truth: Truth) -> list[str]:
        """Suspicions about the estimate, one line each."""
        return []

    def evidence(self, estimate: Estimate, truth: Truth) -> Any:
        """What ``mean`` needs beside the scores (pooled points, say); kept in memory, not written."""
        return None

    def single(self, truth: Path) -> Scene:
        """The scene of a ground truth file that lies in no folder of a known layout."""
        raise InputError(f"{truth}: {self.name} wants a folder of scenes as the ground truth")

    # Files of a run

    def candidates(self, folder: Path, scene: str) -> Iterator[Path]:
        """Files that may be the map of a scene, the likeliest first; they need not exist."""
        for place in self.places:
            for suffix in self.suffixes:
                yield folder / (place.replace("{scene}", scene) + suffix)

    def find(self, folder: Path, names: Sequence[str]) -> Path | None:
        """The map of the scene that goes by any of ``names``; InputError where two compete."""
        return next((path for name in names for path in self.candidates(folder, name) if path.is_file()), None)

    def looked_for(self, names: Sequence[str]) -> str:
        """Where ``find`` looks, for the message that it found nothing."""
        looked = ", ".join(each.replace("{scene}", "SCENE") + ".*" for each in self.places)
        short = names[0].rpartition("/")[2]
        several = "" if short in names else f"; several scenes are called {short}, so that the name needs its folder"
        return f" (looked for {looked}{several})"

    def confidences(self, path: Path) -> dict[str, Path]:
        """Name -> confidence map that lies beside the map ``path``: ``confidence_<name>.pfm`` or ``.npy``."""
        if not self._is_ours(path):
            return {}
        files = sorted(p for p in path.parent.glob("confidence_*") if p.suffix.lower() in (".pfm", ".npy"))
        return {file.stem.removeprefix("confidence_"): file for file in files}

    def status(self, path: Path) -> Path | None:
        """The status map that lies beside the map ``path``; None where there is none."""
        file = path.parent / "status.png"
        return file if self.palette and self._is_ours(path) and file.is_file() else None

    def _is_ours(self, path: Path) -> bool:
        """Called as in a run folder, so that what lies beside it belongs to it."""
        return any(place.rpartition("/")[2] == path.stem for place in self.places)

    def read_confidence(self, path: Path, truth: Truth) -> NDArray[Any]:
        """The values as stored: NaN, infinite and negative ones mean what they say; InputError for another size."""
        values = read_plane(path)
        if any(values.shape != region.shape for region in self.regions(truth).values()):
            raise InputError(f"{path}: the size differs from the truth's")
        return values

    # From scores to figures

    def missing(self, truth: Truth, dense: bool = False) -> list[Score]:
        """Scores of an scene that a run lacks: the worst where a measure has a bound, no number where it has none."""
        scores = (self.dense if dense else self.scores)(self.nothing(truth), truth)
        sizes = {mask: int(np.count_nonzero(region)) for mask, region in self.regions(truth).items()}
        counted = []
        for score in scores:
            worst, pixels = score.measure.worst, sizes.get(score.mask, score.pixels)
            wrong = None if score.wrong is None else pixels
            value = math.nan if worst is None or math.isnan(score.density) else worst
            counted.append(replace(score, value=value, pixels=pixels, wrong=wrong))
        return counted

    def curves(self, estimate: Estimate, truth: Truth, confidences: Mapping[str, NDArray[Any]]) -> list[Curve]:
        """Sparsification curves of every confidence map over the estimated pixels: of wrong ones and of the error."""
        if not confidences:
            return []
        regions, error, wrong = self.regions(truth), self.error(estimate, truth), self.wrong(estimate, truth)
        masks = [mask for mask in self.curve_masks if mask in regions] or list(regions)[:1]
        made = []
        for mask in masks:
            region = regions[mask] & ~np.isnan(error)
            if region.any():
                chosen = {name: confidence[region] for name, confidence in confidences.items()}
                lines = sparsifications(chosen, {"bad": wrong[region], "error": error[region]})
                made += [Curve(mask, name, of, line) for (name, of), line in lines.items()]
        return made

    def figure_masks(self, masks: Sequence[str]) -> list[str]:
        """Regions that the one figure of a run is taken over, of those present."""
        return list(masks) if self.averages_masks else list(masks[:1])

    def ordered(self, masks: Mapping[str, Any] | Sequence[str]) -> list[str]:
        """Names of regions in the order of ``mask_order``, the others behind, by name."""
        return [m for m in self.mask_order if m in masks] + sorted(set(masks) - set(self.mask_order))

    def weight(self, scene: str) -> float:
        """What a scene weighs in a mean."""
        return 1.0

    def pool(self, scores: Sequence[Score], weights: Sequence[float]) -> Score:
        """One score out of those of several scenes: here the mean, in which every scene counts once.

        Empty regions are left out. A region that a map does not answer at all counts as the measure's worst; where
        it has none, the mean is no number.
        """
        pairs = [(s, w) for s, w in zip(scores, weights, strict=True) if not math.isnan(s.density)]
        measure = scores[0].measure
        worst = math.nan if measure.worst is None else measure.worst
        total = math.fsum(w for _, w in pairs)

        def mean(values: list[float]) -> float:
            return math.fsum(v * w for v, (_, w) in zip(values, pairs, strict=True)) / total if total else math.nan

        value = mean([worst if math.isnan(s.value) else s.value for s, _ in pairs])
        return Score(
            measure, scores[0].mask, value, sum(s.pixels for s, _ in pairs), mean([s.density for s, _ in pairs])
        )

    def mean(self, results: Sequence[Result]) -> list[Score]:
        """Every measure in every region over the scenes of one run."""
        return self.pooled((result.scores, result.scene) for result in results)

    def pooled(self, scored: Iterable[tuple[Sequence[Score], str]]) -> list[Score]:
        """One score for every measure and region out of (scores, scene) of several scenes."""
        groups: dict[tuple[Measure, str], list[tuple[Score, float]]] = {}
        for scores, scene in scored:
            for score in scores:
                groups.setdefault((score.measure, score.mask), []).append((score, self.weight(scene)))
        return [self.pool([s for s, _ in group], [w for _, w in group]) for group in groups.values()]

    def tables(self, section: Section) -> list[Table]:
        """The tables of one data set."""
        from depthcli.evaluation import tables

        made = [tables.summary(section), *tables.details(section)]
        several = len(section.scenes) > 1 and (len(section.runs) > 1 or not self.scene_rows)
        return [*made, tables.by_scene(section)] if several else made


def names() -> list[str]:
    """Names of all protocols, sorted."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))


def load(name: str) -> type[Protocol[Any, Any]]:
    """The protocol of that name, written with hyphens or underscores.

    Raises
    ------
    InputError
        There is none; the message lists the names.
    """
    found = name.lower().replace("-", "_")
    if found not in names():
        raise InputError(f"no protocol called {name!r}; one of: {', '.join(names())}")
    return _load(found)


@cache
def _load(name: str) -> type[Protocol[Any, Any]]:
    module = importlib.import_module(f"{__name__}.{name}")
    own = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
    (protocol,) = (v for v in own if issubclass(v, Protocol))
    return protocol
