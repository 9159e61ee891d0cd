"""Score the maps of every run, one scene after another."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._runs import names_in_run, recognized
from depthcli.core.errors import DepthcliError, InputError
from depthcli.evaluation.calibration import HiddenPixels
from depthcli.evaluation.map_files import MapOptions
from depthcli.evaluation.plots import curve_plot
from depthcli.evaluation.protocols import AnyProtocol, Settings, load
from depthcli.evaluation.results import MapResult
from depthcli.io.formats.files import collected_warnings, write_text
from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import read_status
from depthcli.io.scenes import Scene
from depthcli.report.contact_sheet import ContactSheet
from depthcli.run.json_csv import Row, to_csv
from depthcli.run.reports import read_report

if TYPE_CHECKING:
    from depthcli.report.page import Page


@dataclass
class Scoring:
    """An evaluation under way.

    Attributes
    ----------
    runs : name -> folder or file of every run
    truth : folder or file of the ground truth
    output : folder for error pictures, plots and tables of points; None: nothing is written
    protocol : scores every scene; None: each scene names its own
    settings : options of the protocols
    page : is given every map; or None
    map_options : run -> how its maps are named and coded, of those that it was given for, or that were recognized
    protocols : name -> protocol, of those that were used
    hints : what was assumed, one line each
    maps : the files that were read as maps of the runs
    _misfits : name of a protocol -> scenes that it scored, with what they look like instead
    """

    runs: dict[str, Path]
    truth: Path
    output: Path | None
    protocol: AnyProtocol | None
    settings: Settings
    page: Page | None = None
    map_options: dict[str, MapOptions] = field(default_factory=dict)
    protocols: dict[str, AnyProtocol] = field(default_factory=dict)
    hints: list[str] = field(default_factory=list)
    maps: set[Path] = field(default_factory=set)
    _misfits: dict[str, list[tuple[str, str]]] = field(default_factory=dict)

    @cached_property
    def reports(self) -> dict[str, dict[str, Row]]:
        """Run -> scene -> row of the run's own report."""
        return {run: read_report(place) for run, place in self.runs.items()}

    @cached_property
    def sheet(self) -> ContactSheet:
        """Small pictures of the first scenes."""
        return ContactSheet(list(self.runs))

    @cached_property
    def _data_set(self) -> str:
        """Name of the data set of scenes that lie in the folder of the truth itself."""
        return self.truth.resolve().name

    def recognize_maps(self, scenes: Sequence[Scene]) -> None:
        """Find the pattern of the maps of every run that holds none under a usual name.

        Raises
        ------
        InputError
            Several patterns would fit.
        """
        short = [scene.name.rpartition("/")[2] for scene in scenes]
        usable: dict[str, tuple[Scene, AnyProtocol, list[str]]] = {}
        for scene, name in zip(scenes, short, strict=True):
            with contextlib.suppress(DepthcliError):
                usable[scene.name] = scene, self._protocol_of(scene), self._names(scene, short.count(name) == 1)

        def fits(name: str, path: Path, options: MapOptions) -> bool:
            scene, protocol, _ = usable[name]
            with collected_warnings():
                try:
                    self._reader(protocol, options).read(path, scene, protocol.truth(scene))
                except DepthcliError:
                    return False
            return True

        named = {name: (protocol, names) for name, (_, protocol, names) in usable.items()}
        for run, place in self.runs.items():
            if os.path.isdir(place) and not self.reports[run]:
                given = self.map_options.get(run, MapOptions())
                found = recognized(run, place, given, named, fits)
                if found != given:
                    self.map_options[run] = found
                    self.hints.append(f"{run}: taken as its maps: {found.pattern} (--maps says otherwise)")

    def _names(self, scene: Scene, unique: bool) -> list[str]:
        """Names that a scene may have in a run folder."""
        return names_in_run(scene.name, self.truth, unique)

    def _reader(self, protocol: AnyProtocol, options: MapOptions) -> AnyProtocol:
        """The protocol with the settings of one run, by which its maps are read."""
        own = {name: value for name in ("scale", "invalid") if (value := getattr(options, name)) is not None}
        return type(protocol)(replace(protocol.settings, **own, any_scale="scale" in own)) if own else protocol

    def results(self, scene: Scene, unique: bool) -> list[MapResult]:
        """Return the results of one scene for every run; ``unique``: no other scene has its short name."""
        folder, names = scene.name.rpartition("/")[0], self._names(scene, unique)
        start = MapResult("", scene.name, folder or self._data_set, "")
        try:
            protocol = self._protocol_of(scene)
            start = replace(start, protocol=protocol.name)
            with collected_warnings() as lines:
                truth: object = protocol.truth(scene)
        except DepthcliError as error:
            return [replace(start, run=run, error=str(error)) for run in self.runs]
        if self.protocol is None and (better := protocol.better_protocols(truth)):
            self._misfits.setdefault(protocol.name, []).append((scene.name, better))
        if self.page is not None:
            self.page.begin_scene(protocol, scene, truth)
        if self.output is not None and protocol.presentation.error_pictures and not self.sheet.is_full:
            self.sheet.begin_scene(scene.name, protocol.presentation.image(scene), protocol.true_values(truth))
        start = replace(start, warning="; ".join(lines))
        return [self._result(replace(start, run=run), protocol, scene, truth, names) for run in self.runs]

    @property
    def misfits(self) -> tuple[str, ...]:
        """Which scenes look as if another protocol was meant, one line for each protocol that scored such scenes."""
        return tuple(
            f"{found[0][0]}{f' and {len(found) - 1} more' * (len(found) > 1)}: look like {found[0][1]}, but scored as "
            f"{protocol}: name the protocol with evaluate --protocol, in meta.json, or by --layout"
            for protocol, found in self._misfits.items()
        )

    def _protocol_of(self, scene: Scene) -> AnyProtocol:
        scene.check()
        if self.protocol is None and not scene.protocol:
            raise InputError(f"{scene.folder}: {scene.name} names no protocol; choose one with --protocol")
        protocol = self.protocol or load(scene.protocol)(self.settings)
        return self.protocols.setdefault(protocol.name, protocol)

    def _result(
        self, start: MapResult, protocol: AnyProtocol, scene: Scene, truth: object, names: list[str]
    ) -> MapResult:
        """The result of one run's map, with what its readers and the protocol warn of."""
        with collected_warnings() as lines:
            result = self._scored(start, protocol, scene, truth, names)
        return replace(result, warning="; ".join(filter(None, [result.warning, *lines])))

    def _scored(
        self, start: MapResult, protocol: AnyProtocol, scene: Scene, truth: object, names: list[str]
    ) -> MapResult:
        """Find, read, score and draw one run's map; where that fails, the worst scores with the reason."""
        place, rows = self.runs[start.run], self.reports[start.run]
        options = self.map_options.get(start.run, MapOptions())
        files = options.files(protocol.files)
        row: Row = next((rows[name] for name in names if name in rows), {})
        try:
            path = place if os.path.isfile(place) else files.find(place, names)
            if path is None:
                reason = f": the run failed there: {row['error']}" if row.get("error") else files.searched(names)
                raise InputError(f"{place}: no map of scene {scene.name}{reason}")
            self.maps.add(path)
            estimate: object = self._reader(protocol, options).read(path, scene, truth)
        except DepthcliError as error:
            missing, dense = tuple(protocol.missing(truth)), tuple(protocol.missing(truth, dense=True))
            return replace(start, scores=missing, dense=dense, error=str(error))
        warnings, confidences = protocol.warnings(estimate, truth), {}
        for name, file in files.confidences(path).items():
            try:
                confidences[name] = protocol.read_confidence(file, truth)
            except DepthcliError as error:
                warnings.append(str(error))
        hidden = _hidden(protocol, files.status(path), truth, warnings)
        result = replace(
            start,
            source=path.name if path == place else path.relative_to(place).as_posix(),
            scores=tuple(protocol.scores(estimate, truth)),
            dense=tuple(protocol.threshold_curve(estimate, truth)),
            curves=tuple(protocol.curves(estimate, truth, confidences)),
            hidden=hidden,
            seconds=math.fsum(row.get("seconds", {}).values()) or math.nan,
            size=protocol.size(truth),
            n_disparities=largest if isinstance(largest := row.get("max_disparity"), int) and largest > 0 else 0,
            warning="; ".join(filter(None, [start.warning, *warnings])),
            pooling_data=protocol.pooling_data(estimate, truth),
        )
        if self.output is not None:
            if points := protocol.points(estimate, truth):
                write_text(self.output / result.table_of_points, to_csv(points))
            picture = protocol.picture(estimate, truth)
            if picture is not None:
                write_png(self.output / result.picture, picture)
                self.sheet.add_map(result.scene, result.run, protocol.values(estimate, truth), picture)
            for (region, of), plot in result.plots.items():
                lines = {c.confidence: c.line for c in result.curves if (c.region, c.of) == (region, of)}
                write_text(self.output / plot, curve_plot(lines, f"{result.run}: {result.scene}, {region}", of))
        if self.page is not None:
            self.page.add_map(result, path, estimate, truth, confidences)
        return result


def _hidden(protocol: AnyProtocol, file: Path | None, truth: object, warnings: list[str]) -> HiddenPixels | None:
    """How well the status map beside a map says what is hidden; None where nothing is known, or it cannot be read."""
    if file is None:
        return None
    try:
        return protocol.hidden(read_status(file), truth)
    except DepthcliError as error:
        warnings.append(str(error))
        return None
