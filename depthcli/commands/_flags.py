"""The options ``--flag`` and ``--fail-flagged``: rows that a person should look at, in tables, JSON and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from depthcli.batch.command import FLAGGED, SOME_FAILED, Values
from depthcli.batch.console import Reporter, aligned
from depthcli.batch.json_csv import Row
from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.core.flags import Condition, Flagged
    from depthcli.evaluation.comparison import EvaluationReport

FLAGS = (
    Option("flag", str, "Rows to look at: 'measured<0.6', 'z(bad 2)>3'.", "CONDITION", repeatable=True,
           group="Report"),
    Option("fail_flagged", bool, "Exit code 4 where a row is flagged.", default=False, group="Report"),
)  # fmt: skip


def conditions_of(values: Values) -> tuple[Condition, ...]:
    """Return the conditions that are given; ConfigError where one is wrong."""
    if not values.get("flag"):
        return ()
    from depthcli.batch import columns as report
    from depthcli.core.flags import parse_conditions
    from depthcli.evaluation import columns as evaluation

    return parse_conditions(values["flag"], (*report.OF_RUNS, *evaluation.METRICS))


def flagged_rows(conditions: Sequence[Condition], rows: Sequence[Row], reporter: Reporter) -> list[Flagged]:
    """Return the flagged rows, worst first; warn of conditions that say nothing here."""
    from depthcli.core.flags import flag_rows

    flagged, warnings = flag_rows(conditions, rows)
    for line in warnings:
        reporter.info(f"warning: {line}")
    return flagged


def flagged_scores(
    conditions: Sequence[Condition], report: EvaluationReport, own: Mapping[str, Mapping[str, Row]], reporter: Reporter
) -> list[Flagged]:
    """Return the flagged scenes of an evaluation: by its scores, and by what the reports of the runs say.

    A metric is that of the region behind its name, or else of the protocol's main region.

    Parameters
    ----------
    own : run -> scene -> row of its report; scenes that were not scored are flagged by these rows alone
    """
    from depthcli.core.flags import plain_name

    rows: dict[tuple[str, str], Row] = {}
    for run, of_run in own.items():
        rows |= {(run, scene): {**row, "run": run} for scene, row in of_run.items()}
    for section in report.sections:
        for result in section.results:
            scores: Row = {}
            for region in reversed(section.regions):
                here = {score.metric.heading: score.value for score in result.scores if score.region == region}
                scores |= {plain_name(f"{heading} {region}"): value for heading, value in here.items()}
                scores |= {plain_name(heading): value for heading, value in here.items()}
            status = {"status": "failed"} if result.error else {}
            row = rows.get((result.run, result.scene), {"status": "done"})
            rows[result.run, result.scene] = {**row, **scores, **status, "scene": result.scene, "run": result.run}
    return flagged_rows(conditions, list(rows.values()), reporter)


def flagged_table(flagged: Sequence[Flagged], n_rows: int) -> str:
    """Return the table of flagged rows, or the sentence that there are none."""
    if not flagged:
        return f"\nflagged: none of {n_rows}\n"
    runs = any(each.run for each in flagged)
    lines = [("scene", "run", "why") if runs else ("scene", "why")]
    for each in flagged:
        why = "; ".join(each.reasons)
        lines.append((each.scene, each.run, why) if runs else (each.scene, why))
    width = max(len(line[-1]) for line in lines)
    padded = [(*line[:-1], line[-1].ljust(width)) for line in lines]
    return f"\nflagged: {len(flagged)} of {n_rows}\n{aligned(padded)}\n"


def exit_code(failed: bool, flagged: Sequence[Flagged], values: Values) -> int:
    """Return the exit code: something failed, or else a row is flagged and that counts, or 0."""
    if failed:
        return SOME_FAILED
    return FLAGGED if flagged and values.get("fail_flagged") else 0
