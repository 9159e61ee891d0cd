"""``report.html``: what an evaluation found, for people; one file that opens from disk and asks no network."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from depthcli.core.errors import ConfigError, OutputError
from depthcli.data.formats.atomic import write_text
from depthcli.data.scenes import Scene
from depthcli.evaluation import tables
from depthcli.evaluation.matrix import Matrix, best_of, by_scene
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.report import Table, number
from depthcli.evaluation.results import EvaluationReport, Result, Section
from depthcli.evaluation.summary import Comparison, compare
from depthcli.report import colors
from depthcli.report.plots import plots
from depthcli.report.scenes import ScenePage, smaller

ASSETS = "assets"
BUDGET = 50_000_000
"""Bytes that the scenes' pictures may take in the page itself."""

_MOST_CONFIG = 100_000  # characters of a config
_MOST_TABLES = 40_000  # cells of the tables of one section


@dataclass(frozen=True)
class _Entry:
    """A scene that is written to the assets and waits for the end: its name, where it is, what is shown at once."""

    name: str
    file: Path
    size: int
    protocol: Protocol[Any, Any]
    thumbs: dict[str, dict[str, str]]


class Page:
    """Takes scenes and maps while they are evaluated and writes the page at the end.

    Scenes wait in the folder ``assets``, so that only one is in memory; where all of them fit into the page they move
    there, and the folder goes.

    Parameters
    ----------
    folder : of the report
    command : the command line that makes the page, to be shown in it
    budget : bytes of pictures in the page, beyond which it holds smaller ones
    """

    def __init__(self, folder: Path, command: str = "", budget: int = BUDGET) -> None:
        self.folder, self.command, self.budget = folder, command, budget
        self._entries: list[_Entry] = []
        self._scene: ScenePage | None = None

    def scene(self, judge: Protocol[Any, Any], scene: Scene, truth: Any) -> None:
        """The scene that the next maps belong to."""
        self._close()
        self._scene = ScenePage.of(judge, scene, truth)

    def map(self, result: Result, path: Path, estimate: Any, truth: Any, confidences: dict[str, Any]) -> None:
        """One run's map of the scene."""
        if self._scene is not None:
            self._scene.add(result, path, estimate, truth, confidences)

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write ``report.html``.

        Parameters
        ----------
        report : all that was found
        scores : the same as JSON
        configs : run -> its resolved config, where it has one

        Raises
        ------
        ConfigError
            Jinja2 or matplotlib is not installed.
        OutputError
            The page cannot be written.
        """
        self._close()
        total = sum(entry.size for entry in self._entries)
        factor = max(1, math.ceil(math.sqrt(total / self.budget)))
        data = [self._embedded(entry, factor) for entry in self._entries]
        page = {
            "runs": report.runs,
            "assets": [f"{ASSETS}/{entry.file.name}" if factor > 1 else None for entry in self._entries],
            "scale": colors.scale().tolist(),
            "errors": colors.error_scales().tolist(),
            "none": colors.NO_VALUE,
        }
        text = _template().render(
            style=_file("page.css"), scripts=[_file("page.js"), _file("viewer.js")],
            report=report, command=self.command,
            configs={run: text[:_MOST_CONFIG] for run, text in configs.items()}, factor=factor, assets=ASSETS,
            sections=[_Shown.of(section) for section in report.sections], overview=tables.overview(report),
            others=_other_tables(report), scenes=[_thumbs(report, entry) for entry in self._entries], data=data,
            page=_script_json(json.dumps(page)), scores=_script_json(scores),
            kinds=[_swatches(verdicts) for verdicts in dict.fromkeys(e.protocol.verdicts for e in self._entries)],
            number_of={entry.name: i for i, entry in enumerate(self._entries)},
        )  # fmt: skip
        write_text(self.folder / "report.html", text)
        self._clear(keep=len(self._entries) if factor > 1 else 0)

    def _close(self) -> None:
        if self._scene is None:
            return
        scene, number = self._scene, len(self._entries)
        scene.close()
        file = self.folder / ASSETS / f"scene-{number}.js"
        text = f"depthcli({number}, {_script_json(json.dumps(scene.data))});\n"
        write_text(file, text)
        self._entries.append(_Entry(scene.name, file, len(text), scene.judge, scene.thumbs))
        self._scene = None

    def _embedded(self, entry: _Entry, factor: int) -> str:
        text = entry.file.read_text("utf-8")
        data = text[text.index("{") : text.rindex("}") + 1]
        return data if factor == 1 else _script_json(json.dumps(smaller(json.loads(data), factor)))

    def _clear(self, keep: int) -> None:
        """Remove the scenes from ``keep`` on that lie in the assets, and the folder where nothing is left."""
        folder = self.folder / ASSETS
        try:
            for file in folder.glob("scene-*.js"):
                if not file.stem[6:].isdecimal() or int(file.stem[6:]) >= keep:
                    file.unlink(missing_ok=True)
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        except OSError as error:
            raise OutputError(f"{folder}: cannot be cleared ({error.strerror or error})") from error


@dataclass(frozen=True)
class _Shown:
    """One section in the words of the page.

    Attributes
    ----------
    section, summary, tables : as in every report
    order : names of the runs, the best first
    bars : run -> length of the bar of its figure, percent
    verdict : who is best and by how much, or None where there is nothing to compare
    pairs : run -> run -> comparison in the main region; of the row's run with the column's
    matrices : every measure in every region by scene, the headline first
    plots : caption -> data URI
    """

    section: Section
    summary: Table
    tables: list[Table]
    order: list[str]
    bars: dict[str, float]
    verdict: dict[str, Any] | None
    pairs: dict[str, dict[str, Comparison]]
    matrices: list[tuple[str, str, Matrix]]
    plots: dict[str, str]

    @property
    def numbers(self) -> list[int]:
        """Places of ``order`` among the section's runs."""
        return [self.section.runs.index(run) for run in self.order]

    @classmethod
    def of(cls, section: Section) -> _Shown:
        """All that is told of a section."""
        headline, runs = section.protocol.headline, section.runs
        figures = [math.nan if (s := section.figure(run)) is None else s.value for run in runs]
        best = best_of(figures, headline.larger_is_better)
        order = [runs[i] for i in (*best, *(i for i in range(len(runs)) if i not in best))]
        longest = max((v for v in figures if not math.isnan(v)), default=0.0) or 1.0
        signed = {run: section.signed(run) for run in runs}
        pairs = {a: {b: compare(signed[b], signed[a]) for b in runs if b != a} for a in runs}
        keys = dict.fromkeys((s.measure, s.mask) for r in section.results for s in r.scores)
        first = [(headline, mask) for mask in section.masks]
        most = max(1, _MOST_TABLES // max(1, len(section.scenes) * len(runs)))
        chosen = [*first, *(key for key in keys if key not in first)][: max(most, len(first))]
        images = {
            caption: f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode('ascii')}"
            for caption, svg in plots(section).items()
        }
        return cls(
            section, tables.summary(section), _few(section.protocol.tables(section)[1:]), order,
            {run: 0.0 if math.isnan(v) else 100 * v / longest for run, v in zip(runs, figures, strict=True)},
            _verdict(section, [runs[i] for i in best], signed), pairs,
            [(measure.heading, mask, by_scene(section, measure, mask)) for measure, mask in chosen], images,
        )  # fmt: skip


