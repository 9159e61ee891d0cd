"""Files ``report.json`` and ``report.csv``: the rows of a run, written and read back.

Processes that share a run write files of the same form, see ``report_parts``.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

from depthcli.core.errors import InputError
from depthcli.io.formats.files import atomic_path, open_regular
from depthcli.run.json_csv import Row, to_json_line, write_csv
from depthcli.run.records import MAX_TEXT_BYTES, RUN_FILE, Record, digest, read_json, read_text

REPORT_FILES = ("report.json", "report.csv")
PARTS_FOLDER, PARTS = ".parts", "*-of-*.json"
"""In a run folder: the reports of the processes that share the run, and the pattern of their names."""

_ROW_START = b'  {"scene": '  # how a row begins; see write_rows
MEASURED = ("seconds", "peak_memory", "program_cpu", "program_memory", "source")
"""Columns of a report that differ when a scene is computed again; no record holds them."""
_MEASURED_COLUMNS = frozenset({"scene", "status", "error", *MEASURED})


def finished_row(known: Record, measured: Mapping[str, object]) -> Row:
    """Return the row of a finished scene: the facts of its record, and what was measured when it was computed."""
    return {
        "scene": known.scene,
        "status": "done",
        "error": "",
        **{sys.intern(key): value for key, value in known.facts.items()},  # one string for all rows
        "seconds": measured.get("seconds") or {},
        "peak_memory": measured.get("peak_memory"),
        **{key: measured[key] for key in ("program_cpu", "program_memory") if key in measured},
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
    if os.path.isdir(folder / PARTS_FOLDER):
        run = digest(read_text(folder / RUN_FILE).encode())
        for part in sorted((folder / PARTS_FOLDER).glob(PARTS), key=lambda path: (_modified(path), path.name)):
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
