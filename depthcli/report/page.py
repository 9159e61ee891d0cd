"""``report.html``: an evaluation to look at; one file that opens from disk and loads nothing from a network."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from depthcli.core.errors import InputError
from depthcli.core.text import without_secrets
from depthcli.evaluation import tables
from depthcli.evaluation.columns import heading_help
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.plots import plots
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.render import Number
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.files import collected_warnings, write_text
from depthcli.io.formats.pictures import Palette
from depthcli.io.scenes import Scene
from depthcli.report import packing
from depthcli.report.scene_view import SceneView, scale_of, smaller, view_with_truth
from depthcli.run.console import Column
from depthcli.run.flags import Flags
from depthcli.run.json_csv import Row

_ASSETS = "assets"  # folder beside the page, of the pictures that do not fit into it
_BUDGET = 50_000_000  # size of the scenes' pictures in the page, bytes: browsers open such a file within seconds
_MAX_CONFIG = 100_000  # characters of a config that are shown
_MAX_CELLS = 40_000  # of the tables of one section; more make the page slow
_MAX_SHOWN = 300  # scenes without truth with pictures; more would make the page slow
_DOUBTS = {"inside_mean": 1, "mean_error": 1, "measured": -1, "density": -1}
"""Columns of reports by which the scenes with pictures are chosen where there are too many; 1: larger is worse."""


class RunWithoutTruth(NamedTuple):
    """Scenes of a run without truth, which the page shows with what the run says of them."""

    name: str
    folder: Path
    protocol: AnyProtocol  # says where maps lie and how they are shown; it scores nothing here
    palette: Palette | None  # colors and words of the status maps; None: the protocol's
    scenes: Sequence[Scene]
    rows: Mapping[str, Row]  # scene -> its row of the run's report
    columns: Sequence[Column]  # further columns of the table, made from the rows


class _SavedScene(NamedTuple):
    """A scene whose pictures lie in the assets folder: its view without the maps, their file, its size in bytes."""

    view: SceneView
    file: Path
    size: int


class Page:
    """``report.html``: a ``Viewer`` of the scenes of an evaluation, and of those of a run that have no truth.

    The pictures of every scene are written to the folder ``assets`` when it is complete, so that few are in memory at a
    time, and embedded at the end; the folder stays where the page would become larger than ``budget``.

    Parameters
    ----------
    command : the command line, shown on the page
    budget : size of all scenes' pictures in the page itself, bytes; of more, every second, third ... pixel is taken
    """

    file = "report.html"

    def __init__(self, command: str = "", budget: int = _BUDGET, run: RunWithoutTruth | None = None) -> None:
        self.command, self.budget, self.run = command, budget, run
        self._saved: list[_SavedScene] = []
        self._scene: SceneView | None = None

    def begin(self, folder: Path) -> None:
        """Begin a page in ``folder``."""
        self.folder = folder

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        """Begin a scene, to which the maps that follow belong."""
        self._save(self._scene)
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
        """
        self._save(self._scene)
        flags = flags or (report.flags if report else Flags())
        rank = {each.scene: k for k, each in reversed([*enumerate(flags.flagged)])}
        self._saved.sort(key=lambda saved: rank.get(saved.view.name, len(rank)))
        scored, without = list(self._saved), self._add_run()
        factor = max(1, math.ceil(math.sqrt(sum(saved.size for saved in self._saved) / self.budget)))
        page = {
            "runs": report.runs if report else [self.run.name] if self.run else [],
            "assets": [f"{_ASSETS}/{saved.file.name}" if factor > 1 else None for saved in self._saved],
            "keys": [saved.file.stem for saved in self._saved],
            "scale": packing.map_colors().tolist(),
            "errors": packing.error_scales().tolist(),
            "none": packing.NO_VALUE,
        }
        # Words for every kind of pixel, and the colors of a small and of a large error.
        ends = [[f"rgb({','.join(map(str, scale[k].tolist()))})" for k in (0, -1)] for scale in packing.error_scales()]
        names = dict.fromkeys(saved.view.protocol.presentation.pixel_kind_names for saved in scored)
        kinds = [[(words, *end) for words, end in zip(each, ends, strict=True)] for each in names]
        text = _template().render(
            style=_file("page.css"), scripts=[_file("page.js"), _file("viewer.js")],
            report=report, command=without_secrets(self.command),
            configs={run: text[:_MAX_CONFIG] for run, text in configs.items()}, factor=factor, assets=_ASSETS,
            sections=[_section_data(section) for section in report.sections] if report else [],
            overview=tables.overview(report) if report else [], others=tables.further_tables(report) if report else [],
            scenes=[_scene_data(report, saved.view) for saved in scored] if report else [], without=without,
            data=[_embedded(saved, factor) for saved in self._saved],
            page=_script_json(json.dumps(page)), scores=_script_json(scores), kinds=kinds,
            flags=flags,
            number_of={saved.view.name: i for i, saved in enumerate(self._saved)},
        )  # fmt: skip
        write_text(self.folder / self.file, text)
        if factor == 1:
            shutil.rmtree(self.folder / _ASSETS, ignore_errors=True)

    def _add_run(self) -> dict[str, Any] | None:
        """Add the scenes without truth, the worst first; return what the template shows of them.

        Failed scenes come first, then those with pictures by the figures of their maps, then the others. ``by`` is the
        heading of the first figure; a failed scene has the reason in its second cell.
        """
        if self.run is None:
            return None
        run, n_scored, problems, views = self.run, len(self._saved), dict[str, str](), dict[str, SceneView]()
        row_of = {scene.name: run.rows.get(scene.name, {}) for scene in run.scenes}
        done = [scene for scene in run.scenes if row_of[scene.name].get("status") != "failed"]
        done.sort(key=lambda scene: _doubt(row_of[scene.name]))
        for scene in done[:_MAX_SHOWN]:
            try:
                views[scene.name] = _view(run, scene)
            except InputError as error:
                problems[scene.name] = str(error)
            else:
                self._save(views[scene.name])
        failed = [name for name, row in row_of.items() if row.get("status") == "failed" or name in problems]
        worst = {
            name: [math.inf if math.isnan(v) else -v for v in view.figures.values()] for name, view in views.items()
        }
        names = [*sorted(failed), *sorted(views, key=lambda name: (worst[name], name))]
        self._saved[n_scored:] = sorted(self._saved[n_scored:], key=lambda saved: names.index(saved.view.name))
        names += [scene.name for scene in done[_MAX_SHOWN:]]
        shown = {name: view.figures | view.mean_confidence for name, view in views.items()}
        keys = list(dict.fromkeys(key for figures in shown.values() for key in figures))
        rows = []
        for name in names:
            row, figures = row_of[name], shown.get(name, {})
            reason, seconds = (
                str(row.get("error") or problems.get(name, "")),
                math.fsum(row.get("seconds", {}).values()),
            )
            cells = [reason or str(row.get("status") or "done")]
            cells += [str(Number(figures[key])) if key in figures else "-" for key in keys]
            cells += [column.text(row) if row and not reason else "-" for column in run.columns]
            rows.append((name, [*cells, f"{seconds:.2f}" if seconds else "-"]))
        header = ["status", *keys, *(column.title for column in run.columns), "seconds"]
        filled = [k for k in range(len(header)) if any(cells[k] != "-" for _, cells in rows)]
        return {
            "run": run.name,
            "header": ["scene", *(header[k] for k in filled)],
            "rows": [(name, [cells[k] for k in filled]) for name, cells in rows],
            "note": "; ".join(dict.fromkeys(view.note for view in views.values() if view.note)),
            "by": keys[0] if keys else "",
            "n_failed": len(failed),
            "n_left_out": len(done[_MAX_SHOWN:]),
            "views": [saved.view for saved in self._saved[n_scored:]],
        }

    def _save(self, view: SceneView | None) -> None:
        """Write the pictures of a complete scene, so that they are in memory no longer."""
        self._scene = None
        if view is None:
            return
        view.close()
        file = self.folder / _ASSETS / f"scene-{len(self._saved)}.js"
        text = f'depthcli("{file.stem}", {_script_json(json.dumps(view.data))});\n'
        write_text(file, text)
        view.data = {}
        self._saved.append(_SavedScene(view, file, len(text)))


