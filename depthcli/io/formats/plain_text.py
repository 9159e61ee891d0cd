"""Parse small text files: JSON objects, key-value lines, tables, and numbers of a known count."""

from __future__ import annotations

import codecs
import csv
import json
import math
import re
import reprlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError

_MAX_SIDE = 1 << 20  # pixels; no image is as wide
# Letter of an anatomical axis -> axis of LPS and its sign.
_SIDES = {"l": (0, 1), "r": (0, -1), "p": (1, 1), "a": (1, -1), "s": (2, 1), "i": (2, -1)}
_MILLIMETERS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "\u00b5m": 0.001, "\u03bcm": 0.001}
_COUNTED = {"voxel", "voxels", "vox", "px", "pixel", "pixels", "index", "idx", "slice"}


def text_of(data: bytes, errors: str = "strict") -> str:
    """Return the text of a UTF-8 file, or of a UTF-16 file with a byte-order mark, without the mark.

    Other bytes are decoded with ``errors``, a handler of ``bytes.decode``; otherwise the file is read as Latin 1.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig", errors)
    except UnicodeDecodeError:
        return data.decode("latin-1")


def json_object(data: bytes | str) -> dict[str, Any]:
    """Return the object in a JSON file. Raise InputError if there is none."""
    try:
        fields = json.loads(data if isinstance(data, str) else text_of(data, "strict"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid JSON ({str(error)[:200]})") from error
    if not isinstance(fields, dict):
        raise InputError(f"expected a JSON object, got {type(fields).__name__}")
    return fields


def key_values(text: str) -> dict[str, str]:
    """Return key -> value for lines ``key = value`` or ``key: value``; other lines are ignored."""
    return dict(re.findall(r"^\s*(\w+)\s*[=:]\s*(.*?)\s*$", text, re.MULTILINE))


def table_rows(lines: Sequence[str], separators: str = "\t,;") -> list[list[str]]:
    """Return the cells of a table; the separator is the first of ``separators`` in its first line, or a comma.

    Raise InputError if the lines are no table.
    """
    separator = next((mark for mark in separators if lines and mark in lines[0]), ",")
    try:
        rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        raise InputError(f"not a table ({error})") from None
    return [[cell.strip() for cell in row] for row in rows]


def _cells(line: str) -> list[str]:
    """Return the cells of a line in a table of numbers; decimal commas become points."""
    words = line.split()
    if not re.search("[\t;,]", line) or (len(words) > 1 and all(map(is_number, words))):
        return re.sub(r"\s+(?=[(\[])", "", line).split()  # keep a unit with its name
    (cells,) = table_rows([line], "," if re.search(r",\s*\t|\t\s*,", line) else "\t;,")
    return [re.sub(r"^([-+]?\d*),(\d+([eE][-+]?\d+)?)$", r"\1.\2", cell) for cell in cells]


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def points_of(lines: Sequence[str], comments: Sequence[str] = ()) -> NDArray[np.float64]:
    """Return points (N, 3) x, y, z, mm, LPS, from a table with one point per line.

    Column names are in a comment or in a first line without numbers. The coordinates are three names that differ in x,
    y and z, or letters of anatomical axes such as L, P, S or R, A, S; units and frames in the names are applied.
    Without such names, the coordinates are the first three columns, after an optional id: a word, or line numbers.
    Raise InputError if there are no points.
    """
    rows, heads = ([_cells(line) for line in some] for some in (lines, comments))
    first = 1
    if rows and (not any(map(is_number, rows[0])) or (not rows[0][0] and any(row[0] for row in rows[1:]))):
        heads, first = [*heads, rows.pop(0)], 2
    columns = next(filter(None, map(_named_coordinates, heads)), None)
    columns = columns or _first_coordinates(rows, heads[-1] if first == 2 else [])
    points = []
    for number, row in enumerate(rows, first):
        try:
            points.append([float(row[k]) * factor for k, factor in columns])
        except (ValueError, IndexError):
            raise InputError(f"point {number}: expected x, y, z (got {' '.join(row)[:60]!r})") from None
    if not points:
        raise InputError("no points")
    array = np.array(points)
    if not np.isfinite(array).all():
        raise InputError("a point that is not finite")
    return array


Columns = list[tuple[int, float]]  # columns of x, y and z with their factors to mm, LPS


def _named_coordinates(names: Sequence[str]) -> Columns | None:
    """Return the columns named x, y and z, or after anatomical axes; None if there are none."""
    words = [_words(name) for name in names]
    triples: dict[tuple[str, str], dict[int, list[int]]] = {}  # name before and after the letter -> axis -> columns
    for column, name in enumerate(map(str.lower, names)):
        for letter in re.finditer("[xyz]", name):
            axes = triples.setdefault((name[: letter.start()], name[letter.end() :]), {})
            axes.setdefault("xyz".index(letter[0]), []).append(column)
    whole = {key: axes for key, axes in triples.items() if len(axes) == 3}
    whole = {("", ""): whole["", ""]} if ("", "") in whole else whole
    chosen = {key: axes for key, axes in whole.items() if not _COUNTED & {*_words(key[0]), *_words(key[1])}} or whole
    for key, axes in chosen.items():
        if len(chosen) > 1 or any(len(columns) > 1 for columns in axes.values()):
            raise InputError(f"several columns may be x, y and z: {', '.join(names)}")
        frame = next((word for word in _words(f"{key[0]} {key[1]}") if re.fullmatch("[lr][ap][si]", word)), "lps")
        signs = [_SIDES[side][1] for side in frame]
        unit = _millimeters(_words(key[1]), _words(key[0]))
        return [(axes[axis][0], signs[axis] * unit) for axis in range(3)]
    for start in (0, 1):  # the first column may be an id
        sides = [(*_SIDES[each[0]], k) for k, each in enumerate(words) if k >= start and each and each[0] in _SIDES]
        if [axis for axis, _, _ in sorted(sides)] == [0, 1, 2]:
            return [(k, sign * _millimeters(words[k][1:])) for _, sign, k in sorted(sides)]
    return None


def _words(name: str) -> list[str]:
    return re.findall(r"[^\W\d_]+", name.lower())


def _millimeters(unit: Sequence[str], others: Sequence[str] = ()) -> float:
    """Return the unit, in mm, among the words after a column's letter; 1 if there is none."""
    if _COUNTED & {*unit, *others}:
        raise InputError("positions in voxels; they must be in mm")
    return next((_MILLIMETERS[word] for word in unit if word in _MILLIMETERS), 1.0)


