"""``depthcli evaluate``: compare the maps of one or more runs with the ground truth."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.batch.record import read_report
from depthcli.core.errors import DepthcliError, InputError
from depthcli.evaluation import metrics
from depthcli.evaluation.curves import Sparsification, sparsification
from depthcli.evaluation.metrics import Score
from depthcli.evaluation.pictures import LEGEND_TEXT, error_picture
from depthcli.evaluation.report import Line, Table, line_plot, number
from depthcli.evaluation.summary import average_ranks, compare
from depthcli.io.atomic import write_text
from depthcli.io.disparity import MAP_SUFFIXES, read_disparity
from depthcli.io.images import write_png
from depthcli.io.scenes import Metric, Scene, Truth, find_scenes

_CONFIDENCE_SUFFIXES = (".pfm", ".npy")
# The measure that stands for a scene: the headline of its benchmark (v2: bad 1.0; v3: bad 2.0 with
# invalid counted as wrong; KITTI: D1 on the interpolated map).
_HEADLINES: dict[Metric, tuple[str, float, str]] = {
    "v2": ("bad", 1.0, metrics.MISSING_IS_BAD),
    "v3": ("totbad", 2.0, metrics.MISSING_IS_BAD),
    "kitti": ("D1", 3.0, metrics.INTERPOLATED),
}
_FAMILY_NAMES: dict[Metric, str] = {
    "v2": "Middlebury v2: bad > 1.0 px, %; missing counts as bad",
    "v3": "Middlebury v3 / ETH3D",
    "kitti": "KITTI: D1, % (> 3 px and > 5 %)",
}


@dataclass(frozen=True)
class Result:
    """One map of one run against the truth of one scene, or the reason why there is no result.

    Attributes
    ----------
    run, scene, data_set, metric : where the numbers belong
    source : the map's path inside its run folder, or empty
    scores : empty where ``error`` is set
    curves : region -> confidence measure -> sparsification curve; the regions are the visible pixels, where
        they are known, and all pixels
    warning : a suspicion about the map's scale, or empty
    error : why there are no scores, or empty
    """

    run: str
    scene: str
    data_set: str
    metric: Metric
    source: str = ""
    scores: tuple[Score, ...] = ()
    curves: dict[str, dict[str, Sparsification]] = field(default_factory=dict)
    warning: str = ""
    error: str = ""

    def value(self, metric: str, mask: str, threshold: float | None = None, convention: str | None = None) -> float:
        """One number of this result; NaN where there is none."""
        for score in self.scores:
            fits = (score.metric, score.mask) == (metric, mask) and threshold in (None, score.threshold)
            if fits and convention in (None, score.convention):
                return score.value
        return float("nan")

    def density(self, mask: str) -> float:
        """Percent of the region's pixels that the map answers; NaN where there is none."""
        return next((score.density for score in self.scores if score.mask == mask), float("nan"))

    def headline(self, mask: str) -> float:
        """The benchmark's main figure in one region; NaN where there is none."""
        metric, threshold, convention = _HEADLINES[self.metric]
        return self.value(metric, mask, threshold, convention)


