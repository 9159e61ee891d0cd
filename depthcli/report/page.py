"""``report.html``: an evaluation to look at; one file that opens from disk and loads nothing from a network."""

from __future__ import annotations

import base64
import contextlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.core.text import without_secrets
from depthcli.evaluation import tables
from depthcli.evaluation.columns import heading_help
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.plots import plots
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.render import Number
from depthcli.evaluation.scores import MapResult
from depthcli.evaluation.tables import wide_by_scene
from depthcli.io.formats.files import write_text
from depthcli.io.scenes import Scene
from depthcli.report import colors
from depthcli.report.run_without_truth import RunTable, RunWithoutTruth
from depthcli.report.scene_view import SceneView, smaller, view_with_truth
from depthcli.run.flags import Flags

ASSETS = "assets"
"""Folder beside the page, of the pictures that do not fit into it."""

BUDGET = 50_000_000
"""Default size of the scenes' pictures in the page itself, bytes: browsers open such a file within seconds."""

_MAX_CONFIG = 100_000  # characters of a config that are shown
_MAX_CELLS = 40_000  # of the tables of one section; more make the page slow


@dataclass(frozen=True)
class _SavedScene:
    """A scene whose pictures lie in the assets folder: its view without the maps, their file, its size in bytes."""

    view: SceneView
    file: Path
    size: int

    @property
    def key(self) -> str:
        """Name of the scene's pictures in the assets folder."""
        return self.file.stem


class Page:
    """``report.html``: a ``Viewer`` of the scenes of an evaluation, and of those of a run that have no truth.

    The pictures of every scene are written to the folder ``assets`` when it is complete, so that few are in memory at a
    time, and embedded at the end; the folder stays where the page would become larger than ``budget``.

    Parameters
    ----------
    command : the command line, shown on the page
    budget : size of all scenes' pictures in the page itself, bytes; of more, every second, third ... pixel is taken
    run : scenes without truth that the page shows, too
    """

    file = "report.html"

    def __init__(self, command: str = "", budget: int = BUDGET, run: RunWithoutTruth | None = None) -> None:
        self.command, self.budget, self.run = command, budget, run
        self._saved: list[_SavedScene] = []
        self._scene: SceneView | None = None

    def begin(self, folder: Path) -> None:
        """Begin a page in ``folder``."""
        self.folder = folder

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        """Begin a scene, to which the maps that follow belong."""
        self._save()
        self._scene = view_with_truth(protocol, scene, truth)

    def add_map(self, result: MapResult, path: Path, estimate: Any, truth: Any, confidences: Mapping[str, Any]) -> None:
        """Add one run's map to the scene; the whole map, if its truth is known at few points."""
        if self._scene is None:
            return
        shown, dense = self._scene.protocol, None
        if shown.presentation.at_points(truth):
            with contextlib.suppress(InputError):  # the scores count, the whole map is an extra
                dense = shown.presentation.show(path, self._scene.scene, shown.files)
        self._scene.add(result.run, path, estimate, truth, confidences, dense)

    def write(
        self, report: EvaluationReport | None, scores: str, configs: Mapping[str, str], flags: Flags | None = None
    ) -> None:
        """Write ``report.html``.

        Parameters
        ----------
        report : the evaluation; None if no scene has a ground truth
        scores : all of it as JSON
        configs : run -> its resolved config, or empty
        flags : the flagged scenes, which are shown first; None: those of the report

        Raises
        ------
        ConfigError
            Jinja2 or matplotlib is not installed.
        OutputError
            The page cannot be written.
        """
        self._save()
        flags = flags or (report.flags if report else Flags())
        rank = {each.scene: k for k, each in reversed([*enumerate(flags.flagged)])}
        self._saved.sort(key=lambda saved: rank.get(saved.view.name, len(rank)))
        scored, without = list(self._saved), self._add_run()
        factor = max(1, math.ceil(math.sqrt(sum(saved.size for saved in self._saved) / self.budget)))
        page = {
            "runs": [self.run.name] if report is None and self.run is not None else report.runs if report else [],
            "assets": [f"{ASSETS}/{saved.file.name}" if factor > 1 else None for saved in self._saved],
            "keys": [saved.key for saved in self._saved],
            "scale": colors.map_colors().tolist(),
            "errors": colors.error_scales().tolist(),
            "none": colors.NO_VALUE,
        }
        kinds = dict.fromkeys(saved.view.protocol.presentation.pixel_kind_names for saved in scored)
        text = _template().render(
            style=_file("page.css"), scripts=[_file("page.js"), _file("viewer.js")],
            report=report, command=without_secrets(self.command),
            configs={run: text[:_MAX_CONFIG] for run, text in configs.items()}, factor=factor, assets=ASSETS,
            sections=[_section_data(section) for section in report.sections] if report else [],
            overview=tables.overview(report) if report else [], others=tables.further_tables(report) if report else [],
            scenes=[_scene_data(report, saved.view) for saved in scored] if report else [], without=without,
            data=[_embedded(saved, factor) for saved in self._saved],
            page=_script_json(json.dumps(page)), scores=_script_json(scores), kinds=[*map(_swatches, kinds)],
            flags=flags,
            number_of={saved.view.name: i for i, saved in enumerate(self._saved)},
        )  # fmt: skip
        write_text(self.folder / self.file, text)
        self._remove_assets(keep=len(self._saved) if factor > 1 else 0)

    def _add_run(self) -> RunTable | None:
        """Add the scenes without truth, the worst first; return their table."""
        if self.run is None:
            return None
        n_scored = len(self._saved)
        for view in self.run.views():
            self._scene = view
            self._save()
        table = self.run.table()
        order = {view.name: number for number, view in enumerate(table.views)}
        self._saved[n_scored:] = sorted(self._saved[n_scored:], key=lambda saved: order[saved.view.name])
        return table

    def _save(self) -> None:
        if self._scene is None:
            return
        view, number = self._scene, len(self._saved)
        view.close()
        file = self.folder / ASSETS / f"scene-{number}.js"
        text = f'depthcli("{file.stem}", {_script_json(json.dumps(view.data))});\n'
        write_text(file, text)
        view.data = {}
        self._saved.append(_SavedScene(view, file, len(text)))
        self._scene = None

    def _remove_assets(self, keep: int) -> None:
        """Remove the scenes from number ``keep`` on, and the folder where nothing is left in it."""
        folder = self.folder / ASSETS
        try:
            for file in folder.glob("scene-*.js"):
                if not file.stem[6:].isdecimal() or int(file.stem[6:]) >= keep:
                    file.unlink(missing_ok=True)
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
        except OSError as error:
            raise OutputError(f"{folder}: cannot be cleared ({error.strerror or error})") from error


