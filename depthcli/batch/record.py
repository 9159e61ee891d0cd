"""What a run folder says about itself: ``run.yaml``, ``report.json``, ``report.csv``, and a record a scene.

Everything in a run folder is the same, byte by byte, whether the run was disturbed or not, on any
number of threads; only ``report.json`` and ``report.csv`` differ from run to run, by the measured
seconds and memory they hold.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.atomic import write_text

RUN_FILE = "run.yaml"
RECORD_FILE = "record.json"
REPORT_FILES = ("report.json", "report.csv")

_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")


def run_text(command: str, config: BaseModel) -> str:
    """The text of ``run.yaml``: the resolved config and what the run was made with; itself a config."""
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    run = {"command": command, "backend": "numba-cpu", "versions": versions}
    return (
        f"# Written by depthcli: the resolved config of this run. Repeat it with: depthcli {command} run.yaml ...\n"
        + dump_config(config)
        + to_yaml({"run": run})
    )


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digests(paths: Iterable[Path]) -> dict[str, str]:
    """Name -> SHA-256 of files that can be read; others say why not, so that they never match a record."""
    found = {}
    for path in paths:
        try:
            with path.open("rb") as file:
                found[path.name] = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            found[path.name] = f"unreadable: {error.strerror}"
    return found


def open_run(folder: Path, text: str, overwrite: bool) -> str:
    """Make ``folder`` the run that ``text`` describes; return the run's identity.

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
        before = file.read_text("utf-8") if file.exists() else None
    except (OSError, UnicodeDecodeError) as error:
        raise OutputError(f"{folder}: cannot be used as a run folder ({error})") from error
    if before is not None and before != text and not overwrite:
        old, new = before.splitlines(), text.splitlines()
        gone = [line.strip() for line in old if line not in new and not line.startswith("#")]
        come = [line.strip() for line in new if line not in old and not line.startswith("#")]
        what = f"it says {'; '.join(gone[:3])!r}, this run {'; '.join(come[:3])!r}"
        raise ConfigError(
            f"{folder}: holds a run made with another config ({what}); choose another --output, or --overwrite it"
        )
    if before != text:
        write_text(file, text)
    return digest(text.encode())


def read_record(folder: Path) -> dict[str, Any] | None:
    """The record of a scene's folder, or None where there is none that can be trusted."""
    try:
        record = json.loads((folder / RECORD_FILE).read_text("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    files = record.get("files") if isinstance(record, dict) else None
    return record if isinstance(files, dict) else None


def is_done(folder: Path, run: str, inputs: Mapping[str, str], record: dict[str, Any] | None) -> bool:
    """True where ``record`` was made by this run from these inputs and its files are still there."""
    if record is None or record.get("run") != run or record.get("inputs") != dict(inputs):
        return False
    try:
        return all((folder / name).stat().st_size == size for name, size in record["files"].items())
    except (OSError, TypeError):
        return False


def read_report(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows of an earlier report by scene, for the seconds of scenes that are not run again."""
    try:
        rows = json.loads((folder / REPORT_FILES[0]).read_text("utf-8"))["scenes"]
        return {row["scene"]: row for row in rows}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


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
    return json.dumps(_finite(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
