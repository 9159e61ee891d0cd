"""What a run folder says about itself: ``run.yaml``, ``report.json``, ``report.csv``, and a record an scene.

Everything in a run folder is the same, byte by byte, whether the run was disturbed or not, on any
number of threads; only ``report.json`` and ``report.csv`` differ from run to run, by the measured
seconds and memory and the places of the inputs that they hold.

None of these files is trusted when it is read back: a record names only files of its own folder, carries a digest
of itself and of each of them, and counts for nothing where one does not fit.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
import platform
import re
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.data.formats.atomic import atomic_path, write_text
from depthcli.data.formats.files import MOST_BYTES, open_regular
from depthcli.data.formats.images import IMAGE_SUFFIXES

RUN_FILE = "run.yaml"
RECORD_FILE = "record.json"
REPORT_FILES = ("report.json", "report.csv")
PARTS_FOLDER = ".parts"
"""Reports of the processes that share a run, until they are joined."""

_ROW = '  {"scene": '  # how the line of a row begins in a report
_MEASURED = frozenset({"scene", "status", "error", "seconds", "peak_memory", "source"})
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
_MOST_BYTES = 1 << 28
_CHECK, _END = ',\n "check": ', "\n}\n"  # what stands before a record's digest, and behind it
_MOST_HASHED = 1 << 36  # of volumes; a sparse file costs nothing but the time to read it


def run_text(command: str, config: BaseModel | Mapping[str, object]) -> str:
    """The text of ``run.yaml``: the resolved config and what the run was made with; for configs, itself one."""
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    run = {"command": command, "versions": versions}
    title = "# Written by depthcli: the resolved config of this run."
    if isinstance(config, BaseModel):
        return f"{title} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{to_yaml({'run': run})}"
    return f"{title}\n{to_yaml(dict(config))}{to_yaml({'run': run})}"


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digest(path: Path) -> str:
    """SHA-256 of a file's content; where it cannot be read, why not, so that it never matches a record."""
    most = MOST_BYTES if path.suffix.lower() in IMAGE_SUFFIXES else _MOST_HASHED
    sha, left = hashlib.sha256(), most
    try:
        with open_regular(path) as file:
            while block := file.read(1 << 20):
                sha.update(block)
                left -= len(block)
                if left < 0:
                    return f"unreadable: larger than {most >> 30} GiB"
    except InputError as error:
        return f"unreadable: {error}"
    return sha.hexdigest()


def open_run(folder: Path, text: str, overwrite: bool) -> str:
    """Make ``folder`` the run that ``text`` describes; return the run's identity.

    A folder in which no scene was finished yet may change its mind.

    Raises
    ------
    ConfigError
        The folder holds a run made with another config, and ``overwrite`` is not set.
    OutputError
        The folder cannot be written.
    """
    file = folder / RUN_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        before = _read_text(file) if os.path.lexists(file) else None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be used as a run folder ({error.strerror or error})") from error
    if before is not None and before != text and not overwrite and _any_done(folder):
        old, new = before.splitlines(), text.splitlines()
        gone = [line.strip() for line in old if line not in new and not line.startswith("#")]
        come = [line.strip() for line in new if line not in old and not line.startswith("#")]
        what = f"it says {'; '.join(gone[:3])!r}, this run {'; '.join(come[:3])!r}"
        what = what if before else f"its {RUN_FILE} cannot be read"
        raise ConfigError(
            f"{folder}: holds a run made with another config ({what}); choose another --output, or --overwrite it"
        )
    if before != text:
        write_text(file, text)
    return digest(text.encode())


def saved_config(folder: Path) -> str:
    """The text of a run folder's ``run.yaml``; empty where there is none, or none that can be read."""
    return _read_text(folder / RUN_FILE)


def holds_another(folder: Path, text: str) -> bool:
    """The folder holds results of a run that ``text`` does not describe, so that :func:`open_run` refuses it."""
    return os.path.lexists(folder / RUN_FILE) and saved_config(folder) != text and _any_done(folder)


def opened_run(folder: Path) -> tuple[str, str]:
    """Identity and command of the run that a folder holds; InputError where it holds none."""
    text = _read_text(folder / RUN_FILE)
    command = re.search(r"^run:\n  command: (\S+)$", text, re.MULTILINE)
    if command is None:
        raise InputError(f"{folder}: no run there ({RUN_FILE})")
    return digest(text.encode()), command[1]


def join_run(folder: Path, text: str) -> str:
    """The identity of the run that others have opened there; ConfigError where it is not the one of ``text``."""
    if _read_text(folder / RUN_FILE) != text:
        raise ConfigError(f"{folder}: another depthcli writes a run of another config there; choose another --output")
    return digest(text.encode())


def _any_done(folder: Path) -> bool:
    return any(row["status"] == "done" for row in read_report(folder).values()) or any(folder.glob(f"*/{RECORD_FILE}"))


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write ``record``, with a digest of itself, into an item's folder."""
    content = to_json(record)
    write_text(folder / RECORD_FILE, f'{content.removesuffix(_END)}{_CHECK}"{digest(content.encode("utf-8"))}"{_END}')


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record of an item's folder, or None where there is none that can be trusted."""
    # The digest is that of the text without it, so that nothing has to be encoded again.
    content, found, check = _read_text(folder / RECORD_FILE).rpartition(_CHECK)
    content += _END
    if not found or check != f'"{digest(content.encode("utf-8", "surrogatepass"))}"{_END}':
        return None
    try:
        record = json.loads(content)
    except (ValueError, RecursionError):
        return None
    if not isinstance(record, dict) or not isinstance(record.get("facts"), dict):
        return None
    files = record.get("files")
    # A name that leads out of the folder must not be looked at, let alone deleted.
    if not isinstance(files, dict) or not all(isinstance(d, str) and is_inside(name) for name, d in files.items()):
        return None
    return record


