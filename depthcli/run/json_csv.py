"""Rows of reports, and documents as strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, TypeAlias

Row: TypeAlias = dict[str, Any]
"""One row of a report: column -> JSON value."""


def share(values: Any) -> float:
    """Return the mean of an array, such as the share of pixels that are True, as in reports."""
    return round(float(values.mean()), 6)


def median(values: Any) -> float | None:
    """Return the median of the numbers of an array that are not NaN, as in reports; None where there is none."""
    known = values[values == values]  # this module is imported before numpy
    if not known.size:
        return None
    known.sort()
    return round(float(known[(known.size - 1) // 2] + known[known.size // 2]) / 2, 4)


def to_json(value: object) -> str:
    """Return ``value`` as indented JSON that ends with a line break; numbers that are not finite become null."""
    plain = _finite(value)
    text = json.dumps(plain, indent=1, ensure_ascii=False, allow_nan=False)
    return (text if _is_utf8(text) else json.dumps(plain, indent=1, allow_nan=False)) + "\n"


def to_json_line(value: object) -> str:
    """Return ``value`` as JSON on one line; numbers that are not finite become null."""
    try:
        text = json.dumps(value, ensure_ascii=False, allow_nan=False)
    except (ValueError, TypeError):  # numbers that are not finite, or of numpy
        text = json.dumps(_finite(value), ensure_ascii=False, allow_nan=False)
    return text if _is_utf8(text) else json.dumps(_finite(value), allow_nan=False)


def _is_utf8(text: str) -> bool:
    """Return False for text with bytes of a file name that is not UTF-8; escaped they can be read back."""
    try:
        if not text.isascii():
            text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
