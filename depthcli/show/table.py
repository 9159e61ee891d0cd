"""Rows of reports as JSON and CSV; tables: columns, and one renderer to aligned text, Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import os
import re
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter
from typing import Any, Self, TypeAlias
from urllib.parse import quote

from depthcli.core.text import csv_cell, one_line

BEST, SECOND = 1, 2
_MAX_ROWS = 50  # of a run's table; a longer one shows only the failed scenes and a summary
_MIN_NAME = 12  # characters of a name that is shortened
_NUMERIC = re.compile(r"[-+.\de]*\**")
_NO_LABEL = re.compile(r"[^A-Za-z0-9_.:-]+")
_MARKDOWN = re.compile(r"[\\`|<\[\]]|&(?=#?\w+;)")
_LATEX = {char: "\\" + char for char in "&%$#_{}"}
_LATEX |= {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
_LATEX |= {"<": r"\textless{}", ">": r"\textgreater{}"}
_LATEX |= {"[": "{[}", "]": "{]}"}  # behind the end of a row they would be its distance to the next


Row: TypeAlias = dict[str, Any]
"""One row of a report: column -> JSON value."""


class Number(str):
    """A number with its text in tables, ``-`` for NaN; its value is kept, for ranks and for output with all digits."""

    value: float
    digits: int

    def __new__(cls, value: float, digits: int = 2, mark: str = "") -> Self:
        """Format the value, with a mark such as ``*`` behind its digits."""
        number = super().__new__(cls, "-" if math.isnan(value) else f"{value:.{digits}f}{mark}")
        number.value, number.digits = float(value), digits
        return number

    @property
    def plain(self) -> float | None:
        """All digits; None for NaN."""
        return None if math.isnan(self.value) else self.value


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    heading: str
    cell: Callable[[Any], Any]  # text or :class:`Number` of a row; values of any type are for CSV alone
    better: bool | None = None  # whether larger numbers are better; None: not ranked
    scene: str = ""  # full name of the scene that it is about, or empty


def percent(key: str, heading: str = "") -> Column:
    """Return the column of a share in a report, as a percentage, under the name of its key or ``heading``."""

    def cell(row: Mapping[str, Any]) -> str:
        return f"{100 * row[key]:.1f} %" if isinstance(row.get(key), int | float) else "-"

    return Column(heading or key.replace("_", " "), cell)


def number(key: str, form: str, heading: str = "") -> Column:
    """Return the column of a number in a format such as ``{:.2f} px``, under the name of its key or ``heading``."""
    return Column(heading or key.replace("_", " "), lambda row: "-" if row.get(key) is None else form.format(row[key]))


SECONDS = Column("seconds", lambda row: f"{s:.2f}" if (s := math.fsum(row.get("seconds", {}).values())) else "-")
SIZE = Column("size", lambda row: f"{row['width']}x{row['height']}" if "width" in row else "-")


def size_of(image: Any) -> Row:
    """Return the report's columns about the size of an image or map (H, W, ...), pixels."""
    return {"width": image.shape[1], "height": image.shape[0]}


