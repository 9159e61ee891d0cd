"""``report.html``: one page of an evaluation, which opens from disk and loads nothing from a network."""

from __future__ import annotations

import base64
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from depthcli.core.text import printable, without_secrets
from depthcli.evaluation.bounds import COVERAGE
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.evaluate import ScoredMap, Viewer
from depthcli.evaluation.protocols import AnyProtocol
from depthcli.evaluation.scores import difference
from depthcli.io.formats.files import short_path, write_text
from depthcli.io.scenes import Scene
from depthcli.report import tables
from depthcli.report.packing import script_json
from depthcli.report.plots import plots
from depthcli.report.scene_view import SceneView, view_with_truth
from depthcli.report.terms import heading_help
from depthcli.report.without_truth import RunWithoutTruth, scenes_without_truth
from depthcli.show.table import Number, to_csv
from depthcli.show.view import MEASURED_CODE, NO_VALUE, error_scales, map_colors

_ASSETS = "assets"  # folder of the pictures that do not fit into the page
_BUDGET = 50_000_000  # size of the scenes' pictures in the page, bytes: browsers open such a file within seconds
_MAX_CONFIG = 100_000  # characters of a config that are shown
_MAX_CELLS = 40_000  # of the tables of one section; more make the page slow


class Page(Viewer):
    """``report.html`` with the scenes of an evaluation, and the scenes of a run without ground truth.

    The pictures of every scene are written to the folder ``assets`` when it is complete, so that few are in memory at a
    time, and embedded at the end. If the page would exceed ``budget``, the folder stays.

    Parameters
    ----------
    command : the command line, shown on the page
    budget : largest size of all scenes' pictures in the page, bytes; if they exceed it, every second, third ... pixel
        is taken
    """

    file = "report.html"

    def __init__(self, command: str = "", budget: int = _BUDGET, run: RunWithoutTruth | None = None) -> None:
        self.command, self.budget, self.run = command, budget, run
        self._views: list[SceneView] = []  # of complete scenes
        self._scene: SceneView | None = None

    def begin_scene(self, protocol: AnyProtocol, scene: Scene, truth: Any) -> None:
        self._save(self._scene)
        self._scene = view_with_truth(protocol, scene, truth)

    def add_map(self, scored: ScoredMap) -> None:
        if self._scene is not None:
            self._scene.add(scored, self.folder)

    def _save(self, view: SceneView | None) -> None:
        self._scene = None
        if view is not None:
            view.close(self.folder / _ASSETS / f"scene-{len(self._views)}.js")
            self._views.append(view)

    def write(self, report: EvaluationReport, scores: str, configs: Mapping[str, str]) -> None:
        """Write the page, flagged scenes first; ``report`` has no results if no scene has a ground truth."""
        self._save(self._scene)
        rank = {flag.scene: k for k, flag in reversed([*enumerate(report.flags.flagged)])}
        scored = sorted(self._views, key=lambda view: rank.get(view.name, len(rank)))
        without = scenes_without_truth(self.run, self._save) if self.run else None
        views = [*scored, *(without.views if without else ())]
        factor = max(1, math.ceil(math.sqrt(sum(view.packed.size for view in views) / self.budget)))
        for_script = {
            "runs": report.runs,
            "assets": [f"{_ASSETS}/{view.packed.file.name}" if factor > 1 else None for view in views],
            "keys": [view.packed.file.stem for view in views],
            "scale": map_colors().tolist(),
            "errors": error_scales().tolist(),
            "none": NO_VALUE,
            "measured": MEASURED_CODE,
        }
        shown = [_scene_data(report, view) for view in scored]
        text = _template().render(
            style=_file("page.css"), scripts=[_file("page.js"), _file("viewer.js")], gradient=_gradient(),
            no_value=NO_VALUE, report=report, command=without_secrets(self.command), flags=report.flags, factor=factor,
            assets=_ASSETS, measured_code=MEASURED_CODE if any(view.codes for view in views) else "",
            configs={run: text[:_MAX_CONFIG] for run, text in configs.items()},
            sections=[_section_data(section, self.folder) for section in report.sections],
            overview=tables.overview(report), others=tables.further_tables(report),
            kinds=_pixel_kinds(scored), scenes=shown, most=_differing(report, shown),
            without=without, number_of={view.name: number for number, view in enumerate(views)},
            data=[view.packed.embedded(factor) for view in views],
            page=script_json(json.dumps(for_script)), scores=script_json(scores),
        )  # fmt: skip
        write_text(self.folder / self.file, text)
        if factor == 1:
            shutil.rmtree(self.folder / _ASSETS, ignore_errors=True)


