"""Records of scenes: from what a scene was made and which files are its own, so that no other file is replaced.

A record is not trusted when it is read: it may name only files in its own folder, holds a digest of itself and of
each of them, and is ignored where a digest does not match.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from depthcli.batch.json_csv import Row, to_json
from depthcli.core.errors import InputError
from depthcli.data.formats.files import MAX_BYTES, open_regular, write_text
from depthcli.data.formats.images import IMAGE_SUFFIXES

RECORD_FILE = "record.json"
CLAIM_FILE = ".claim.json"
"""The record of a scene whose files are being written or removed: it is not done, but its files may be replaced."""

# The digest at the end of a record stands between these two.
_BEFORE_DIGEST, _AFTER_DIGEST = ',\n "check": ', "\n}\n"
# A report of 100,000 scenes has about 60 MB; larger files are not ours.
MAX_TEXT_BYTES = 1 << 28
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


def write_record(folder: Path, record: SceneRecord) -> None:
    """Write a record, with a digest of itself at its end, into a scene's folder."""
    content = to_json(asdict(record))
    check = f'{_BEFORE_DIGEST}"{digest(content.encode("utf-8"))}"{_AFTER_DIGEST}'
    write_text(folder / RECORD_FILE, content.removesuffix(_AFTER_DIGEST) + check)


def read_record(folder: Path) -> SceneRecord | None:
    """Return the record of a scene's folder; None where it is missing, damaged, or names files elsewhere."""
    return _record_of(folder / RECORD_FILE)


def _record_of(file: Path) -> SceneRecord | None:
    # The digest is that of the text without it, so that nothing has to be encoded again.
    content, found, check = read_text(file).rpartition(_BEFORE_DIGEST)
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


def remove_scene(folder: Path) -> None:
    """Delete the files that the records of a scene's folder claim; others stay.

    The record becomes a claim first: where this is interrupted the scene is not done, and its files are still known.
    """
    for _ in range(2):  # what a claim that was left behind lists, then what the record lists
        folders = {folder}
        for name in claims(folder, (CLAIM_FILE,)):
            (folder / name).unlink(missing_ok=True)
            folders.add((folder / name).parent)
        (folder / CLAIM_FILE).unlink(missing_ok=True)
        for each in sorted(folders, key=lambda path: -len(path.parts)):
            with contextlib.suppress(OSError):  # it is not empty
                each.rmdir()
        if read_record(folder) is not None:
            with contextlib.suppress(FileNotFoundError):
                (folder / RECORD_FILE).replace(folder / CLAIM_FILE)


def claims(folder: Path, names: Sequence[str] = (CLAIM_FILE, RECORD_FILE)) -> set[str]:
    """Return the files in a scene's folder that the records of these names say a run wrote."""
    known = [record for name in names if (record := _record_of(folder / name)) is not None]
    return {name for record in known for name in record.files}


def foreign_files(folder: Path, files: Mapping[str, str]) -> list[str]:
    """Return those of ``files``, name -> digest, that would replace a file that no record claims.

    A file with the same content counts as ours: nothing is lost. So do the results of a scene whose record was lost.
    """
    claimed = claims(folder)
    there = {name: file_digest(folder / name) for name in files if os.path.lexists(folder / name)}
    names = [name for name, content in there.items() if name not in claimed and content != files[name]]
    if not claimed and not any(content == files[name] for name, content in there.items()):
        names += [name for name in (RECORD_FILE, CLAIM_FILE) if os.path.lexists(folder / name)]  # not a damaged record
    return names


def is_inside(name: str) -> bool:
    """Return True for a relative path, with ``/``, that stays within its folder."""
    return not any(part in ("", ".", "..") or "\0" in part for part in name.split("/"))


def read_text(path: Path) -> str:
    """Return the text of a regular file of reasonable size, empty for any other."""
    try:
        if path.is_file() and path.stat().st_size <= MAX_TEXT_BYTES:
            return path.read_text("utf-8", "replace")
    except OSError:
        pass
    return ""


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; None where it is missing or damaged."""
    try:
        return json.loads(read_text(path))
    except (ValueError, RecursionError):
        return None
