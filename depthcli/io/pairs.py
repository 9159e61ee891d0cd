"""Pairs of files that the command line names: patterns, folders, tables."""

from __future__ import annotations

import contextlib
import csv
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.files import naming, read_bytes

TABLE_SUFFIXES = (".csv", ".tsv")

_WILD = re.compile(r"[*?\[]")
_MAX_BYTES = 1 << 28  # of a table
# Words of a file's name that say which view it is; a file without the other's word has no partner.
_SIDES = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])", re.IGNORECASE)
_COLUMNS = ("left", "right", "name", "calibration", "max_disparity", "min_disparity")


class NamedPair(NamedTuple):
    """Two files that belong together."""

    name: str  # of the scene
    left: Path | None  # None where it has no partner, and so is the right one
    right: Path | None
    more: Mapping[str, str] = MappingProxyType({})  # column -> value, for the other columns of the table


def is_many(path: Path) -> bool:
    """Return whether a path is a pattern or a folder: more than one file."""
    return os.path.isdir(path) or (bool(_WILD.search(str(path))) and not os.path.lexists(path))


def match_patterns(left: Path, right: Path, suffixes: Iterable[str]) -> list[NamedPair]:
    """Return the pairs of two patterns such as ``left/*.png`` and ``right/*.png``, or of two folders.

    Files belong together whose names are the same where the patterns have wildcards, but for words that say which
    view it is (``left_0001`` and ``right_0001``); where that pairs none, the whole names count, then their last number.
    """
    suffixes = tuple(suffixes)
    matches = [_matching(pattern, suffixes) for pattern in (left, right)]
    for pattern, files in zip((left, right), matches, strict=True):
        if not files:
            query = "; a query behind its URL is read of archives alone" if ":/" in str(pattern) else ""
            raise ConfigError(f"{pattern}: matches no image{query}")
    keys: tuple[Callable[[_Match], str], ...] = (
        lambda file: _without_side(file.captured),
        lambda file: _without_side(file.name),
        lambda file: (re.findall(r"\d+", file.name) or [""])[-1],
    )
    for key in keys:
        sides = [_keyed(files, key) for files in matches]
        if set(sides[0]) & set(sides[1]):
            names = sorted(set(sides[0]) | set(sides[1]))
            return [NamedPair(name, sides[0].get(name), sides[1].get(name)) for name in names]
    raise ConfigError(f"{left} and {right}: no two names belong together ({matches[0][0].path.name}, ...)")


def read_table(path: Path) -> list[NamedPair]:
    """Return the pairs of a CSV (or tab-separated) file with one line per pair, paths relative to the file's folder.

    A first line with ``left`` and ``right`` names the columns, of which also ``name``, ``calibration``,
    ``max_disparity`` and ``min_disparity`` are known; without it the first two are left and right, the third is the
    name. Lines that begin with ``#`` are passed over. Without a name, it is the left file's, or the line's number
    where those repeat.
    """
    with naming(path):
        text = read_bytes(path, _MAX_BYTES).decode("utf-8-sig", "surrogateescape")
        lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
        try:
            rows = list(csv.reader(lines, delimiter="\t" if path.suffix.lower() == ".tsv" else ","))
        except csv.Error as error:
            raise InputError(f"not a table ({error})") from None
        columns: tuple[str, ...] = _COLUMNS[:3]
        if rows and {"left", "right"} <= {word.strip().lower() for word in rows[0]}:
            columns = tuple(word.strip().lower() for word in rows.pop(0))
            if unknown := [word for word in columns if word not in _COLUMNS]:
                raise InputError(f"no such column: {', '.join(unknown)}; known: {', '.join(_COLUMNS)}")
            if twice := [word for word, count in Counter(columns).items() if count > 1]:
                raise InputError(f"two columns are called {twice[0]!r}")
        if not rows:
            raise InputError("names no pair")
        pairs = [_pair_of(number, row, columns, path.parent) for number, row in enumerate(rows, 1)]
        return _named_apart(pairs) if len({pair.name for pair in pairs}) < len(pairs) else pairs


def _named_apart(pairs: list[NamedPair]) -> list[NamedPair]:
    """Pairs some of which have one name: those without a name of their own get their line's number."""
    taken = Counter(pair.more["name"] for pair in pairs if "name" in pair.more)
    if twice := [name for name, count in taken.items() if count > 1]:
        raise InputError(f"two lines are called {twice[0][:100]!r}")
    apart = []
    for number, pair in enumerate(pairs, 1):
        name = pair.name if "name" in pair.more else f"{number:0{len(str(len(pairs)))}}_{pair.name}"
        while "name" not in pair.more and name in taken:
            name += "_"
        taken[name] = 1
        apart.append(pair._replace(name=name))
    return apart


def _pair_of(number: int, row: list[str], columns: tuple[str, ...], folder: Path) -> NamedPair:
    fields = {key: word.strip() for key, word in zip(columns, row, strict=False) if word.strip()}
    if len(row) > len(columns) or "left" not in fields or "right" not in fields:
        raise InputError(f"pair {number}: want {', '.join(columns)} (got {','.join(row)[:60]!r})")
    left = folder / fields["left"]
    return NamedPair(fields.get("name") or left.stem, left, folder / fields["right"], fields)


class _Match(NamedTuple):
    """A file of a pattern: what the wildcards stand for, and its name from the first of them on, without ending."""

    path: Path
    captured: str
    name: str


def _matching(pattern: Path, suffixes: tuple[str, ...]) -> list[_Match]:
    if os.path.isdir(pattern):
        pattern = pattern / "*"
    parts = pattern.parts
    first = next((k for k, part in enumerate(parts) if _WILD.search(part)), len(parts) - 1)
    root = Path(*parts[:first])
    places: list[tuple[Path, tuple[str, ...]]] = [(root, ())]
    for depth, part in enumerate(parts[first:], first):
        ends = suffixes if depth == len(parts) - 1 else None
        pieces = re.split(r"(\*+|\?|\[[^\]]+\])", part)  # a group for every wildcard
        inside = re.compile("".join(_group(piece) if k % 2 else re.escape(piece) for k, piece in enumerate(pieces)))
        reached = []
        for place, captured in places:
            with contextlib.suppress(OSError):
                for name in sorted(os.listdir(place)):
                    match = inside.fullmatch(name) if name[0] != "." else None
                    if match and (ends is None or os.path.splitext(name)[1].lower() in ends):
                        text = "".join(match.groups())
                        reached.append((place / name, (*captured, text) if text else captured))
        places = reached
    return [
        _Match(path, "/".join(captured).removesuffix(path.suffix), str(path.relative_to(root).with_suffix("")))
        for path, captured in places
    ]


def _group(wildcard: str) -> str:
    """Return the regular expression of ``*``, ``?`` or ``[...]``, as a group."""
    if wildcard[0] == "[":
        return f"([{'^' if wildcard[1] == '!' else wildcard[1]}{wildcard[2:]})"
    return "(.)" if wildcard == "?" else "(.*)"


def _keyed(files: list[_Match], key: Callable[[_Match], str]) -> dict[str, Path]:
    """Key -> file; of two with one key none, so that no pair is made up."""
    keys = [key(file) for file in files]
    once = {text for text, count in Counter(keys).items() if count == 1 and text}
    return {text: file.path for text, file in zip(keys, files, strict=True) if text in once}


def _without_side(name: str) -> str:
    plain = "/".join(re.sub(r"[-_. ]{2,}", "_", part).strip("-_. ") for part in _SIDES.sub("", name).split("/"))
    return plain.strip("/")
