"""What ``--evaluate`` and ``--html`` do with the scenes of a run: compare them with their truth, write the page."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from depthcli.commands._evaluation import viewers
from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.core.text import summarized
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import RESULTS, Choices, can_be_missed, evaluate_runs
from depthcli.evaluation.map_files import run_names
from depthcli.evaluation.protocols import load
from depthcli.io.scenes import Scene, SequenceScene
from depthcli.io.scenes.places import local, origin
from depthcli.problems.problem import SceneJob
from depthcli.report.page import Page
from depthcli.report.without_truth import RunWithoutTruth
from depthcli.run.flags import flag_rows
from depthcli.run.folder import EVALUATION, saved_config, staging_folder
from depthcli.run.job import SceneT
from depthcli.run.json_csv import Row


def evaluated(
    batch: SceneJob[SceneT],
    scenes: Sequence[SceneT],
    rows: Sequence[Row],
    options: RunOptions,
    source: SceneOptions | None,
) -> EvaluationReport:
    """Compare scenes with their truth, and write the page of these and of the others; no results without truth."""
    reporter, conditions = options.reporter, options.conditions
    output, truth = options.output / EVALUATION, source.input if source is not None else None
    in_folder = truth is not None and os.path.isdir(local(truth))  # pairs of a table have no truth
    scored = [scene for scene in scenes if in_folder and scene.has_truth]
    others = [scene for scene in scenes if not (in_folder and scene.has_truth)]
    shown = _without_truth(batch, others, rows, options.output) if options.html and others else None
    if scored and truth is not None:
        judged = [scene for scene in batch.truth_scenes(scenes) if scene.problem or scene.has_truth]
        by_name, views = {str(row["scene"]): row for row in rows}, viewers(reporter, output, options.html, run=shown)
        choices = Choices(rows=by_name, conditions=conditions, viewers=views, reporter=reporter)
        return evaluate_runs([options.output], judged, local(truth), output, choices)
    shows = ": the page shows the maps without scores" if options.html else ", nothing to compare with"
    reporter.info(f"no ground truth in {truth or 'the given files'}{shows}")
    flags, runs = flag_rows(conditions, rows, reporter), tuple(run_names([options.output]))
    report = EvaluationReport(runs, (), {}, "" if truth is None else origin(truth), flags=flags)
    if shown is not None:
        page = Page(reporter.command_line, run=shown)
        with (
            can_be_missed(page.file, report.unwritten, reporter),
            staging_folder(output, "evaluate", RESULTS, reporter.info) as folder,
        ):
            page.begin(folder)
            page.write(None, "{}", {shown.name: saved_config(shown.folder)}, flags)
    return report


def _without_truth(
    batch: SceneJob[SceneT], scenes: Sequence[SceneT], rows: Sequence[Row], folder: Path
) -> RunWithoutTruth:
    """Return the views of scenes without truth for the page; a sequence is shown frame by frame."""
    by_name, shown, row_of = {str(row["scene"]): row for row in rows}, list[Scene](), dict[str, Row]()
    for scene in scenes:
        row = by_name.get(scene.name, {})
        if isinstance(scene, SequenceScene):  # its row has means over the frames
            shown += scene.frames
            row_of |= {frame.name: {key: row.get(key, "") for key in ("status", "error")} for frame in scene.frames}
        else:
            shown.append(scene)
            row_of[scene.name] = row
    (run,) = run_names([folder])
    columns = batch.shown.columns if batch.shown.page_columns is None else batch.shown.page_columns
    own = [(scene.name, by_name[scene.name]) for scene in scenes if scene.name in by_name]
    warnings = summarized((name, line) for name, row in own for line in row.get("warnings") or ())
    bounds = frozenset(name for name, row in own if batch.is_lower_bound(row))
    judge = load(batch.shown.protocol)()
    return RunWithoutTruth(run, folder, judge, batch.shown.palette, shown, row_of, columns, warnings, bounds)