@dataclass(frozen=True)
class EvaluationReport:
    """All results, in the order of the scenes, then of the runs.

    Attributes
    ----------
    runs : names of the runs
    results : one for every scene and run
    truth, output : folders
    """

    runs: tuple[str, ...]
    results: tuple[Result, ...]
    truth: Path
    output: Path

    @property
    def failed(self) -> list[Result]:
        """Results that hold a reason instead of scores."""
        return [result for result in self.results if result.error]

    @property
    def warnings(self) -> list[str]:
        """Suspicions about scales, one line each."""
        return [f"{r.run}: {r.scene}: {r.warning}" for r in self.results if r.warning]

    def tables(self) -> list[Table]:
        """Every table of the report."""
        made: list[Table] = []
        sections = self._sections()
        for (data_set, metric), results in sections.items():
            if all(result.error for result in results):
                continue
            if metric == "v2":
                made += _v2_tables(data_set, self.runs, results)
            elif metric == "v3":
                made += _v3_tables(data_set, self.runs, results)
            else:
                made.append(_kitti_table(data_set, self.runs, results))
        if len(sections) > 1:
            made.append(_overview(self.runs, sections))
        made += _comparisons(self.runs, self.results)
        made += _confidence_tables(self.results)
        if self.failed:
            rows = tuple((r.run, r.scene, r.error) for r in self.failed)
            made.append(Table("Not evaluated", ("run", "scene", "reason"), rows))
        return made

    def text(self) -> str:
        """The tables and warnings for a terminal."""
        blocks = [table.text() for table in self.tables()]
        if self.warnings:
            blocks.append("".join(f"warning: {line}\n" for line in self.warnings))
        return "\n".join(blocks)

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values for JSON; None where there is no number."""
        return {
            "truth": str(self.truth),
            "runs": list(self.runs),
            "results": [_result_dict(result) for result in self.results],
            "means": [_plain(row) for row in self.means()],
            "mean_of_all_figures": [
                {"data_set": data_set, "metric": metric, "run": run, "value": _none(mean), "figures": count}
                for (data_set, metric), results in self._sections().items()
                for run in self.runs
                for mean, count in [_mean_of_figures([r for r in results if r.run == run])]
            ],
            "comparisons": [
                {"a": a, "b": b, **_plain(vars(comparison))} for a, b, comparison in _pairs(self.runs, self.results)
            ],
            "failed": [{"run": r.run, "scene": r.scene, "reason": r.error} for r in self.failed],
            "warnings": self.warnings,
        }

    def means(self) -> list[dict[str, Any]]:
        """The mean of every measure over the scenes of a data set, by run and mask.

        Each scene counts once. ``scenes`` says over how many; scenes without a map are left out.
        """
        rows = []
        for (data_set, metric), results in self._sections().items():
            for run in self.runs:
                values: dict[tuple[str, str, float | None, str, str], list[Score]] = {}
                for result in results:
                    for s in result.scores if result.run == run else ():
                        values.setdefault((s.metric, s.mask, s.threshold, s.convention, s.unit), []).append(s)
                for (name, mask, threshold, convention, unit), scores in values.items():
                    rows.append(
                        {
                            "run": run,
                            "data_set": data_set,
                            "family": metric,
                            "metric": name,
                            "threshold": threshold,
                            "mask": mask,
                            "value": _mean(s.value for s in scores),
                            "unit": unit,
                            "density": _mean(s.density for s in scores),
                            "convention": convention,
                            "scenes": len(scores),
                        }
                    )
        return rows

    def _sections(self) -> dict[tuple[str, Metric], list[Result]]:
        sections: dict[tuple[str, Metric], list[Result]] = {}
        for result in self.results:
            sections.setdefault((result.data_set, result.metric), []).append(result)
        return sections


def evaluate(
    runs: Sequence[Path | str],
    truth: Path | str,
    output: Path | str,
    scenes: str = "*",
    layout: str | None = None,
    scale: float | None = None,
    on_scene: Callable[[str, int, int], None] | None = None,
) -> EvaluationReport:
    """Evaluate runs side by side and write scores, pictures, curves and a report.

    A run is a folder that ``depthcli`` made (``<scene>/disp_left.pfm``) or a folder of maps by another
    program: ``<scene>.pfm|png|...``, ``<scene>/disp0METHOD.pfm``, ``disp_0/<frame>.png``,
    ``low_res_two_view/<scene>.pfm``. Confidence maps ``<scene>/confidence_<name>.pfm`` give curves.

    Written to ``output``: ``scores.csv``, ``scores.json``, ``report.md``,
    ``errors/<run>/<scene>.png``, ``curves/<run>/<scene>_<region>.svg``.

    Parameters
    ----------
    runs : folders of maps
    truth : folder of scenes with ground truth
    output : folder for the results
    scenes : shell pattern of scene names
    layout : layout of ``truth``; None recognizes it
    scale : codes per pixel of the maps; None: 256 for 16-bit PNG, the scene's own scale for 8-bit ones
    on_scene : called with (scene name, number, total) before each scene

    Raises
    ------
    InputError
        No run folder, no scenes with ground truth. A map that is missing or unreadable is no error:
        it becomes a result with its reason (``report.failed``).
    OutputError
        The results cannot be written.
    """
    if not runs:
        raise InputError("no run to evaluate")
    folders = [Path(run) for run in runs]
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder")
    truth, output = Path(truth), Path(output)
    names = _run_names(folders)
    chosen = [scene for scene in find_scenes(truth, layout, scenes) if scene.problem or scene.disparity_left]
    if not any(scene.disparity_left for scene in chosen):
        if chosen:
            raise InputError(chosen[0].problem)
        raise InputError(f"{truth}: no scene there has ground truth (looked for disp_left, disp0GT.pfm, disp2, ...)")
    short = [scene.name.rpartition("/")[2] for scene in chosen]
    results = []
    for i, scene in enumerate(chosen):
        if on_scene is not None:
            on_scene(scene.name, i + 1, len(chosen))
        keys = [scene.name, f"{truth.resolve().name}/{scene.name}"]
        if short.count(short[i]) == 1:
            keys.append(short[i])
        data_set = scene.name.rpartition("/")[0] or truth.resolve().name
        try:
            reference = scene.load_truth()
        except DepthcliError as error:
            results += [Result(name, scene.name, data_set, scene.metric, error=str(error)) for name in names]
            continue
        for name, folder in zip(names, folders, strict=True):
            results.append(_evaluate_map(folder, name, keys, data_set, scene, reference, scale, output))
    report = EvaluationReport(tuple(names), tuple(results), truth, output)
    write_text(output / "scores.csv", _scores_csv(report))
    write_text(output / "scores.json", json.dumps(report.to_dict(), indent=1, allow_nan=False) + "\n")
    write_text(output / "report.md", _markdown(report))
    return report


def _evaluate_map(
    folder: Path,
    run: str,
    keys: Sequence[str],
    data_set: str,
    scene: Scene,
    truth: Truth,
    scale: float | None,
    output: Path,
) -> Result:
    source = ""
    try:
        if np.isnan(truth.disparity).all():
            raise InputError(f"{scene.disparity_left}: the ground truth has no known pixel")
        path = _find_map(folder, keys)
        source = path.relative_to(folder).as_posix()
        own = scene.disparity_scale if scene.disparity_scale is not None and scene.disparity_scale < 256 else None
        estimate = read_disparity(path, scale, scale_8bit=own)
        try:
            sized = metrics.fit_size(estimate, (truth.disparity.shape[0], truth.disparity.shape[1]))
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
        if scene.metric != "v3" and sized is not estimate:
            have, want = (f"{a.shape[1]} x {a.shape[0]}" for a in (estimate, truth.disparity))
            raise InputError(f"{path}: the map is {have}, the truth {want}; only v3 and ETH3D maps may be smaller")
    except DepthcliError as error:
        return Result(run, scene.name, data_set, scene.metric, source, error=str(error))
    if scene.metric == "v2":
        scores = metrics.middlebury_v2(estimate, truth.disparity, truth.masks)
    elif scene.metric == "v3":
        scores = metrics.middlebury_v3(
            estimate, truth.disparity, truth.masks, scene.max_disparity, scene.round_disparity
        )
    else:
        scores = metrics.kitti(estimate, truth.disparity, truth.masks)
    wrong = metrics.wrong_pixels(sized, truth.disparity, scene.metric)
    known = ~np.isnan(truth.disparity)
    everything = known & truth.masks.get("all", known)
    visible = truth.masks.get("nonocc", truth.masks.get("noc"))
    write_png(output / "errors" / run / f"{scene.name}.png", error_picture(sized, wrong, everything, visible))
    regions = {m: truth.masks[m] & known & ~np.isnan(sized) for m in _curve_masks(truth.masks)}
    curves: dict[str, dict[str, Sparsification]] = {}
    problems = []
    for name, file in _confidence_files(path).items():
        try:
            confidence = read_disparity(file)
            if confidence.shape != sized.shape:
                raise InputError(f"{file}: the size differs from the truth's")
        except DepthcliError as error:
            problems.append(str(error))
            continue
        for mask, region in regions.items():
            if region.any():
                curves.setdefault(mask, {})[name] = sparsification(confidence[region], wrong[region])
    for mask, group in curves.items():
        title = f"{run}: {scene.name}, {mask}"
        write_text(output / "curves" / run / f"{scene.name}_{mask}.svg", _curve_svg(group, title))
    warning = "; ".join(filter(None, [metrics.scale_warning(sized, truth.disparity), *problems]))
    return Result(run, scene.name, data_set, scene.metric, source, tuple(scores), curves, warning)


def _find_map(folder: Path, keys: Sequence[str]) -> Path:
    """The map of a scene in a run folder, known by any of ``keys``."""
    for key in keys:
        inside = folder / key
        for suffix in MAP_SUFFIXES:
            if (inside / f"disp_left{suffix}").is_file():
                return inside / f"disp_left{suffix}"
        # Result files of the Middlebury v3 kit: disp0METHOD.pfm is dense, ..._s.pfm sparse.
        kit = sorted(path for path in inside.glob("disp0*.pfm") if not path.stem.endswith("GT"))
        dense = [path for path in kit if not path.stem.endswith("_s")] or kit
        named = [path for path in dense if path.stem == f"disp0{folder.resolve().name}"] or dense
        if len(named) > 1:
            raise InputError(f"{inside}: both {named[0].name} and {named[1].name}; keep one method in a folder")
        if named:
            return named[0]
        for base in (folder, folder / "disp_0", folder / "low_res_two_view"):
            for suffix in MAP_SUFFIXES:
                if (base / f"{key}{suffix}").is_file():
                    return base / f"{key}{suffix}"
    rows = read_report(folder)
    for row in (rows[key] for key in keys if key in rows):
        if row.get("error"):
            raise InputError(f"{folder}: no map of scene {keys[0]}: the run failed there: {row['error']}")
    raise InputError(
        f"{folder}: no map of scene {keys[0]} (looked for SCENE/disp_left.pfm, SCENE.pfm or .png, "
        "SCENE/disp0METHOD.pfm, disp_0/SCENE.png, low_res_two_view/SCENE.pfm)"
    )


def _confidence_files(path: Path) -> dict[str, Path]:
    if not path.stem.startswith("disp"):
        return {}
    files = sorted(p for p in path.parent.glob("confidence_*") if p.suffix.lower() in _CONFIDENCE_SUFFIXES)
    return {file.stem.removeprefix("confidence_"): file for file in files}


def _run_names(folders: Sequence[Path]) -> list[str]:
    """Folder names, with as many parents as it takes to tell them apart."""
    parts = [folder.resolve().parts for folder in folders]
    for depth in range(1, max(len(p) for p in parts) + 1):
        names = ["_".join(p[-depth:]).strip("/") or "run" for p in parts]
        if len(set(names)) == len(names):
            return names
    raise InputError("the same run folder is given twice")


def _main_mask(masks: Iterable[str]) -> str:
    """The region that stands for a scene where one number is wanted: visible pixels if they are known."""
    present = list(masks)
    return next(name for name in ("nonocc", "noc", "all", "occ", *present) if name in present)


def _curve_masks(masks: Iterable[str]) -> list[str]:
    """Regions of the confidence curves: the main one, and all pixels with known truth."""
    present = list(masks)
    return list(dict.fromkeys([_main_mask(present), next((n for n in ("all", "occ") if n in present), present[0])]))


def _figure_masks(results: Iterable[Result]) -> list[str]:
    """Masks of the results' scores, in their usual order."""
    seen = {score.mask: None for result in results for score in result.scores}
    usual = [name for name in ("nonocc", "all", "disc", "noc", "occ") if name in seen]
    return usual + [name for name in seen if name not in usual]


