"""Protocols: the rules by which a benchmark, or a kind of ground truth, scores and shows a map; one file each.

The folder is the registry. ``_disparity`` has the common part of the protocols of disparity maps: ``middlebury_v2``,
``middlebury_v3``, ``eth3d``, ``kitti_2012``, ``kitti_2015``, ``scene_flow`` and ``booster``. ``depth`` scores depth
maps, ``registration`` expected registration errors. ``load`` returns the class of a name, :class:`Protocol` lists
its members, :class:`Presentation` its words, units and colors.
"""

from __future__ import annotations

import contextlib
import math
import typing
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.plugins import Registry, registered_name
from depthcli.evaluation.curves import ConfidenceCurve, is_probability, reliability, sparsifications
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.scores import Key, MapResult, Metric, Score, mean_of_scenes
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.images import read_color8
from depthcli.io.scenes import Scene
from depthcli.show.table import Table
from depthcli.show.view import KIND_COLORS, Palette, Picture, SliceAxis, View, draw, pixel_kinds


@dataclass(frozen=True, eq=False)
class ShownMap(View):
    """A run's map as it is shown, read without ground truth."""

    # Heading with unit -> number, by which scenes are ordered: larger is worse, the first counts most.
    figures: dict[str, float] = field(default_factory=dict)
    note: str = ""  # explanation of the figures


def companions(
    path: Path, files: MapFiles, unit: float = 1.0, read: Callable[[Path], NDArray[Any]] = read_plane
) -> dict[str, Any]:
    """Return ``confidence`` and ``bound``, times ``unit``, of a map's folder, if they can be read."""
    confidence: dict[str, NDArray[Any]] = {}
    for name, file in files.planes(path).items():
        with contextlib.suppress(InputError):
            confidence[name] = read(file)
    bound = None
    with contextlib.suppress(InputError):
        if (file_of_bound := files.companion(path, "bound")) is not None:
            bound = unit * read(file_of_bound).astype(np.float64)
    return {"confidence": confidence, "bound": bound}


def _first_image(scene: Scene) -> NDArray[np.uint8] | None:
    """Return the left image of a scene, or its first, (H, W, 3) uint8 RGB; None if it is no picture."""
    try:
        files = scene.input_files
        return read_color8(files.get("left") or next(iter(files.values())))
    except (InputError, StopIteration):
        return None


@dataclass(frozen=True)
class Presentation:
    """Words of a protocol's tables, and how its maps are shown; no scores."""

    title: str = ""  # heading of the tables
    unit: str = ""  # of the errors
    note: str = ""  # explanation of the numbers, below the tables
    digits: int = 2  # decimals of the scores
    mean_heading: str = "mean"  # of the means over the scenes
    scene_rows: bool = True  # tables have a row for every scene in addition to the means
    quantity: str = "value"  # quantity of a map, in a word
    threshold_axis: str = "threshold"  # label of a plot's axis
    error_pictures: bool = False  # a picture of correct, incorrect and missing pixels is written for every map
    visible_region: str = ""  # name of the region that both views see, pixels outside being shown as occluded; or empty
    palette: Palette = field(default_factory=dict)  # colors and words of a map's status map
    opacity: float = 1.0  # initial one of a map's colors over the scene's image, 0 to 1
    verdicts: tuple[str, str] = ("correct", "incorrect")  # words for a pixel that is correct, and for one that is not
    scale: tuple[float, float] | None = None  # of the colors if no truth is known; None: by the map
    # Returns one run's map as it is shown if no truth is known; raises InputError if it cannot be read.
    show: Callable[[Path, Scene, MapFiles], ShownMap] = lambda path, _, files: ShownMap(
        read_plane(path), **companions(path, files)
    )
    # Returns the picture beneath maps: (H, W, 3) uint8 RGB, or (Z, Y, X) uint8 grey levels of a volume; or None.
    image: Callable[[Scene], NDArray[np.uint8] | None] = _first_image
    # Returns the map of a sensor that methods refine, (H, W) in the unit, NaN = none; None: there is no such map.
    sensor: Callable[[Scene], NDArray[np.floating[Any]] | None] = lambda _: None
    # Returns an array of a region's shape as an image or volume, NaN or False where it has no point, given the truth;
    # None: the points are on no grid and cannot be shown.
    on_grid: Callable[[NDArray[Any], Any], NDArray[Any] | None] = lambda points, _: points if points.ndim > 1 else None
    axes: Callable[[Any], tuple[SliceAxis, ...]] = lambda _: ()  # of the picture if it is a volume, given the truth
    at_points: Callable[[Any], bool] = lambda _: False  # whether the truth is of few points: the whole map is shown
    # Returns further tables of a run, from the protocol's data of every scene with a map.
    tables: Callable[[str, Sequence[Any]], list[Table]] = lambda _, __: []

    @property
    def pixel_kind_names(self) -> tuple[str, ...]:
        """Words for the kinds of pixel, ``UNKNOWN`` to ``EMPTY``."""
        right, wrong = self.verdicts
        return ("truth unknown or not evaluated", right, wrong, f"{right}, occluded", f"{wrong}, occluded", "no value")

    @property
    def legend(self) -> str:
        """Colors of the error pictures in words."""
        words = [f"{color}: {kind}" for (color, *_), kind in zip(KIND_COLORS, self.pixel_kind_names, strict=True)]
        return "; ".join(words[1:] + words[:1])