def is_inside(name: str) -> bool:
    """A relative name, with ``/``, that does not lead out of its folder."""
    return not any(part in ("", ".", "..") or "\0" in part for part in name.split("/"))


def is_done(folder: Path, run: str, inputs: Mapping[str, str], record: dict[str, Any] | None) -> bool:
    """True where ``record`` was made by this run from these inputs and its files are still there, whole."""
    if record is None or record.get("run") != run or record.get("inputs") != dict(inputs):
        return False
    return all(file_digest(folder / name) == content for name, content in record["files"].items())


def read_report(folder: Path, facts: bool = True) -> dict[str, dict[str, Any]]:
    """Rows of an earlier report by scene: what is only measured, and where the inputs were.

    Of a run that several processes share, also the rows of their parts that are not joined yet, the newest last.
    Without ``facts`` the rows lack what the scenes' records say, too: there may be many.
    """
    found = _rows_of(_rows_in(folder / REPORT_FILES[0], None if facts else _MEASURED))
    parts = sorted((folder / PARTS_FOLDER).glob("*.json"), key=lambda path: (_age(path), path.name))
    if parts:
        run = digest(_read_text(folder / RUN_FILE).encode())
        for part in parts:
            document = _read_json(part)
            if isinstance(document, dict) and document.get("run") == run:
                found |= _rows_of(document.get("scenes"))
    return found


def _interned(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Of 50,000 rows every key is kept once."""
    return {sys.intern(key): value for key, value in pairs}


def _rows_in(path: Path, keys: frozenset[str] | None) -> list[Any]:
    """The rows of a report, or of each the values of ``keys``; those of ``write_rows`` are read one by one."""
    found = []
    try:
        if path.is_file() and path.stat().st_size <= _MOST_BYTES:
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    if line.startswith(_ROW):
                        row = json.loads(line.rstrip().rstrip(","), object_pairs_hook=_interned)
                        found.append(row if keys is None else {key: row[key] for key in row if key in keys})
    except (OSError, ValueError, RecursionError):
        return []
    if found:
        return found
    document = _read_json(path)
    rows = document.get("scenes") if isinstance(document, dict) else None
    return rows if isinstance(rows, list) else []


def _age(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _rows_of(rows: Any) -> dict[str, dict[str, Any]]:
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


def _read_text(path: Path) -> str:
    """What is in a file that is ours if it is regular and not huge; "" where it cannot be."""
    try:
        if path.is_file() and path.stat().st_size <= _MOST_BYTES:
            return path.read_text("utf-8", "replace")
    except OSError:
        pass
    return ""


def _read_json(path: Path) -> Any:
    try:
        return json.loads(_read_text(path))
    except (ValueError, RecursionError):
        return None


def report_document(command: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The report as one JSON document."""
    failed = sum(row["status"] == "failed" for row in rows)
    return {"command": command, "scenes": rows, "done": len(rows) - failed, "failed": failed}


def write_report(folder: Path, command: str, rows: list[dict[str, Any]]) -> None:
    """Write ``report.json`` and ``report.csv``, one row a scene, row by row: there may be many."""
    failed = sum(row["status"] == "failed" for row in rows)
    ends = {"command": command}, {"done": len(rows) - failed, "failed": failed}
    write_rows(folder / REPORT_FILES[0], rows, *ends)
    columns = list(dict.fromkeys(key for row in rows for key in flat(row)))
    with atomic_path(folder / REPORT_FILES[1]) as path, _writing(path) as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(flat(row) for row in rows)


def write_rows(path: Path, rows: list[dict[str, Any]], before: Mapping[str, Any], behind: Mapping[str, Any]) -> None:
    """Write a JSON document with ``rows`` under ``scenes``, a line each, between what else it holds."""
    with atomic_path(path) as temporary, _writing(temporary) as file:
        file.write("{" + "".join(f"\n {_line(key)}: {_line(value)}," for key, value in before.items()))
        file.write('\n "scenes": [')
        for number, row in enumerate(rows):
            file.write((",\n  " if number else "\n  ") + _line(row))
        file.write("\n ]" + "".join(f",\n {_line(key)}: {_line(value)}" for key, value in behind.items()) + "\n}\n")


def _writing(path: Path) -> TextIO:
    return path.open("w", 1 << 20, "utf-8", "backslashreplace", "")


def _line(value: Any) -> str:
    """Strict JSON on one line."""
    try:
        text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    except (ValueError, TypeError):  # numbers that are not finite, or of numpy
        text = json.dumps(_finite(value), ensure_ascii=False, allow_nan=False)
    if not text.isascii():
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:  # a file name that is not UTF-8
            text = json.dumps(_finite(value), allow_nan=False)
    return text


def flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings as ``outer_inner`` columns."""
    out: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            out.update({f"{key}_{inner}": v for inner, v in value.items()})
        else:
            out[key] = value
    return out


def to_csv(rows: list[dict[str, Any]]) -> str:
    """Rows as CSV with a header; columns in the order of their first appearance."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def to_json(value: Any) -> str:
    """Strict JSON: numbers that are not finite become null."""
    plain = _finite(value)
    text = json.dumps(plain, indent=1, ensure_ascii=False, allow_nan=False)
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:  # a file name that is not UTF-8: escaped, it reads back as it is
        text = json.dumps(plain, indent=1, allow_nan=False)
    return text + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