def _mean_of_figures(results: Sequence[Result]) -> tuple[float, int]:
    """Mean over scenes x masks of the headline figure, and how many figures that are."""
    figures = [r.headline(mask) for r in results if not r.error for mask in _figure_masks([r])]
    return _mean(figures), len(figures)


def _v2_tables(data_set: str, runs: Sequence[str], results: Sequence[Result]) -> list[Table]:
    scenes = list(dict.fromkeys(result.scene for result in results))
    masks = _figure_masks(results)
    thresholds = metrics.V2_THRESHOLDS
    cells = {(r.run, r.scene, m): r.headline(m) for r in results for m in masks}
    columns = [(s, m) for s in scenes for m in masks if any(cells[run, s, m] == cells[run, s, m] for run in runs)]
    grid = np.array([[cells[run, s, m] for s, m in columns] for run in runs], np.float64).reshape(len(runs), -1)
    rank = average_ranks(grid)
    summary = []
    for i, run in enumerate(runs):
        mine = [r for r in results if r.run == run]
        done = sum(not r.error for r in mine)
        mean, count = _mean_of_figures(mine)
        by_mask = [number(_mean(grid[i, [m == mask for _, m in columns]])) for mask in masks]
        density = number(_mean(r.density("all") for r in mine if not r.error), 1)
        summary.append((run, f"{done}/{len(scenes)}", *by_mask, number(mean), str(count), number(rank[i], 1), density))
    header = ("run", "scenes", *masks, "mean of all figures", "figures", "avg rank", "density all %")
    note = "mean of all figures: over scenes x masks; columns of masks: means over scenes"
    tables = [Table(f"{data_set} - {_FAMILY_NAMES['v2']}", header, tuple(summary), note)]
    at = [
        (
            run,
            *(number(_mean(r.value("bad", m, t) for r in results if r.run == run for m in masks)) for t in thresholds),
        )
        for run in runs
    ]
    heads = ("run", *(f"bad {t:g}" for t in thresholds))
    tables.append(Table(f"{data_set} - mean of all figures at other thresholds (px)", heads, tuple(at)))
    if len(scenes) <= 4:
        rows = [
            (
                run,
                *(" / ".join(number(cells[run, s, m]) for c, m in columns if c == s) for s in scenes),
                number(_mean(grid[i])),
                number(rank[i], 1),
            )
            for i, run in enumerate(runs)
        ]
        titles = [s.rpartition("/")[2] for s in scenes]
        heading = f"{data_set} - by scene: {' / '.join(masks)}"
        tables.append(Table(heading, ("run", *titles, "mean", "avg rank"), tuple(rows)))
    else:
        several = len(runs) > 1
        sides = [f"{run}: {m}" if several else m for run in runs for m in masks]
        rows = [(s.rpartition("/")[2], *(number(cells[run, s, m]) for run in runs for m in masks)) for s in scenes]
        rows.append(("mean", *(number(_mean(cells[run, s, m] for s in scenes)) for run in runs for m in masks)))
        tables.append(Table(f"{data_set} - by scene", ("scene", *sides), tuple(rows)))
    return tables


