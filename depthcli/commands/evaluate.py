"""Compare maps of one or more runs with the ground truth.

A run is a folder that ``depthcli`` made, or a folder of maps by another program; which files are a scene's map, how it
is read and how it is scored is decided by the scene's protocol (``depthcli/evaluation/protocols``).
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._flags import FLAGS, conditions_of, exit_code, flags_of_scores
from depthcli.commands._old_options import LAYOUT, SCENES
from depthcli.commands._page import HTML, PAGE_FILE, RESULTS, new_page
from depthcli.commands._tables import TABLES, check_tables, print_place, print_tables
from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.option import Option
from depthcli.core.registry import Plugin, plugin_of, versions_here
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter
from depthcli.run.json_csv import Row, to_csv, to_json

if TYPE_CHECKING:
    from depthcli.commands._scoring import Scoring
    from depthcli.core.flags import Condition
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.evaluation.map_files import MapOptions
    from depthcli.evaluation.protocols import AnyProtocol, Settings
    from depthcli.evaluation.results import MapResult
    from depthcli.io.scenes import Scene
    from depthcli.report.page import Page

_DEFAULT_PROTOCOL = "middlebury-v2"  # of a truth file that lies in no scene's folder, without --protocol


class EvaluateCommand(Command):
    """``depthcli evaluate RUN... --truth DIR [--output DIR]``."""

    arguments = (
        Option("runs", Path, "Run folders or maps; NAME=DIR gives a run a name.", "RUN...", repeatable=True,
               required=True, group="Input"),
    )  # fmt: skip

    options = (
        Option("truth", Path, "Folder with ground truth; of a single map, a file.", "DIR", required=True,
               group="Input"),
        Option("output", Path, "Folder for scores, pictures and report. Default: none.", "DIR", short="-o",
               group="Output"),
        SCENES,
        LAYOUT,
        Option("protocol", str, "How to score, such as kitti-2015. Default: by data set.", "NAME"),
        Option("maps", str, "Path of a map, '{scene}/a.tiff'. Of one run: NAME=...", "PATTERN",
               repeatable=True, group="Input"),
        Option("scale", str, "Codes per unit of integer files. Of one run: NAME=...", "CODES", repeatable=True,
               group="Input"),
        Option("invalid", str, "Value that means none, or nan. Of one run: NAME=...", "VALUE", repeatable=True,
               group="Input"),
        Option("resolution", str, "Size of Middlebury v3's truth. Default: by the width.", "F|H|Q"),
        Option("resize", str, "Bring depth maps and truth to this size.", "WxH"),
        Option("threshold", float, "Threshold of wrong pixels. Default: the benchmark's.", "T", min_value=1e-6),
        *TABLES,
        *FLAGS,
        *HTML,
    )  # fmt: skip

    page = "how_to/compare_maps"
    examples = (
        "depthcli evaluate runs/accurate runs/fast --truth scenes -o results --html",
        "depthcli evaluate a=maps/a b=maps/b --maps b='{scene}/d.tiff' --truth in",
        "depthcli evaluate runs/fast --truth scenes --format latex --tables metrics",
    )

    def run(self, values: Values, reporter: Reporter) -> int:
        """Evaluate and print the tables; return the exit code."""
        from depthcli.commands._runs import given_map_options
        from depthcli.evaluation.protocols import Settings

        resolution, resize = (values["resolution"] or "").upper() or None, _size(values["resize"])
        scale, invalid, map_options = given_map_options(values)
        settings = Settings(scale, resolution, values["threshold"], resize, invalid)
        check_tables(values)
        conditions = conditions_of(values)
        page = new_page(reporter.command_line, values, values["output"])
        report = evaluate(
            values["runs"], values["truth"], values["output"], values["scenes"] or ["*"], values["layout"],
            values["protocol"], settings, reporter, page=page,
            map_options=map_options, conditions=conditions,
        )  # fmt: skip
        if values["json"]:
            reporter.data(to_json(report.to_dict()))
        else:
            print_tables(report, values, reporter)
            if conditions and not values["quiet"]:
                reporter.data(report.flags.text())
        if values["output"] is not None:
            print_place(values["output"], page is not None and page.written, reporter)
        return exit_code(bool(report.failed), report.flags, values)


def evaluate(
    runs: Sequence[Path | str],
    truth: Path | str,
    output: Path | str | None,
    scenes: Sequence[str] = ("*",),
    layout: str | None = None,
    protocol: str | None = None,
    settings: Settings | None = None,
    reporter: Reporter | None = None,
    kinds: Iterable[type[Scene]] | None = None,
    page: Page | None = None,
    map_options: Mapping[str, MapOptions] | None = None,
    conditions: Sequence[Condition] = (),
    rows: Mapping[str, Row] | None = None,
) -> EvaluationReport:
    """Evaluate runs side by side and write scores, pictures, curves and a report.

    Written to ``output``, all at the end: ``scores.csv``, ``scores.json``, ``report.md``, ``contact_sheet.png``,
    ``errors/<run>/<scene>.png``, ``curves/<run>/<scene>_<region>_<kind>.svg``, ``points/<run>/<scene>.csv``, and
    ``record.json``, by which the next evaluation knows which files it may replace.

    Parameters
    ----------
    runs : folders of maps; or maps, where there is a single scene; ``NAME=PLACE`` names one
    truth : folder of scenes with ground truth, or one file of it
    output : folder for the results; None: nothing is written
    scenes : shell patterns of scene names
    layout : layout of ``truth``; None recognizes it
    protocol : its name; None: what every scene names
    settings : options of the protocols
    reporter : shows progress, failures and warnings
    kinds : kinds of scene to evaluate; None: all, or what ``protocol`` scores
    page : is filled and written to ``output``; or None
    map_options : run -> how its maps are named and coded; what is not given is recognized
    conditions : on scores and on columns of the runs' reports, by which scenes are flagged
    rows : scene -> row of the report of the only run; None: read from the runs

    Raises
    ------
    ConfigError
        ``output`` holds files that no evaluation wrote under the names of its results; nothing is computed then.
    InputError
        No run, no scenes with ground truth, no such protocol, a run of which several files may be the maps. A map
        that is missing or unreadable is no error: it becomes a result with its reason (``report.failed``).
    OutputError
        The results cannot be written.
    """
    from depthcli.commands._runs import find_runs
    from depthcli.commands._scoring import Scoring
    from depthcli.evaluation.protocols import Settings, load
    from depthcli.io.inputs import local
    from depthcli.run.install import staging_folder

    reporter, settings, truth = reporter or Reporter(-1), settings or Settings(), local(truth)
    places = find_runs(runs)
    scored_by = None if protocol is None else load(protocol)(settings)
    found = _find_truth(truth, scored_by, kinds, layout, scenes, settings, reporter)
    if len(found) > 1 and any(map(os.path.isfile, places.values())):
        raise InputError(f"a single map wants a single scene, {truth} has {len(found)}: give a file, or --scenes")
    writing = staging_folder(Path(output), "evaluate", RESULTS, reporter.info) if output is not None else None
    with writing or contextlib.nullcontext() as folder:
        if page is not None and folder is not None:
            page.folder = folder
        report = _scored(
            Scoring(places, truth, folder, scored_by, settings, page, dict(map_options or {})),
            found, reporter, conditions, rows,
        )  # fmt: skip
    for line in report.warning_lines:
        reporter.info(f"warning: {line}")
    for result in report.failed:
        reporter.error(f"{result.run} {result.scene}: {result.error}")
    return report


def _scored(
    scoring: Scoring,
    scenes: Sequence[Scene],
    reporter: Reporter,
    conditions: Sequence[Condition],
    rows: Mapping[str, Row] | None,
) -> EvaluationReport:
    """Score all scenes, and write scores, pictures and the page."""
    from depthcli.evaluation.comparison import EvaluationReport
    from depthcli.evaluation.plots import cache_below
    from depthcli.io.inputs import origin

    results: list[MapResult] = []
    with cache_below(scoring.output):
        with reporter:
            scoring.recognize_maps(scenes)
            reporter.start(len(scenes), 0, "evaluate")
            short = [scene.name.rpartition("/")[2] for scene in scenes]
            for scene, name in zip(scenes, short, strict=True):
                of_scene = scoring.results(scene, unique=short.count(name) == 1)
                results += of_scene
                reporter.step(any(result.error for result in of_scene))
        for name, value in vars(scoring.settings).items():
            taken = any(name in each.takes for each in scoring.protocols.values())
            if value not in (None, False) and scoring.protocols and not taken:
                reporter.info(f"--{name} makes no difference to {', '.join(scoring.protocols)}")
        hints = (*scoring.hints, *scoring.misfits)
        plugins = versions_here(_plugins(scoring, scenes))
        shown_truth = origin(scoring.truth)
        report = EvaluationReport(tuple(scoring.runs), tuple(results), scoring.protocols, shown_truth, hints, plugins)
        if conditions:
            own = {run: _report_of(place, scenes) if rows is None else rows for run, place in scoring.runs.items()}
            report = replace(report, flags=flags_of_scores(conditions, report, own, reporter))
            if scoring.page is not None:
                scoring.page.flags = report.flags
        _write(report, scoring, reporter)
    return report


def _report_of(place: Path, scenes: Sequence[Scene]) -> dict[str, Row]:
    """Return scene -> row of a run's report, of those of the scenes that it has."""
    from depthcli.run.reports import read_report

    rows = read_report(place) if os.path.isdir(place) else {}
    return {scene.name: rows[scene.name] for scene in scenes if scene.name in rows}


