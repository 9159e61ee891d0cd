"""Records of results with their inputs and files, and reports.

Records let a later run resume, and prevent that it replaces files that no run wrote. The folder of a scene or an
evaluation has the results and ``record.json``, which is written last. Results are written to a hidden folder and then
moved. A record is checked when it is read: it may name only files in its own folder, and it has digests of itself and
of each file. The report of a run has the rows of its records.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError, OutputError
from depthcli.io.formats.files import (
    RECORD_FILE,
    file_states,
    flush,
    flush_all,
    open_regular,
    remove_temporaries,
    write_text,
)
from depthcli.show.table import Row, to_csv, to_json

REPORT_FILES = ("report.json", "report.csv")
CLAIM_FILE = ".claim.json"
"""Record of results that are being written or removed: they are not done, but their files may be replaced."""

OTHER_RUN = "has a scene of another run; choose another --output, or --overwrite it"
PARTIAL_PREFIX = ".partial-"
"""Prefix of the hidden folders that results are written to; killed runs leave such folders."""

_MAX_TEXT_BYTES = 1 << 28  # a report of 100,000 scenes has about 60 MB; depthcli writes no larger files
_MAX_NAMED = 3  # files to name in a message


@dataclass(frozen=True)
class Record:
    """The inputs and files of results."""

    scene: str  # its name; empty for an evaluation
    run: str  # identity of the run, the digest of its run.yaml; for commands without that file, the command's name
    inputs: dict[str, str]  # role -> digest of an input file or another value that the result depends on
    files: dict[str, str]  # path below the scene's folder -> digest; empty for a failed scene
    row: Row  # of the report


def digest(data: bytes) -> str:
    """Return the SHA-256 digest in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, or the reason if it is unreadable, which never equals a digest."""
    try:
        with open_regular(path) as file:
            sha = hashlib.sha256()
            while block := file.read(1 << 20):
                sha.update(block)
            return sha.hexdigest()
    except (InputError, ValueError) as error:
        return f"unreadable: {error}"


def digest_and_state(path: Path) -> tuple[str, object]:
    """Return the digest of a file, and its state (time, size, inode) before reading."""
    state = file_states(path)
    return file_digest(path), state


def digests_below(folder: Path) -> dict[str, str]:
    """Return path below ``folder`` -> digest, for every file in it."""
    files = filter(Path.is_file, sorted(folder.rglob("*")))
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in files}


def write_record(folder: Path, record: Record) -> None:
    """Write a record with its own digest into a folder of results. Raise OutputError on failure."""
    content = json.loads(to_json(asdict(record)))
    write_text(folder / RECORD_FILE, to_json(content | {"check": _check(content)}))


def read_record(folder: Path, name: str = RECORD_FILE) -> Record | None:
    """Return the record in a folder of results, or None if it is missing or damaged."""
    content = read_json(folder / name)
    if not isinstance(content, dict) or content.pop("check", None) != _check(content):
        return None
    try:
        record = Record(**content)
    except TypeError:
        return None
    return record if all(map(is_inside, record.files)) else None


def _check(content: object) -> str:
    return digest(json.dumps(content, sort_keys=True).encode())


def records_below(folder: Path, run: str) -> Iterator[Record]:
    """Yield the records of a run's scenes, sorted by name; folders inside scenes and hidden folders are skipped."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(each for each in folders if not each.startswith("."))
        if RECORD_FILE in files:
            folders.clear()
            record = read_record(Path(place))
            if record is not None and record.scene and record.run == run:
                yield record


def is_inside(name: str) -> bool:
    """Return whether a path with ``/`` is relative and stays within its folder."""
    return {"", ".", ".."}.isdisjoint(name.split("/")) and "\0" not in name


def read_text(path: Path) -> str:
    """Return the text of a regular file of at most 256 MiB, or an empty text if it cannot be read."""
    try:
        with open_regular(path) as file:
            return file.read(_MAX_TEXT_BYTES).decode("utf-8", "replace").replace("\r\n", "\n")
    except InputError:
        return ""


def read_json(path: Path) -> object:
    """Return the content of a JSON file, or None if it is missing or damaged."""
    try:
        content: object = json.loads(read_text(path))
    except (ValueError, RecursionError):
        return None
    return content


def hidden_folder(folder: Path) -> Path:
    """Return the path of a new hidden folder below ``folder`` for this process's results.

    Its name contains the time, since processes of restarted containers may have the same machine name and id.
    """
    machine = re.sub("[^A-Za-z0-9-]", "_", platform.node())
    return folder / f"{PARTIAL_PREFIX}{machine}-{os.getpid()}-{time.time_ns():x}"


