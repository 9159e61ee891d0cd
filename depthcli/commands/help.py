"""Explain columns, layouts, formats and other topics."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, TypeAlias

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.core.registry import with_package
from depthcli.run.batch import EXIT_CODES
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter
from depthcli.run.json_csv import to_json

if TYPE_CHECKING:
    from depthcli.core.columns import ColumnHelp

Page: TypeAlias = dict[str, list[tuple[str, str]]]
"""Heading -> names with their explanations."""

_WIDTH, _MAX_NAMES = 100, 30
METHOD_PACKAGES = tuple(
    f"depthcli.{package}"
    for package in (
        "methods.stereo.pipeline", "methods.stereo.cost", "methods.stereo.aggregation", "methods.stereo.optimization",
        "methods.stereo.refinement", "methods.confidence", "methods.fusion.choice", "methods.kinect.pipeline",
        "methods.kinect.model", "methods.transparent.pipeline", "methods.registration.pipeline",
        "methods.registration.feature", "algorithms.segmentation", "algorithms.keypoints",
    )
)  # fmt: skip
"""Packages of all families of methods, in the order in which they are explained."""


class HelpCommand(Command):
    """``depthcli help [TOPIC]``; of another command's name, ``cli/`` shows its ``--help``."""

    arguments = (Option("topic", str, "Topic, or name of a command. Default: all topics.", "TOPIC", group="Input"),)
    examples = ("depthcli help columns", "depthcli help stereo")

    def run(self, values: Values, reporter: Reporter) -> int:
        """Print a topic, or all of them in a line each; return the exit code."""
        topic = values["topic"]
        if topic is None:
            about = [(name, (page.__doc__ or "").removeprefix("Return ").strip()) for name, page in TOPICS.items()]
            found: Page = {"Topics: depthcli help TOPIC": about}
        elif topic in TOPICS:
            found = TOPICS[topic]()
        else:
            raise ConfigError(f"help: no topic or command {topic!r}; topics are {', '.join(TOPICS)}")
        if values["json"]:
            reporter.data(to_json([{"group": g, "name": n, "about": t} for g, rows in found.items() for n, t in rows]))
        else:
            reporter.data("\n".join(_text(heading, rows) for heading, rows in found.items()))
        return 0


def _text(heading: str, rows: Iterable[tuple[str, str]]) -> str:
    """One heading with its names, explanations beside them or, of long names, below."""
    rows = list(rows)
    width = max((len(name) for name, _ in rows if len(name) <= _MAX_NAMES), default=0)
    lines = [f"{heading}:"]
    for name, text in rows:
        first = f"  {name:<{width}}  "
        rest = " " * (width + 4)
        if len(name) > width:
            lines.append(f"  {name}")
            first = rest
        lines += textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=rest) or [first.rstrip()]
    return "\n".join(lines) + "\n"


def _columns() -> Page:
    """Return every column of every table: name, unit and meaning."""
    from depthcli.evaluation import columns as evaluation
    from depthcli.run import columns as report

    return {
        "Metrics (evaluate)": _rows(evaluation.METRICS),
        "Regions (evaluate)": _rows(evaluation.REGIONS),
        "Other columns of evaluate and sweep": _rows(evaluation.TABLES),
        "scores.csv": _rows(evaluation.SCORES),
        "points.csv, points/RUN/SCENE.csv": _rows(evaluation.POINTS),
        "Sensitivity, sweep.csv": _rows(evaluation.SWEEP),
        "report.csv of every run": _rows(report.REPORT),
        "report.csv of stereo, fuse, rectify": _rows(report.MAPS),
        "report.csv of refine-kinect, transparent, depth": _rows(report.DEPTH),
        "report.csv of confidence, fuse maps": _rows(report.GIVEN_MAPS),
        "report.csv of register-confidence": _rows(report.REGISTRATION),
        "report.csv of sample": _rows(report.SAMPLES),
        "planes.csv, segment_labels.csv, keypoints.csv": _rows(report.SEGMENTS),
        "Printed by devices, warmup, --dry-run": _rows(report.LISTS),
    }


def _rows(columns: Iterable[ColumnHelp]) -> list[tuple[str, str]]:
    return [(column.headings, column.about) for column in columns]


def _layouts() -> Page:
    """Return the layouts of folders that are recognized, and the files of each."""
    from depthcli.io.layouts import layouts

    rows = [(each.name, with_package(type(each), each.wants.replace("`", ""))) for each in layouts()]
    return {"Layouts (--layout NAME)": rows}


