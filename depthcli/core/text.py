"""Text for people: escapes for terminals, tables and spreadsheets; hints; sizes; kinds of warnings."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping

_NUMBER = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?")
_URL_AS_PATH = re.compile(r"\b(https?|s3|gs|ftp|memory):/(?=[^/\s])")  # paths have one slash of the two
_PASSWORD = re.compile(r"(\b[a-z][a-z0-9+.-]{1,20}:/{1,2})[^/\s@]+@", re.IGNORECASE)
# Up to its end, since a slash may be part of a signature.
_QUERY = re.compile(
    r"""(\b[a-z][a-z0-9+.-]{1,20}:/[^\s?'"]{0,4096})\?[^\s'"]*?(?=['"]|[:;,)]*(?:\s|$))""", re.IGNORECASE
)
_FORMULA_STARTS = ("=", "+", "-", "@")  # cells that begin so are computed by spreadsheets (OWASP, CSV injection)


def printable(text: str) -> str:
    """Return ``text`` with escapes for control characters except line breaks, and for bytes that are not UTF-8.

    Python represents such bytes as lone surrogates, which cannot be written to a stream.
    """
    if text.isprintable():
        return text
    bytes_shown = (f"\\x{ord(c) - 0xDC00:02x}" if "\udc80" <= c <= "\udcff" else c for c in text)
    shown = (c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode("ascii") for c in bytes_shown)
    return "".join(shown)


def one_line(text: str) -> str:
    """Return ``text`` on one line, with escapes for line breaks, too."""
    return printable(text).replace("\n", "\\n")


def without_secrets(text: str) -> str:
    """Return ``text`` without queries and passwords of URLs, including URLs in paths such as ``https:/host/a.zip``."""
    if ":/" not in text:
        return text
    return _URL_AS_PATH.sub(r"\1://", _QUERY.sub(r"\1", _PASSWORD.sub(r"\1", text)))


def csv_cell(value: object) -> object:
    """Return ``value`` as a cell of a CSV file: one line of text, with an apostrophe before a formula."""
    if not isinstance(value, str):
        return value
    text = one_line(value)
    if len(text) < 2 or not text.lstrip().startswith(_FORMULA_STARTS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def short(value: object) -> str:
    """Return a value as text for a message, on one line of at most 64 characters."""
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):  # no plain data, or an integer with too many digits
        text = str(value) if not isinstance(value, int) else "a number of thousands of digits"
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 64 else text[:61] + "..."


def did_you_mean(name: str, known: Iterable[str], renamed: Mapping[str, str] | None = None, cutoff: float = 0.6) -> str:
    """Return a hint at the new name of something renamed, or at a similar known name; or an empty text."""
    near = [renamed[name]] if renamed and name in renamed else difflib.get_close_matches(name, list(known), 1, cutoff)
    return f"; did you mean {near[0]!r}?" if near else ""


def show_bytes(size: int) -> str:
    """Return a size as people read it, such as 1.5 GiB."""
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.0f} MiB"


def side_and_distance(ends: str, millimeters: float) -> str:
    """Return a position along an axis as side of the origin and distance, ``S 12 mm``."""
    return f"{ends[millimeters < 0]} {abs(millimeters):.0f} mm"


def summarized(warnings: Iterable[tuple[str, str]]) -> list[str]:
    """Return one line per kind of warning (scene, line): its first scene, and the number of other scenes."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for scene, line in warnings:
        kinds.setdefault(kind_of_warning(scene, without_file(line)), []).append((scene, line))
    more = {kind: len(of) - 1 for kind, of in kinds.items()}
    return [f"{of[0][0]}{f' and {more[k]} more' if more[k] else ''}: {of[0][1]}" for k, of in kinds.items()]


def kind_of_warning(scene: str, text: str) -> str:
    """Return the text of a warning without numbers and the name of its scene."""
    return _NUMBER.sub("#", re.sub(rf"(?<!\w){re.escape(scene)}(?!\w)", "#", text))


def without_file(line: str) -> str:
    """Return the line without a path at its beginning."""
    start, colon, rest = line.partition(": ")
    return rest if colon and "/" in start else line
