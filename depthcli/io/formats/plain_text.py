"""Content of calibrations and descriptions: JSON objects, lines of key and value, numbers of a known count."""

from __future__ import annotations

import json
import re
import reprlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError

_MAX_SIDE = 1 << 20  # pixels; no image is as wide


def json_object(data: bytes | str) -> dict[str, Any]:
    """Return the object that a JSON file is; InputError where it is none."""
    try:
        fields = json.loads(data if isinstance(data, str) else data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid JSON ({str(error)[:200]})") from error
    if not isinstance(fields, dict):
        raise InputError(f"expected a JSON object, got {type(fields).__name__}")
    return fields


def key_values(text: str) -> dict[str, str]:
    """Return key -> value of the lines ``key = value`` or ``key: value``; others are passed over."""
    return dict(re.findall(r"^\s*(\w+)\s*[=:]\s*(.*?)\s*$", text, re.MULTILINE))


def numbers(value: Any, name: str, shape: tuple[int, ...] = (-1,)) -> NDArray[np.float64]:
    """Return the finite numbers of a value: one, those of a text (as ``[1 0; 0 1]``), of a list, or of a list of rows.

    InputError, which names the field, where it is something else or has another count than ``shape``; (-1,): any.
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
        except ValueError:  # Python writes no integer of more than 4300 digits, which YAML has as 0x...
            got = "a number of thousands of digits"
        raise InputError(f"{name}: expected {wanted} (got {got})")
    return array.reshape(shape)


def image_sides(value: Any, name: str) -> tuple[int, int]:
    """Return width and height of an image, pixels; InputError where they make no sense."""
    width, height = numbers(value, name, (2,))
    if not 1 <= min(width, height) <= max(width, height) <= _MAX_SIDE:
        raise InputError(f"{name}: expected the size of an image (got {width:g} x {height:g})")
    return int(width), int(height)
