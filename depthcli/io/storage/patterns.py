"""Archives by a pattern, and those in a folder."""

from __future__ import annotations

import os
import re
from pathlib import Path

from depthcli.io import storage
from depthcli.io.storage import AT_END

_BRACES = re.compile(r"\{(?:(\d{1,9})\.\.(\d{1,9})|([^{}/]*,[^{}/]*))\}")
_WILD = re.compile(r"[*?\[]")
_MAX_MATCHES = 100_000


def matching(pattern: Path) -> list[Path]:
    """Return the archives that a pattern such as ``shard-{000..015}.tar`` or ``shard-*.tar`` stands for, sorted.

    Those of numbers in braces are named whether they are there or not.
    """
    found: list[Path] = []
    for path in _without_braces(str(pattern)):
        place, name = os.path.split(path)
        found += storage.glob(Path(place), name) if _WILD.search(name) else [Path(path)]
    named = {path for path in found if AT_END.search(str(path))}
    return sorted(named) if str(pattern) not in map(str, named) else []


def is_pattern(path: Path) -> bool:
    """Return whether a path is a pattern of several."""
    return bool(_WILD.search(str(path)) or _BRACES.search(str(path)))


def archives_in(folder: Path) -> list[Path]:
    """Return the archives in a folder, sorted."""
    return [folder / name for name in storage.names(folder) if name[:1] != "." and AT_END.search(name)]


def top_folder(archive: Path) -> Path | None:
    """Return the folder that holds all of an archive; None where there is no single one."""
    inside = [name for name in storage.names(archive) if name[:1] != "."]
    folders = storage.subfolders(archive)
    return folders[0] if len(inside) == 1 == len(folders) else None


def entered(path: Path) -> Path:
    """Return the single folder that holds all of an archive; for all other paths the path itself."""
    return (top_folder(path) if storage.is_archive(path) else None) or path


def stem(path: Path) -> str:
    """Return the name of an archive without its ending."""
    return AT_END.sub("", path.name) or path.name


def _without_braces(text: str) -> list[str]:
    """Return the texts that ``a{00..15}`` or ``{a,b}`` stand for, at most 100,000; without braces the text itself."""
    found = _BRACES.search(text)
    if found is None:
        return [text]
    if found[1]:
        low, top, digits = int(found[1]), int(found[2]), len(found[1]) if found[1][0] == "0" else 0
        words = [f"{number:0{digits}}" for number in range(low, min(top, low + _MAX_MATCHES) + 1)]
    else:
        words = found[3].split(",")
    made = [text[: found.start()] + word + rest for word in words for rest in _without_braces(text[found.end() :])]
    return made[:_MAX_MATCHES]
