"""Files that describe a run folder: ``run.yaml``, one record per scene, and the reports, read back.

The bytes in a run folder do not depend on interruptions or on the number of threads; only ``report.json`` and
``report.csv`` differ from run to run, by measured seconds and memory and by the paths of the inputs.

None of these files is trusted when it is read: a record may name only files in its own folder, holds a digest of
itself and of each of them, and is ignored where a digest does not match.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli import __version__
from depthcli.batch.json_csv import Row
from depthcli.batch.records import (
    MAX_TEXT_BYTES,
    RECORD_FILE,
    SceneRecord,
    digest,
    is_inside,
    read_json,
    read_record,
    read_text,
)
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.data.formats.files import write_text

RUN_FILE = "run.yaml"
REPORT_FILES = ("report.json", "report.csv")
LEGEND_FILE = "legend.png"
PARTS_FOLDER = ".parts"
"""Reports of the processes that share a run, until they are joined."""

# The line of a row in a report begins with this; see report_writer.write_rows.
_ROW_START = '  {"scene": '
# Columns of a report that a scene's record does not hold.
_MEASURED_COLUMNS = frozenset({"scene", "status", "error", "seconds", "peak_memory", "source"})
# Packages whose versions decide what a run computes; part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
# The first line of a run.yaml begins with this; a file of that name without it is not ours.
_TITLE = "# Written by depthcli: the resolved config of this run."


def run_text(command: str, config: BaseModel | Mapping[str, object]) -> str:
    """Return the text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions."""
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    run = to_yaml({"run": {"command": command, "versions": versions}})
    if isinstance(config, BaseModel):
        return f"{_TITLE} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
    return f"{_TITLE}\n{to_yaml(dict(config))}{run}"


def open_run(folder: Path, text: str, overwrite: bool) -> None:
    """Write ``text`` as the ``run.yaml`` of a folder, which is made where it is missing.

    A ``run.yaml`` that differs is replaced as long as the folder holds no finished scene.

    Raises
    ------
    ConfigError
        The folder holds results of another config, and ``overwrite`` is not set; or files that no run wrote have the
        names of a run's.
    OutputError
        The folder cannot be written.
    """
    file = folder / RUN_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        known = read_text(file) if os.path.lexists(file) else None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used as a run folder ({error.strerror or error})") from error
    if holds_another(folder, text) and not overwrite:
        old, new = (known or "").splitlines(), text.splitlines()
        removed = [line.strip() for line in old if line not in new and not line.startswith("#")]
        added = [line.strip() for line in new if line not in old and not line.startswith("#")]
        changes = f"it says {'; '.join(removed[:3])!r}, this run {'; '.join(added[:3])!r}"
        reason = changes if known else f"its {RUN_FILE} cannot be read"
        raise ConfigError(
            f"{folder}: holds a run made with another config ({reason}); choose another --output, or --overwrite it"
        )
    if known == text:
        return
    if not (known or "").startswith(_TITLE) and not _holds_results(folder):
        names = (RUN_FILE, *REPORT_FILES, LEGEND_FILE)
        if foreign := [name for name in names if os.path.lexists(folder / name)]:
            raise ConfigError(f"{folder}: {not_ours(foreign)}")
    write_text(file, text)


def not_ours(names: Sequence[str]) -> str:
    """Return why files that no run wrote are not replaced, and what to do."""
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return (
        f"{names[0]}{more} would be replaced, but no record says that depthcli wrote it; "
        "move it away, or choose another --output or --name (--overwrite replaces only results)"
    )


def holds_another(folder: Path, text: str) -> bool:
    """Return True where a folder holds results of a run other than ``text``, so that :func:`open_run` refuses it."""
    if not os.path.lexists(folder / RUN_FILE) or saved_config(folder) == text:
        return False
    return _holds_results(folder)


def _holds_results(folder: Path) -> bool:
    if any(row["status"] == "done" for row in read_report(folder).values()) or any(folder.glob(f"*/{RECORD_FILE}")):
        return True
    deeper = (path.parents[1] for path in folder.glob(f"*/*/{RECORD_FILE}"))
    return any(not (group / RUN_FILE).exists() for group in deeper)  # with a run.yaml it is a run of its own


def join_run(folder: Path, text: str) -> str:
    """Return the identity of the run that another process opened; ConfigError where it is not the one of ``text``."""
    if saved_config(folder) != text:
        raise ConfigError(f"{folder}: another depthcli writes a run of another config there; choose another --output")
    return digest(text.encode())


def opened_run(folder: Path) -> tuple[str, str]:
    """Return identity and command of the run that a folder holds; InputError where it holds none."""
    text = saved_config(folder)
    command = re.search(r"^run:\n  command: (\S+)$", text, re.MULTILINE)
    if command is None:
        raise InputError(f"{folder}: no run there ({RUN_FILE})")
    return digest(text.encode()), command[1]


def saved_config(folder: Path) -> str:
    """Return the text of a run folder's ``run.yaml``; empty where it is missing or cannot be read."""
    return read_text(folder / RUN_FILE)


def reported_record(output: Path, name: str) -> SceneRecord | None:
    """Return the record of a scene that a report names; None also where the name leads out of the run folder."""
    return read_record(output / name) if is_inside(name) else None


def read_report(folder: Path, facts: bool = True) -> dict[str, Row]:
    """Return the rows of a run folder's report by scene; empty where there is none.

    Rows of processes that share the run and whose reports are not joined yet are among them, the newest last.

    Parameters
    ----------
    facts : False leaves out the columns that the scenes' records hold as well, which saves memory for long reports
    """
    rows = _rows_by_scene(_rows_of_file(folder / REPORT_FILES[0], None if facts else _MEASURED_COLUMNS))
    files = (folder / PARTS_FOLDER).glob("*.json") if os.path.isdir(folder / PARTS_FOLDER) else ()
    parts = sorted(files, key=lambda path: (_modified(path), path.name))
    if parts:
        run = digest(saved_config(folder).encode())
        for part in parts:
            document = read_json(part)
            if isinstance(document, dict) and document.get("run") == run:
                rows |= _rows_by_scene(document.get("scenes"))
    return rows


def _rows_of_file(path: Path, keys: frozenset[str] | None) -> Any:
    """Return all rows of a report, reduced to ``keys``; one of ours is read line by line, which saves memory."""
    rows = []
    try:
        if path.is_file() and path.stat().st_size <= MAX_TEXT_BYTES:
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    if line.startswith(_ROW_START):
                        row = json.loads(line.rstrip().rstrip(","), object_pairs_hook=_with_interned_keys)
                        rows.append(row if keys is None else {key: row[key] for key in row if key in keys})
    except (OSError, ValueError, RecursionError):
        return []
    if rows:
        return rows
    document = read_json(path)
    return document.get("scenes") if isinstance(document, dict) else None


def _with_interned_keys(pairs: list[tuple[str, Any]]) -> Row:
    return {sys.intern(key): value for key, value in pairs}


def _modified(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
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