def _few(found: list[Table]) -> list[Table]:
    """The tables, where they are not too many to be read."""
    return found if sum(len(table.rows) * len(table.header) for table in found) <= _MOST_TABLES else []


def _verdict(section: Section, order: list[str], signed: Mapping[str, list[float]]) -> dict[str, Any] | None:
    """The best run against the second: by how much, on how many scenes, where most and where not."""
    if len(order) < 2:
        return None
    best, second = order[:2]
    figures = [section.figure(run) for run in (best, second)]
    assert figures[0] is not None and figures[1] is not None
    gains = [
        (b - a, abs(a), abs(b), scene)
        for a, b, scene in zip(signed[best], signed[second], section.scenes, strict=True)
        if not math.isnan(a + b)
    ]
    ordered = sorted(gains, reverse=True)
    return {
        "best": best, "second": second, "values": [number(f.value) for f in figures if f is not None],
        "gap": number(abs(figures[0].value - figures[1].value)), "compared": compare(signed[second], signed[best]),
        "most": [g for g in ordered[:2] if g[0] > 0],
        "lost": [g for g in ordered[::-1][:2] if g[0] < 0],
    }  # fmt: skip


def _thumbs(report: EvaluationReport, entry: _Entry) -> dict[str, Any]:
    """A scene without script: small pictures, each run's figures in every region."""
    runs = []
    headline = entry.protocol.headline
    for r in report.results:
        if r.scene == entry.name and r.protocol == entry.protocol.name:
            figures = {s.mask: number(s.value) for s in r.scores if s.measure == headline}
            curves = [(c.mask, c.confidence, c.of, number(c.line.auc, 4)) for c in r.curves]
            runs.append({"result": r, "figures": figures, "curves": curves, "thumbs": entry.thumbs.get(r.run, {})})
    return {"name": entry.name, "protocol": entry.protocol, "thumbs": entry.thumbs.get("", {}), "runs": runs}


def _other_tables(report: EvaluationReport) -> list[Table]:
    found = tables.confidence(report)
    if report.failed:
        rows = tuple((r.run, r.scene, r.error) for r in report.failed)
        found.append(Table("Not evaluated", ("run", "scene", "reason"), rows))
    return found


def _swatches(verdicts: tuple[str, str]) -> list[tuple[str, str, str]]:
    """(words, color of a small error, color of a large one) of every kind of pixel."""
    scales = colors.error_scales()
    ends = [[f"rgb({','.join(map(str, scales[kind, k].tolist()))})" for k in (0, -1)] for kind in range(len(scales))]
    return [(words, first, last) for words, (first, last) in zip(colors.words(*verdicts), ends, strict=True)]


def _template() -> Any:
    try:
        import jinja2
    except ImportError as error:  # pragma: no cover
        raise ConfigError(f"--html wants Jinja2 ({error})") from error
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     undefined=jinja2.StrictUndefined)  # fmt: skip
    environment.filters["short"] = tables.short
    environment.filters["number"] = number
    return environment.from_string(_file("page.html"))


def _file(name: str) -> str:
    return (resources.files("depthcli.report") / name).read_text("utf-8")


def _script_json(text: str) -> str:
    r"""JSON that cannot end its script element: ``<`` stands in strings alone and is written ``\u003c`` there."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
