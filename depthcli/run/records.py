"""Records of results: their inputs and files, by which a later run resumes and replaces no other file; and reports.

The folder of a scene has its results and ``record.json``, which is written last; so does an evaluation. Results are
made in a hidden folder and then moved. A record is not trusted when it is read: it may name only files in its own
folder, has a digest of itself and of each of them, and is ignored if a digest does not match. The report of a run has
the rows of its records.
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
from depthcli.io.formats.files import file_states, flush, flush_all, open_regular, remove_temporaries, write_text
from depthcli.show.table import Row, to_csv, to_json

REPORT_FILES = ("report.json", "report.csv")
RECORD_FILE = "record.json"
CLAIM_FILE = ".claim.json"
"""The record of results that are being written or removed: they are not done, but their files may be replaced."""

OTHER_RUN = "has a scene of another run; choose another --output, or --overwrite it"
PARTIAL_PREFIX = ".partial-"
"""Start of the names of hidden folders in which results are made; one without a process is left by a killed run."""

_MAX_TEXT_BYTES = 1 << 28  # a report of 100,000 scenes has about 60 MB; larger files are not ours
_MAX_NAMED = 3  # files that a message names


@dataclass(frozen=True)
class Record:
    """What results were made from and consist of."""

    scene: str  # its name; empty for an evaluation
    run: str  # identity of the run, the digest of its run.yaml; or the name of the command that has no such file
    inputs: dict[str, str]  # role -> digest of an input file, and whatever else the result depends on
    files: dict[str, str]  # path below the scene's folder -> digest of the file
    row: Row  # of the report; of a scene that failed, too, which has no files then

    def is_done(self, folder: Path, run: str, inputs: Mapping[str, str]) -> bool:
        """Return True where this run made the files from these inputs, and all of them are unchanged in ``folder``."""
        made = self.row.get("status") == "done" and self.run == run and self.inputs == dict(inputs)
        return made and all(file_digest(folder / name) == content for name, content in self.files.items())


def digest(data: bytes) -> str:
    """Return the SHA-256 digest in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, or the reason why it cannot be read, which never equals a digest."""
    try:
        with open_regular(path) as file:
            sha = hashlib.sha256()
            while block := file.read(1 << 20):
                sha.update(block)
            return sha.hexdigest()
    except (InputError, ValueError) as error:
        return f"unreadable: {error}"


def digest_and_state(path: Path) -> tuple[str, object]:
    """Return the digest of a file, and its state before it was read, which changes when the file does."""
    state = file_states(path)
    return file_digest(path), state


def digests_below(folder: Path) -> dict[str, str]:
    """Return path below ``folder`` -> digest of every file in it."""
    files = filter(Path.is_file, sorted(folder.rglob("*")))
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in files}


def write_record(folder: Path, record: Record) -> None:
    """Write a record, with a digest of itself, into a folder of results; OutputError where that is impossible."""
    content = json.loads(to_json(asdict(record)))
    write_text(folder / RECORD_FILE, to_json(content | {"check": _check(content)}))


def read_record(folder: Path, name: str = RECORD_FILE) -> Record | None:
    """Return the record in a folder of results; None where it is missing or damaged."""
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
    """Yield the records of all scenes of a run, by name; folders of scenes and hidden ones are not searched."""
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(each for each in folders if not each.startswith("."))
        if RECORD_FILE in files:
            folders.clear()
            record = read_record(Path(place))
            if record is not None and record.scene and record.run == run:
                yield record


def is_inside(name: str) -> bool:
    """Return True for a relative path, with ``/``, that stays within its folder."""
    return {"", ".", ".."}.isdisjoint(name.split("/")) and "\0" not in name


def read_text(path: Path) -> str:
    """Return the text of a regular file of reasonable size, empty for any other."""
    try:
        with open_regular(path) as file:
            return file.read(_MAX_TEXT_BYTES).decode("utf-8", "replace").replace("\r\n", "\n")
    except InputError:
        return ""


def read_json(path: Path) -> object:
    """Return the content of a JSON file; None where it is missing or damaged."""
    try:
        content: object = json.loads(read_text(path))
    except (ValueError, RecursionError):
        return None
    return content


def hidden_folder(folder: Path) -> Path:
    """Return a new hidden folder below ``folder`` in which this process makes results.

    The time is part of its name: processes of restarted containers have the same machine and number again.
    """
    machine = re.sub("[^A-Za-z0-9-]", "_", platform.node())
    return folder / f"{PARTIAL_PREFIX}{machine}-{os.getpid()}-{time.time_ns():x}"


def install(made: Path, folder: Path, record: Record, overwrite: bool = False) -> None:
    """Move results from the hidden folder ``made`` to ``folder``, in the place of files that a record claims.

    OutputError, and nothing was moved: the folder has results of another run and ``overwrite`` is not set, or files
    that no record claims have the names of results.

    Files and record, and their names, are on the disk before they are moved: a power cut leaves no record in ``folder``
    without its files. That they were moved is on the disk when the next results are, or when the caller flushes the
    folder above: a power cut before costs these results alone.
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
    except OSError:  # the folder exists and has files of others
        folder.mkdir(exist_ok=True)
        # Where this is interrupted, the next run knows by the claim that the files are its own.
        os.replace(made / RECORD_FILE, folder / CLAIM_FILE)
        for name in record.files:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(made / name, folder / name)
        for path in _folders(folder, record):
            flush(path)
        os.replace(folder / CLAIM_FILE, folder / RECORD_FILE)
        flush(folder)