class Truth(typing.Protocol):
    """The common members of all prepared ground truths; arrays can have any number of axes."""

    @property
    def regions(self) -> Mapping[str, NDArray[np.bool_]]:
        """Name -> pixels (or voxels) with known truth, in the order of tables."""

    @property
    def values(self) -> NDArray[np.floating[Any]]:
        """The true values, NaN = unknown, in the unit of the presentation."""

    @property
    def size(self) -> int:
        """Number of pixels or voxels that a run processes, for its time per pixel."""

    @property
    def looks_like(self) -> str:
        """Other protocols that usually score such a ground truth; empty if this one fits."""


Estimate = TypeVar("Estimate")
TruthT = TypeVar("TruthT", bound=Truth)


@dataclass(frozen=True)
class Settings:
    """Options of an evaluation; every protocol takes those that apply to it (``Protocol.takes``)."""

    scale: float | None = None  # codes per unit of maps of integer codes; None: by the file's kind and the scene
    resolution: str | None = None  # size of the ground truth if a benchmark has several (Middlebury v3: F, H or Q)
    threshold: float | None = None  # of the headline, in the protocol's unit, instead of the benchmark's
    resize: tuple[int, int] | None = None  # (width, height) of depth maps and truth, nearest neighbor (ClearGrasp)
    invalid: float | None = None  # value of disparity files that is no value, before ``scale``; NaN: there is none
    any_scale: bool = False  # ``scale`` applies to all files, not only to integer codes

    def __post_init__(self) -> None:
        if self.resolution not in (None, "F", "H", "Q"):
            raise ConfigError(f"resolution: expected F, H or Q (got {self.resolution!r})")


