"""What ``--flag`` and ``--fail-flagged`` do: the rows that a person should look at, and the exit code."""

from __future__ import annotations

from collections.abc import Sequence

from depthcli.core.errors import ConfigError
from depthcli.core.flags import Condition, Flags, flag_rows
from depthcli.run.batch import FLAGGED, SOME_FAILED
from depthcli.run.console import Reporter
from depthcli.run.json_csv import Row


def conditions_of(flag: Sequence[str] | None, fail_flagged: bool) -> list[Condition]:
    """Return the conditions that are given; ConfigError if one is wrong, or --fail-flagged has none."""
    if fail_flagged and not flag:
        raise ConfigError("--fail-flagged needs a condition, such as --flag 'measured<0.6'")
    return [Condition.of(text) for text in flag or ()]


def flags_of(conditions: Sequence[Condition], rows: Sequence[Row], reporter: Reporter) -> Flags:
    """Return the rows that the conditions flag; warn about conditions that some or all rows have no value for."""
    flags = flag_rows(conditions, rows)
    for line in flags.warnings:
        reporter.info(f"warning: {line}")
    for line in flags.unanswered:
        reporter.error(line)
    return flags


def exit_code(failed: bool, flags: Flags, fail_flagged: bool, shard: str | None = None) -> int:
    """Return the exit code: something failed, or a row is flagged or a condition has no values.

    Values that one shard lacks may be in the others.
    """
    if failed:
        return SOME_FAILED
    return FLAGGED if fail_flagged and (flags.flagged or (flags.unanswered and not shard)) else 0
