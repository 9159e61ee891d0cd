"""Find photos of a calibration board: tell the cameras apart and match the photos of two cameras."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from depthcli.core.errors import InputError
from depthcli.io.formats.files import shown
from depthcli.io.formats.images import IMAGE_SUFFIXES

SIDES = re.compile(r"(?<![a-z])(?:(left|l)|(right|r))(?![a-z])", re.IGNORECASE)
"""Words in a file name that name the view."""

# "cam0" and "cam1" name the camera only if both are there.
_WORDS = (SIDES, re.compile(r"(?<![a-z])(?:cam(?:era)?|image|img)[-_]?0?(?:(0)|(1))(?![0-9a-z])", re.IGNORECASE))
_MAX_DEPTH = 2  # folder levels to search


class Photos(NamedTuple):
    """The photos of one position of the board."""

    name: str  # the common part of their names
    left: Path | None  # None if the photo is missing
    right: Path | None  # None if the photo is missing or there is only one camera


def find_photos(folders: Sequence[Path]) -> tuple[list[Photos], list[Path]]:
    """Return the photos of one or two cameras, sorted by name, and the files whose names give no camera.

    The first of two folders is the left camera's. In a single folder, the names of files or subfolders give the camera
    (left, right, l, r, cam0, cam1). Photos match if their names are equal without that word. If no name has such a
    word, all photos are from one camera.
    """
    found = [_images(folder) for folder in folders]
    place = " and ".join(map(shown, folders))
    if len(folders) == 2:
        if os.path.samefile(*folders):
            raise InputError(f"{shown(folders[0])}: given for both cameras; give one of each, left first")
        for word in (None, *_WORDS):  # the folders may contain left01.png and right01.png
            left, right = (_keyed(files.items(), word, place) for files in found)
            if set(left) & set(right):
                break
        return _paired(left, right, place), []
    files = found[0]
    for word in _WORDS:
        matches = {name: next(reversed(list(word.finditer(name))), None) for name in files}
        left, right = (
            _keyed([(name, files[name]) for name, match in matches.items() if match and match[side]], word, place)
            for side in (1, 2)
        )
        without = [files[name] for name, match in matches.items() if match is None]
        # The numbers in img0, img1, img2 ... count photos, not cameras.
        are_photo_numbers = word is _WORDS[1] and 2 * len(without) > len(files)
        if left and right and not are_photo_numbers:
            return _paired(left, right, place), without
    return [Photos(name, file, None) for name, file in files.items()], []


def _keyed(files: Iterable[tuple[str, Path]], word: re.Pattern[str] | None, place: str) -> dict[str, Path]:
    """Return name without the match of ``word`` -> file."""
    keyed: dict[str, Path] = {}
    for name, file in files:
        key = without_word(os.path.splitext(name)[0], word) or "photo"
        if (other := keyed.setdefault(key, file)) is not file:
            raise InputError(f"{place}: {other.name} and {file.name} of one camera are both called {key}")
    return keyed


def _paired(left: dict[str, Path], right: dict[str, Path], place: str) -> list[Photos]:
    if not set(left) & set(right):
        one, other = (next(iter(side.values())).name for side in (left, right))
        raise InputError(f"{place}: no photos of the two cameras have the same name ({one}, {other})")
    return [Photos(name, left.get(name), right.get(name)) for name in sorted(set(left) | set(right))]


def _images(folder: Path) -> dict[str, Path]:
    """Return relative path -> image, sorted, without hidden files and folders."""
    if not os.path.isdir(folder):
        raise InputError(f"{shown(folder)}: no such folder")
    found: dict[str, Path] = {}
    for place, folders, names in os.walk(folder):
        inside = Path(place).relative_to(folder)
        folders[:] = [name for name in folders if name[0] != "." and len(inside.parts) < _MAX_DEPTH]
        for name in names:
            if name[0] != "." and os.path.splitext(name)[1].lower() in IMAGE_SUFFIXES:
                found[(inside / name).as_posix()] = Path(place, name)
    if not found:
        raise InputError(f"{shown(folder)}: no photos ({', '.join(IMAGE_SUFFIXES)})")
    return dict(sorted(found.items()))


def without_word(name: str, word: re.Pattern[str] | None) -> str:
    """Return a name or path without the matches of ``word`` and their separators."""
    parts = (word.sub("", name) if word else name).split("/")
    plain = (re.sub(r"[-_. ]{2,}", "_", part).strip("-_. ") for part in parts)
    return "/".join(part for part in plain if part)
