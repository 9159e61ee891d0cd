"""Join the reports of processes that shared a run, and list every scene that is there.

A run's last process does that itself; this is for runs whose processes were killed, or that are still going on.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.batch.command import SOME_FAILED, Command, Values
from depthcli.core.errors import InputError
from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.reporter import Reporter


class MergeCommand(Command):
    """``depthcli merge RUN``."""

    @property
    def arguments(self) -> tuple[Option, ...]:
        """The run."""
        return (Option("run", Path, "Run folder.", "RUN", required=True),)

    @property
    def options(self) -> tuple[Option, ...]:
        """None of its own."""
        return ()

    def run(self, values: Values, reporter: Reporter) -> int:
        """Write report.json and report.csv anew; the exit code says whether a scene failed."""
        from depthcli.batch import record
        from depthcli.batch.report import drop_parts, joined_rows
        from depthcli.batch.sharing import FolderLock
        from depthcli.batch.tables import run_table

        place: Path = values["run"]
        if not place.is_dir():
            raise InputError(f"{place}: no such folder")
        identity, command = record.opened_run(place)
        with FolderLock(place, True, reporter.info) as lock:
            alone = lock.alone
            if not alone:
                lock.settle()
            with lock.reporting():
                found = (path.parent for depth in ("*", "*/*") for path in place.glob(f"{depth}/{record.RECORD_FILE}"))
                rows = joined_rows(place, identity, (path.relative_to(place).as_posix() for path in found))
                record.write_report(place, command, rows)
                if alone:
                    drop_parts(place)
        failed = sum(row["status"] == "failed" for row in rows)
        if values["json"]:
            reporter.data(record.to_json(record.report_document(command, rows)))
        elif not values["quiet"]:
            reporter.data(run_table(rows, ()))
        reporter.info(f"{len(rows) - failed} of {len(rows)} scenes done, in {place}")
        return SOME_FAILED if failed else 0


COMMAND = MergeCommand()
