"""Records of results: their inputs and their files, by which a later run resumes and replaces no other file.

Every scene of a run has a record, and so has an evaluation. A record is not trusted when it is read: it may name only
files in its own folder, holds a digest of itself and of each of them, and is ignored where a digest does not match.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError
from depthcli.io.formats.files import MAX_BYTES, open_regular, read_bytes, write_text
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.run.json_csv import Row, to_json

RUN_FILE = "run.yaml"
"""In a run folder: the config of the run."""

RECORD_FILE = "record.json"
CLAIM_FILE = ".claim.json"
"""The record of results that are being written or removed: they are not done, but their files may be replaced."""

# The digest at the end of a record stands between these two.
_BEFORE_DIGEST, _AFTER_DIGEST = ',\n "check": ', "\n}\n"
# A report of 100,000 scenes has about 60 MB; larger files are not ours.
MAX_TEXT_BYTES = 1 << 28
# Volumes may be large; without a bound a sparse file of no size on disk would be read for hours.
_MAX_HASHED_BYTES = 1 << 36


@dataclass(frozen=True)
class Record:
    """What finished results were made from and consist of; the last file that is written into their folder.

    Attributes
    ----------
    scene : name of the scene; empty for an evaluation
    run : identity of the run, the digest of its ``run.yaml``; or the name of the command that has no such file
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
        """Return True where this run made the files from these inputs, and all of them are unchanged in ``folder``."""
        made = self.run == run and self.inputs == dict(inputs)
        return made and all(file_digest(folder / name) == content for name, content in self.files.items())


def digest(data: bytes) -> str:
    """Return the SHA-256 digest in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def file_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file, or the reason why it cannot be read, which never equals a digest."""
    limit = MAX_BYTES if path.suffix.lower() in IMAGE_SUFFIXES else _MAX_HASHED_BYTES
    sha = hashlib.sha256()
    try:
        with open_regular(path) as file:
            left = os.fstat(file.fileno()).st_size
            if left > limit:
                return f"unreadable: larger than {limit >> 30} GiB"
            while block := file.read(1 << 20):
                sha.update(block)
                left -= len(block)
                if left < 0:  # a file of the kernel, which may have no end, or one that is being written
                    return "unreadable: longer than its size says"
    except InputError as error:
        return f"unreadable: {error}"
    return sha.hexdigest()


def digests_below(folder: Path) -> dict[str, str]:
    """Return path below ``folder`` -> digest of every file in it."""
    made = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in made}


def write_record(folder: Path, record: Record) -> None:
    """Write a record, with a digest of itself at its end, into a folder of results."""
    content = to_json(asdict(record))
    check = f'{_BEFORE_DIGEST}"{digest(content.encode("utf-8"))}"{_AFTER_DIGEST}'
    write_text(folder / RECORD_FILE, content.removesuffix(_AFTER_DIGEST) + check)


def read_record(folder: Path, name: str = "") -> Record | None:
    """Return the record of a folder of results; None where it is missing, damaged, or names files elsewhere.

    Parameters
    ----------
    name : scene in the run folder ``folder``, as a report has it; one that leads out of the folder has no record
    """
    if name and not is_inside(name):
        return None
    return _record_of(folder / name / RECORD_FILE)


def _record_of(file: Path) -> Record | None:
    # The digest is that of the text without it, so that nothing has to be encoded again.
    content, found, check = read_text(file).rpartition(_BEFORE_DIGEST)
    content += _AFTER_DIGEST
    if not found or check != f'"{digest(content.encode("utf-8", "surrogatepass"))}"{_AFTER_DIGEST}':
        return None
    try:
        record = Record(**json.loads(content))
    except (ValueError, TypeError, RecursionError):
        return None
    if not all(isinstance(each, dict) for each in (record.inputs, record.files, record.facts)):
        return None
    return record if all(is_inside(name) for name in record.files) else None


def claims(folder: Path, names: Sequence[str] = (CLAIM_FILE, RECORD_FILE)) -> set[str]:
    """Return the files in a folder that the records of these names say a run wrote."""
    known = [record for name in names if (record := _record_of(folder / name)) is not None]
    return {name for record in known for name in record.files}


def is_inside(name: str) -> bool:
    """Return True for a relative path, with ``/``, that stays within its folder."""
    return not any(part in ("", ".", "..") or "\0" in part for part in name.split("/"))


def read_text(path: Path) -> str:
    """Return the text of a regular file of reasonable size, empty for any other."""
    try:  # no more than its size: some files of /proc have none, and no end
        return read_bytes(path, MAX_TEXT_BYTES).decode("utf-8", "replace").replace("\r\n", "\n")
    except InputError:
        return ""


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; None where it is missing or damaged."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError):
        return None
