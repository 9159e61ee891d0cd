"""Tables of a terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

_MOST_ROWS = 50


@dataclass(frozen=True)
class Column:
    """A column of a command's table: its title, and the text of a finished row."""

    title: str
    text: Callable[[dict[str, Any]], str]


def percent(key: str) -> Callable[[dict[str, Any]], str]:
    """The text of a fact that is a share."""
    return lambda row: f"{100 * row[key]:.1f} %" if isinstance(row.get(key), int | float) else "-"


SIZE = Column("size", lambda row: f"{row['width']}x{row['height']}" if "width" in row else "-")


def run_table(rows: Sequence[dict[str, Any]], columns: Sequence[Column]) -> str:
    """The rows of a run; of many, only those that failed, and what they come to."""
    shown = [row for row in rows if len(rows) <= _MOST_ROWS or row["status"] != "done"]
    lines = [("scene", "status", *(column.title for column in columns), "seconds", "memory")]
    for row in shown:
        seconds, peak = sum(row["seconds"].values()), row["peak_memory"]
        cells = (column.text(row) if row["status"] == "done" else "-" for column in columns)
        memory = f"{peak / 2**20:.0f} MiB" if peak else "-"
        lines.append((str(row["scene"]), str(row["status"]), *cells, f"{seconds:.2f}" if seconds else "-", memory))
    if len(shown) < len(rows):
        seconds = sum(sum(row["seconds"].values()) for row in rows)
        blank = ("-",) * len(columns)
        lines.append((f"all {len(rows)}", f"{len(rows) - len(shown)} done", *blank, f"{seconds:.2f}", "-"))
    return aligned(lines)


def aligned(lines: Sequence[tuple[str, ...]]) -> str:
    """Rows of cells, the first two columns to the left, the others to the right."""
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    table = []
    for line in lines:
        cells = [c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))]
        table.append("  ".join(cells).rstrip())
    return "\n".join(table)
