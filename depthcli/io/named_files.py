"""Scenes whose files the command line names: single files, patterns, folders, videos, tables."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.text import without_secrets
from depthcli.io.calibration_photos import SIDES, without_word
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import table_rows, text_of
from depthcli.io.formats.videos import VIDEO_SUFFIXES, count_frames
from depthcli.io.scenes import LEFT_OUT, MAX_DISPARITY, RgbdScene, Scene, StereoScene, VolumePairScene

TABLE_SUFFIXES = (".csv", ".tsv")
STDIN = Path("-")
"""In place of a table: the standard input."""

_MAX_FOLDERS = 8  # that are looked at for two whose images belong together
_WILD = re.compile(r"[*?\[]")
_MAX_BYTES = 1 << 28  # of a table
_COLUMNS = ("left", "right", "name", "calibration", "max_disparity", "min_disparity")
# Names of files that do not name the scene, which is called like the folder then.
_GENERIC_LEFT = ("left", "im0", "im2", "iml", "view0", "view1", "image_0", "image_2", "colored_0")
_GENERIC_COLOR = ("color", "rgb", "image", "depth")


def named_scenes(kind: type[Scene], values: Mapping[str, Any]) -> list[Scene]:
    """Return the scenes of a kind whose files the options name.

    These are the pair of ``--left`` and ``--right``, pairs of two patterns or folders, the frames of two videos; the
    frame of ``--color`` and ``--depth``, or of the latter alone; the pair of ``--fixed`` and ``--warped``, or of
    ``--moving`` with its transform. ConfigError where an option is missing.
    """
    for base, find in ((StereoScene, _named_pairs), (RgbdScene, _named_frame), (VolumePairScene, _named_volumes)):
        if issubclass(kind, base):
            return find(values)
    return []


def _named_pairs(values: Mapping[str, Any]) -> list[Scene]:
    if not _together(values, "left", "right"):
        return []
    left, right = values["left"], values["right"]
    if _is_many(left) or _is_many(right):
        return [_pair(*each, {}, Path()) for each in match_patterns(left, right)]
    one = StereoScene(name=_name_of(left, *_GENERIC_LEFT), folder=left.parent, left=left, right=right)
    if left.suffix.lower() not in VIDEO_SUFFIXES:
        return [one]
    try:
        counts = count_frames(left), count_frames(right)
    except InputError as error:
        raise ConfigError(str(error)) from None
    digits = max(6, len(str(max(counts))))
    return [replace(one, name=f"{number:0{digits}}", frame_number=number) for number in range(min(counts))]


def _named_frame(values: Mapping[str, Any]) -> list[Scene]:
    color, depth = values.get("color"), values.get("depth")
    if depth is None:
        _together(values, "color", "depth")
        return []
    image = color or depth
    return [RgbdScene(name=_name_of(image, *_GENERIC_COLOR), folder=image.parent, color=color, depth=depth)]


def _named_volumes(values: Mapping[str, Any]) -> list[Scene]:
    roles = {"warped": "moving_warped"} | {name: name for name in ("moving", "displacement", "transform", "mask")}
    files: dict[str, Any] = {role: values[name] for name, role in roles.items() if values.get(name) is not None}
    fixed, apply = values.get("fixed"), values.get("apply")
    both = {"displacement", "transform"} <= files.keys()
    if apply is not None and not (both and apply in LEFT_OUT):
        raise ConfigError(f"--apply: expected {', '.join(LEFT_OUT)}, of a pair with --displacement and --transform")
    if fixed is None:
        if files:
            raise ConfigError(f"--{next(n for n in roles if roles[n] in files)} needs --fixed, too")
        return []
    if "moving_warped" not in files and not ("moving" in files and files.keys() & {"displacement", "transform"}):
        raise ConfigError("--fixed needs --warped, or --moving with --displacement or --transform")
    if both and apply is None:
        raise ConfigError("both --displacement and --transform: leave one out, or say which counts by --apply")
    files.pop(LEFT_OUT.get(apply or "", ""), None)
    return [VolumePairScene(name=_name_of(fixed, "fixed"), folder=fixed.parent, fixed=fixed, **files)]


def _together(values: Mapping[str, Any], *names: str) -> bool:
    """Return True where all of the options are given, False where none is; ConfigError otherwise."""
    given = [name for name in names if values.get(name) is not None]
    if given and len(given) < len(names):
        missing = " and ".join(f"--{name}" for name in names if name not in given)
        raise ConfigError(f"--{given[0]} needs {missing}, too")
    return bool(given)


def _name_of(file: Path, *generic: str) -> str:
    """Return the name of a single scene: its file's, or its folder's where that is a generic one."""
    folder, stem = file.absolute().parent.name, file.stem
    if file.suffix.lower() == ".gz":  # of a compressed file the other ending goes, too: scan.nii.gz is scan
        stem = Path(stem).stem
    return folder if stem.lower() in generic and folder else stem


def _is_many(path: Path) -> bool:
    """Return whether a path is a pattern or a folder: more than one file."""
    return os.path.isdir(path) or (bool(_WILD.search(str(path))) and not os.path.lexists(path))


def _pair(name: str, left: Path | None, right: Path | None, fields: Mapping[str, str], folder: Path) -> StereoScene:
    """Return the pair of a line of a table in ``folder``; it has a problem without one of its images.

    ``left`` or ``right`` is None where the image has no partner.
    """
    there = left or right
    assert there is not None
    problem = "" if left and right else f"{there}: no {'right' if left else 'left'} image belongs to it"
    known: dict[str, Any] = {}
    for key in {"max_disparity", "min_disparity"} & fields.keys():
        text = fields[key]
        if re.fullmatch(r"[-+]?[0-9]{1,7}", text) and abs(int(text)) <= MAX_DISPARITY:
            known[key] = int(text)
        else:
            problem = f"{there}: {key}: expected a whole number up to {MAX_DISPARITY} (got {text[:40]!r})"
    if "calibration" in fields:
        known["calibration"] = folder / fields["calibration"]
    return StereoScene(name=name, folder=there.parent, left=left or there, right=right, problem=problem, **known)


def is_table(path: Path) -> bool:
    """Return whether a path names a table of pairs: a file with its ending, or ``-``, the standard input."""
    return path == STDIN or (os.path.isfile(path) and path.suffix.lower() in TABLE_SUFFIXES)


def scenes_of_table(path: Path) -> list[StereoScene]:
    """Return the pairs of a CSV (or tab-separated) file with one line per pair, paths relative to the file's folder.

    ``-`` is the standard input, whose paths are relative to the current folder.

    A first line with ``left`` and ``right`` names the columns, of which also ``name``, ``calibration``,
    ``max_disparity`` and ``min_disparity`` are known; without it the first two are left and right, the third is the
    name. Lines that begin with ``#`` are passed over. Without a name, it is the left file's, or the line's number
    where those repeat.
    """
    with naming("standard input" if path == STDIN else path):
        data = sys.stdin.buffer.read() if path == STDIN else read_bytes(path, _MAX_BYTES)
        text = text_of(data, "surrogateescape")
        rows = table_rows([line for line in text.splitlines() if line.strip() and not line.startswith("#")])
        columns: tuple[str, ...] = _COLUMNS[:3]
        if rows and {"left", "right"} <= {word.strip().lower() for word in rows[0]}:
            columns = tuple(word.strip().lower() for word in rows.pop(0))
            if unknown := [word for word in columns if word not in _COLUMNS]:
                raise InputError(f"no such column: {', '.join(unknown)}; known: {', '.join(_COLUMNS)}")
            if len(set(columns)) < len(columns):
                raise InputError(f"two columns are called {Counter(columns).most_common(1)[0][0]!r}")
        if not rows:
            raise InputError("names no pair")
        fields = []
        for number, row in enumerate(rows, 1):
            fields.append({key: word.strip() for key, word in zip(columns, row, strict=False) if word.strip()})
            if len(row) > len(columns) or not {"left", "right"} <= fields[-1].keys():
                raise InputError(f"pair {number}: expected {', '.join(columns)} (got {','.join(row)[:60]!r})")
        taken = Counter(each["name"] for each in fields if "name" in each)
        if twice := [name for name, count in taken.items() if count > 1]:
            raise InputError(f"two lines are called {twice[0][:100]!r}")
    folder, names = path.parent, _names_of(fields)
    return [_pair(n, folder / f["left"], folder / f["right"], f, folder) for n, f in zip(names, fields, strict=True)]


def _names_of(fields: Sequence[Mapping[str, str]]) -> list[str]:
    """Return the names of pairs: their own, else their left files', with their numbers where those repeat."""
    names = [each.get("name") or Path(without_secrets(each["left"])).stem for each in fields]
    if len(set(names)) == len(names):
        return names
    taken = {each["name"] for each in fields if "name" in each}
    unique = []
    for number, (name, each) in enumerate(zip(names, fields, strict=True), 1):
        if "name" not in each:
            name = f"{number:0{len(str(len(names)))}}_{name}"
            while name in taken:
                name += "_"
            taken.add(name)
        unique.append(name)
    return unique