def install(made: Path, folder: Path, record: Record, overwrite: bool = False) -> None:
    """Move results from the hidden folder ``made`` to ``folder``, and replace files that a record claims.

    Raise OutputError, and move nothing, if the folder has results of another run and ``overwrite`` is not set, or if
    files that no record claims have the names of results.

    Files, record and their names are flushed before they are moved, so that a power cut leaves no record without its
    files in ``folder``. The move itself is flushed with the next results, or when the caller flushes the parent folder.
    Until then, a power cut can lose these results, but no others.
    """
    write_record(made, record)
    above = [folder.parent] if folder.parent.is_dir() else []  # of the results before
    flush_all([*map(made.joinpath, [*record.files, RECORD_FILE]), *_folders(made, record), *above])
    earlier = read_record(folder)
    if earlier is not None and earlier.run != record.run and not overwrite:
        raise OutputError(f"{folder}: {OTHER_RUN}")
    if foreign := _foreign_files(folder, record.files):
        raise OutputError(f"{folder}: {not_ours(foreign)}")
    remove_results(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        made.rename(folder)
    except OSError:  # the folder exists and has other files
        folder.mkdir(exist_ok=True)
        # If this is interrupted, the claim tells the next run that it may replace the files.
        os.replace(made / RECORD_FILE, folder / CLAIM_FILE)
        for name in record.files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(made / name, folder / name)
        for path in _folders(folder, record):
            flush(path)
        os.replace(folder / CLAIM_FILE, folder / RECORD_FILE)
        flush(folder)


def _folders(folder: Path, record: Record) -> list[Path]:
    """Return the folders of a record's files, deepest first and ``folder`` last."""
    return sorted({folder, *((folder / name).parent for name in record.files)}, reverse=True)


def record_failure(folder: Path, record: Record, overwrite: bool) -> None:
    """Write the record of a failed scene, if possible, and remove an earlier result.

    Results of another run and files that no record claims are kept.
    """
    earlier = read_record(folder)
    is_ours = earlier is None or earlier.run == record.run or overwrite
    if is_ours and not _foreign_files(folder, {}):
        with contextlib.suppress(OSError, OutputError):
            remove_results(folder)
            write_record(folder, record)


def remove_results(folder: Path) -> None:
    """Delete the files that the records of a folder claim, and empty folders; other files are kept.

    The record is first renamed to a claim. If this is interrupted, the results are not done, but may be replaced.
    """
    for _ in range(2):  # files in an old claim, then files in the record
        folders = {folder}
        claim = read_record(folder, CLAIM_FILE)
        for name in () if claim is None else claim.files:
            (folder / name).unlink(missing_ok=True)
            folders.update(folder / parent for parent in Path(name).parents)
        (folder / CLAIM_FILE).unlink(missing_ok=True)
        for each in sorted(folders, reverse=True):  # inner ones first
            with contextlib.suppress(OSError):  # it is not empty
                each.rmdir()
        if read_record(folder) is not None:
            with contextlib.suppress(FileNotFoundError):
                (folder / RECORD_FILE).replace(folder / CLAIM_FILE)


def discard(folder: Path) -> None:
    """Delete a hidden folder; it is renamed first, so that a process that still writes there fails at once."""
    away = folder.with_name(f"{folder.name}-{time.time_ns()}")
    try:
        folder.rename(away)
    except OSError:
        away = folder
    shutil.rmtree(away, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove leftovers of killed processes from a folder in which no other process writes."""
    for made in folder.glob(f"{PARTIAL_PREFIX}*"):
        if not made.is_symlink():
            discard(made)
    remove_temporaries(folder)


def not_ours(names: Sequence[str]) -> str:
    """Return a message that files that no run wrote are not replaced, with a remedy."""
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return (
        f"{', '.join(names[:_MAX_NAMED])}{more} would be replaced, but no record shows that depthcli wrote "
        f"{'it' if len(names) == 1 else 'them'}; move {'it' if len(names) == 1 else 'them'} away, or choose another "
        "folder of results (only results are ever replaced)"
    )


def _foreign_files(folder: Path, files: Mapping[str, str]) -> list[str]:
    """Return the names in ``files``, name -> digest, that would replace a file that no record claims.

    Files with the same content may be replaced, since nothing is lost. This includes results whose record was lost.
    """
    record, claim = read_record(folder), read_record(folder, CLAIM_FILE)
    claimed = {**(record.files if record else {}), **(claim.files if claim else {})}
    names, is_ours = list[str](), record is not None or claim is not None
    for name, content in files.items():
        if os.path.lexists(folder / name):
            if file_digest(folder / name) == content:
                is_ours = True
            elif name not in claimed:
                names.append(name)
    if not is_ours:
        names += [name for name in (RECORD_FILE, CLAIM_FILE) if os.path.lexists(folder / name)]  # foreign files
    return names


def write_report(folder: Path, command: str, run: str) -> list[Row]:
    """Write the report of all scenes with a record, and return its rows. Raise OutputError on failure."""
    rows = [record.row for record in sorted(records_below(folder, run), key=attrgetter("scene"))]
    document = report_document(command, rows)
    lines = ",\n  ".join(to_json(row, indent=None).rstrip() for row in rows)
    text = to_json(document | {"scenes": []}).replace('"scenes": []', f'"scenes": [\n  {lines}\n ]')
    write_text(folder / REPORT_FILES[0], text)
    write_text(folder / REPORT_FILES[1], to_csv(rows))
    return rows


def is_gone(source: str) -> bool:
    """Return whether a row's source was removed: file and archive are missing, but a folder above exists."""
    above = Path(source).parents
    return not os.path.exists(source) and any(map(os.path.isdir, above[:2])) and not any(map(os.path.isfile, above))


def report_document(command: str, rows: Sequence[Row]) -> dict[str, Any]:
    """Return the document of ``report.json``: command, rows, and numbers of done and failed scenes."""
    failed = sum(row["status"] == "failed" for row in rows)
    return {"command": command, "scenes": list(rows), "done": len(rows) - failed, "failed": failed}


def read_report(folder: Path) -> dict[str, Row]:
    """Return scene -> row of a run folder's report, with the expected types; empty if there is no report."""
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
