"""Texts from outside, such as names of files and scenes, made harmless for terminals, tables and spreadsheets."""

from __future__ import annotations

from depthcli.core.errors import printable

_FORMULA_STARTS = ("=", "+", "-", "@")  # cells that begin so are computed by spreadsheets (OWASP, CSV injection)


def one_line(text: str) -> str:
    """``text`` on one line, with escapes for line breaks and for what cannot be shown."""
    return printable(text).replace("\n", "\\n")


def csv_cell(value: object) -> object:
    """``value`` as a cell of a CSV file: a text that a spreadsheet would compute gets an apostrophe before it.

    Numbers stay, those in texts too; line breaks and what cannot be shown are escaped.
    """
    if not isinstance(value, str):
        return value
    text = one_line(value)
    return f"'{text}" if len(text) > 1 and text.lstrip().startswith(_FORMULA_STARTS) and not _is_number(text) else text


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