def match_patterns(left: Path, right: Path) -> list[tuple[str, Path | None, Path | None]]:
    """Return name and images of the pairs of two patterns such as ``left/*.png`` and ``right/*.png``, or folders.

    Files belong together whose names are the same where the patterns have wildcards, but for words that say which
    view it is (``left_0001`` and ``right_0001``); where that pairs none, the whole names count, then their last number.
    One without a partner is None.
    """
    matches = [_matching(pattern) for pattern in (left, right)]
    for pattern, files in zip((left, right), matches, strict=True):
        if not files:
            query = "; a query behind its URL is read of archives alone" if ":/" in str(pattern) else ""
            raise ConfigError(f"{pattern}: matches no image{query}")
    keys: tuple[Callable[[_Match], str], ...] = (
        lambda file: without_word(file.captured, SIDES),
        lambda file: without_word(file.name, SIDES),
        lambda file: (re.findall(r"\d+", file.name) or [""])[-1],
    )
    for key in keys:
        one, other = (_keyed(files, key) for files in matches)
        if set(one) & set(other):
            return [(name, one.get(name), other.get(name)) for name in sorted(set(one) | set(other))]
    raise ConfigError(f"{left} and {right}: no two names belong together ({matches[0][0].path.name}, ...)")


def patterns_in(folder: Path) -> tuple[str, str] | None:
    """Return patterns of two folders in a folder whose images belong together by their names; None without such."""
    inside = sorted(Path(folder, name) for name in os.listdir(folder) if name[0] != ".")
    for left, right in itertools.combinations([path for path in inside if os.path.isdir(path)][:_MAX_FOLDERS], 2):
        with contextlib.suppress(ConfigError):
            # Two images in each of two folders are two pairs as likely as two folders of views.
            if sum(bool(one and other) for _, one, other in match_patterns(left, right)) not in (0, 2):
                endings = (Counter(file.path.suffix for file in _matching(place)) for place in (left, right))
                one, other = (ending.most_common(1)[0][0] for ending in endings)
                return f"{left}/*{one}", f"{right}/*{other}"
    return None


class _Match(NamedTuple):
    """A file of a pattern: the texts of the wildcards, and its name from the first of them on, without ending."""

    path: Path
    captured: str
    name: str


def _matching(pattern: Path) -> list[_Match]:
    if os.path.isdir(pattern):
        pattern = pattern / "*"
    parts = pattern.parts
    first = next((k for k, part in enumerate(parts) if _WILD.search(part)), len(parts) - 1)
    root = Path(*parts[:first])
    places: list[tuple[Path, tuple[str, ...]]] = [(root, ())]
    for depth, part in enumerate(parts[first:], first):
        ends = IMAGE_SUFFIXES if depth == len(parts) - 1 else None
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
