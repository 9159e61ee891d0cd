"""What a run folder says about itself: ``run.yaml``, ``report.json``, ``report.csv``, and a record an item.

Everything in a run folder is the same, byte by byte, whether the run was disturbed or not, on any
number of threads; only ``report.json`` and ``report.csv`` differ from run to run, by the measured
seconds and memory and the places of the inputs that they hold.

None of these files is trusted when it is read back: a record names only files of its own folder, carries a digest
of itself and of each of them, and counts for nothing where one does not fit.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.io.atomic import write_text
from depthcli.io.files import MOST_BYTES, open_regular
from depthcli.io.images import IMAGE_SUFFIXES

RUN_FILE = "run.yaml"
RECORD_FILE = "record.json"
REPORT_FILES = ("report.json", "report.csv")

_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
_MOST_BYTES = 1 << 28
_MOST_HASHED = 1 << 36  # of volumes; a sparse file costs nothing but the time to read it


def run_text(command: str, config: BaseModel | Mapping[str, Any]) -> str:
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


@contextlib.contextmanager
def locked(output: Path, say: Callable[[str], None]) -> Iterator[None]:
    """Keep a second run out of the folder; the system drops the lock when this process ends, however it ends."""
    try:
        output.mkdir(parents=True, exist_ok=True)
        handle = os.open(output, os.O_RDONLY)
    except OSError as error:
        raise OutputError(f"{output}: cannot be used as a run folder ({error.strerror or error})") from error
    try:
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{output}: another depthcli is writing there now") from None
        except (ImportError, OSError):
            say(f"{output}: no locks on this file system; see to it that no other run writes there")
        yield
    finally:
        os.close(handle)


def open_run(folder: Path, text: str, overwrite: bool) -> str:
    """Make ``folder`` the run that ``text`` describes; return the run's identity.

    A folder in which no item was finished yet may change its mind.

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


def _any_done(folder: Path) -> bool:
    return any(row["status"] == "done" for row in read_report(folder).values()) or any(folder.glob(f"*/{RECORD_FILE}"))


def write_record(folder: Path, record: Mapping[str, Any]) -> None:
    """Write ``record``, with a digest of itself, into an item's folder."""
    write_text(folder / RECORD_FILE, to_json({**record, "check": _check(record)}))


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record of an item's folder, or None where there is none that can be trusted."""
    record = _read_json(folder / RECORD_FILE)
    if not isinstance(record, dict) or not isinstance(record.get("facts"), dict):
        return None
    files = record.get("files")
    if record.pop("check", None) != _check(record) or not isinstance(files, dict):
        return None
    # A name that leads out of the folder must not be looked at, let alone deleted.
    return record if all(isinstance(d, str) and is_inside(name) for name, d in files.items()) else None


def is_inside(name: str) -> bool:
    """A relative name, with ``/``, that does not lead out of its folder."""
    return not any(part in ("", ".", "..") or "\0" in part for part in name.split("/"))


def _check(record: Mapping[str, Any]) -> str:
    try:
        return digest(to_json(record).encode("utf-8"))
    except (TypeError, ValueError, RecursionError):
        return ""


def is_done(folder: Path, run: str, inputs: Mapping[str, str], record: dict[str, Any] | None) -> bool:
    """True where ``record`` was made by this run from these inputs and its files are still there, whole."""
    if record is None or record.get("run") != run or record.get("inputs") != dict(inputs):
        return False
    return all(file_digest(folder / name) == content for name, content in record["files"].items())


def read_report(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows of an earlier report by scene: what is only measured, and where the inputs were."""
    document = _read_json(folder / REPORT_FILES[0])
    rows = document.get("scenes") if isinstance(document, dict) else None
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
    """Write ``report.json`` and ``report.csv``, one row a scene."""
    write_text(folder / REPORT_FILES[0], to_json(report_document(command, rows)))
    write_text(folder / REPORT_FILES[1], to_csv([flat(row) for row in rows]))


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
