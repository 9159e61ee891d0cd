"""What an archive holds: its members by path, the folders they make, and what of it is not used and why."""

from __future__ import annotations

import re
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import BinaryIO, Generic, NamedTuple, TypeVar

from depthcli.core.errors import InputError

LARGE_BYTES = 1 << 26
"""Size of a member from which on it is read in pieces, and its rate of compression is looked at."""

_MAX_RATE = 200  # of a large member; images of a single value reach 1000, but no such image has 64 MiB
_MAX_MEMBERS = 1 << 20  # each takes about a kB of memory
_MAX_NAME = 4096  # characters of a member's path, as of the longest path of a file system
_N_NAMED = 3  # members in a warning
# WebDataset: the key of a sample ends at the first dot of the base name, what follows is the name of its field.
_SAMPLE = re.compile(r"((?:.*/)?[^/.]+)\.([^/]+)")
# Fields by which an archive is one of samples: those that the layouts ``scenes`` and ``rgbd`` cannot do without.
_SHARD_FIELD = re.compile(r"(left|right|color|depth)\.[A-Za-z0-9]+")
_FIELD_NAMES = {"json": "meta.json"}  # WebDataset's usual field of facts

_PLAIN_NAME = re.compile(r"[A-Za-z0-9_-][\w.-]{,99}(?:/[A-Za-z0-9_-][\w.-]{,99}){,9}", re.ASCII).fullmatch

WhereT = TypeVar("WhereT")


class Member(NamedTuple, Generic[WhereT]):
    """A file in an archive.

    Attributes
    ----------
    size : bytes, unpacked
    where : what the archive needs to find it
    problem : why it cannot be read, or empty
    """

    size: int
    where: WhereT
    problem: str = ""


@dataclass
class Listing(Generic[WhereT]):
    """The members of an archive, by their path in it.

    Attributes
    ----------
    files : path -> member
    folders : path -> names in it; that of the archive itself is empty
    notes : lines about members that are not used
    damage : why not all of the archive could be listed, or empty
    """

    files: dict[str, Member[WhereT]] = field(default_factory=dict)
    folders: dict[str, list[str]] = field(default_factory=lambda: {"": []})
    notes: list[str] = field(default_factory=list)
    damage: str = ""


def listing_of(
    members: Iterable[tuple[str, Member[WhereT]]], *, damage: str = "", shards: bool = False
) -> Listing[WhereT]:
    """Return the listing of named members; names that lead out of the archive are left out and noted.

    Parameters
    ----------
    damage : why there may be members that are not listed
    shards : whether files such as ``key.left.png`` are taken for ``key/left.png``, as in WebDataset
    """
    made: Listing[WhereT] = Listing(damage=damage)
    unsafe = []
    for name, member in members:
        path = _inside(name)
        if path is None:
            unsafe.append(name)
        elif path.partition("/")[0] == "__MACOSX":  # what macOS adds for itself
            continue
        elif path in made.files:  # which of them is meant cannot be known
            made.files[path] = Member(member.size, member.where, "is there more than once in the archive")
        else:
            made.files[path] = member
            if len(made.files) > _MAX_MEMBERS:
                raise InputError(f"more than {_MAX_MEMBERS} members; make several archives of it")
    if shards and any((parts := _SAMPLE.fullmatch(path)) and _SHARD_FIELD.fullmatch(parts[2]) for path in made.files):
        made.files = dict(_of_samples(made.files))
    _add_folders(made)
    if unsafe:
        named = ", ".join(ascii(name[:80]) for name in unsafe[:_N_NAMED])
        made.notes.append(f"{len(unsafe)} members not used, their names lead out of the archive: {named}")
    return made


def _inside(name: str) -> str | None:
    """Path within the archive; None where it could lead out of it or is none at all."""
    if _PLAIN_NAME(name):  # nearly all of a hundred thousand
        return name
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    if not parts or ".." in parts or name[:1] in "/\\" or parts[0][1:2] == ":" or "\0" in name or len(name) > _MAX_NAME:
        return None
    return "/".join(parts)


def _of_samples(files: dict[str, Member[WhereT]]) -> Iterable[tuple[str, Member[WhereT]]]:
    for path, member in files.items():
        parts = _SAMPLE.fullmatch(path)
        yield (f"{parts[1]}/{_FIELD_NAMES.get(parts[2], parts[2])}" if parts else path), member


def _add_folders(made: Listing[WhereT]) -> None:
    for path in list(made.files):
        child = path
        while child:
            parent = child.rpartition("/")[0]
            known = parent in made.folders
            made.folders.setdefault(parent, []).append(child[len(parent) + bool(parent) :])
            if known:
                break
            child = parent
    for path in [path for path in made.files if path in made.folders]:  # one name for both: it is the folder's
        del made.files[path]
        made.notes.append(f"{path[:80]!a} is a file and a folder; the file is not used")
    for place, names in made.folders.items():
        made.folders[place] = sorted(set(names))


def problem_of_size(size: int, packed: int) -> str:
    """Return why a member of that size is not unpacked, or nothing: much of it was made of almost nothing."""
    if size > LARGE_BYTES and size > _MAX_RATE * max(packed, 1):
        return f"unpacks {packed} bytes to {size}, as archives do that are made to fill memories; not read"
    return ""


class Archive(ABC):
    """An archive that is open: its listing, and its members as files.

    Attributes
    ----------
    listing : what it holds
    lock : held while a member is read piece by piece, by archives whose members share one position
    """

    listing: Listing[object]

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.lock = threading.RLock()

    def member(self, path: str) -> Member[object]:
        """Return a member; InputError where it cannot be read."""
        member = self.listing.files.get(path)
        if member is None:
            raise InputError("no such file in the archive")
        if member.problem:
            raise InputError(member.problem)
        return member

    @abstractmethod
    def open(self, member: Member[object]) -> BinaryIO:
        """Return a member's bytes as a file; OSError or InputError, here or when it is read, where it is damaged."""

    def read(self, member: Member[object]) -> bytes:
        """Return all bytes of a member, at most one more than its size says; errors as of :meth:`open`."""
        with self.open(member) as file:
            return file.read(member.size + 1)

    def close(self) -> None:
        """Close the file of the archive."""
        self._file.close()
