"""Scoring of runs: find their maps, compare them with ground truth, write pictures and a report."""

from __future__ import annotations

import contextlib
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.bound import Bound
from depthcli.core.errors import DepthcliError, InputError
from depthcli.core.plugins import loaded, plugins_of, versions_here
from depthcli.evaluation.bounds import judged, promised
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.curves import hidden_pixels
from depthcli.evaluation.map_files import MapNaming, find_runs, names_in_run, recognized
from depthcli.evaluation.protocols import AnyProtocol, Settings, load, missing_scores, picture
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.disparity import ScaleError, read_disparity, read_status
from depthcli.io.formats.files import RUN_FILE, collected_warnings, short_path, warn, write_text
from depthcli.io.formats.images import write_drawn
from depthcli.io.scenes import RgbdScene, Scene, StereoScene, plugins_of_scenes
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, scenes_with_files
from depthcli.io.scenes.places import origin
from depthcli.io.scenes.rows import Folder
from depthcli.run.console import Reporter
from depthcli.run.flags import Condition, flag_rows, plain_name
from depthcli.run.folder import staging_folder
from depthcli.run.records import read_report, read_text
from depthcli.show.table import Row, to_csv, to_json

PAGE_FILE = "report.html"
"""The page, in the folder of an evaluation."""

_FILES = ("scores.*", "report.md", PAGE_FILE, "contact_sheet.png")
RESULTS = (*_FILES, "errors/**/*", "bounds/**/*", "curves/**/*", "points/**/*", "assets/*")
"""Shell patterns of the files of an evaluation."""

_DEFAULT_PROTOCOLS = "middlebury-v2", "depth"  # of a truth file in no scene's folder, without --protocol


def scenes_with_truth(
    truth: Path,
    patterns: Sequence[str] = ("*",),
    layout: str | None = None,
    protocol: AnyProtocol | None = None,
    settings: Settings | None = None,
    reporter: Reporter | None = None,
    maps: Iterable[Path] = (),
) -> list[Scene]:
    """Return the scenes of a folder that have ground truth or cannot be used; or the scene of a single file.

    Raise InputError if no scene has ground truth.

    Parameters
    ----------
    patterns : shell patterns of scene names
    layout : layout of the folder; None recognizes it
    protocol : protocol that scores all scenes and decides on their kind; None: the protocol of each scene
    maps : files compared with the ground truth; a name can show that both are depth
    """
    settings, reporter = settings or Settings(), reporter or Reporter(-1)
    if os.path.isfile(truth):
        return [_scene_of_file(truth, protocol, settings, reporter, maps)]
    tried = ALL_KINDS if protocol is None else ALL_KINDS.of_kind(protocol.kind)
    there = discover_scenes(truth, tried, layout, patterns, reporter.info)
    scenes = [scene for scene in there if scene.problem or scene.has_truth]
    if all(scene.problem for scene in scenes):
        nothing = f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)"
        lacking = [*filter(None, (scene.lacks_for_truth for scene in there)), nothing]
        raise InputError(scenes[0].problem if scenes else lacking[0])
    return scenes


def _scene_of_file(
    truth: Path, protocol: AnyProtocol | None, settings: Settings, reporter: Reporter, maps: Iterable[Path]
) -> Scene:
    """Return the scene whose truth a file is, or one of that map alone, of meta.json's or the settings' scale."""
    if holding := scenes_with_files([truth], ALL_KINDS):
        return holding[truth]
    if protocol is None:
        of_depth = any(file.name.lower().startswith("depth") for file in (truth, truth.parent, *maps))
        name = _DEFAULT_PROTOCOLS[of_depth]
        what = "depth" if of_depth else "disparities"
        reporter.info(f"{truth}: in no scene's folder; scored as {what}, by {name}, unless --protocol is given")
        protocol = load(name)(settings)
    meta = Folder(truth.parent, truth.stem, "").meta
    common: dict[str, Any] = {"name": truth.stem, "folder": truth.parent, "protocol": protocol.name}
    if issubclass(protocol.kind, StereoScene):
        codes = None if truth.suffix.lower() == ".pfm" else meta.positive("disp_scale") or settings.scale
        decode = partial(read_disparity, asks=not protocol.kitti_codes)
        return StereoScene(**common, left=truth, disparity_left=truth, disparity_scale=codes, decode=decode)
    if issubclass(protocol.kind, RgbdScene):
        alone = RgbdScene(**common, color=truth, depth=truth, depth_true=truth, depth_scale=settings.scale)
        return alone.with_scale(meta.positive("depth_scale"))
    raise InputError(f"{truth}: {protocol.name} needs a folder of scenes as the ground truth")