@dataclass(frozen=True)
class Table:
    """A table: each column makes one cell of each row."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Any]
    note: str = ""
    name: str = ""  # by which it is chosen, and its label in LaTeX

    @classmethod
    def of_cells(cls, title: str, header: Sequence[str], rows: Sequence[Any], note: str = "", name: str = "") -> Table:
        """Return the table of rows with one cell per column."""
        return cls(title, [Column(heading, itemgetter(j)) for j, heading in enumerate(header)], rows, note, name)

    @cached_property
    def header(self) -> tuple[str, ...]:
        """Headings of the columns."""
        return tuple(column.heading for column in self.columns)

    @cached_property
    def cells(self) -> list[list[str]]:
        """Cells of every column."""
        return [list(map(column.cell, self.rows)) for column in self.columns]

    @property
    def lines(self) -> list[tuple[str, ...]]:
        """Header, and cells of every row."""
        return [self.header, *zip(*self.cells, strict=True)]

    def only(self, headings: Collection[str]) -> Table:
        """Return the table with its first column and the columns of the headings."""
        return replace(self, columns=[c for j, c in enumerate(self.columns) if j == 0 or c.heading in headings])

    def fitted(self, width: int, spare: Sequence[str] = (), names: Sequence[str] = ()) -> Table:
        """Return the table with lines of at most ``width`` characters, if that is possible.

        Columns of ``spare`` are left out in that order. If the table is still too wide, the texts of the columns
        ``names`` are shortened.
        """
        table = self
        for heading in spare:
            if table._width > width:
                table = table.only(set(table.header) - {heading})
        for j in (table.header.index(name) for name in names):
            limit = max(_MIN_NAME, max(map(len, table.cells[j]), default=0) - max(0, table._width - width))
            cells = [*table.cells]
            cells[j] = [_shortened(cell, limit) for cell in cells[j]]
            columns = [replace(column, cell=itemgetter(k)) for k, column in enumerate(table.columns)]
            table = replace(table, columns=columns, rows=list(zip(*cells, strict=True)))
        return table

    @property
    def _width(self) -> int:
        return max(map(len, aligned(self.lines, self._numeric).splitlines()))

    @property
    def _numeric(self) -> list[bool]:
        """Return for each column whether it has only numbers; the first never does."""
        return [j > 0 and all(map(_NUMERIC.fullmatch, cells)) for j, cells in enumerate(self.cells)]

    def places(self, j: int) -> list[int]:
        """Return ``BEST``, ``SECOND`` or 0 for every cell of a column; numbers with the same text share a place."""
        cells, larger = self.cells[j], self.columns[j].better
        if len(cells) < 2 or larger is None:
            return [0] * len(cells)
        sign = -1.0 if larger else 1.0
        keys = [sign * round(c.value, c.digits) if isinstance(c, Number) and c != "-" else None for c in cells]
        ranked = sorted({key for key in keys if key is not None})[:2]
        return [BEST + ranked.index(key) if key in ranked else 0 for key in keys]

    def shades(self, j: int) -> list[float]:
        """Return how much worse than the best each number of a column is: 0 (best) to 1 (twice as bad or worse)."""
        values = [cell.value if isinstance(cell, Number) else math.nan for cell in self.cells[j]]
        known, larger = [v for v in values if not math.isnan(v)], self.columns[j].better
        if len(known) < 2 or larger is None:
            return [0.0] * len(values)
        best = max(known) if larger else min(known)
        worse = [0.0 if math.isnan(v) else abs(v - best) / max(abs(best), 1e-9) for v in values]
        return [round(min(share, 1.0), 2) for share in worse]

    def text(self, width: int = 10_000) -> str:
        """Return aligned columns for a terminal, numbers set to the right; title and note wrapped at width."""
        title, note = (textwrap.wrap(one_line(words), width) for words in (self.title, self.note))
        return "\n".join([*title, aligned(self.lines, self._numeric), *note]) + "\n"

    def markdown(self) -> str:
        """Return a Markdown section; in ranked columns, the best is bold and the second best underlined."""
        marks = ["---:" if right else "---" for right in self._numeric]
        header, *rows = self._escaped("**{}**", "<u>{}</u>", markdown_text)
        out = [f"## {markdown_text(self.title)}", ""] if self.title else []
        out += ["| " + " | ".join(row) + " |" for row in (header, marks, *rows)]
        return "\n".join([*out, *(["", markdown_text(self.note)] if self.note else [])]) + "\n"

    def latex(self) -> str:
        r"""Return a ``table`` with booktabs' rules: the best ``\textbf``, the second best ``\underline``.

        Its label is ``tab:`` and the table's name.
        """
        header, *rows = map(" & ".join, self._escaped(r"\textbf{{{}}}", r"\underline{{{}}}", _latex))
        sides = "".join("r" if right else "l" for right in self._numeric)
        lines = [r"% needs \usepackage{booktabs}", r"\begin{table}", r"\centering"]
        lines.append(rf"\caption{{{_latex(self.title)}}}")
        lines += [rf"\label{{tab:{_NO_LABEL.sub('-', self.name)}}}"] if self.name else []
        lines += [rf"\begin{{tabular}}{{{sides}}}", r"\toprule", rf"{header} \\", r"\midrule"]
        lines += [*(rf"{row} \\" for row in rows), r"\bottomrule", r"\end{tabular}"]
        lines += [rf"\par\footnotesize {_latex(self.note)}"] if self.note else []
        return "\n".join([*lines, "\\end{table}"]) + "\n"

    def csv(self) -> str:
        """Return comma-separated values: numbers with all digits, NaN and None empty, no formulas of spreadsheets."""
        return _csv(self.lines)

    def _escaped(self, best: str, second: str, escape: Callable[[str], str]) -> list[list[str]]:
        """Return header and rows, escaped; ranked numbers in the formats of their place."""
        forms = {0: "{}", BEST: best, SECOND: second}
        columns = [
            [escape(heading), *(forms[k].format(escape(c)) for k, c in zip(self.places(j), self.cells[j], strict=True))]
            for j, heading in enumerate(self.header)
        ]
        return [list(row) for row in zip(*columns, strict=True)]


def joined(tables: Sequence[Table]) -> Table:
    """Return one table with the rows of several tables, and their titles in a column ``table``.

    A cell is empty if its table has no such column.
    """
    # Two scenes of a table may share a name, so a column is its heading and how often that occurred before.
    places = [{(h, table.header[:j].count(h)): j for j, h in enumerate(table.header)} for table in tables]
    headings = list(dict.fromkeys(heading for place in places for heading in place))
    rows = [
        [table.title, *(table.columns[place[h]].cell(row) if h in place else "" for h in headings)]
        for table, place in zip(tables, places, strict=True)
        for row in table.rows
    ]
    return Table.of_cells("", ["table", *(heading for heading, _ in headings)], rows)


FORMATS: dict[str, Callable[[Sequence[Table]], str]] = {
    "latex": lambda tables: "\n".join(map(Table.latex, tables)),
    "markdown": lambda tables: "\n".join(map(Table.markdown, tables)),
    "csv": lambda tables: joined(tables).csv(),
}
"""Name of a file format -> function that writes tables in it."""


def share(values: Any) -> float:
    """Return the mean of an array, such as the share of True pixels, rounded for reports."""
    return round(float(values.mean()), 6)


def median(values: Any) -> float | None:
    """Return the median of an array without NaN, rounded for reports, or None if all are NaN."""
    known = values[values == values]  # not np.isnan, since this module does not import numpy
    if not known.size:
        return None
    known.sort()
    return round(float(known[(known.size - 1) // 2] + known[known.size // 2]) / 2, 4)


def to_json(value: object, indent: int | None = 1) -> str:
    """Return ``value`` as JSON that ends with a line break; numbers that are not finite become null.

    Bytes of file names that are not UTF-8 are escaped so that they can be read back. ``indent`` None: on one line.
    """
    form: dict[str, Any] = {"indent": indent, "default": lambda number: number.item()}  # of numpy
    text = json.dumps(value, ensure_ascii=False, **form)
    if "NaN" in text or "Infinity" in text:
        value = json.loads(text, parse_constant=lambda constant: None)
        text = json.dumps(value, ensure_ascii=False, **form)
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        text = json.dumps(value, **form)
    return f"{text}\n"


def to_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as CSV with a header; columns are in the order of their first appearance.

    Mappings become columns ``outer_inner``; lists become text.
    """
    flat: list[dict[str, Any]] = []
    for row in rows:
        flat.append({})
        for key, value in row.items():
            if isinstance(value, Mapping):
                for inner, part in value.items():
                    flat[-1][f"{key}_{inner}"] = part
            else:
                flat[-1][key] = "; ".join(map(str, value)) if isinstance(value, list) else value
    keys = list(dict.fromkeys(itertools.chain(*flat)))
    return _csv([keys, *(map(row.get, keys) for row in flat)])


