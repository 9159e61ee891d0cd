"""Files that describe a run folder: ``run.yaml``, one record per scene, and the reports, read back.

The bytes in a run folder do not depend on interruptions or on the number of threads; only ``report.json`` and
``report.csv`` differ from run to run, by measured seconds and memory and by the paths of the inputs.

None of these files is trusted when it is read: a record may name only files in its own folder, holds a digest of
itself and of each of them, and is ignored where a digest does not match.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli import __version__
from depthcli.batch.json_csv import Row, to_json
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.data.formats.files import MAX_BYTES, open_regular, write_text
from depthcli.data.formats.images import IMAGE_SUFFIXES

RUN_FILE = "run.yaml"
RECORD_FILE = "record.json"
REPORT_FILES = ("report.json", "report.csv")
PARTS_FOLDER = ".parts"
"""Reports of the processes that share a run, until they are joined."""

# The line of a row in a report begins with this; see report_writer.write_rows.
_ROW_START = '  {"scene": '
# Columns of a report that a scene's record does not hold.
_MEASURED_COLUMNS = frozenset({"scene", "status", "error", "seconds", "peak_memory", "source"})
# Packages whose versions decide what a run computes; part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
# The digest at the end of a record stands between these two.
_BEFORE_DIGEST, _AFTER_DIGEST = ',\n "check": ', "\n}\n"
# A report of 100,000 scenes has about 60 MB; larger files are not ours.
_MAX_TEXT_BYTES = 1 << 28
# Volumes may be large; without a bound a sparse file of no size on disk would be read for hours.
_MAX_HASHED_BYTES = 1 << 36


@dataclass(frozen=True)
class SceneRecord:
    """What a finished scene was made from and consists of; the last file that is written into its folder.

    Attributes
    ----------
    scene : name of the scene
    run : identity of the run, the digest of its ``run.yaml``
    inputs : role -> digest of an input file, and whatever else the result depends on
    files : path below the scene's folder -> digest of the file
    facts : columns of the report that do not change when the scene is computed again
    """

    scene: str
    run: str
    inputs: dict[str, str]
    files: dict[str, str]
    facts: Row

    def is_done(self, folder: Path, run: str, inputs: Mapping[str, str]) -> bool:
        """Return True where this run made the scene from these inputs and all its files in ``folder`` are unchanged."""
        made = self.run == run and self.inputs == dict(inputs)
        return made and all(file_digest(folder / name) == content for name, content in self.files.items())


def run_text(command: str, config: BaseModel | Mapping[str, object]) -> str:
    """Return the text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions."""
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    run = to_yaml({"run": {"command": command, "versions": versions}})
    title = "# Written by depthcli: the resolved config of this run."
    if isinstance(config, BaseModel):
        return f"{title} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
    return f"{title}\n{to_yaml(dict(config))}{run}"


def digest(data: bytes) -> str:
    """Return the SHA-256 digest in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, or the reason why it cannot be read, which never equals a digest."""
    limit = MAX_BYTES if path.suffix.lower() in IMAGE_SUFFIXES else _MAX_HASHED_BYTES
    sha, left = hashlib.sha256(), limit
    try:
        with open_regular(path) as file:
            while block := file.read(1 << 20):
                sha.update(block)
                left -= len(block)
                if left < 0:
                    return f"unreadable: larger than {limit >> 30} GiB"
    except InputError as error:
        return f"unreadable: {error}"
    return sha.hexdigest()


def open_run(folder: Path, text: str, overwrite: bool) -> None:
    """Write ``text`` as the ``run.yaml`` of a folder, which is made where it is missing.

    A ``run.yaml`` that differs is replaced as long as the folder holds no finished scene.

    Raises
    ------
    ConfigError
        The folder holds results of another config, and ``overwrite`` is not set.
    OutputError
        The folder cannot be written.
    """
    file = folder / RUN_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        known = _read_text(file) if os.path.lexists(file) else None
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
    if known != text:
        write_text(file, text)


def holds_another(folder: Path, text: str) -> bool:
    """Return True where a folder holds results of a run other than ``text``, so that :func:`open_run` refuses it."""
    if not os.path.lexists(folder / RUN_FILE) or saved_config(folder) == text:
        return False
    return any(row["status"] == "done" for row in read_report(folder).values()) or any(folder.glob(f"*/{RECORD_FILE}"))


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
    return _read_text(folder / RUN_FILE)


def write_record(folder: Path, record: SceneRecord) -> None:
    """Write a record, with a digest of itself at its end, into a scene's folder."""
    content = to_json(asdict(record))
    check = f'{_BEFORE_DIGEST}"{digest(content.encode("utf-8"))}"{_AFTER_DIGEST}'
    write_text(folder / RECORD_FILE, content.removesuffix(_AFTER_DIGEST) + check)


