"""Compare maps of one or more runs with the ground truth.

A run is a folder that depthcli made, or a folder of maps by another program. The protocol of a scene decides which file
is its map, how it is read, and how it is scored.

Examples:
  depthcli evaluate runs/accurate runs/fast --truth scenes -o results --html
  depthcli evaluate a=maps/a b=maps/b --pattern b='{scene}/d.tiff' --truth in
  depthcli evaluate runs/fast --truth scenes --format latex --tables metrics
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from depthcli.commands._options import (
    CodingOptions,
    FailFlaggedOption,
    FlagOption,
    HtmlBudgetOption,
    LayoutOption,
    Printing,
    ScenesOption,
    ScoringOptions,
    TableOptions,
    local_output,
)
from depthcli.core.errors import SOME_FAILED, ConfigError
from depthcli.run.flags import conditions_of
from depthcli.show.table import to_json


def evaluate(
    printing: Printing,
    tables: TableOptions,
    runs: Annotated[list[str], Argument(metavar="RUN...", help="Run folders or maps; NAME=DIR gives a run a name.")],
    truth: Annotated[Path, Option(metavar="DIR", help="Folder with ground truth; for a single map, a file.")],
    output: Annotated[
        Path | None,
        Option("--output", "-o", metavar="DIR", help="Folder for scores, pictures and report.", callback=local_output),
    ] = None,
    scenes: ScenesOption = None,
    layout: LayoutOption = None,
    protocol: Annotated[
        str | None,
        Option(metavar="NAME", help="How to score, such as kitti-2015. Default: by data set."),
    ] = None,
    *,
    coding: CodingOptions,
    maps: Annotated[list[str] | None, Option(hidden=True)] = None,  # old name of --pattern
    scoring: ScoringOptions,
    compare: Annotated[
        str, Option(metavar="best|all", help="Test the runs against the best, or all pairs of them.")
    ] = "best",
    flag: FlagOption = None,
    fail_flagged: FailFlaggedOption = False,
    html: Annotated[bool, Option("--html", help="Also write report.html: maps and errors in a browser.")] = False,
    html_budget: HtmlBudgetOption = "50MB",
) -> int:
    """Evaluate, print the tables, and return the exit code."""
    from depthcli.commands._scores import check_tables, print_place, print_tables, viewers
    from depthcli.evaluation.evaluate import Choices, evaluate_runs, scenes_with_truth
    from depthcli.evaluation.map_files import MapNaming, find_runs, given_naming
    from depthcli.evaluation.protocols import load
    from depthcli.io.scenes.places import local

    # The runs, and how their maps are named and coded.
    reporter, places = printing.reporter, find_runs(runs)
    if maps:
        reporter.info("warning: --maps is called --pattern here, as in all commands")
    patterns = [*(coding.pattern or []), *(maps or [])]
    of_all, own = given_naming(places, patterns, coding.scale, coding.invalid)

    # How they are scored, and what with.
    check_tables(tables)
    if compare not in ("best", "all"):
        raise ConfigError(f"--compare: must be best or all (got {compare!r})")
    settings = scoring.settings(of_all.scale, of_all.invalid)
    scored_by = None if protocol is None else load(protocol)(settings)
    truth = local(truth)
    found = scenes_with_truth(truth, scenes or ["*"], layout, scored_by, settings, reporter, places.values())
    choices = Choices(
        scored_by,
        settings,
        {run: naming.over(MapNaming(of_all.pattern)) for run, naming in own.items()},
        conditions=conditions_of(flag) if flag or fail_flagged else (),
        with_pairs=compare == "all",
        viewers=viewers(reporter, output, html, html_budget),
        reporter=reporter,
    )
    report = evaluate_runs(runs, found, truth, output, choices)

    # The results on the terminal.
    if printing.json:
        reporter.data(to_json(report.to_dict()))
    else:
        print_tables(report, reporter, tables, quiet=printing.quiet)
        if choices.conditions and not printing.quiet:
            reporter.data(report.flags.text())
    if output is not None:
        print_place(report, output, html, reporter)
    if report.incomplete:
        return SOME_FAILED
    return report.flags.exit_code() if fail_flagged else 0