def _embedded(saved: _SavedScene, factor: int) -> str:
    text = saved.file.read_text("utf-8")
    data = text[text.index("{") : text.rindex("}") + 1]
    return data if factor == 1 else _script_json(json.dumps(smaller(json.loads(data), factor)))


def _section_data(section: Section) -> dict[str, Any]:
    """Return what the template shows of a section: runs from the best to the worst, tables, plots."""
    headline, runs, order = section.protocol.headline, section.runs, section.ranking.runs
    figures = {run: section.overall(run).value for run in runs}
    known = [run for run in order if not math.isnan(figures[run])]
    longest = max((figures[run] for run in known), default=0.0) or 1.0
    keys = dict.fromkeys([*((headline, region) for region in section.regions), *section.keys])
    n_keys = max(1, _MAX_CELLS // max(1, len(section.scenes) * len(runs)), len(section.regions))
    narrow = tables.section_tables(section)
    n_cells = sum(len(table.rows) * len(table.header) for table in narrow[1:])
    return {
        "section": section,
        "summary": narrow[0],
        "tables": narrow[1:] if n_cells <= _MAX_CELLS else [],
        "order": order,
        "known": known,
        "rows": [runs.index(run) for run in order],
        "bars": {run: 100 * figures[run] / longest if run in known else 0.0 for run in runs},
        "wide": [(*key, tables.wide_by_scene(section, key)) for key in list(keys)[:n_keys]],
        "plots": {
            caption: f"data:image/svg+xml;base64,{base64.b64encode(svg.encode()).decode('ascii')}"
            for caption, svg in plots(section).items()
        },
    }


def _scene_data(report: EvaluationReport, view: SceneView) -> dict[str, Any]:
    """Return what the template shows of a scene: small pictures, and each run's headline in every region."""
    runs = []
    for r in report.results:
        if r.scene == view.name and r.protocol == view.protocol.name:
            figures = {s.region: Number(s.value) for s in r.scores if s.metric == view.protocol.headline}
            curves = [(c.region, c.confidence, c.of, Number(c.line.auc, 4)) for c in r.curves]
            runs.append({"result": r, "figures": figures, "curves": curves, "thumbs": view.thumbs.get(r.run, {})})
    return {"name": view.name, "protocol": view.protocol, "thumbs": view.thumbs.get("", {}), "runs": runs}


def _view(run: RunWithoutTruth, scene: Scene) -> SceneView:
    """Return the view of a scene without truth; InputError where its map cannot be read."""
    protocol, presentation = run.protocol, run.protocol.presentation
    path = protocol.files.find(run.folder, [scene.name])
    if path is None:
        raise InputError(f"no map there{protocol.files.searched([scene.name])}")
    with collected_warnings():
        shown = presentation.show(path, scene, protocol.files)
        nothing, scale = np.zeros(shown.values.shape, np.bool_), presentation.scale or scale_of(shown.values)
        palette = presentation.palette if run.palette is None else run.palette
        view = SceneView(scene, protocol, nothing, nothing, None, shown.axes, scale, palette)
        view.add_shown(run.name, path, shown)
    return view


def _doubt(row: Row) -> tuple[float, ...]:
    """Return a key of a row of the report: the worse its scene is, the smaller."""
    values = ((row.get(key), sign) for key, sign in _DOUBTS.items())
    return tuple(-sign * value if isinstance(value, int | float) else math.inf for value, sign in values)


def _template() -> Any:
    import jinja2  # takes a tenth of a second to import

    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "undefined": jinja2.StrictUndefined}
    environment = jinja2.Environment(autoescape=True, **options)
    environment.globals["help"] = heading_help
    environment.filters["number"] = Number
    return environment.from_string(_file("page.html"))


def _file(name: str) -> str:
    return (resources.files("depthcli.report") / name).read_text("utf-8")


def _script_json(text: str) -> str:
    r"""Return JSON that cannot end its script element: ``<``, which strings alone have, is written ``\u003c``."""
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
