"""Protocols: how a benchmark, or a kind of ground truth, scores a map; one file each, the folder is the registry.

``_disparity`` has what the protocols of disparity maps share: ``middlebury_v2``, ``middlebury_v3``, ``eth3d``,
``kitti_2012``, ``kitti_2015``, ``scene_flow`` and ``booster``. ``depth`` scores depth maps,
``registration`` expected registration errors, whose metrics are in ``_registration``. ``load`` returns the class of a
name, :class:`Protocol` says what it has to have.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.registry import Registry, registered_name
from depthcli.evaluation.calibration import HiddenPixels, reliability
from depthcli.evaluation.curves import sparsifications
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.pooling import Pooling
from depthcli.evaluation.presentation import Presentation, ShownMap, error_picture, pixel_kinds
from depthcli.evaluation.results import ConfidenceCurve
from depthcli.evaluation.scores import Metric, Score
from depthcli.io.formats.disparity import read_plane
from depthcli.io.scenes import Scene

Estimate = TypeVar("Estimate")
Truth = TypeVar("Truth")


@dataclass(frozen=True)
class Settings:
    """Options of an evaluation; every protocol takes those that apply to it (``Protocol.takes``).

    Attributes
    ----------
    scale : codes per unit of maps that hold integer codes; None: by the file's kind and the scene
    resolution : size of the ground truth where a benchmark has several (Middlebury v3: F, H or Q)
    threshold : of the headline, in the protocol's unit, instead of the benchmark's
    resize : (width, height) that depth maps and their truth are brought to, nearest neighbor, as ClearGrasp does
    invalid : value of the files of disparity maps that stands for no value, before ``scale``; None: it is recognized
    any_scale : ``scale`` is of all files, not only of those that may hold integer codes
    """

    scale: float | None = None
    resolution: str | None = None
    threshold: float | None = None
    resize: tuple[int, int] | None = None
    invalid: float | None = None
    any_scale: bool = False

    def __post_init__(self) -> None:
        if self.resolution not in (None, "F", "H", "Q"):
            raise ConfigError(f"resolution: want F, H or Q (got {self.resolution!r})")


class Protocol(Pooling, ABC, Generic[Estimate, Truth]):
    """How one benchmark scores: an estimate and a scene's truth in, scores out, and the pooling of several scenes.

    ``truth`` prepares a scene's ground truth once and ``read`` one run's estimate for it; all other methods open no
    file. Boolean and error arrays have the shape of the regions, whatever the number of axes. Where the maps of a run
    lie is declared in ``files``, how numbers and maps are shown in ``presentation``.

    A protocol has to have the attributes without a default, ``headline``, ``truth``, ``read``, ``regions``, ``error``
    and ``scores``; ``values`` and ``true_values`` where maps are to be shown, ``wrong`` where the headline has no
    threshold. Everything else is overridden where a benchmark differs.

    Attributes
    ----------
    kind : kind of scene that is scored
    files : where a run folder may hold the maps
    presentation : words, units and colors of tables and pictures
    curve_regions : regions of the confidence curves; empty: the main region
    takes : names of the settings that make a difference
    """

    kind: ClassVar[type[Scene]]
    files: ClassVar[MapFiles]
    presentation: ClassVar[Presentation]
    curve_regions: ClassVar[tuple[str, ...]] = ()
    takes: ClassVar[tuple[str, ...]] = ("scale", "threshold")

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    @property
    def name(self) -> str:
        """Name of the protocol: its module's or its plug-in's, with dashes."""
        return registered_name(type(self)).replace("_", "-")

    @property
    @abstractmethod
    def headline(self) -> Metric:
        """The metric that ranks runs; ``scores`` has it for every region."""

    @abstractmethod
    def truth(self, scene: Scene) -> Truth:
        """Return the scene's ground truth, checked and prepared.

        Raises
        ------
        InputError
            The scene is of another kind, or its ground truth is missing or unusable.
        """

    @abstractmethod
    def read(self, path: Path, scene: Scene, truth: Truth) -> Estimate:
        """Return one run's estimate; InputError where the file is damaged or does not fit the truth."""

    def read_confidence(self, path: Path, truth: Truth) -> NDArray[Any]:
        """Return a confidence map as stored, NaN and infinite values included; InputError for another size."""
        values = read_plane(path)
        if any(values.shape != region.shape for region in self.regions(truth).values()):
            raise InputError(f"{path}: the size differs from the truth's")
        return values

    def scene_of_file(self, truth: Path) -> Scene:
        """Return the scene of a ground truth file that lies in no folder of a known layout."""
        raise InputError(f"{truth}: {self.name} wants a folder of scenes as the ground truth")

    def shown_map(self, path: Path, scene: Scene) -> ShownMap:
        """Return one run's map as it is shown where no truth is known; InputError where it cannot be read."""
        return ShownMap(read_plane(path), self._planes(path))

    def dense_map(self, path: Path, scene: Scene, truth: Truth) -> ShownMap | None:
        """Return one run's whole map where the truth is known at few points; None: the truth covers the map."""
        return None

    def _planes(self, path: Path) -> dict[str, NDArray[Any]]:
        """Return name -> confidence map beside a map; those that cannot be read are left out."""
        found = {}
        for name, file in self.files.confidences(path).items():
            with contextlib.suppress(InputError):
                found[name] = read_plane(file)
        return found

    # One map: ``regions``, ``error`` and ``scores`` have to be written, the others where a benchmark differs.

    def empty_estimate(self, truth: Truth) -> Any:
        """Return the estimate without any value: NaN for every true value; overridden where ``true_values`` is None."""
        return np.full_like(self.true_values(truth), np.nan)

    @abstractmethod
    def regions(self, truth: Truth) -> dict[str, NDArray[np.bool_]]:
        """Return name -> pixels (or voxels) with known truth, in the order of ``region_order``."""

    @abstractmethod
    def error(self, estimate: Estimate, truth: Truth) -> NDArray[np.floating[Any]]:
        """Return the absolute error of every pixel, in the unit of the errors; NaN without estimate or truth."""

    @abstractmethod
    def scores(self, estimate: Estimate, truth: Truth) -> list[Score]:
        """Compute every metric in every region."""

    def threshold_curve(self, estimate: Estimate, truth: Truth) -> list[Score]:
        """Compute one metric at many thresholds in the main region, as ``scores`` does; empty where there is none."""
        return []

    def wrong(self, estimate: Estimate, truth: Truth) -> NDArray[np.bool_]:
        """Return True where the error is above the headline's threshold; False where there is no estimate."""
        if self.headline.threshold is None:
            raise NotImplementedError(f"{self.name} has no headline threshold: override wrong")
        return self.error(estimate, truth) > self.headline.threshold

    def values(self, estimate: Estimate, truth: Truth) -> NDArray[np.floating[Any]] | None:
        """Return the values that are compared, NaN = none; None where no single number stands for a pixel."""
        return None

    def true_values(self, truth: Truth) -> NDArray[np.floating[Any]] | None:
        """Return the values of the truth that ``values`` are compared with, or None."""
        return None

    def shown_pixels(self, truth: Truth) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the pixels of any region, and those of them that the other view does not see."""
        regions = self.regions(truth)
        known: NDArray[np.bool_] = np.logical_or.reduce(list(regions.values()))
        visible = regions.get(self.presentation.visible_region)
        return known, np.zeros_like(known) if visible is None else known & ~visible

    def picture(self, estimate: Estimate, truth: Truth) -> NDArray[np.uint8] | None:
        """Return the (H, W, 3) RGB error picture; None where the presentation wants none."""
        if not self.presentation.error_pictures:
            return None
        missing = np.isnan(self.error(estimate, truth))
        return error_picture(pixel_kinds(*self.shown_pixels(truth), self.wrong(estimate, truth), missing))

    def points(self, estimate: Estimate, truth: Truth) -> list[dict[str, float]]:
        """Return a row for each point whose truth is known, for a table; empty where the truth is a map."""
        return []

    def size(self, truth: Truth) -> int:
        """Return the number of pixels or voxels that a run processes, by which its seconds are divided."""
        return next(region.size for region in self.regions(truth).values())

    def headlines(self, estimate: Estimate, truth: Truth) -> dict[str, float]:
        """Return region -> value of the headline."""
        return {s.region: s.value for s in self.scores(estimate, truth) if s.metric == self.headline}

    def warnings(self, estimate: Estimate, truth: Truth) -> list[str]:
        """Return what looks wrong with the estimate, one line each."""
        return []

    def better_protocols(self, truth: Truth) -> str:
        """Return what of other protocols a scene's truth looks like, and why; empty where this protocol fits."""
        return ""

    def missing(self, truth: Truth, dense: bool = False) -> list[Score]:
        """Return the scores (or ``dense``) of a scene without a map: the worst value, NaN where there is no bound."""
        scores = (self.threshold_curve if dense else self.scores)(self.empty_estimate(truth), truth)
        sizes = {name: int(np.count_nonzero(region)) for name, region in self.regions(truth).items()}
        made = []
        for score in scores:
            worst, pixels = score.metric.worst, sizes.get(score.region, score.pixels)
            wrong = None if score.wrong is None else pixels
            value = math.nan if worst is None or math.isnan(score.density) else worst
            made.append(replace(score, value=value, pixels=pixels, wrong=wrong))
        return made

    def curves(
        self, estimate: Estimate, truth: Truth, confidences: Mapping[str, NDArray[Any]]
    ) -> list[ConfidenceCurve]:
        """Compute the sparsification curves of every confidence map, of wrong pixels and of the error."""
        if not confidences:
            return []
        regions, error, wrong = self.regions(truth), self.error(estimate, truth), self.wrong(estimate, truth)
        made = []
        for name in [name for name in self.curve_regions if name in regions] or list(regions)[:1]:
            region = regions[name] & ~np.isnan(error)
            if region.any():
                chosen = {confidence: values[region] for confidence, values in confidences.items()}
                lines = sparsifications(chosen, {"bad": wrong[region], "error": error[region]})
                for (confidence, of), line in lines.items():
                    right = reliability(chosen[confidence], ~wrong[region]) if of == "bad" else None
                    made.append(ConfidenceCurve(name, confidence, of, line, right))
        return made

    def hidden(self, status: NDArray[np.uint8], truth: Truth) -> HiddenPixels | None:
        """Compare what a status map says about what the right view does not see with the truth, where that is known."""
        return None

    def pooling_data(self, estimate: Estimate, truth: Truth) -> Any:
        """Return what ``mean`` needs beside the scores, such as points to be pooled; kept in memory, not written."""
        return None


AnyProtocol: TypeAlias = Protocol[Any, Any]


_REGISTRY = Registry[AnyProtocol](__name__)


def names() -> list[str]:
    """Return the names of all protocols, with dashes, those of plug-ins last."""
    return [name.replace("_", "-") for name in _REGISTRY.names()]


@cache
def load(name: str) -> type[AnyProtocol]:
    """Return the protocol of that name, written with dashes or underscores.

    Raises
    ------
    InputError
        There is none; the message lists the names.
    """
    known = _REGISTRY.find(name)
    if known is None:
        raise InputError(f"no protocol called {name!r}; one of: {', '.join(names())}")
    return _REGISTRY.load(known)