def _v3_tables(name: str, runs: Sequence[str], results: Sequence[Result]) -> list[Table]:
    columns: list[tuple[str, str, float | None]] = [(f"bad {t:g}", "bad", t) for t in metrics.V3_THRESHOLDS]
    columns += [("invalid", "invalid", None)]
    columns += [(f"totbad {t:g}", "totbad", t) for t in metrics.V3_THRESHOLDS]
    columns += [(m, m, None) for m in ("avgerr", "rms", *(f"A{q}" for q in metrics.QUANTILES))]
    tables = []
    for mask in _figure_masks(results):

        def cells(result: Result, mask: str = mask) -> list[float]:
            return [result.value(metric, mask, threshold) for _, metric, threshold in columns]

        rows = _rows_by_run(runs, results, cells)
        header = ("run", "scene", *(title for title, _, _ in columns))
        note = "bad, invalid, totbad: % of all pixels; avgerr, rms, A50 ... : px, valid pixels only"
        tables.append(Table(f"{name} - {_FAMILY_NAMES['v3']}, {mask}", header, rows, note))
    return tables


def _kitti_table(name: str, runs: Sequence[str], results: Sequence[Result]) -> Table:
    masks = _figure_masks(results)

    def cells(result: Result) -> list[float]:
        values = [result.value("D1", m, 3.0, metrics.INTERPOLATED) for m in masks]
        values += [result.value("out", m, 3.0, metrics.INTERPOLATED) for m in masks]
        for m in masks:
            values += [result.value("D1", m, 3.0, metrics.ESTIMATED_ONLY), result.density(m)]
            values += [result.value("avgerr", m, None, metrics.ESTIMATED_ONLY)]
        return values

    header = [f"D1 {m}" for m in masks] + [f"> 3 px {m}" for m in masks]
    for m in masks:
        header += [f"est D1 {m}", f"density {m} %", f"est avgerr {m} px"]
    note = "D1, > 3 px: %, background-interpolated maps; est: estimated pixels only"
    rows = _rows_by_run(runs, results, cells)
    return Table(f"{name} - {_FAMILY_NAMES['kitti']}", ("run", "scene", *header), rows, note)


