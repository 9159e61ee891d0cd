"""The options ``--flag`` and ``--fail-flagged``: rows that a person should look at, in tables, JSON and the page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.flags import Condition, Flags, flag_rows, plain_name
from depthcli.core.option import Option
from depthcli.run.batch import FLAGGED, SOME_FAILED
from depthcli.run.command import Values
from depthcli.run.console import Reporter
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport

FLAGS = (
    Option("flag", str, "Rows to look at, such as 'measured<0.6'.", "CONDITION", repeatable=True, group="Report"),
    Option("fail_flagged", bool, "Exit code 4 if a row is flagged.", default=False, group="Report"),
)


def conditions_of(values: Values) -> list[Condition]:
    """Return the conditions that are given; ConfigError if one is wrong, or --fail-flagged has none."""
    if values.get("fail_flagged") and not values.get("flag"):
        raise ConfigError("--fail-flagged needs a condition, such as --flag 'measured<0.6'")
    return [Condition.of(text) for text in values.get("flag") or ()]


def flags_of(conditions: Sequence[Condition], rows: Sequence[Row], reporter: Reporter) -> Flags:
    """Return the rows that the conditions flag; warn about conditions that some or all rows have no value for."""
    flags = flag_rows(conditions, rows)
    for line in flags.warnings:
        reporter.info(f"warning: {line}")
    for line in flags.unanswered:
        reporter.error(line)
    return flags


def flags_of_scores(
    conditions: Sequence[Condition], report: EvaluationReport, own: Mapping[str, Mapping[str, Row]], reporter: Reporter
) -> Flags:
    """Return the scenes of an evaluation that the conditions flag, by its scores and by the reports of the runs.

    A metric without a region behind it is that of the protocol's main region; ``bad 2 (0.5)``, whose threshold in
    pixels of a smaller image stands in brackets, is ``bad 2``, too.

    Parameters
    ----------
    own : run -> scene -> row of its report; scenes that were not scored are flagged by these rows alone
    """
    rows: dict[tuple[str, str], Row] = {}
    for run, of_run in own.items():
        rows |= {(run, scene): {**row, "run": run} for scene, row in of_run.items()}
    for section in report.sections:
        for result in section.results:
            scores: Row = {}
            for region in reversed(section.regions):
                here = {score.metric.heading: score.value for score in result.scores if score.region == region}
                here = {re.sub(r" \([\d.]+\)$", "", heading): value for heading, value in here.items()} | here
                scores |= {plain_name(f"{heading} {region}"): value for heading, value in here.items()}
                scores |= {plain_name(heading): value for heading, value in here.items()}
            row = rows.get((result.run, result.scene), {})
            rows[result.run, result.scene] = {**row, **scores, "scene": result.scene, "run": result.run}
    return flags_of(conditions, list(rows.values()), reporter)


def exit_code(failed: bool, flags: Flags, values: Values) -> int:
    """Return the exit code: something failed, or a row is flagged or a condition has no values.

    Values that one shard lacks may be in the others.
    """
    if failed:
        return SOME_FAILED
    unanswered = bool(flags.unanswered) and not values.get("shard")
    return FLAGGED if (flags.flagged or unanswered) and values.get("fail_flagged") else 0
