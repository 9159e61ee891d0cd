"""The files ``report.json`` and ``report.csv``: the rows of a run, from its scenes' records."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from depthcli.io.formats.files import write_text
from depthcli.run.folder import REPORT_FILES
from depthcli.run.json_csv import Row, to_json, to_json_line
from depthcli.run.records import read_json, records_below
from depthcli.show.table import to_csv


def write_report(folder: Path, command: str, run: str) -> list[Row]:
    """Write the report of all scenes of a run that have a record, and return its rows; OutputError where impossible."""
    rows = sorted((record.row for record in records_below(folder, run)), key=lambda row: str(row["scene"]))
    document = report_document(command, rows)
    lines = ",\n  ".join(map(to_json_line, rows))
    text = to_json(document | {"scenes": []}).replace('"scenes": []', f'"scenes": [\n  {lines}\n ]')
    write_text(folder / REPORT_FILES[0], text)
    write_text(folder / REPORT_FILES[1], to_csv(rows))
    return rows


def is_gone(source: str) -> bool:
    """Return whether a source of a row was removed: neither the file is there nor an archive, but a folder above it."""
    above = Path(source).parents
    return not os.path.exists(source) and any(map(os.path.isdir, above[:2])) and not any(map(os.path.isfile, above))


def report_document(command: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return the document of ``report.json``: command, rows, and how many are done and failed."""
    failed = sum(row["status"] == "failed" for row in rows)
    return {"command": command, "scenes": list(rows), "done": len(rows) - failed, "failed": failed}


def read_report(folder: Path) -> dict[str, Row]:
    """Return the rows of a run folder's report by scene, with the types that readers expect; empty without a report."""
    document = read_json(folder / REPORT_FILES[0])
    rows = document.get("scenes") if isinstance(document, dict) else None
    found = {}
    for row in rows if isinstance(rows, list) else []:
        if isinstance(row, dict) and isinstance(row.get("scene"), str):
            seconds, peak = row.get("seconds"), row.get("peak_memory")
            known = isinstance(seconds, dict) and all(isinstance(s, int | float) for s in seconds.values())
            row |= {"seconds": seconds if known else {}, "peak_memory": peak if isinstance(peak, int) else None}
            lines = row.get("warnings")
            row["warnings"] = list(map(str, lines)) if isinstance(lines, list) else []
            row |= {key: str(row.get(key) or "") for key in ("status", "error", "source")}
            found[row["scene"]] = row
    return found
