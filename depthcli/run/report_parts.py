"""The reports of the processes that share a run: each writes its own, a part, into ``.parts/``; the last joins them.

Beside the parts lies the list of all scenes, by which ``merge`` knows what no process has computed.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.formats.files import ends_of_file, remove_temporaries, write_text
from depthcli.run.json_csv import Row, to_json_line
from depthcli.run.records import read_json, read_record
from depthcli.run.reports import PARTS, PARTS_FOLDER, finished_row, read_report, write_report, write_rows
from depthcli.run.sharing import FolderLock, Shard

_SCENES_FILE = "scenes.json"  # beside the parts
_MAX_SHARDS = 999_999  # as of --shard
_MIN_PAUSE = 1.0  # seconds between two writes of the report
_MAX_SHARE = 0.05  # of the time may be spent on writing the report
# How a part begins; see Part.write.
_PART_START = re.compile(rb'\{\n "command": "[^"]*",\n "run": "(\w+)",\n "inputs": "(\w+)"')


@dataclass(frozen=True)
class Part:
    """Which run, inputs and shard the report of one process belongs to.

    Attributes
    ----------
    command : name of the command
    run : identity of the run
    shard : the part of a shared run; None: all of a run, whose report needs no joining
    inputs : digest of the inputs of all shards; empty without a shard
    names : the scenes of all shards; empty without a shard
    """

    command: str
    run: str
    shard: Shard | None = None
    inputs: str = ""
    names: tuple[str, ...] = ()

    def begin(self, output: Path) -> None:
        """Begin the report of a shard; ConfigError where another shard of the run computes other inputs."""
        if self.shard is None:
            return
        parts = {file.stem: its for file, (run, its) in _parts(output).items() if run == self.run}
        others = {shard for shard, its in parts.items() if its != self.inputs and shard != str(self.shard)}
        if others:
            raise ConfigError(
                f"{output}: shard {' and '.join(sorted(others))} of this run computed other inputs than these; give "
                "all shards the same scenes, or choose another --output, or --overwrite it"
            )
        if _listed(output, self.inputs) != list(self.names):
            write_text(output / PARTS_FOLDER / _SCENES_FILE, to_json_line({"inputs": self.inputs, "names": self.names}))
        if parts.get(str(self.shard)) != self.inputs:  # none, or what this shard made of other inputs
            self.write(output, [], ended=False)

    def write(self, output: Path, rows: list[Row], ended: bool) -> None:
        """Write the report, which says whether the shard ``ended``; OutputError where that is impossible."""
        if self.shard is None:
            write_report(output, self.command, rows)
            return
        before = {"command": self.command, "run": self.run, "inputs": self.inputs}
        write_rows(output / PARTS_FOLDER / f"{self.shard}.json", rows, before, {"ended": ended})


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

    def update(self) -> None:
        """Write the report, unless it was written shortly before."""
        if time.monotonic() - self._written > self._pause:
            self._write(ended=False)

    def _write(self, ended: bool) -> None:
        start = time.monotonic()
        rows = [self.rows[name] for name in self.order if name in self.rows]
        try:
            self.part.write(self.output, sorted(self.others + rows, key=lambda row: str(row["scene"])), ended)
            self.problem = ""
        except OutputError as error:  # a scene that cannot be written reports that itself
            self.problem = str(error)
        self._written = time.monotonic()
        self._pause = max(_MIN_PAUSE, (self._written - start) / _MAX_SHARE)

    def close(self, lock: FolderLock, complete: bool) -> None:
        """Write the report for the last time; the last process of a shared run joins the reports of all.

        Parameters
        ----------
        complete : whether all scenes of this call were computed
        """
        self._write(ended=complete)
        if self.part.shard is None:
            drop_parts(self.output)
            return
        last = lock.last()
        with contextlib.nullcontext() if last else lock.reporting():
            try:
                rows = joined_rows(self.output, self.part.run)
                write_report(self.output, self.part.command, rows)
            except (OutputError, ConfigError) as error:
                self.problem = str(error)
                return
            if last:
                drop_joined_parts(self.output, self.part.run, rows)


def _parts(output: Path) -> dict[Path, tuple[str, str]]:
    """Return file of a part -> its run and the digest of the inputs of all shards; both empty in a damaged one."""
    found = {}
    for file in sorted((output / PARTS_FOLDER).glob(PARTS)):
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
        if keep is None:  # the run has ended: nobody else writes here
            remove_temporaries(output / PARTS_FOLDER)
            (output / PARTS_FOLDER / _SCENES_FILE).unlink(missing_ok=True)
        (output / PARTS_FOLDER).rmdir()


def drop_joined_parts(output: Path, run: str, rows: Iterable[Row]) -> None:
    """Delete the reports of the shards when all have ended, or all of the run's scenes have a row of the joined report.

    Until then they say which inputs belong together. A shard that was killed or stopped has not ended.
    """
    parts = _parts(output)
    listed = _listed(output, next((inputs for its_run, inputs in parts.values() if its_run == run), ""))
    everything_there = listed and {row["scene"] for row in rows}.issuperset(listed)
    if everything_there or any(not left for left in _unfinished_shards(output, parts).values()):
        drop_parts(output)


def _unfinished_shards(output: Path, files: Iterable[Path]) -> dict[int, list[int]]:
    """Return number of parts -> the shards among them that have not ended, for every division that ``files`` tell."""
    ended: dict[int, set[int]] = {}
    for file in files:
        index, _, count = file.stem.partition("-of-")
        if index.isdigit() and count.isdigit() and 1 <= int(index) <= int(count) <= _MAX_SHARDS:
            end = ends_of_file(file)
            ended.setdefault(int(count), set()).update(
                [int(index)] if end is not None and b'"ended": true' in end[2] else []
            )
    return {count: [k for k in range(1, count + 1) if k not in done] for count, done in ended.items()}


def _listed(output: Path, inputs: str) -> list[str]:
    """Return the scenes of all shards that compute these ``inputs``; empty where no file lists them."""
    document = read_json(output / PARTS_FOLDER / _SCENES_FILE)
    names = document.get("names") if isinstance(document, dict) and document.get("inputs") == inputs else None
    return [str(name) for name in names] if isinstance(names, list) else []


def missing_parts(output: Path, run: str, rows: Iterable[Row]) -> tuple[list[str], list[str]]:
    """Return what a shared run lacks: shards that have not ended, such as "3 of 8", and scenes that have no row.

    Parameters
    ----------
    run : identity of the run
    rows : the joined rows

    Returns
    -------
    Two empty lists where all scenes have a row, and where nothing tells that the run was shared.
    """
    parts = {file: inputs for file, (its_run, inputs) in _parts(output).items() if its_run == run}
    there = {row["scene"] for row in rows}
    listed = _listed(output, next(iter(parts.values()), ""))
    names = [name for name in listed if name not in there]
    if listed and not names:
        return [], []
    unfinished = _unfinished_shards(output, parts)
    if not all(unfinished.values()):  # one division of the scenes is complete
        return [], names
    return [f"{index} of {count}" for count, left in sorted(unfinished.items()) for index in left], names


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
            "again from the same scenes, into another folder"
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
