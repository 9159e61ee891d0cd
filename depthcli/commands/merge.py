"""Join the reports of processes that share a run.

The last process of a run does that itself; this is for runs whose processes were killed or still compute.
"""

from __future__ import annotations

import os
from pathlib import Path

from depthcli.commands._old_batch import BatchCommand
from depthcli.core.errors import InputError
from depthcli.core.option import Option
from depthcli.run.batch import SOME_FAILED
from depthcli.run.command import Command, Values
from depthcli.run.console import Column, Reporter, run_table
from depthcli.run.json_csv import Row, to_json

_MAX_NAMED = 10  # shards, and scenes, that a message names


class MergeCommand(Command):
    """``depthcli merge RUN``."""

    arguments = (Option("run", Path, "Run folder.", "RUN", required=True, group="Input"),)
    page = "how_to/cluster"
    examples = ("depthcli merge runs/accurate",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Write report.json and report.csv again; return the exit code, 3 where a scene failed or is missing."""
        from depthcli.run.records import RECORD_FILE
        from depthcli.run.report_parts import drop_joined_parts, joined_rows, missing_parts
        from depthcli.run.reports import report_document, write_report
        from depthcli.run.run_folder import opened_run
        from depthcli.run.sharing import FolderLock

        place: Path = values["run"]
        if not os.path.isdir(place):
            raise InputError(f"{place}: no such folder")
        identity, command = opened_run(place)
        with FolderLock(place, True, reporter.info) as lock:
            alone = lock.alone
            if not alone:
                lock.settle()
            with lock.reporting():
                found = (path.parent for depth in ("*", "*/*") for path in place.glob(f"{depth}/{RECORD_FILE}"))
                rows = joined_rows(place, identity, (path.relative_to(place).as_posix() for path in found))
                write_report(place, command, rows)
                shards, names = missing_parts(place, identity, rows)
                if alone and not names:
                    drop_joined_parts(place, identity, rows)
        failed = sum(row["status"] == "failed" for row in rows)
        if values["json"]:
            reporter.data(to_json(report_document(command, rows) | {"missing": names, "unfinished_shards": shards}))
        elif not values["quiet"]:
            absent: list[Row] = [
                {"scene": name, "status": "missing", "seconds": {}, "peak_memory": None} for name in names
            ]
            reporter.data(run_table(sorted([*rows, *absent], key=lambda row: str(row["scene"])), _columns(command)))
        if shards or names:
            reporter.error(_missing_text(shards, names))
        reporter.info(f"{len(rows) - failed} of {len(rows) + len(names)} scenes done, in {place}")
        return SOME_FAILED if failed or shards or names else 0


def _columns(name: str) -> tuple[Column, ...]:
    """Return the columns of the table that the command ``name`` prints itself."""
    from depthcli.commands import find_command

    command = find_command(name)
    return command.columns() if isinstance(command, BatchCommand) else ()


def _missing_text(shards: list[str], names: list[str]) -> str:
    """Return one line that says which shards have not ended, and which scenes have no result."""
    parts = []
    if len(shards) == 1:
        parts.append(f"shard {shards[0]} has not ended")
    elif shards:
        parts.append(f"shards {_some(shards)} have not ended")
    if names:
        parts.append(f"{len(names)} {'scene is' if len(names) == 1 else 'scenes are'} missing: {_some(names)}")
    again = ("that shard" if len(shards) == 1 else "those shards") if shards else "the run"
    return f"{'; '.join(parts)}; start {again} again with the same command"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return f"{', '.join(names[:_MAX_NAMED])}{more}"


COMMAND = MergeCommand()
