"""Tables as text and Markdown, and line plots as SVG, without a plotting library."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from depthcli.evaluation.curves import Sparsification


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


@dataclass(frozen=True)
class Line:
    """One line of a plot: a name for the legend, points, and whether it is a bound: drawn grey and dotted."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    bound: bool = False


# Okabe & Ito's palette: told apart by color-blind readers too.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6d1f", "#000000")
_DASHES = ("", "6 4", "2 2 8 2")
_BOUND = ("#888888", "2 3")


def line_plot(lines: Sequence[Line], title: str, x_label: str, y_label: str) -> str:
    """A line plot with axes, grid and legend, as the text of an SVG file.

    Parameters
    ----------
    lines : at least one point each; colors are given in turn, from the ninth line on with dashes
    title, x_label, y_label : plain text
    """
    width, height, left, top = 560, 360, 62, 34
    legend = 14 + 7 * max((len(line.name) for line in lines), default=0) + 30
    plot_w, plot_h = width - left - 16, height - top - 48
    xs = [x for line in lines for x in line.x if math.isfinite(x)]
    ys = [y for line in lines for y in line.y if math.isfinite(y)]
    x_ticks = _ticks(min([0.0, *xs]), max([0.0, *xs]))
    y_ticks = _ticks(min([0.0, *ys]), max([0.0, *ys]))

    def px(x: float) -> float:
        return left + (x - x_ticks[0]) / (x_ticks[-1] - x_ticks[0]) * plot_w

    def py(y: float) -> float:
        return top + plot_h - (y - y_ticks[0]) / (y_ticks[-1] - y_ticks[0]) * plot_h

    tall = max(height, top + 18 * len(lines) + 16)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width + legend}" height="{tall}" '
        f'viewBox="0 0 {width + legend} {tall}" font-family="sans-serif" font-size="12">',
        f'<rect width="{width + legend}" height="{tall}" fill="white"/>',
        f'<text x="{left}" y="20" font-size="14">{escape(title)}</text>',
    ]
    for tick in x_ticks:
        x = px(tick)
        out.append(f'<path d="M{x:.1f} {top}V{top + plot_h}" stroke="#e2e2e2"/>')
        out.append(f'<text x="{x:.1f}" y="{top + plot_h + 16}" text-anchor="middle">{tick:g}</text>')
    for tick in y_ticks:
        y = py(tick)
        out.append(f'<path d="M{left} {y:.1f}H{left + plot_w}" stroke="#e2e2e2"/>')
        out.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    out.append(f'<rect x="{left}" y="{top}" width="{plot_w}" height="{plot_h}" fill="none" stroke="#444"/>')
    middle = left + plot_w / 2
    out.append(f'<text x="{middle}" y="{top + plot_h + 36}" text-anchor="middle">{escape(x_label)}</text>')
    y_at = top + plot_h / 2
    out.append(f'<text transform="translate(16 {y_at}) rotate(-90)" text-anchor="middle">{escape(y_label)}</text>')
    for i, line in enumerate(lines):
        color, dashes = _COLORS[i % len(_COLORS)], _DASHES[i // len(_COLORS) % len(_DASHES)]
        if line.bound:
            color, dashes = _BOUND
        style = f' stroke-dasharray="{dashes}"' if dashes else ""
        points = [(x, y) for x, y in zip(line.x, line.y, strict=True) if math.isfinite(x) and math.isfinite(y)]
        path = " ".join(f"{px(x):.1f},{py(y):.1f}" for x, y in points)
        out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="1.6"{style}/>')
        y = top + 8 + 18 * i
        out.append(f'<path d="M{width} {y}h24" stroke="{color}" stroke-width="2"{style}/>')
        out.append(f'<text x="{width + 30}" y="{y + 4}">{escape(line.name)}</text>')
    out.append("</svg>")
    return "\n".join(out) + "\n"


def curve_plot(curves: Mapping[str, Sparsification], title: str, of: str) -> str:
    """Sparsification curves of one region with their bounds, the best first, as the text of an SVG file."""
    ordered = sorted(curves.items(), key=lambda item: item[1].auc)
    lines = [Line(f"{name} {c.auc:.4f}", c.percentages, c.errors) for name, c in ordered]
    some = ordered[0][1]
    lines.append(Line(f"optimal {some.optimal:.4f}", some.percentages, some.best, bound=True))
    lines.append(Line(f"random {some.mean:.4f}", some.percentages, [some.mean] * len(some.percentages), bound=True))
    y_label = "error rate" if of == "bad" else "mean absolute error"
    return line_plot(lines, title, "most confident pixels, %", y_label)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers that enclose [low, high], about five steps."""
    if high <= low:
        high = low + 1
    raw = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]
