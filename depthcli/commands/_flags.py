"""The options ``--flag`` and ``--fail-flagged``: rows that a person should look at, in tables, JSON and the page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.command import FLAGGED, SOME_FAILED, Values
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import Row

if TYPE_CHECKING:
    from depthcli.core.conditions import Condition
    from depthcli.core.flags import Flags
    from depthcli.evaluation.comparison import EvaluationReport

_IN_BRACKETS = re.compile(r" \([\d.]+\)$")

FLAGS = (
    Option("flag", str, "Rows to look at: 'measured<0.6', 'z(bad 2)>3'.", "CONDITION", repeatable=True,
           group="Report"),
    Option("fail_flagged", bool, "Exit code 4 where a row is flagged.", default=False, group="Report"),
)  # fmt: skip


def conditions_of(values: Values) -> tuple[Condition, ...]:
    """Return the conditions that are given; ConfigError where one is wrong, or none is there to count."""
    if not values.get("flag"):
        if values.get("fail_flagged"):
            raise ConfigError("nothing is flagged without a condition: give one, such as 'measured<0.6'")
        return ()
    from depthcli.core.conditions import parse_conditions
    from depthcli.evaluation import columns as evaluation
    from depthcli.run import columns as report

    return parse_conditions(values["flag"], (*report.OF_RUNS, *evaluation.METRICS))


def flags_of(conditions: Sequence[Condition], rows: Sequence[Row], reporter: Reporter) -> Flags:
    """Return what the conditions flag; warn of those that say nothing here."""
    from depthcli.core.flags import flag_rows

    flags = flag_rows(conditions, rows)
    for line in flags.warnings:
        reporter.info(f"warning: {line}")
    for line in flags.unanswered:
        reporter.error(line)
    return flags


def flags_of_scores(
    conditions: Sequence[Condition], report: EvaluationReport, own: Mapping[str, Mapping[str, Row]], reporter: Reporter
) -> Flags:
    """Return what the conditions flag in an evaluation: by its scores, and by what the reports of the runs say.

    A metric is that of the region behind its name, or else of the protocol's main region; ``bad 2 (0.5)``, whose
    threshold in pixels of a smaller image stands in brackets, is ``bad 2``, too.

    Parameters
    ----------
    own : run -> scene -> row of its report; scenes that were not scored are flagged by these rows alone
    """
    from depthcli.core.conditions import plain_name

    rows: dict[tuple[str, str], Row] = {}
    for run, of_run in own.items():
        rows |= {(run, scene): {**row, "run": run} for scene, row in of_run.items()}
    for section in report.sections:
        for result in section.results:
            scores: Row = {}
            for region in reversed(section.regions):
                here = {score.metric.heading: score.value for score in result.scores if score.region == region}
                here = {_IN_BRACKETS.sub("", heading): value for heading, value in here.items()} | here
                scores |= {plain_name(f"{heading} {region}"): value for heading, value in here.items()}
                scores |= {plain_name(heading): value for heading, value in here.items()}
            status = {"status": "failed"} if result.error else {}
            row = rows.get((result.run, result.scene), {"status": "done"})
            rows[result.run, result.scene] = {**row, **scores, **status, "scene": result.scene, "run": result.run}
    return flags_of(conditions, list(rows.values()), reporter)


def flagged_table(flags: Flags) -> str:
    """Return the table of flagged rows, or the sentence that there are none."""
    in_regions = sum(bool(each.region) for each in flags.flagged)
    counts = f"{len(flags.flagged) - in_regions or 'none'} of {flags.n_rows}"
    if flags.verdicts:
        unknown = sum(each.verdict == "unknown" for each in flags.verdicts)
        counts += f", and {in_regions or 'none'} of {len(flags.verdicts)} regions"
        counts += f" ({unknown} unknown)" if unknown else ""
    if not flags.flagged:
        return f"\nflagged: {counts}\n"
    shown = [name for name in ("scene", "region", "run") if any(getattr(each, name) for each in flags.flagged)]
    lines = [(*shown, "why")]
    lines += [(*(getattr(each, name) or "-" for name in shown), "; ".join(each.reasons)) for each in flags.flagged]
    width = max(len(line[-1]) for line in lines)
    padded = [(*line[:-1], line[-1].ljust(width)) for line in lines]
    return f"\nflagged: {counts}\n{aligned(padded)}\n"


def exit_code(failed: bool, flags: Flags, values: Values) -> int:
    """Return the exit code: something failed, or a row is flagged or a condition has no values.

    Values that one shard lacks may be in the others.
    """
    if failed:
        return SOME_FAILED
    unanswered = bool(flags.unanswered) and not values.get("shard")
    return FLAGGED if (flags.flagged or unanswered) and values.get("fail_flagged") else 0
