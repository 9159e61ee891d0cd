"""The report of a run while it grows, and how the parts of a shared run become one."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.batch import record
from depthcli.batch.sharing import FolderLock, Shard
from depthcli.core.errors import OutputError
from depthcli.data.scenes import Scene


class ReportWriter:
    """Keeps the report on disk current without writing it after each of a thousand scenes.

    Parameters
    ----------
    output, command : the run folder and who writes it
    run : identity of the run
    rows : scene -> row; grows
    scenes : of this call, in order
    others : rows of scenes of the same run that this call does not concern
    shard : the part of a shared run, which is written beside those of the others; None for the whole

    Attributes
    ----------
    problem : why it could not be written the last time, or empty
    """

    def __init__(
        self,
        output: Path,
        command: str,
        run: str,
        rows: dict[str, dict[str, Any]],
        scenes: Sequence[Scene],
        others: list[dict[str, Any]],
        shard: Shard | None,
    ) -> None:
        self.output, self.command, self.run, self.rows, self.others = output, command, run, rows, others
        self.order = [scene.name for scene in scenes]
        self.shard = shard
        self.written = 0.0
        self.pause = 1.0
        self.problem = ""

    def update(self, final: bool = False) -> None:
        """Write it, unless that was done a moment ago."""
        start = time.monotonic()
        if not final and start - self.written <= self.pause:
            return
        rows = [self.rows[name] for name in self.order if name in self.rows]
        rows = sorted(self.others + rows, key=lambda row: str(row["scene"]))
        try:
            if self.shard is None:
                record.write_report(self.output, self.command, rows)
            else:
                part = self.output / record.PARTS_FOLDER / f"{self.shard}.json"
                record.write_rows(part, rows, {"command": self.command, "run": self.run}, {})
            self.problem = ""
        except OutputError as error:  # the scenes go on, and say themselves what they cannot write
            self.problem = str(error)
        self.written = time.monotonic()
        self.pause = max(1.0, 20 * (self.written - start))  # a long report is not most of the work

    def close(self, lock: FolderLock) -> None:
        """The last word; of a shared run also the report of all that is there, by whom it is written."""
        self.update(final=True)
        if self.shard is None:
            drop_parts(self.output)
            return
        last = lock.last()
        with contextlib.nullcontext() if last else lock.reporting():
            try:
                record.write_report(self.output, self.command, joined_rows(self.output, self.run))
            except OutputError as error:
                self.problem = str(error)
                return
            if last:
                drop_parts(self.output)


def drop_parts(output: Path) -> None:
    """The report holds what they held."""
    shutil.rmtree(output / record.PARTS_FOLDER, ignore_errors=True)


def joined_rows(output: Path, run: str, names: Iterable[str] = ()) -> list[dict[str, Any]]:
    """Rows of everything that the report, its parts, and the records of the scenes ``names`` say of the run, by name.

    A row stands where the scene's record does, or where it says why there is none.
    """
    rows = record.read_report(output)
    for name in names:
        rows.setdefault(name, {})
    found = []
    for name, row in sorted(rows.items()):
        known = record.read_record(output / name) if record.is_inside(name) else None
        if known is not None and known.get("run") == run:
            found.append(row_of(known, row))
        elif row.get("status") == "failed":
            found.append(row)
    return found


def row_of(known: Mapping[str, Any], measured: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a finished scene: what its record says, with what was measured once."""
    return {
        "scene": known.get("scene"),
        "status": "done",
        "error": "",
        **{sys.intern(key): value for key, value in known["facts"].items()},  # of 50,000 records, once
        "seconds": measured.get("seconds") or {},
        "peak_memory": measured.get("peak_memory"),
        "source": measured.get("source") or "",
    }
