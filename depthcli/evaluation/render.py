"""Tables, and their one renderer: aligned text, Markdown, LaTeX and CSV; the page renders its own by its template."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self
from urllib.parse import quote

from depthcli.core.text import csv_cell, one_line

BEST, SECOND = 1, 2


class Number(str):
    """A number as tables show it, ``-`` for NaN; it keeps its value, to be ranked and written with all digits."""

    value: float
    digits: int

    def __new__(cls, value: float, digits: int = 2, mark: str = "") -> Self:
        """Format the value, with a mark such as ``*`` behind its digits."""
        made = super().__new__(cls, "-" if math.isnan(value) else f"{value:.{digits}f}{mark}")
        made.value, made.digits = float(value), digits
        return made

    @property
    def plain(self) -> str:
        """All digits, empty for NaN."""
        return "" if math.isnan(self.value) else repr(self.value)


class TableColumn(NamedTuple):
    """A column of a table."""

    heading: str
    cells: Sequence[str]
    better: bool | None = None  # whether larger numbers are better; None: not ranked
    scene: str = ""  # full name of the scene that it speaks of, or empty


@dataclass(frozen=True)
class Table:
    """A table of texts and numbers."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]  # one cell a column; those that are a :class:`Number` can be ranked
    note: str = ""
    better: tuple[bool | None, ...] = ()  # of columns, whether larger numbers are better; None: not ranked
    scenes: tuple[str, ...] = ()  # of columns, full name of the scene that one speaks of, or empty
    name: str = ""  # by which it is chosen, and its label in LaTeX

    @classmethod
    def of_columns(cls, title: str, columns: Iterable[TableColumn], note: str = "", name: str = "") -> Table:
        """Return the table with these columns."""
        header, cells, better, scenes = zip(*columns, strict=True)
        return cls(title, header, list(zip(*cells, strict=True)), note, better, scenes, name)

    def only(self, headings: Collection[str]) -> Table:
        """Return the table with its first column and the columns of the headings."""
        chosen = [j for j, heading in enumerate(self.header) if j == 0 or heading in headings]

        def part(cells: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(cells[j] for j in chosen) if cells else ()

        rows, better, scenes = [part(row) for row in self.rows], part(self.better), part(self.scenes)
        return replace(self, header=part(self.header), rows=rows, better=better, scenes=scenes)

    def fitted(self, width: int, spare: Sequence[str] = (), names: Sequence[str] = ()) -> Table:
        """Return the table with lines of at most ``width`` characters, where that is possible.

        Columns of ``spare`` are left out in that order; if it is too wide still, the texts of the columns ``names`` are
        shortened.
        """
        table = self
        for heading in spare:
            if _width(table) > width:
                table = table.only(set(table.header) - {heading})
        for j in (table.header.index(name) for name in names):
            longest = max(map(len, table.column(j)), default=0)
            limit = max(_MIN_NAME, longest - max(0, _width(table) - width))
            half = (limit - 3) // 2
            rows = []
            for row in table.rows:
                name = one_line(row[j])
                if len(name) > limit:
                    name = f"{name[: limit - 3 - half]}...{name[len(name) - half :]}"
                rows.append((*row[:j], name, *row[j + 1 :]))
            table = replace(table, rows=rows)
        return table

    def column(self, j: int) -> list[str]:
        """Return the cells of a column."""
        return [row[j] for row in self.rows]

    def places(self, j: int) -> list[int]:
        """Return ``BEST``, ``SECOND`` or 0 for every cell of a column; numbers that read alike share a place."""
        if len(self.rows) < 2 or not self.better or (larger := self.better[j]) is None:
            return [0] * len(self.rows)
        cells = [cell if isinstance(cell, Number) else Number(math.nan) for cell in self.column(j)]
        keys = [(-1.0 if larger else 1.0) * round(cell.value, cell.digits) if cell != "-" else None for cell in cells]
        ranked = sorted({key for key in keys if key is not None})[:2]
        return [BEST + ranked.index(key) if key in ranked else 0 for key in keys]

    def shades(self, j: int) -> list[float]:
        """Return how much worse every number of a column is than the best: 0 the best, 1 twice as bad or worse."""
        values = [cell.value if isinstance(cell, Number) else math.nan for cell in self.column(j)]
        known = [v for v in values if not math.isnan(v)]
        if len(known) < 2 or not self.better or (larger := self.better[j]) is None:
            return [0.0] * len(values)
        best = max(known) if larger else min(known)
        worse = [0.0 if math.isnan(v) else abs(v - best) / max(abs(best), 1e-9) for v in values]
        return [round(min(share, 1.0), 2) for share in worse]

    def text(self, width: int = 10_000) -> str:
        """Return aligned columns for a terminal, numbers set to the right; title and note wrapped at width."""
        lines = [tuple(map(one_line, line)) for line in (self.header, *self.rows)]
        widths = [max(len(line[j]) for line in lines) for j in range(len(self.header))]
        right = _numeric(self)
        out = textwrap.wrap(one_line(self.title), width)
        for line in lines:
            cells = [c.rjust(w) if r else c.ljust(w) for c, w, r in zip(line, widths, right, strict=True)]
            out.append("  ".join(cells).rstrip())
        return "\n".join([*out, *textwrap.wrap(one_line(self.note), width)]) + "\n"

    def markdown(self) -> str:
        """Return a Markdown section: of ranked columns the best bold, the second best underlined."""
        marks = ["---:" if right else "---" for right in _numeric(self)]
        rows = _formatted(self, "**{}**", "<u>{}</u>", markdown_text)
        out = [f"## {markdown_text(self.title)}", ""] if self.title else []
        out += ["| " + " | ".join(row) + " |" for row in (rows[0], marks, *rows[1:])]
        return "\n".join([*out, *(["", markdown_text(self.note)] if self.note else [])]) + "\n"

    def latex(self) -> str:
        r"""Return a ``table`` with booktabs' rules: the best ``\textbf``, the second best ``\underline``.

        Its label is ``tab:`` and the table's name.
        """
        header, *rows = (" & ".join(row) for row in _formatted(self, r"\textbf{{{}}}", r"\underline{{{}}}", _latex))
        columns = "".join("r" if right else "l" for right in _numeric(self))
        lines = [r"% needs \usepackage{booktabs}", r"\begin{table}", r"\centering"]
        lines.append(rf"\caption{{{_latex(self.title)}}}")
        lines += [rf"\label{{tab:{_NO_LABEL.sub('-', self.name)}}}"] if self.name else []
        lines += [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", rf"{header} \\", r"\midrule"]
        lines += [*(rf"{row} \\" for row in rows), r"\bottomrule", r"\end{tabular}"]
        lines += [rf"\par\footnotesize {_latex(self.note)}"] if self.note else []
        return "\n".join([*lines, "\\end{table}"]) + "\n"


def csv_text(tables: Sequence[Table]) -> str:
    """Return comma-separated values with one header: numbers with all digits, NaN empty, titles in a column ``table``.

    A cell is empty where a table has no such column.
    """
    places = [_numbered(table.header) for table in tables]
    columns = list(dict.fromkeys(heading for each in places for heading in each))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["table", *(csv_cell(heading) for heading, _ in columns)])
    for table, headings in zip(tables, places, strict=True):
        for row in table.rows:
            cells = {heading: cell.plain if isinstance(cell, Number) else csv_cell(cell)
                     for heading, cell in zip(headings, row, strict=True)}  # fmt: skip
            writer.writerow([csv_cell(table.title), *(cells.get(heading, "") for heading in columns)])
    return text.getvalue()


def _numbered(header: Sequence[str]) -> list[tuple[str, int]]:
    """Return headings with how often each occurred before: two scenes of a table may have one name."""
    return [(heading, header[:j].count(heading)) for j, heading in enumerate(header)]


def _width(table: Table) -> int:
    return max(map(len, replace(table, title="", note="").text().splitlines()))


def _numeric(table: Table) -> list[bool]:
    """Return whether each column has numbers alone; the first never does."""
    return [j > 0 and all(map(_NUMERIC.fullmatch, table.column(j))) for j in range(len(table.header))]


def _formatted(table: Table, best: str, second: str, escape: Callable[[str], str]) -> list[list[str]]:
    """Return header and rows, escaped; ranked numbers in the formats of their place."""
    forms = {0: "{}", BEST: best, SECOND: second}
    places = [table.places(j) for j in range(len(table.header))]
    rows = ([forms[places[j][i]].format(escape(c)) for j, c in enumerate(row)] for i, row in enumerate(table.rows))
    return [[escape(cell) for cell in table.header], *rows]


FORMATS: dict[str, Callable[[Sequence[Table]], str]] = {
    "latex": lambda tables: "\n".join(map(Table.latex, tables)),
    "markdown": lambda tables: "\n".join(map(Table.markdown, tables)),
    "csv": csv_text,
}
"""Name of a file format -> function that writes tables in it."""

_LATEX = {char: "\\" + char for char in "&%$#_{}"}
_LATEX |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {"<": r"\textless{}", ">": r"\textgreater{}"}
_LATEX |= {"[": "{[}", "]": "{]}"}  # behind the end of a row they would be its distance to the next

_NO_LABEL = re.compile(r"[^A-Za-z0-9_.:-]+")
_NUMERIC = re.compile(r"[-+.\de]*\**")
_MIN_NAME = 12  # characters of a name that is shortened

_MARKDOWN = re.compile(r"[\\`|<\[\]]|&(?=#?\w+;)")


def _latex(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in one_line(text))


def markdown_text(text: str) -> str:
    """Return a text that Markdown shows as it is, on one line: no HTML, link, code or column in it."""
    return _MARKDOWN.sub(r"\\\g<0>", one_line(text))


def markdown_code(name: str) -> str:
    """Return a name as code, or as text where it would end the code itself."""
    return markdown_text(name) if "`" in name else f"`{one_line(name)}`"


def markdown_link(path: str) -> str:
    """Return a relative path as the target of a link, of whatever bytes."""
    return quote(os.fsencode(path))
