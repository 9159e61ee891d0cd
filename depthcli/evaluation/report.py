"""Tables as text and Markdown."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A table of strings.

    Attributes
    ----------
    title : one line
    header : names of the columns
    rows : one string a cell
    note : what the numbers mean, or empty
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def text(self) -> str:
        """Aligned columns for a terminal; columns of numbers are set to the right."""
        lines = [self.header, *self.rows]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.header))]
        right = [self._numeric(i) for i in range(len(self.header))]
        out = [self.title] if self.title else []
        for line in lines:
            cells = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(line, widths, right, strict=True)]
            out.append("  ".join(cells).rstrip())
        if self.note:
            out.append(self.note)
        return "\n".join(out) + "\n"

    def markdown(self) -> str:
        """A Markdown section with the table."""
        marks = ["---:" if self._numeric(i) else "---" for i in range(len(self.header))]
        out = [f"## {self.title}", ""] if self.title else []
        for line in (self.header, tuple(marks), *self.rows):
            out.append("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |")
        if self.note:
            out += ["", self.note]
        return "\n".join(out) + "\n"

    def _numeric(self, column: int) -> bool:
        return column > 0 and all(_is_number(row[column]) for row in self.rows)


def number(value: float, digits: int = 2) -> str:
    """A number of a table; ``-`` for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def _is_number(text: str) -> bool:
    try:
        float(text.strip("*") or "0")
    except ValueError:
        return text in ("", "-")
    return True