def _embedded(saved: _SavedScene, factor: int) -> str:
    text = saved.file.read_text("utf-8")
    data = text[text.index("{") : text.rindex("}") + 1]
    return data if factor == 1 else _script_json(json.dumps(smaller(json.loads(data), factor)))


def _section_data(section: Section) -> dict[str, Any]:
    """What the template shows of a section: runs from the best to the worst, tables, plots, comparisons."""
    headline, runs, order = section.protocol.headline, section.runs, section.ranking.runs
    figures = {run: section.overall(run).value for run in runs}
    known = [run for run in order if not math.isnan(figures[run])]
    longest = max((figures[run] for run in known), default=0.0) or 1.0
    by_scene = {run: section.by_scene(run) for run in runs}
    keys = dict.fromkeys([*((headline, region) for region in section.regions), *section.keys])
    n_keys = max(1, _MAX_CELLS // max(1, len(section.scenes) * len(runs)), len(section.regions))
    narrow = tables.section_tables(section)
    n_cells = sum(len(table.rows) * len(table.header) for table in narrow[1:])
    return {
        "section": section,
        "summary": narrow[0],
        "tables": narrow[1:] if n_cells <= _MAX_CELLS else [],
        "order": order,
        "rows": [runs.index(run) for run in order],
        "bars": {run: 100 * figures[run] / longest if run in known else 0.0 for run in runs},
        "verdict": _verdict(section, known),
        "wins": {a: {b: _n_better(by_scene[a], by_scene[b]) for b in runs} for a in runs},
        "wide": [(*key, wide_by_scene(section, key)) for key in list(keys)[:n_keys]],
        "plots": {
            caption: f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode('ascii')}"
            for caption, svg in plots(section).items()
        },
    }


def _n_better(a: Sequence[float], b: Sequence[float]) -> int:
    """Number of scenes on which ``a`` is lower."""
    return sum(x < y for x, y in zip(a, b, strict=True))


def _verdict(section: Section, best: list[str]) -> dict[str, Any] | None:
    """The best run against the second: by how much, on how many scenes, where it gains and loses most."""
    if len(best) < 2:
        return None
    first, second = (section.overall(run).value for run in best[:2])
    gains = sorted(
        (
            (b - a, abs(a), abs(b), scene)
            for a, b, scene in zip(section.by_scene(best[0]), section.by_scene(best[1]), section.scenes, strict=True)
            if not math.isnan(a + b)
        ),
        reverse=True,
    )
    return {
        "best": best[0], "second": best[1], "values": [Number(first), Number(second)],
        "gap": Number(abs(first - second)), "compared": section.ranking.tests[best[1]],
        "tested": section.ranking.verdict(),
        "gains": [g for g in gains[:2] if g[0] > 0], "losses": [g for g in gains[::-1][:2] if g[0] < 0],
    }  # fmt: skip


def _scene_data(report: EvaluationReport, view: SceneView) -> dict[str, Any]:
    """What the template shows of a scene: small pictures, and each run's headline in every region."""
    runs = []
    for r in report.results:
        if r.scene == view.name and r.protocol == view.protocol.name:
            figures = {s.region: Number(s.value) for s in r.scores if s.metric == view.protocol.headline}
            curves = [(c.region, c.confidence, c.of, Number(c.line.auc, 4)) for c in r.curves]
            runs.append({"result": r, "figures": figures, "curves": curves, "thumbs": view.thumbs.get(r.run, {})})
    return {"name": view.name, "protocol": view.protocol, "thumbs": view.thumbs.get("", {}), "runs": runs}


def _swatches(names: tuple[str, ...]) -> list[tuple[str, str, str]]:
    """(words, color of a small error, color of a large one) of every kind of pixel."""
    ends = [[f"rgb({','.join(map(str, scale[k].tolist()))})" for k in (0, -1)] for scale in colors.error_scales()]
    return [(words, first, last) for words, (first, last) in zip(names, ends, strict=True)]


def _template() -> Any:
    try:
        import jinja2
    except ImportError as error:  # pragma: no cover
        raise ConfigError(f"--html wants Jinja2 ({error})") from error
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.globals["help"] = heading_help
    environment.filters["short"] = tables.short
    environment.filters["number"] = Number
    return environment.from_string(_file("page.html"))


def _file(name: str) -> str:
    return (resources.files("depthcli.report") / name).read_text("utf-8")


def _script_json(text: str) -> str:
    r"""JSON that cannot end its script element: ``<`` stands in strings alone and is written ``\u003c`` there."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