def read_record(folder: Path) -> SceneRecord | None:
    """Return the record of a scene's folder; None where it is missing, damaged, or names files elsewhere."""
    # The digest is that of the text without it, so that nothing has to be encoded again.
    content, found, check = _read_text(folder / RECORD_FILE).rpartition(_BEFORE_DIGEST)
    content += _AFTER_DIGEST
    if not found or check != f'"{digest(content.encode("utf-8", "surrogatepass"))}"{_AFTER_DIGEST}':
        return None
    try:
        record = SceneRecord(**json.loads(content))
    except (ValueError, TypeError, RecursionError):
        return None
    if not all(isinstance(each, dict) for each in (record.inputs, record.files, record.facts)):
        return None
    return record if all(is_inside(name) for name in record.files) else None


def reported_record(output: Path, name: str) -> SceneRecord | None:
    """Return the record of a scene that a report names; None also where the name leads out of the run folder."""
    return read_record(output / name) if is_inside(name) else None


def remove_scene(folder: Path, record: SceneRecord) -> None:
    """Delete the files that a record lists, the record first; other files in the folder stay."""
    (folder / RECORD_FILE).unlink(missing_ok=True)
    folders = {folder}
    for name in record.files:
        (folder / name).unlink(missing_ok=True)
        folders.add((folder / name).parent)
    for each in sorted(folders, key=lambda path: -len(path.parts)):
        with contextlib.suppress(OSError):  # it is not empty
            each.rmdir()


def is_inside(name: str) -> bool:
    """Return True for a relative path, with ``/``, that stays within its folder."""
    return not any(part in ("", ".", "..") or "\0" in part for part in name.split("/"))


def read_report(folder: Path, facts: bool = True) -> dict[str, Row]:
    """Return the rows of a run folder's report by scene; empty where there is none.

    Rows of processes that share the run and whose reports are not joined yet are among them, the newest last.

    Parameters
    ----------
    facts : False leaves out the columns that the scenes' records hold as well, which saves memory for long reports
    """
    rows = _rows_by_scene(_rows_of_file(folder / REPORT_FILES[0], None if facts else _MEASURED_COLUMNS))
    parts = sorted((folder / PARTS_FOLDER).glob("*.json"), key=lambda path: (_modified(path), path.name))
    if parts:
        run = digest(saved_config(folder).encode())
        for part in parts:
            document = _read_json(part)
            if isinstance(document, dict) and document.get("run") == run:
                rows |= _rows_by_scene(document.get("scenes"))
    return rows


def _rows_of_file(path: Path, keys: frozenset[str] | None) -> Any:
    """Return all rows of a report, reduced to ``keys``; one of ours is read line by line, which saves memory."""
    rows = []
    try:
        if path.is_file() and path.stat().st_size <= _MAX_TEXT_BYTES:
            with path.open(encoding="utf-8", errors="replace") as file:
                for line in file:
                    if line.startswith(_ROW_START):
                        row = json.loads(line.rstrip().rstrip(","), object_pairs_hook=_with_interned_keys)
                        rows.append(row if keys is None else {key: row[key] for key in row if key in keys})
    except (OSError, ValueError, RecursionError):
        return []
    if rows:
        return rows
    document = _read_json(path)
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


def _read_text(path: Path) -> str:
    """Return the text of a regular file of reasonable size, empty for any other."""
    try:
        if path.is_file() and path.stat().st_size <= _MAX_TEXT_BYTES:
            return path.read_text("utf-8", "replace")
    except OSError:
        pass
    return ""


def _read_json(path: Path) -> Any:
    try:
        return json.loads(_read_text(path))
    except (ValueError, RecursionError):
        return None