def _rows_by_run(
    runs: Sequence[str], results: Sequence[Result], cells: Callable[[Result], list[float]]
) -> tuple[tuple[str, ...], ...]:
    """Rows of one run after the other, each followed by its mean over the scenes."""
    rows = []
    for run in runs:
        mine = [r for r in results if r.run == run]
        values = [cells(r) for r in mine]
        rows += [
            (run, r.scene.rpartition("/")[2], *(number(v) for v in line)) for r, line in zip(mine, values, strict=True)
        ]
        done = sum(not r.error for r in mine)
        if len(mine) > 1:
            means = (number(_mean(column)) for column in zip(*values, strict=True))
            rows.append((run, f"mean of {done}", *means))
    return tuple(rows)


def _overview(runs: Sequence[str], sections: dict[tuple[str, Metric], list[Result]]) -> Table:
    rows = []
    for run in runs:
        cells = [run]
        every: list[Result] = []
        for (_, metric), results in sections.items():
            mine = [r for r in results if r.run == run]
            cells.append(number(_mean_of_figures(mine)[0]))
            every += mine if metric == "v2" else []
        cells.append(number(_mean_of_figures(every)[0]))
        rows.append(tuple(cells))
    titles = [f"{data_set} ({metric})" for data_set, metric in sections]
    note = "v2: bad > 1.0; v3: totbad > 2.0; kitti: D1, interpolated; last column: all figures of the v2 scenes"
    return Table("Mean of all figures, by data set", ("run", *titles, "v2 scenes together"), tuple(rows), note)


