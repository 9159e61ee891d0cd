"""Files ``report.json`` and ``report.csv``: written while a run goes on, joined where processes share it, read back.

Every process of a shared run writes a report of its own, its part, into ``.parts/``; ``report.json`` joins them.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from depthcli.batch.json_csv import Row, to_json_line, write_csv
from depthcli.batch.records import MAX_TEXT_BYTES, RUN_FILE, Record, digest, read_json, read_record, read_text
from depthcli.batch.sharing import FolderLock, Shard
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.data.formats.files import atomic_path, ends_of_file, open_regular

REPORT_FILES = ("report.json", "report.csv")
_PARTS_FOLDER = ".parts"
_MIN_PAUSE = 1.0  # seconds between two writes of the report
_MAX_SHARE = 0.05  # of the time may be spent on writing the report
# How a part begins, and a row of any report; see write_rows.
_PART_START = re.compile(rb'\{\n "command": "[^"]*",\n "run": "(\w+)",\n "inputs": "(\w+)"')
_ROW_START = b'  {"scene": '
# Columns of a report that a scene's record does not hold.
_MEASURED_COLUMNS = frozenset({"scene", "status", "error", "seconds", "peak_memory", "source"})


@dataclass(frozen=True)
class Part:
    """Which run, inputs and shard the report of one process belongs to.

    Attributes
    ----------
    command : name of the command
    run : identity of the run
    shard : the part of a shared run; None: all of a run, whose report needs no joining
    inputs : digest of the inputs of all shards; empty without a shard
    """

    command: str
    run: str
    shard: Shard | None = None
    inputs: str = ""

    def begin(self, output: Path) -> None:
        """Begin the report of a shard; ConfigError where another shard of the run computes other inputs."""
        if self.shard is None:
            return
        others = {file.stem for file, (run, its) in _parts(output).items() if run == self.run and its != self.inputs}
        if others:
            raise ConfigError(
                f"{output}: shard {' and '.join(sorted(others))} of this run computed other inputs than these; give "
                "all shards the same --input and --scenes, or choose another --output, or --overwrite it"
            )
        if not (output / _PARTS_FOLDER / f"{self.shard}.json").is_file():
            self.write(output, [], ended=False)

    def write(self, output: Path, rows: list[Row], ended: bool) -> None:
        """Write the report; OutputError where that is impossible."""
        if self.shard is None:
            write_report(output, self.command, rows)
            return
        before = {"command": self.command, "run": self.run, "inputs": self.inputs}
        write_rows(output / _PARTS_FOLDER / f"{self.shard}.json", rows, before, {"ended": ended})


class ReportWriter:
    """Keeps the report on disk up to date, without writing it again after every scene of a long run.

    Parameters
    ----------
    output, part : the run folder, and what the report is about
    rows : scene -> row; the caller adds to it
    order : names of the scenes of this call
    others : rows of scenes of the same run that are not part of this call

    Attributes
    ----------
    problem : why the report could not be written the last time, or empty
    """

    def __init__(self, output: Path, part: Part, rows: dict[str, Row], order: Sequence[str], others: list[Row]) -> None:
        self.output, self.part, self.rows, self.order, self.others = output, part, rows, order, others
        self.problem = ""
        self._written, self._pause = 0.0, _MIN_PAUSE

    def update(self, final: bool = False) -> None:
        """Write the report, unless it was written shortly before."""
        start = time.monotonic()
        if not final and start - self._written <= self._pause:
            return
        rows = [self.rows[name] for name in self.order if name in self.rows]
        try:
            self.part.write(self.output, sorted(self.others + rows, key=lambda row: str(row["scene"])), final)
            self.problem = ""
        except OutputError as error:  # a scene that cannot be written reports that itself
            self.problem = str(error)
        self._written = time.monotonic()
        self._pause = max(_MIN_PAUSE, (self._written - start) / _MAX_SHARE)

    def close(self, lock: FolderLock) -> None:
        """Write the report for the last time; the last process of a shared run joins the reports of all."""
        self.update(final=True)
        if self.part.shard is None:
            drop_parts(self.output)
            return
        last = lock.last()
        with contextlib.nullcontext() if last else lock.reporting():
            try:
                write_report(self.output, self.part.command, joined_rows(self.output, self.part.run))
            except (OutputError, ConfigError) as error:
                self.problem = str(error)
                return
            if last:
                drop_joined_parts(self.output)


# The reports of the processes that share a run.


def _parts(output: Path) -> dict[Path, tuple[str, str]]:
    """Return file of a part -> its run and the digest of the inputs of all shards; both empty in a damaged one."""
    found = {}
    for file in sorted((output / _PARTS_FOLDER).glob("*-of-*.json")):
        ends = ends_of_file(file)
        about = ends and _PART_START.match(ends[1])
        found[file] = (about[1].decode(), about[2].decode()) if about else ("", "")
    return found


def drop_parts(output: Path, keep: Part | None = None) -> None:
    """Delete the reports of the processes that shared a run, but for those of the run and the inputs of ``keep``."""
    with contextlib.suppress(OSError):
        for file, about in _parts(output).items():
            if keep is None or about != (keep.run, keep.inputs):
                file.unlink()
        (output / _PARTS_FOLDER).rmdir()


def drop_joined_parts(output: Path) -> None:
    """Delete the reports of the shards when all have ended; until then they say which inputs belong together.

    A shard that was killed has not ended.
    """
    ends = {file.stem: ends_of_file(file) for file in _parts(output)}
    names = {name for name, end in ends.items() if end is not None and b'"ended": true' in end[2]}
    counts = {int(name.rpartition("-")[2]) for name in names if name.rpartition("-")[2].isdigit()}
    if any(all(f"{index}-of-{count}" in names for index in range(1, count + 1)) for count in counts):
        drop_parts(output)


def joined_rows(output: Path, run: str, names: Iterable[str] = ()) -> list[Row]:
    """Return one row per scene of a run, by name, from its report, the reports of its parts, and records.

    A finished scene has a row only if its record is there; a failed one keeps the row with its reason.

    Parameters
    ----------
    names : scenes that have a record, whether or not a report lists them

    Raises
    ------
    ConfigError
        The parts were computed from different inputs.
    """
    by_inputs = {inputs: file.stem for file, (its_run, inputs) in _parts(output).items() if its_run == run}
    if len(by_inputs) > 1:
        raise ConfigError(
            f"{output}: its shards {' and '.join(sorted(by_inputs.values()))} computed different inputs; compute all "
            "again from the same --input and --scenes, with --overwrite"
        )
    rows: dict[str, Row] = {name: {} for name in names} | read_report(output)
    found = []
    for name, row in sorted(rows.items()):
        known = read_record(output, name)
        if known is not None and known.run == run:
            found.append(finished_row(known, row))
        elif row.get("status") == "failed":
            found.append(row)
    return found


# Rows, and files of rows.


def finished_row(known: Record, measured: Mapping[str, object]) -> Row:
    """Return the row of a finished scene: the facts of its record, and what was measured when it was computed."""
    return {
        "scene": known.scene,
        "status": "done",
        "error": "",
        **{sys.intern(key): value for key, value in known.facts.items()},  # one string for all rows
        "seconds": measured.get("seconds") or {},
        "peak_memory": measured.get("peak_memory"),
        "source": measured.get("source") or "",
    }


def report_document(command: str, rows: list[Row]) -> Row:
    """Return the report as one JSON document."""
    failed = sum(row["status"] == "failed" for row in rows)
    return {"command": command, "scenes": rows, "done": len(rows) - failed, "failed": failed}


def write_report(folder: Path, command: str, rows: list[Row]) -> None:
    """Write ``report.json`` and ``report.csv``, one row per scene; OutputError where that is impossible."""
    after = report_document(command, rows)
    write_rows(folder / REPORT_FILES[0], after.pop("scenes"), {"command": after.pop("command")}, after)
    with atomic_path(folder / REPORT_FILES[1]) as path, _writing(path) as file:
        write_csv(file, rows)


def write_rows(path: Path, rows: list[Row], before: Mapping[str, object], after: Mapping[str, object]) -> None:
    """Write a JSON document with ``rows`` under ``scenes``, one line each, between the keys before and after."""
    with atomic_path(path) as temporary, _writing(temporary) as file:
        file.write("{" + "".join(f"\n {to_json_line(key)}: {to_json_line(value)}," for key, value in before.items()))
        file.write('\n "scenes": [')
        for number, row in enumerate(rows):
            file.write((",\n  " if number else "\n  ") + to_json_line(row))
        ends = "".join(f",\n {to_json_line(key)}: {to_json_line(value)}" for key, value in after.items())
        file.write(f"\n ]{ends}\n}}\n")


def _writing(path: Path) -> TextIO:
    return path.open("w", 1 << 20, "utf-8", "backslashreplace", "")


def read_report(folder: Path, facts: bool = True) -> dict[str, Row]:
    """Return the rows of a run folder's report by scene; empty where there is none.

    Rows of parts that are not joined yet are among them, the newest last.

    Parameters
    ----------
    facts : False leaves out the columns that the scenes' records hold as well, which saves memory for long reports
    """
    rows = _rows_by_scene(_rows_of_file(folder / REPORT_FILES[0], None if facts else _MEASURED_COLUMNS))
    if os.path.isdir(folder / _PARTS_FOLDER):
        run = digest(read_text(folder / RUN_FILE).encode())
        for part in sorted((folder / _PARTS_FOLDER).glob("*.json"), key=lambda path: (_modified(path), path.name)):
            document = read_json(part)
            if isinstance(document, dict) and document.get("run") == run:
                rows |= _rows_by_scene(document.get("scenes"))
    return rows


def _rows_of_file(path: Path, keys: frozenset[str] | None) -> Any:
    """Return all rows of a report, reduced to ``keys``; one of ours is read line by line, which saves memory."""
    rows = []
    try:
        with open_regular(path) as file:
            left = os.fstat(file.fileno()).st_size
            while 0 < left <= MAX_TEXT_BYTES and (line := file.readline(left)):  # files of /proc have no size, no end
                left -= len(line)
                if line.startswith(_ROW_START):
                    row = json.loads(
                        line.decode("utf-8", "replace").rstrip().rstrip(","), object_pairs_hook=_with_interned_keys
                    )
                    rows.append(row if keys is None else {key: row[key] for key in row if key in keys})
    except (InputError, ValueError, RecursionError):
        return []
    if rows:
        return rows
    document = read_json(path)
    return document.get("scenes") if isinstance(document, dict) else None


def _with_interned_keys(pairs: list[tuple[str, Any]]) -> Row:
    return {sys.intern(key): value for key, value in pairs}


def _modified(path: Path) -> int:
    with contextlib.suppress(OSError):
        return path.stat().st_mtime_ns
    return 0


def _rows_by_scene(rows: Any) -> dict[str, Row]:
    """Return scene -> row with the types that every reader expects, whatever the file holds."""
    found = {}
    for row in rows if isinstance(rows, list) else []:
        if not isinstance(row, dict) or not isinstance(row.get("scene"), str):
            continue
        seconds = row.get("seconds")
        if not isinstance(seconds, dict) or not all(isinstance(s, int | float) for s in seconds.values()):
            row["seconds"] = {}
        if not isinstance(row.get("peak_memory"), int):
            row["peak_memory"] = None
        row["source"] = str(row.get("source") or "")
        row["status"], row["error"] = str(row.get("status")), str(row.get("error") or "")
        found[row["scene"]] = row
    return found