class _FoundMap(NamedTuple):
    """One run's map as it was read, with the maps beside it."""

    path: Path
    estimate: Any
    confidences: dict[str, NDArray[Any]]
    bound: NDArray[Any] | None  # in the unit of the run's maps
    status: NDArray[np.uint8] | None


class ScoredMap(NamedTuple):
    """One run's map: its scores, its file, and the data that the protocol read."""

    result: MapResult
    path: Path
    estimate: Any
    truth: Any
    confidences: Mapping[str, NDArray[Any]]
    bound: NDArray[Any] | None = None


class Viewer:
    """A file that shows the maps, such as the page; it gets them while they are scored."""

    file: ClassVar[str]
    needed: ClassVar[bool] = False  # True: an evaluation without the file fails; False: it is incomplete
    folder: Path

    def begin(self, folder: Path) -> None:
        """Begin the file in ``folder``."""
        self.folder = folder

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        """Begin a scene; the maps that follow belong to it. ``truth`` is the result of ``protocol.truth(scene)``."""

    def add_map(self, scored: ScoredMap) -> None:
        """Add one run's map to the scene."""

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write the file: the report, all of it as JSON, and run -> its resolved config, or empty."""


@dataclass(frozen=True)
class Choices:
    """How runs are scored and shown."""

    protocol: AnyProtocol | None = None  # that scores all scenes; None: what every scene names
    settings: Settings = field(default_factory=Settings)
    naming: Mapping[str, MapNaming] = field(default_factory=dict)  # of a run's maps; the rest is recognized
    rows: Mapping[str, Row] | None = None  # scene -> row of the report of the only run; None: read from the runs
    conditions: Sequence[Condition] = ()  # on scores and on columns of the runs' reports, by which scenes are flagged
    with_pairs: bool = False  # all pairs of runs are tested, not those with the best alone
    viewers: Sequence[Viewer] = ()  # which show the maps, if there is a folder for the results
    reporter: Reporter = field(default_factory=lambda: Reporter(-1))


def evaluate_runs(
    runs: Sequence[Path | str],
    scenes: Sequence[Scene],
    truth: Path,
    output: Path | str | None,
    choices: Choices | None = None,
) -> EvaluationReport:
    """Evaluate runs side by side and write scores, pictures and a report.

    These files are written to ``output`` at the end: ``scores.csv``, ``scores.json``, ``errors`` and
    ``bounds/<run>/<scene>.png``, ``points/<run>/<scene>.csv``, the files of ``viewers``, and ``record.json``, which
    tells the next evaluation which files it may replace.

    Parameters
    ----------
    runs : folders of maps; for a single scene also maps; ``NAME=PLACE`` gives a run a name
    scenes : the scenes, each with ground truth or with a reason why it cannot be used
    output : folder for the results; None: nothing is written

    Raises
    ------
    ConfigError
        ``output`` has files that no evaluation wrote under the names of its results; nothing is computed then.
    InputError
        There is no run, or it is ambiguous which files of a run are its maps. A missing or unreadable map raises
        nothing: it becomes a result with its reason (``report.failed``).
    OutputError
        The results cannot be written.
    """
    choices, places = choices or Choices(), find_runs(runs)
    choices = choices if output is not None else replace(choices, viewers=())
    reporter = choices.reporter
    if len(scenes) > 1 and any(place.is_file() for place in places.values()):
        raise InputError(f"a single map needs a single scene, {truth} has {len(scenes)}: give a file, or --scenes")
    writing = staging_folder(Path(output), "evaluate", RESULTS, reporter.info) if output is not None else None
    with writing or contextlib.nullcontext() as folder:
        scoring = _Scoring(places, truth, folder, choices)
        report = scoring.report(scenes, scoring.all_results(scenes))
        if folder is not None:
            scores = to_json(report.to_dict())
            write_text(folder / "scores.csv", to_csv(report.records()))
            write_text(folder / "scores.json", scores)
            configs = {run: read_text(place / RUN_FILE) for run, place in places.items()}
            scoring.show(lambda viewer: viewer.write(report, scores, configs))
    with_reports = choices.rows is None  # otherwise the run has just printed its own
    for line in report.warnings(together=True, with_reports=with_reports):
        reporter.info(f"warning: {line}")
    for result in report.failed:
        reporter.error(f"{result.run} {result.scene}: {result.error}")
    return report


@contextlib.contextmanager
def can_be_missed(file: str, unwritten: dict[str, str], reporter: Reporter) -> Iterator[None]:
    """Catch errors in writing a page or sheet, which is optional: print them and note them in ``unwritten``."""
    try:
        yield
    except DepthcliError as error:
        unwritten[file] = str(error)
        reporter.error(f"no {file}: {error}")
    except Exception as error:  # a fault of drawing: the scores are right all the same
        unwritten[file] = f"{type(error).__name__}: {error}"
        reporter.error(f"no {file}: {unwritten[file]}; please report this line")


@dataclass
class _Scoring:
    """An evaluation under way."""

    runs: Mapping[str, Path]
    truth: Path
    output: Path | None
    choices: Choices
    reports: dict[str, Mapping[str, Row]] = field(default_factory=dict)  # run -> scene -> row of the run's own report
    promises: dict[str, Bound | None] = field(default_factory=dict)  # of the runs' bounds
    naming: dict[str, MapNaming] = field(default_factory=dict)  # of a run's maps
    protocols: dict[str, AnyProtocol] = field(default_factory=dict)  # by name, those that were used
    hints: list[str] = field(default_factory=list)  # assumptions, one line each
    maps: set[Path] = field(default_factory=set)  # files that were read
    misfits: dict[str, list[tuple[str, str]]] = field(default_factory=dict)  # protocol -> scenes that look otherwise
    unread: dict[str, list[str]] = field(default_factory=dict)  # run -> why maps of it cannot be read
    unwritten: dict[str, str] = field(default_factory=dict)  # file of a viewer -> why it could not be written

    def __post_init__(self) -> None:
        for run, place in self.runs.items():
            self.reports[run] = read_report(place) if self.choices.rows is None else self.choices.rows
            self.promises[run] = promised(read_text((place if place.is_dir() else place.parent.parent) / RUN_FILE))

    def show(self, step: Callable[[Viewer], None]) -> None:
        """Let every viewer take a step, except those that could not be written before."""
        for viewer in self.choices.viewers:
            if viewer.file not in self.unwritten:
                missed = can_be_missed(viewer.file, self.unwritten, self.choices.reporter)
                with contextlib.nullcontext() if viewer.needed else missed:
                    step(viewer)

    def all_results(self, scenes: Sequence[Scene]) -> list[MapResult]:
        """Return the results of every scene and run; a line of progress for each scene."""
        names = names_in_run([scene.name for scene in scenes], self.truth)
        self._recognize_maps(scenes, names)
        if (folder := self.output) is not None:
            self.show(lambda viewer: viewer.begin(folder))
        results = []
        with self.choices.reporter.counting(len(scenes), 0, "evaluate"):
            for scene in scenes:
                of_scene = self._results(scene, names[scene.name])
                results += of_scene
                self.choices.reporter.step(any(result.error for result in of_scene))
        for run, errors in self.unread.items():
            if errors and len(errors) == len(scenes):
                raise InputError(f"{run}: none of its maps can be read: {errors[0]}")
        return results

    def report(self, scenes: Sequence[Scene], results: Sequence[MapResult]) -> EvaluationReport:
        """Return the results as a report, with the plug-ins in use, warnings, and flags."""
        reporter, protocols = self.choices.reporter, self.protocols
        for name, value in vars(self.choices.settings).items():
            if value in (None, False) or not protocols:
                continue
            if not any(name in protocol.takes for protocol in protocols.values()):
                reporter.info(f"--{name} makes no difference to {', '.join(protocols)}")
        plugins = dict[str, str]()
        if loaded:
            files = self.maps | {value for scene in scenes for value in vars(scene).values() if isinstance(value, Path)}
            plugins = versions_here(plugins_of(map(type, protocols.values())) | plugins_of_scenes(scenes, files))
        for name, scored in self.misfits.items():
            (scene, others), more = scored[0], f" and {len(scored) - 1} more" if len(scored) > 1 else ""
            how = "name the protocol with evaluate --protocol, in meta.json, or by --layout"
            self.hints.append(f"{scene}{more}: look like {others}, but scored as {name}: {how}")
        report = EvaluationReport(
            tuple(self.runs),
            tuple(results),
            protocols,
            origin(self.truth),
            tuple(self.hints),
            plugins,
            unwritten=self.unwritten,
            with_pairs=self.choices.with_pairs,
        )
        if not self.choices.conditions:
            return report
        rows = self._flag_columns(report, {scene.name for scene in scenes})
        return replace(report, flags=flag_rows(self.choices.conditions, rows, reporter))

    def _flag_columns(self, report: EvaluationReport, scenes: set[str]) -> list[Row]:
        """Return the rows that conditions see: scores, and the runs' own rows, also of scenes that were not scored.

        A metric without a region belongs to the protocol's main region; ``bad 2 (0.5)``, whose threshold in
        pixels of a smaller image is in brackets, is ``bad 2``, too.
        """
        rows: dict[tuple[str, str], Row] = {}
        for run, of_run in self.reports.items():
            rows |= {(run, scene): {**row, "run": run} for scene, row in of_run.items() if scene in scenes}
        for section in report.sections:
            for result in section.results:
                scores: Row = {}
                for region in reversed(section.regions):
                    here: Row = {}
                    for score in (*result.scores, *result.bounds):
                        if score.region == region:
                            here |= {score.metric.heading: score.value}
                            here.setdefault(re.sub(r" \([\d.]+\)$", "", score.metric.heading), score.value)
                    scores |= {plain_name(f"{heading} {region}"): value for heading, value in here.items()}
                    scores |= {plain_name(heading): value for heading, value in here.items()}
                place = result.run, result.scene
                rows[place] = {**rows.get(place, {}), **scores, "scene": result.scene, "run": result.run}
        return list(rows.values())

    def _recognize_maps(self, scenes: Sequence[Scene], names: Mapping[str, list[str]]) -> None:
        """Set how the maps of every run are named; the patterns of other programs' runs are recognized."""
        for run, place in self.runs.items():
            naming = self.naming[run] = self.choices.naming.get(run, MapNaming())
            rows = self.reports[run]
            if rows and not any(name in rows for known in names.values() for name in known):
                here, there = (", ".join([*of][:3]) + ", ..." * (len(of) > 3) for of in (rows, names))
                self.hints.append(f"{run}: a run of other scenes ({here}) than the truth ({there})")
            if place.is_dir() and not rows:
                self.naming[run] = self._recognized(run, place, naming, scenes, names)
                if self.naming[run] != naming:
                    self.hints.append(f"{run}: taken as its maps: {self.naming[run].pattern} (--pattern sets others)")

    def _recognized(
        self, run: str, place: Path, naming: MapNaming, scenes: Sequence[Scene], names: Mapping[str, list[str]]
    ) -> MapNaming:
        """Return the options with the pattern of a run's maps, if none has a usual name.

        Raise InputError if several patterns fit.
        """
        usable: dict[str, tuple[Scene, AnyProtocol]] = {}
        for scene in scenes:
            with contextlib.suppress(DepthcliError):
                usable[scene.name] = scene, self._protocol_of(scene)

        def fits(name: str, path: Path, options: MapNaming) -> bool:
            scene, protocol = usable[name]
            try:
                with collected_warnings():
                    self._reader(protocol, options).read(path, scene, protocol.truth(scene))
            except DepthcliError as error:
                return isinstance(error, ScaleError)  # the map itself is readable
            return True

        files = {name: (protocol.files, names[name]) for name, (_, protocol) in usable.items()}
        return recognized(run, place, naming, files, fits)

    def _reader(self, protocol: AnyProtocol, options: MapNaming) -> AnyProtocol:
        """Return the protocol with the settings of one run, by which its maps are read."""
        scale, invalid, usual = options.scale, options.invalid, protocol.settings
        if scale is None and invalid is None:
            return protocol
        scale, invalid = scale or usual.scale, usual.invalid if invalid is None else invalid
        return type(protocol)(replace(usual, scale=scale, invalid=invalid, any_scale=options.scale is not None))

    def _protocol_of(self, scene: Scene) -> AnyProtocol:
        scene.check()
        if self.choices.protocol is None and not scene.protocol:
            raise InputError(f"{scene.folder}: {scene.name} names no protocol; choose one with --protocol")
        protocol = self.choices.protocol or load(scene.protocol)(self.choices.settings)
        return self.protocols.setdefault(protocol.name, protocol)

    def _results(self, scene: Scene, names: list[str]) -> list[MapResult]:
        """Return the results of one scene for every run; ``names``: those that it may have in a run folder."""
        data_set = scene.name.rpartition("/")[0] or self.truth.resolve().name
        start = MapResult("", scene.name, data_set, "")
        try:
            protocol = self._protocol_of(scene)
            start = replace(start, protocol=protocol.name)
            with collected_warnings() as lines:
                truth: Any = protocol.truth(scene)
        except DepthcliError as error:
            return [replace(start, run=run, error=str(error)) for run in self.runs]
        if self.choices.protocol is None and truth.looks_like:
            self.misfits.setdefault(protocol.name, []).append((scene.name, truth.looks_like))
        self.show(lambda viewer: viewer.begin_scene(protocol, scene, truth))
        results = []
        for run in self.runs:
            with collected_warnings() as map_lines:
                result = self._result(replace(start, run=run), protocol, scene, truth, names)
            results.append(replace(result, warning="; ".join([*lines, *map_lines])))
        return results

    def _result(self, start: MapResult, protocol: AnyProtocol, scene: Scene, truth: Any, names: list[str]) -> MapResult:
        """Read, score and draw one run's map; if it cannot be read, return the worst scores with the reason."""
        rows = self.reports[start.run]
        row: Row = next((rows[name] for name in names if name in rows), {})
        start = replace(start, run_warnings=tuple(row.get("warnings") or ()))
        try:
            found = self._read(start.run, protocol, scene, truth, names, str(row.get("error") or ""))
        except DepthcliError as error:
            missing, dense = missing_scores(protocol, truth), missing_scores(protocol, truth, dense=True)
            return replace(start, scores=tuple(missing), dense=tuple(dense), error=str(error))
        result, points, outside = self._scored(start, protocol, truth, found, row)
        if self.output is not None:
            if points:
                write_text(self.output / short_path(f"points/{result.run}/{result.scene}.csv"), to_csv(points))
            paint = partial(picture, protocol, found.estimate, truth)
            write_drawn(self.output / result.picture, paint)
            if outside is not None:
                write_drawn(self.output / result.bound_picture, partial(paint, outside))
        scored = ScoredMap(result, found.path, found.estimate, truth, found.confidences, found.bound)
        self.show(lambda viewer: viewer.add_map(scored))
        return result

    def _read(
        self, run: str, protocol: AnyProtocol, scene: Scene, truth: Any, names: list[str], failure: str
    ) -> _FoundMap:
        """Return one run's map with the maps beside it. Raise an error if there is no map, or it cannot be read.

        ``failure`` is the error of the run itself in that scene, or empty.
        """
        place, naming = self.runs[run], self.naming[run]
        files = naming.files(protocol.files)
        path = place if place.is_file() else files.find(place, names)
        if path is None:
            reason = f": the run failed there: {failure}" if failure else files.searched(names)
            raise InputError(f"{place}: no map of scene {scene.name}{reason}")
        self.maps.add(path)
        try:
            estimate: Any = self._reader(protocol, naming).read(path, scene, truth)
        except DepthcliError as error:
            self.unread.setdefault(run, []).append(str(error))
            raise
        confidences = {}
        for name, file in files.planes(path).items():
            if (plane := _extra(protocol.read_confidence, file, truth)) is not None:
                confidences[name] = plane
        status = _extra(read_status, files.companion(path, "status.png"))
        bound = _extra(protocol.read_confidence, files.companion(path, "bound"), truth)
        return _FoundMap(path, estimate, confidences, bound, status)

    def _scored(
        self, start: MapResult, protocol: AnyProtocol, truth: Any, found: _FoundMap, row: Row
    ) -> tuple[MapResult, list[dict[str, float]], NDArray[np.bool_] | None]:
        """Return a map's result, rows of points with known truth, and True where the truth is outside its bound.

        ``row`` is the scene's row in the run's own report, or empty. Maps have no rows; without a bound, the last is
        None.
        """
        place, limit = self.runs[start.run], found.bound
        if limit is not None:
            # A bound that ends with the search, of a registration, promises no limit; reach is rounded.
            limit = np.where(limit >= row.get("reach", math.inf) - 1e-3, np.inf, limit)
        curves, bounds, outside = judged(
            protocol, found.estimate, truth, found.confidences, limit, found.status, self.promises[start.run]
        )
        points, pooling_data = protocol.points(found.estimate, truth)
        result = replace(
            start,
            source=found.path.name if found.path == place else found.path.relative_to(place).as_posix(),
            scores=tuple(protocol.scores(found.estimate, truth)),
            dense=tuple(protocol.threshold_curve(found.estimate, truth)),
            curves=tuple(curves),
            bounds=tuple(bounds),
            hidden=None if found.status is None else hidden_pixels(found.status, truth.regions),
            seconds=math.fsum(row.get("seconds", {}).values()) or math.nan,
            size=truth.size,
            n_disparities=largest if isinstance(largest := row.get("max_disparity"), int) and largest > 0 else 0,
            pooling_data=pooling_data,
        )
        return result, points, outside


def _extra(read: Callable[..., NDArray[Any]], file: Path | None, *more: Any) -> NDArray[Any] | None:
    """Return the content of a file beside a map, or None if there is none or, with a warning, it is unreadable."""
    try:
        return None if file is None else read(file, *more)
    except DepthcliError as error:  # the scores do not need it
        warn(str(error))
        return None