class Protocol(ABC, Generic[Estimate, TruthT]):
    """The rules of one benchmark: from an estimate and the ground truth to scores, and the pooling of several scenes.

    ``truth`` prepares a scene's ground truth once and ``read`` one run's estimate for it; all other methods open no
    file. Boolean and error arrays have the shape of the regions.

    A protocol has to have the attributes without a default, ``truth``, ``read``, ``values``, ``error`` and ``scores``,
    and ``wrong`` if the headline has no threshold. A protocol overrides the other members if its benchmark differs.
    """

    kind: ClassVar[type[Scene]]  # of scene that is scored
    files: ClassVar[MapFiles]  # places of the maps in a run folder
    presentation: ClassVar[Presentation]
    read_truth: Callable[[Any], Any]  # reads the ground truth of a scene of that kind as stored
    headline: Metric  # the metric that ranks runs; ``scores`` has it for every region
    kitti_codes: ClassVar[bool] = False  # 16-bit maps have KITTI's 256 codes per pixel
    takes: ClassVar[tuple[str, ...]] = ("scale", "threshold")  # names of the settings that make a difference
    region_order: ClassVar[tuple[str, ...]] = ("nonocc", "all", "disc")  # in tables; the first present is the main one
    averages_regions: ClassVar[bool] = False  # the single figure of a run is the mean over all regions
    curve_regions: ClassVar[tuple[str, ...]] = ()  # of the confidence curves; empty: the main region
    map_unit: ClassVar[float] = 1.0  # unit of float maps and their bounds, in units of the errors
    within: ClassVar[float] = math.nan  # error of P(|error| <= within) if the run names none, in the maps' unit
    # Name -> bits of a status map; a pixel belongs to the first group with one of its bits, otherwise to that with 0.
    status_groups: ClassVar[Mapping[str, int]] = {}
    weights: ClassVar[Mapping[str, float]] = {}  # short name of a scene -> its weight in means, if not 1
    # Makes one score of the scores of one metric and region in several scenes, with the scenes' weights.
    pool: ClassVar[staticmethod[[Sequence[Score], Sequence[float]], Score]] = staticmethod(mean_of_scenes)

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()
        self.name = registered_name(type(self)).replace("_", "-")

    @abstractmethod
    def truth(self, scene: Scene) -> TruthT:
        """Return the scene's ground truth. Raise InputError if it is of another kind, missing or unusable."""

    @abstractmethod
    def read(self, path: Path, scene: Scene, truth: TruthT) -> Estimate:
        """Return one run's estimate. Raise InputError if the file is damaged or does not fit the ground truth."""

    def read_confidence(self, path: Path, truth: TruthT) -> NDArray[Any]:
        """Return a confidence map as stored, NaN and infinite values included. Raise InputError for another size."""
        values = read_plane(path)
        if any(values.shape != region.shape for region in truth.regions.values()):
            raise InputError(f"{path}: the size differs from the truth's")
        return values

    @abstractmethod
    def values(self, estimate: Estimate, truth: TruthT) -> NDArray[np.floating[Any]]:
        """Return the values that are compared with ``truth.values``, NaN = none."""

    @abstractmethod
    def error(self, estimate: Estimate, truth: TruthT) -> NDArray[np.floating[Any]]:
        """Return the absolute error of every pixel, in the unit of the errors; NaN without estimate or truth."""

    def bounded_error(self, estimate: Estimate, truth: TruthT) -> NDArray[np.floating[Any]]:
        """Return the absolute error that a run's bounds limit, in the form of ``error``."""
        return self.error(estimate, truth)

    def wrong(self, estimate: Estimate, truth: TruthT) -> NDArray[np.bool_]:
        """Return True for pixels whose error exceeds the headline's threshold; False if there is no estimate."""
        if self.headline.threshold is None:
            raise NotImplementedError(f"{self.name} has no headline threshold: override wrong")
        return self.error(estimate, truth) > self.headline.threshold

    @abstractmethod
    def scores(self, estimate: Estimate, truth: TruthT) -> list[Score]:
        """Compute every metric in every region."""

    def threshold_curve(self, estimate: Estimate, truth: TruthT) -> list[Score]:
        """Compute one metric at many thresholds in the main region, as ``scores`` does; empty if there is none."""
        return []

    def curves(
        self, estimate: Estimate, truth: TruthT, confidences: Mapping[str, NDArray[Any]]
    ) -> list[ConfidenceCurve]:
        """Compute the sparsification curves of every confidence map, of incorrect pixels and of the error."""
        if not confidences:
            return []
        regions, error, wrong = truth.regions, self.error(estimate, truth), self.wrong(estimate, truth)
        curves = []
        for name in [name for name in self.curve_regions if name in regions] or list(regions)[:1]:
            region = regions[name] & ~np.isnan(error)
            if region.any():
                chosen = {confidence: values[region] for confidence, values in confidences.items()}
                lines = sparsifications(chosen, {"bad": wrong[region], "error": error[region]})
                for (confidence, of), line in lines.items():
                    probable = of == "bad" and is_probability(confidence)
                    right = reliability(chosen[confidence], ~wrong[region]) if probable else None
                    curves.append(ConfidenceCurve(name, confidence, of, line, right))
        return curves

    def points(self, estimate: Estimate, truth: TruthT) -> tuple[list[dict[str, float]], Any]:
        """Return a table of points with known ground truth, and data for ``mean``; ([], None) for maps."""
        return [], None

    def mean(self, results: Sequence[MapResult]) -> list[Score]:
        """Compute every metric in every region over the scenes of one run."""
        return self.pooled((result.scores, result.scene) for result in results)

    def pooled(self, scored: Iterable[tuple[Sequence[Score], str]]) -> list[Score]:
        """Return one score for every metric and region, pooled from the scores of several scenes."""
        groups: dict[Key, list[tuple[Score, float]]] = {}
        for scores, scene in scored:
            weight = self.weights.get(scene.rpartition("/")[2], 1.0)
            for score in scores:
                groups.setdefault(score.key, []).append((score, weight))
        return [self.pool(*zip(*group, strict=True)) for group in groups.values()]