def _pairs(runs: Sequence[str], results: Sequence[Result]) -> list[tuple[str, str, Any]]:
    """The first run against every other, on the headline figure of every scene's main mask."""
    by_run: dict[str, list[float]] = {run: [] for run in runs}
    for _, group in itertools.groupby(results, key=lambda r: r.scene):
        members = list(group)
        masks = _figure_masks(members)
        for r in members:
            by_run[r.run].append(r.headline(_main_mask(masks)) if masks else float("nan"))
    return [(runs[0], other, compare(by_run[runs[0]], by_run[other])) for other in runs[1:]]


def _comparisons(runs: Sequence[str], results: Sequence[Result]) -> list[Table]:
    pairs = _pairs(runs, results)
    if not pairs:
        return []
    rows = tuple(
        (
            f"{b} against {a}",
            *(str(n) for n in (c.scenes, c.wins, c.losses, c.ties)),
            number(c.mean_difference, 3),
            number(c.worst_ratio, 3),
            f"{c.p_value:.3g}",
        )
        for a, b, c in pairs
    )
    header = ("runs", "scenes", "wins", "losses", "ties", "mean difference", "worst ratio", "p (sign test)")
    note = "headline figure of every scene, visible pixels where they are known; a win is a lower error"
    return [Table("Paired comparison", header, rows, note)]


def _confidence_tables(results: Sequence[Result]) -> list[Table]:
    rows: list[tuple[str, ...]] = []
    groups: dict[tuple[str, str, str], list[Sparsification]] = {}
    for result in results:
        for mask, name, curve in _flat_curves(result):
            groups.setdefault((result.run, mask, name), []).append(curve)
            rows.append((result.run, result.scene, mask, name, *_area_cells([curve])))
    for (run, mask, name), curves in groups.items():
        if len(curves) > 1:
            rows.append((run, f"mean of {len(curves)}", mask, name, *_area_cells(curves)))
    if not rows:
        return []
    header = ("run", "scene", "mask", "confidence", "AUC", "optimal", "random", "AUC/optimal", "AUC/random")
    note = "sparsification, 5..100 % of the most confident estimated pixels; random = their error rate"
    return [Table("Confidence", header, tuple(rows), note)]


def _flat_curves(result: Result) -> list[tuple[str, str, Sparsification]]:
    return [(mask, name, curve) for mask, group in result.curves.items() for name, curve in group.items()]