def _presets() -> Page:
    """Return the presets of every command."""
    from depthcli.run.presets import list_presets

    page: Page = {}
    for command, preset, about in list_presets():
        page.setdefault(f"{command} PRESET", []).append((preset, about))
    return page


def _outputs() -> Page:
    """Return the files that every command writes."""
    from depthcli.commands import command_names, load_command
    from depthcli.commands._old_batch import BatchCommand
    from depthcli.commands._page import RESULTS
    from depthcli.run.records import RUN_FILE
    from depthcli.run.reports import REPORT_FILES

    commands = [(name, load_command(name)) for name in command_names()]
    scenes = [
        (name, ", ".join(each.results) + each.results_note) for name, each in commands if isinstance(each, BatchCommand)
    ]
    return {
        "In every run folder": [
            (RUN_FILE, "the config with all values, versions and seed; itself a config"),
            (", ".join(REPORT_FILES), "a row for every scene: status, seconds, memory; see depthcli help columns"),
            ("SCENE/record.json", "inputs and files of a scene, by their digests: by it a run is resumed"),
        ],
        "In the folder of a scene": scenes,
        "In the folder of an evaluation": [("evaluate", ", ".join(RESULTS))],
    }


def _status() -> Page:
    """Return the bits of status.png."""
    from depthcli.core.maps import DEPTH_STATUS_HELP, STATUS_HELP

    return {
        "Disparity maps": [(str(int(bit)), text) for bit, text in STATUS_HELP.items()],
        "Depth maps": [(str(int(bit)), text) for bit, text in DEPTH_STATUS_HELP.items()],
    }


def _protocols() -> Page:
    """Return the protocols of evaluate, and how each scores."""
    from depthcli.evaluation.protocols import load, names

    rows = []
    for name in names():
        kind = load(name)
        shown = kind.presentation
        rows.append((name, with_package(kind, ". ".join(filter(None, [shown.title, shown.note])))))
    return {"Protocols (--protocol NAME)": rows}


def _formats() -> Page:
    """Return the kinds of files that are read."""
    from depthcli.evaluation.protocols import load, names
    from depthcli.io.formats.images import IMAGE_SUFFIXES
    from depthcli.io.formats.map_format import MAP_SUFFIXES, map_formats
    from depthcli.io.formats.volumes import VOLUME_SUFFIXES

    others = [(suffix, with_package(type(of), _first_paragraph(type(of)))) for suffix, of in map_formats().items()]
    maps: dict[str, list[str]] = {}
    for name in names():
        maps.setdefault(" ".join(load(name).files.endings), []).append(name)
    return {
        "Files, by their endings; the content decides": [
            ("images", " ".join(IMAGE_SUFFIXES)),
            ("disparity and depth maps", f"{' '.join(MAP_SUFFIXES)}: PFM and floats hold pixels or meters, integers "
             "codes"),
            *others,
            ("volumes", " ".join(VOLUME_SUFFIXES)),
        ],
        "Maps of a run, by the protocol that scores them": [(", ".join(which), ends) for ends, which in maps.items()],
    }  # fmt: skip


def _methods() -> Page:
    """Return the methods of every family, with the packages of plug-ins."""
    from depthcli.core.method import Family

    page: Page = {}
    for package in METHOD_PACKAGES:
        family = Family.of(package)
        rows = []
        for name in family.names():
            kind = family.load(name)
            rows.append((name, with_package(kind, _first_paragraph(kind))))
        page[family.group.removeprefix("depthcli.")] = rows
    return page


def _first_paragraph(kind: type) -> str:
    return " ".join((kind.__doc__ or "").split("\n\n")[0].split())


def _measures() -> Page:
    """Return the confidence measures: of cost volumes, and of maps that were made before."""
    from depthcli.methods.confidence import measures
    from depthcli.methods.given_maps import map_measures

    return {
        "Of costs (confidence: in configs of stereo and fuse)": list(measures().items()),
        "Of given maps (confidence --measure NAME)": list(map_measures().items()),
    }


def _exit_codes() -> Page:
    """Return the exit codes of all commands."""
    return {"Exit codes": [(str(code), text) for code, text in EXIT_CODES.items()]}


TOPICS: dict[str, Callable[[], Page]] = {
    "columns": _columns,
    "exit-codes": _exit_codes,
    "formats": _formats,
    "layouts": _layouts,
    "measures": _measures,
    "methods": _methods,
    "outputs": _outputs,
    "presets": _presets,
    "protocols": _protocols,
    "status": _status,
}
"""Topic -> function that makes its page."""

COMMAND = HelpCommand()