AnyProtocol: TypeAlias = Protocol[Any, Any]


def headlines(protocol: AnyProtocol, estimate: Any, truth: Any) -> dict[str, float]:
    """Return region -> value of the headline."""
    return {s.region: s.value for s in protocol.scores(estimate, truth) if s.metric == protocol.headline}


def missing_scores(protocol: AnyProtocol, truth: Truth, dense: bool = False) -> list[Score]:
    """Return the scores (or ``dense``: the threshold curve) of a scene without a map: the worst value, or NaN."""
    empty = np.full_like(truth.values, np.nan)
    sizes = {name: int(np.count_nonzero(region)) for name, region in truth.regions.items()}
    scores = []
    for score in (protocol.threshold_curve if dense else protocol.scores)(empty, truth):
        worst, pixels = score.metric.worst, sizes.get(score.region, score.pixels)
        value = math.nan if worst is None or math.isnan(score.density) else worst
        scores.append(replace(score, value=value, pixels=pixels, wrong=None if score.wrong is None else pixels))
    return scores


def shown_pixels(protocol: AnyProtocol, truth: Truth) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the pixels of any region, and the pixels among them that the other view does not see."""
    known: NDArray[np.bool_] = np.logical_or.reduce(list(truth.regions.values()))
    visible = truth.regions.get(protocol.presentation.visible_region)
    return known, np.zeros_like(known) if visible is None else known & ~visible


def picture(
    protocol: AnyProtocol, estimate: Any, truth: Truth, wrong: NDArray[np.bool_] | None = None
) -> Picture | None:
    """Return the (H, W, 3) RGB error picture, in the colors of the legend; None if the presentation has none.

    ``wrong``: the incorrect pixels; None: by the headline.
    """
    if not protocol.presentation.error_pictures:
        return None
    error = protocol.error(estimate, truth)
    wrong = protocol.wrong(estimate, truth) if wrong is None else wrong
    return draw(View(error, kinds=pixel_kinds(*shown_pixels(protocol, truth), wrong, np.isnan(error))), "error")


_REGISTRY = Registry[AnyProtocol](__name__)


def names() -> list[str]:
    """Return the names of all protocols, with dashes, plug-ins last."""
    return [name.replace("_", "-") for name in _REGISTRY.names()]


def has_kitti_codes(name: str) -> bool:
    """Return the protocol's ``kitti_codes``; False for an unknown name."""
    known = _REGISTRY.find(name)
    return known is not None and _REGISTRY.load(known).kitti_codes


@cache
def load(name: str) -> type[AnyProtocol]:
    """Return the protocol of that name, with dashes or underscores; InputError, with all names, if there is none."""
    known = _REGISTRY.find(name)
    if known is None:
        raise InputError(f"no protocol called {name!r}; one of: {', '.join(names())}")
    return _REGISTRY.load(known)