def _gradient() -> str:
    """Return the colors of the maps' scale as stops of a CSS gradient."""
    return ", ".join(f"rgb({','.join(map(str, color))})" for color in map_colors()[::15].tolist())


def _differing(report: EvaluationReport, shown: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the scene of the first section whose maps differ most; None: it has no scene with pictures."""
    name = report.sections[0].protocol.name if report.sections else ""
    several = len(report.runs) > 1
    fitting = [scene for scene in shown if scene["protocol"].name == name]

    def differs(scene: dict[str, Any]) -> float:
        return difference([run["result"] for run in scene["runs"]], scene["protocol"].headline, several)

    return max(fitting, key=differs, default=None)


def _pixel_kinds(views: Sequence[SceneView]) -> list[list[tuple[str, ...]]]:
    """Return the words for every kind of pixel, with the CSS colors of a small and of a large error."""
    ends = [[f"rgb({','.join(map(str, scale[k].tolist()))})" for k in (0, -1)] for scale in error_scales()]
    wordings = dict.fromkeys(view.protocol.presentation.pixel_kind_names for view in views)
    return [[(words, *end) for words, end in zip(kinds, ends, strict=True)] for kinds in wordings]


def _section_data(section: Section, folder: Path) -> dict[str, Any]:
    """Return the data of a section for the template: runs from the best to the worst, tables, plots.

    The plots, and the numbers of their curves, are also written into the folder.
    """
    drawn = plots(section)
    for plot in drawn.values():
        name = short_path(f"curves/all_scenes/{section.data_set}_{section.protocol.name}_{plot.name}")
        write_text(folder / f"{name}.svg", plot.svg)
        if plot.rows:
            write_text(folder / f"{name}.csv", to_csv(plot.rows))
    headline, runs, order = section.protocol.headline, section.runs, section.ranking.runs
    figures = {run: section.overall(run).value for run in runs}
    known = [run for run in order if not math.isnan(figures[run])]
    keys = dict.fromkeys([*((headline, region) for region in section.regions), *section.keys])
    n_keys = max(1, _MAX_CELLS // max(1, len(section.scenes) * len(runs)), len(section.regions))
    narrow = [table for table in tables.section_tables(section) if table.name != "bounds"]
    n_cells = sum(len(table.rows) * len(table.header) for table in narrow[1:])
    return {
        "section": section,
        "summary": narrow[0],
        "bounds": tables.bound_tables(section)[:1],
        "tables": narrow[1:] if n_cells <= _MAX_CELLS else [],
        "order": order,
        "known": known,
        "rows": [runs.index(run) for run in order],
        "bars": _bars(figures),
        "wide": [(*key, tables.wide_by_scene(section, key)) for key in list(keys)[:n_keys]],
        "plots": {
            caption: f"data:image/svg+xml;base64,{base64.b64encode(plot.svg.encode()).decode('ascii')}"
            for caption, plot in drawn.items()
        },
    }


def _bars(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the lengths of the bars of a headline, percent of the longest; 0: unknown, or a negative correlation."""
    lengths = {run: max(figure, 0.0) if not math.isnan(figure) else 0.0 for run, figure in figures.items()}
    longest = max(lengths.values(), default=0.0) or 1.0
    return {run: 100 * length / longest for run, length in lengths.items()}


def _scene_data(report: EvaluationReport, view: SceneView) -> dict[str, Any]:
    """Return the data of a scene for the template: small pictures, and each run's headline in every region."""
    runs = []
    for r in report.results:
        if r.scene == view.name and r.protocol == view.protocol.name:
            figures = {s.region: Number(s.value) for s in r.scores if s.metric == view.protocol.headline}
            inside = {
                s.region: Number(s.value, 1) for s in r.bounds if s.metric.name == COVERAGE and s.region in figures
            }
            thumbs = view.thumbs.get(r.run, {})
            runs.append({"result": r, "figures": figures, "inside": inside, "thumbs": thumbs})
    return {"name": view.name, "protocol": view.protocol, "view": view, "thumbs": view.thumbs.get("", {}), "runs": runs}


def _template() -> Any:
    import jinja2  # takes a tenth of a second to import

    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "undefined": jinja2.StrictUndefined}
    options["finalize"] = lambda value: printable(value) if type(value) is str else value  # names, but no markup
    environment = jinja2.Environment(autoescape=True, **options)
    environment.globals["help"] = heading_help
    environment.filters["number"] = Number
    return environment.from_string(_file("page.html"))


def _file(name: str) -> str:
    return (resources.files("depthcli.report") / name).read_text("utf-8")