def run_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[Column]) -> str:
    """Return the table of a run: one line per scene, or for a long run its failed scenes and a summary.

    Columns without a value in any finished scene are left out.
    """
    done = [row for row in rows if row["status"] == "done"]
    columns = [column for column in columns if not done or any(column.cell(row) != "-" for row in done)]
    shown = [row for row in rows if len(rows) <= _MAX_ROWS or row["status"] != "done"]
    lines = [("scene", "status", *(column.heading for column in (*columns, SECONDS)), "memory")]
    for row in shown:
        cells = (column.cell(row) if row["status"] == "done" else "-" for column in columns)
        memory = f"{row['peak_memory'] / 2**20:.0f} MiB" if row["peak_memory"] else "-"
        lines.append((str(row["scene"]), str(row["status"]), *cells, SECONDS.cell(row), memory))
    if len(shown) < len(rows):
        seconds = sum(sum(row["seconds"].values()) for row in rows)
        blank = ("-",) * len(columns)
        lines.append((f"all {len(rows)}", f"{len(rows) - len(shown)} done", *blank, f"{seconds:.2f}", "-"))
    return aligned(lines)


def aligned(lines: Sequence[Sequence[str]], right: Sequence[bool] | None = None) -> str:
    """Return rows of cells with aligned columns; ``right``: to the right; None: all but the first two columns."""
    lines = [tuple(map(one_line, line)) for line in lines]
    sizes = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = [">" if to_right else "<" for to_right in right or [j > 1 for j in range(len(sizes))]]
    form = "  ".join(f"{{:{side}{size}}}" for side, size in zip(sides, sizes, strict=True))
    return "\n".join(form.format(*line).rstrip() for line in lines)


def markdown_text(text: str) -> str:
    """Return a text on one line, with escapes so that Markdown shows it without HTML, links, code or columns."""
    return _MARKDOWN.sub(r"\\\g<0>", one_line(text))


def markdown_code(name: str) -> str:
    """Return a name as code, or as text if it contains the end of code."""
    return markdown_text(name) if "`" in name else f"`{one_line(name)}`"


def markdown_link(path: str) -> str:
    """Return a relative path of any bytes as the target of a link."""
    return quote(os.fsencode(path))


def _latex(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in one_line(text))


def _csv(lines: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for line in lines:
        writer.writerow(csv_cell(cell) if type(cell) is not Number else cell.plain for cell in line)
    return text.getvalue()


def _shortened(name: str, limit: int) -> str:
    """Return a name of at most ``limit`` characters, without its middle."""
    name, half = one_line(name), (limit - 3) // 2
    return name if len(name) <= limit else f"{name[: limit - 3 - half]}...{name[len(name) - half :]}"