def _first_coordinates(rows: Sequence[Sequence[str]], names: Sequence[str]) -> Columns:
    """Return the first three columns, after an id column if there is one; ``names`` contain no axes."""
    width = max((len(row) - row.count("") for row in rows), default=0)
    ids = [float(row[0]) if is_number(row[0]) else math.nan for row in rows]
    counted = any(ids == list(range(start, start + len(ids))) for start in (0, 1))
    start = int(width > 3 and (counted or all(map(math.isnan, ids))))
    if names and width - start > 3:
        raise InputError(f"which of the columns {', '.join(names)} are x, y and z?")
    if set("ijk") <= set(map(str.lower, names)):
        raise InputError("positions in voxels; they must be in mm")
    return [(start + k, 1.0) for k in range(3)]


def numbers(value: Any, name: str, shape: tuple[int, ...] = (-1,)) -> NDArray[np.float64]:
    """Return the finite numbers in a number, a text such as ``[1 0; 0 1]``, a list, or a list of rows.

    Raise InputError, with the field's ``name``, for other values or counts other than ``shape``; (-1,) is any count.
    """
    items = re.sub(r"[\[\];,]", " ", value).split() if isinstance(value, str) else value
    items = items if isinstance(items, list) else [items]
    try:
        rows = [row if isinstance(row, list) else [row] for row in items]
        array = np.array([float(number) for row in rows for number in row])
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    count = int(np.prod(shape))
    if not array.size or count not in (-1, array.size) or not np.isfinite(array).all():
        wanted = {-1: "finite numbers", 1: "1 number"}.get(count, f"{' x '.join(map(str, shape))} finite numbers")
        try:
            got = reprlib.repr(value)
        except ValueError:  # Python prints no integers of over 4300 digits; YAML allows them as 0x...
            got = "a number of thousands of digits"
        raise InputError(f"{name}: expected {wanted} (got {got})")
    return array.reshape(shape)


def image_sides(value: Any, name: str) -> tuple[int, int]:
    """Return width and height of an image, pixels. Raise InputError if they are not plausible."""
    width, height = numbers(value, name, (2,))
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise InputError(f"{name}: expected the size of an image (got {width:g} x {height:g})")
    return int(width), int(height)