def _folders(folder: Path, record: Record) -> list[Path]:
    """Return the folders of the files of a record in ``folder``, which is the last one."""
    return sorted({folder, *((folder / name).parent for name in record.files)}, reverse=True)


def record_failure(folder: Path, record: Record, overwrite: bool) -> None:
    """Write the record of a scene that failed, in place of an earlier result from other inputs, if possible.

    Results of another run stay, and so do files that no record claims.
    """
    earlier = read_record(folder)
    is_ours = earlier is None or earlier.run == record.run or overwrite
    if is_ours and not _foreign_files(folder, {}):
        with contextlib.suppress(OSError, OutputError):
            remove_results(folder)
            write_record(folder, record)


def remove_results(folder: Path) -> None:
    """Delete the files that the records of a folder claim, and folders that are empty then; other files stay.

    The record becomes a claim first: where this is interrupted the results are not done, but still known.
    """
    for _ in range(2):  # files in a claim that was left behind, then in the record
        folders = {folder}
        for name in _claims(folder, (CLAIM_FILE,)):
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
    """Delete a hidden folder; it is renamed first, so that a process still writing into it loses all of it at once."""
    away = folder.with_name(f"{folder.name}-{time.time_ns()}")
    try:
        folder.rename(away)
    except OSError:
        away = folder
    shutil.rmtree(away, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what killed processes left in a folder where no other process writes."""
    for made in folder.glob(f"{PARTIAL_PREFIX}*"):
        if not made.is_symlink():
            discard(made)
    remove_temporaries(folder)


def not_ours(names: Sequence[str]) -> str:
    """Return why files that no run wrote are not replaced, and what to do."""
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return (
        f"{', '.join(names[:_MAX_NAMED])}{more} would be replaced, but no record shows that depthcli wrote "
        f"{'it' if len(names) == 1 else 'them'}; move {'it' if len(names) == 1 else 'them'} away, or choose another "
        "folder of results (only results are ever replaced)"
    )


def _claims(folder: Path, names: Sequence[str] = (CLAIM_FILE, RECORD_FILE)) -> set[str]:
    """Return the files in a folder that a run wrote, by the records of these names."""
    return {file for name in names if (record := read_record(folder, name)) is not None for file in record.files}


def _foreign_files(folder: Path, files: Mapping[str, str]) -> list[str]:
    """Return the members of ``files``, name -> digest, that would replace a file that no record claims.

    A file with the same content counts as ours: nothing is lost. So do the results of a scene whose record was lost.
    """
    claimed, names, is_ours = _claims(folder), list[str](), False
    for name, content in files.items():
        if os.path.lexists(folder / name):
            if file_digest(folder / name) == content:
                is_ours = True
            elif name not in claimed:
                names.append(name)
    if not is_ours and read_record(folder) is None and read_record(folder, CLAIM_FILE) is None:
        names += [name for name in (RECORD_FILE, CLAIM_FILE) if os.path.lexists(folder / name)]  # not a damaged record
    return names


def write_report(folder: Path, command: str, run: str) -> list[Row]:
    """Write the report of all scenes of a run that have a record, and return its rows; OutputError where impossible."""
    rows = [record.row for record in sorted(records_below(folder, run), key=attrgetter("scene"))]
    document = report_document(command, rows)
    lines = ",\n  ".join(to_json(row, indent=None).rstrip() for row in rows)
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
