"""Files ``report.json`` and ``report.csv``: written while a run goes on, and joined where processes shared it."""

from __future__ import annotations

import contextlib
import re
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TextIO

from depthcli.batch.json_csv import Row, to_json_line, write_csv
from depthcli.batch.records import SceneRecord
from depthcli.batch.run_folder import PARTS_FOLDER, REPORT_FILES, read_report, reported_record
from depthcli.batch.sharing import FolderLock, Shard
from depthcli.core.errors import ConfigError, OutputError
from depthcli.data.formats.files import atomic_path, ends_of_file
from depthcli.data.scenes import Scene

_MIN_PAUSE = 1.0  # seconds between two writes of the report
# How the report of a shard begins; see write_rows.
_PART_START = re.compile(rb'\{\n "command": "[^"]*",\n "run": "(\w+)",\n "inputs": "(\w+)"')
_MAX_SHARE = 0.05  # of the time may be spent on writing the report


class ReportWriter:
    """Keeps the report on disk up to date, without writing it again after each of a thousand scenes.

    Parameters
    ----------
    output, command : the run folder, and the command that fills it
    run : identity of the run
    rows : scene -> row; the caller adds to it
    scenes : scenes of this call, in order
    others : rows of scenes of the same run that are not part of this call
    shard : the part of a shared run, which gets a report of its own until all are joined; None for the whole
    inputs : digest of the inputs of all shards

    Attributes
    ----------
    problem : why the report could not be written the last time, or empty
    """

    def __init__(
        self,
        output: Path,
        command: str,
        run: str,
        rows: dict[str, Row],
        scenes: Sequence[Scene],
        others: list[Row],
        shard: Shard | None,
        inputs: str,
    ) -> None:
        self.output, self.command, self.run, self.rows, self.others = output, command, run, rows, others
        self.order = [scene.name for scene in scenes]
        self.shard, self.inputs = shard, inputs
        self.written, self.pause = 0.0, _MIN_PAUSE
        self.problem = ""

    def update(self, final: bool = False) -> None:
        """Write the report, unless that was done a moment ago."""
        start = time.monotonic()
        if not final and start - self.written <= self.pause:
            return
        rows = [self.rows[name] for name in self.order if name in self.rows]
        rows = sorted(self.others + rows, key=lambda row: str(row["scene"]))
        try:
            if self.shard is None:
                write_report(self.output, self.command, rows)
            else:
                _write_part(self.output, self.command, self.run, self.shard, self.inputs, rows, final)
            self.problem = ""
        except OutputError as error:  # a scene that cannot be written reports that itself
            self.problem = str(error)
        self.written = time.monotonic()
        self.pause = max(_MIN_PAUSE, (self.written - start) / _MAX_SHARE)

    def close(self, lock: FolderLock) -> None:
        """Write the report for the last time; the last process of a shared run joins the reports of all."""
        self.update(final=True)
        if self.shard is None:
            drop_parts(self.output)
            return
        last = lock.last()
        with contextlib.nullcontext() if last else lock.reporting():
            try:
                write_report(self.output, self.command, joined_rows(self.output, self.run))
            except (OutputError, ConfigError) as error:
                self.problem = str(error)
                return
            if last:
                drop_joined_parts(self.output)


def open_part(output: Path, command: str, run: str, shard: Shard, inputs: str) -> None:
    """Begin the report of a shard; ConfigError where another shard of the run computes other inputs."""
    others = {part.stem for part, (its_run, its) in _parts(output).items() if its_run == run and its != inputs}
    if others:
        raise ConfigError(
            f"{output}: shard {' and '.join(sorted(others))} of this run computed other inputs than these; give all "
            "shards the same --input and --scenes, or choose another --output, or --overwrite it"
        )
    if not (output / PARTS_FOLDER / f"{shard}.json").is_file():
        _write_part(output, command, run, shard, inputs, [], ended=False)


def _write_part(output: Path, command: str, run: str, shard: Shard, inputs: str, rows: list[Row], ended: bool) -> None:
    before = {"command": command, "run": run, "inputs": inputs}
    write_rows(output / PARTS_FOLDER / f"{shard}.json", rows, before, {"ended": ended})


def _parts(output: Path) -> dict[Path, tuple[str, str]]:
    """Return report of a shard -> its run and the digest of the inputs of all shards."""
    found = {}
    for part in sorted((output / PARTS_FOLDER).glob("*-of-*.json")):
        ends = ends_of_file(part)
        about = ends and _PART_START.match(ends[1])
        found[part] = (about[1].decode(), about[2].decode()) if about else ("", "")
    return found


def drop_parts(output: Path, other_than: tuple[str, str] | None = None) -> None:
    """Delete the reports of the processes that shared a run, but for those of this run with these inputs."""
    with contextlib.suppress(OSError):
        for part, about in _parts(output).items():
            if about != other_than:
                part.unlink()
        (output / PARTS_FOLDER).rmdir()


def drop_joined_parts(output: Path) -> None:
    """Delete the reports of the shards when all have ended; until then they say which inputs belong together.

    A shard that was killed has not ended.
    """
    ends = {part.stem: ends_of_file(part) for part in _parts(output)}
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
    by_inputs = {inputs: part.stem for part, (its_run, inputs) in _parts(output).items() if its_run == run}
    if len(by_inputs) > 1:
        raise ConfigError(
            f"{output}: its shards {' and '.join(sorted(by_inputs.values()))} computed different inputs; compute all "
            "again from the same --input and --scenes, with --overwrite"
        )
    rows: dict[str, Row] = {name: {} for name in names} | read_report(output)
    found = []
    for name, row in sorted(rows.items()):
        known = reported_record(output, name)
        if known is not None and known.run == run:
            found.append(finished_row(known, row))
        elif row.get("status") == "failed":
            found.append(row)
    return found


def finished_row(known: SceneRecord, measured: Mapping[str, object]) -> Row:
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


def failed_row(scene: str, error: str, source: str) -> Row:
    """Return the row of a scene that could not be computed."""
    return {
        "scene": scene, "status": "failed", "error": error, "seconds": {}, "peak_memory": None, "source": source,
    }  # fmt: skip


def report_document(command: str, rows: list[Row]) -> Row:
    """Return the report as one JSON document."""
    failed = sum(row["status"] == "failed" for row in rows)
    return {"command": command, "scenes": rows, "done": len(rows) - failed, "failed": failed}


def write_report(folder: Path, command: str, rows: list[Row]) -> None:
    """Write ``report.json`` and ``report.csv``, one row per scene; OutputError where that is impossible."""
    failed = sum(row["status"] == "failed" for row in rows)
    write_rows(folder / REPORT_FILES[0], rows, {"command": command}, {"done": len(rows) - failed, "failed": failed})
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
