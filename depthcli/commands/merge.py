"""Join the reports of processes that share a run.

The last process of a run does that itself; this is for runs whose processes were killed or still compute.
"""

from __future__ import annotations

import os
from pathlib import Path

from depthcli.batch.command import SOME_FAILED, Command, Values
from depthcli.batch.console import Reporter, run_table
from depthcli.batch.json_csv import to_json
from depthcli.core.errors import InputError
from depthcli.core.option import Option


class MergeCommand(Command):
    """``depthcli merge RUN``."""

    arguments = (Option("run", Path, "Run folder.", "RUN", required=True, group="Input"),)
    examples = ("depthcli merge runs/accurate",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Write report.json and report.csv again; return the exit code, which says whether a scene failed."""
        from depthcli.batch.records import RECORD_FILE
        from depthcli.batch.reports import drop_joined_parts, joined_rows, report_document, write_report
        from depthcli.batch.run_folder import opened_run
        from depthcli.batch.sharing import FolderLock

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
                if alone:
                    drop_joined_parts(place)
        failed = sum(row["status"] == "failed" for row in rows)
        if values["json"]:
            reporter.data(to_json(report_document(command, rows)))
        elif not values["quiet"]:
            reporter.data(run_table(rows, ()))
        reporter.info(f"{len(rows) - failed} of {len(rows)} scenes done, in {place}")
        return SOME_FAILED if failed else 0


COMMAND = MergeCommand()