def _plugins(scoring: Scoring, scenes: Sequence[Scene]) -> set[Plugin]:
    """The plug-ins that found the scenes, read their truth and the maps of the runs, or scored them."""
    from depthcli.io.formats.map_format import format_plugins
    from depthcli.io.layouts import layout_plugins

    files = {value for scene in scenes for value in vars(scene).values() if isinstance(value, Path)}
    own = {plugin for protocol in scoring.protocols.values() if (plugin := plugin_of(type(protocol))) is not None}
    return own | layout_plugins(scenes) | format_plugins(files | scoring.maps)


def _size(text: str | None) -> tuple[int, int] | None:
    """Return ``640x480`` as (640, 480), and None for None."""
    found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", (text or "1x1").strip().lower())
    if not found:
        raise ConfigError(f"--resize: want WIDTHxHEIGHT, such as 256x144 (got {text!r})")
    return (int(found[1]), int(found[2])) if text else None


def _find_truth(
    truth: Path,
    scored_by: AnyProtocol | None,
    kinds: Iterable[type[Scene]] | None,
    layout: str | None,
    patterns: Sequence[str],
    settings: Settings,
    reporter: Reporter,
) -> list[Scene]:
    """All scenes with ground truth, and those that cannot be used; of a file, the scene whose truth it is."""
    from depthcli.evaluation.protocols import load
    from depthcli.io.walk import discover_scenes, scene_with_file

    if os.path.isfile(truth):
        holding = scene_with_file(truth)
        if holding is None and scored_by is None:
            reporter.info(f"{truth}: in no scene's folder; scored as {_DEFAULT_PROTOCOL} unless --protocol is given")
        return [holding or (scored_by or load(_DEFAULT_PROTOCOL)(settings)).scene_of_file(truth)]
    found = discover_scenes(truth, kinds if scored_by is None else [scored_by.kind], layout, patterns, reporter.info)
    found = [scene for scene in found if scene.problem or scene.has_truth]
    if not any(scene.has_truth and not scene.problem for scene in found):
        if found:
            raise InputError(found[0].problem)
        raise InputError(f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)")
    return found


def _write(report: EvaluationReport, scoring: Scoring, reporter: Reporter) -> None:
    from depthcli.evaluation.printing import report_markdown
    from depthcli.io.formats.files import write_text
    from depthcli.run.run_folder import saved_config

    scores = to_json(report.to_dict())
    if scoring.output is not None:
        write_text(scoring.output / "scores.csv", to_csv([record.row() for record in report.records()]))
        write_text(scoring.output / "scores.json", scores)
        write_text(scoring.output / "report.md", report_markdown(report))
        scoring.sheet.write(scoring.output / "contact_sheet.png")
    if scoring.page is not None:
        try:
            scoring.page.write(report, scores, {run: saved_config(place) for run, place in scoring.runs.items()})
        except DepthcliError as error:  # the scores are there
            reporter.error(f"no {PAGE_FILE}: {error}")


COMMAND = EvaluateCommand()