def _area_cells(curves: Sequence[Sparsification]) -> tuple[str, ...]:
    auc, optimal, chance = (_mean(getattr(c, key) for c in curves) for key in ("auc", "optimal", "random"))
    ratios = (auc / optimal if optimal > 0 else float("nan"), auc / chance if chance > 0 else float("nan"))
    return (number(auc, 4), number(optimal, 4), number(chance, 4), *(number(ratio, 2) for ratio in ratios))


def _curve_svg(curves: dict[str, Sparsification], title: str) -> str:
    ordered = sorted(curves.items(), key=lambda item: item[1].auc)
    lines = [Line(f"{name} {c.auc:.4f}", c.percentages, c.rates) for name, c in ordered]
    some = next(iter(curves.values()))
    e = some.error_rate
    best = [max(0.0, 1 - (1 - e) * 100 / p) for p in some.percentages]
    lines.append(Line(f"optimal {some.optimal:.4f}", some.percentages, best, bound=True))
    lines.append(Line(f"random {e:.4f}", some.percentages, [e] * len(some.percentages), bound=True))
    return line_plot(lines, title, "most confident pixels, %", "error rate")


def _markdown(report: EvaluationReport) -> str:
    out = ["# Evaluation", "", f"Ground truth: `{report.truth}`. Runs: {', '.join(f'`{r}`' for r in report.runs)}.", ""]
    out += [f"**Warning:** {line}\n" for line in report.warnings]
    out += [table.markdown() for table in report.tables()]
    pictures = [r for r in report.results if not r.error]
    if pictures:
        out += ["## Error pictures", "", f"{LEGEND_TEXT}.", ""]
        for r in pictures:
            out += [f"{r.run}, {r.scene}:", "", f"![{r.scene}]({_link(f'errors/{r.run}/{r.scene}.png')})", ""]
            for mask in r.curves:
                out += [f"![curves, {mask}]({_link(f'curves/{r.run}/{r.scene}_{mask}.svg')})", ""]
    return "\n".join(out)


def _link(path: str) -> str:
    return path.replace(" ", "%20").replace("(", "%28").replace(")", "%29")


_CSV_COLUMNS = (
    "run", "data_set", "scene", "family", "metric", "threshold", "mask", "value", "unit", "wrong", "pixels",
    "density", "convention", "map", "note",
)  # fmt: skip


def _scores_csv(report: EvaluationReport) -> str:
    """One row a number; then the curves' areas, the failures, and the means over scenes (scene = ``*mean``)."""
    rows: list[dict[str, Any]] = []
    for r in report.results:
        base = {"run": r.run, "data_set": r.data_set, "scene": r.scene, "family": r.metric, "map": r.source}
        rows += [{**base, **_plain(vars(score)), "note": r.warning} for score in r.scores]
        for mask, name, c in _flat_curves(r):
            common = {**base, "mask": mask, "pixels": c.pixels, "convention": metrics.ESTIMATED_ONLY}
            for metric in ("auc", "optimal", "random"):
                rows.append({**common, "metric": f"{metric}:{name}", "value": getattr(c, metric), "unit": "rate"})
        if r.error:
            rows.append({**base, "metric": "failed", "note": r.error})
    for mean in report.means():
        note = f"mean over {mean['scenes']} scenes"
        rows.append({**_plain(mean), "scene": "*mean", "note": note})
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_COLUMNS, extrasaction="ignore", restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: "" if value is None else value for key, value in row.items()} for row in rows)
    return text.getvalue()


def _result_dict(result: Result) -> dict[str, Any]:
    return {
        "run": result.run,
        "scene": result.scene,
        "data_set": result.data_set,
        "family": result.metric,
        "map": result.source,
        "scores": [_plain(vars(score)) for score in result.scores],
        "confidence": [{"measure": name, "mask": mask, **_plain(vars(c))} for mask, name, c in _flat_curves(result)],
        "warning": result.warning or None,
        "error": result.error or None,
    }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {key: _none(value) if isinstance(value, float) else value for key, value in values.items()}


def _none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mean(values: Iterable[float] | NDArray[np.float64]) -> float:
    present = [float(value) for value in values if value == value]
    return sum(present) / len(present) if present else float("nan")
