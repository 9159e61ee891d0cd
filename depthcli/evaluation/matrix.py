"""Wide tables of numbers: a row a run, a column a scene or a measure, the best and the second best marked."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from depthcli.core.errors import ConfigError
from depthcli.evaluation.report import number
from depthcli.evaluation.results import EvaluationReport, Section
from depthcli.evaluation.scores import Measure
from depthcli.evaluation.tables import average_rank, mean, short

BEST, SECOND = 1, 2


@dataclass(frozen=True)
class Column:
    """One column of numbers.

    Attributes
    ----------
    title : heading
    values : one a run, NaN for none
    larger_is_better : a larger number beats a smaller one; None: neither does, and none is marked
    marks : what is written behind a number, such as ``*``; as many as values, or empty
    digits : decimals, of all that is written for people
    scene : full name of the scene that the column speaks of, or empty
    """

    title: str
    values: tuple[float, ...]
    larger_is_better: bool | None = False
    marks: tuple[str, ...] = ()
    digits: int = 2
    scene: str = ""

    @property
    def texts(self) -> list[str]:
        """The numbers as tables show them."""
        marks = self.marks or ("",) * len(self.values)
        pairs = zip(self.values, marks, strict=True)
        return [number(v, self.digits) + (mark if not math.isnan(v) else "") for v, mark in pairs]

    @property
    def places(self) -> list[int]:
        """``BEST``, ``SECOND`` or 0 for every run; numbers that read alike share a place."""
        if self.larger_is_better is None or len(self.values) < 2:
            return [0] * len(self.values)
        sign = -1.0 if self.larger_is_better else 1.0
        keys = [math.nan if math.isnan(v) else sign * round(v, self.digits) for v in self.values]
        order = sorted({key for key in keys if not math.isnan(key)})
        places = {key: place for place, key in enumerate(order[:2], BEST)}
        return [places.get(key, 0) for key in keys]

    @property
    def shades(self) -> list[float]:
        """How much worse every number is than the best, as a share of it: 0 best, 1 twice as bad or worse."""
        known = [v for v in self.values if not math.isnan(v)]
        if self.larger_is_better is None or len(known) < 2:
            return [0.0] * len(self.values)
        best = max(known) if self.larger_is_better else min(known)
        worse = [0.0 if math.isnan(v) else abs(v - best) / max(abs(best), 1e-9) for v in self.values]
        return [round(min(share, 1.0), 2) for share in worse]


@dataclass(frozen=True)
class Matrix:
    """A wide table.

    Attributes
    ----------
    title, note : lines above and below
    runs : names of the rows
    columns : with a number for every run each
    """

    title: str
    runs: tuple[str, ...]
    columns: tuple[Column, ...]
    note: str = ""

    def _rows(self, best: str, second: str, escape: Callable[[str], str]) -> list[list[str]]:
        forms = {0: "{}", BEST: best, SECOND: second}
        cells = [
            [forms[place].format(text) for text, place in zip(column.texts, column.places, strict=True)]
            for column in self.columns
        ]
        return [[escape(run), *(column[i] for column in cells)] for i, run in enumerate(self.runs)]

    def markdown(self) -> str:
        """A Markdown table: best bold, second underlined."""

        def escape(text: str) -> str:
            return text.replace("|", "\\|")

        header = ["run", *(escape(column.title) for column in self.columns)]
        lines = [header, ["---", *["---:"] * len(self.columns)], *self._rows("**{}**", "<u>{}</u>", escape)]
        table = "".join("| " + " | ".join(line) + " |\n" for line in lines)
        return f"## {self.title}\n\n{table}" + (f"\n{self.note}\n" if self.note else "")

    def latex(self) -> str:
        r"""A ``table`` with booktabs' rules: best ``\textbf``, second ``\underline``."""
        rows = self._rows(r"\textbf{{{}}}", r"\underline{{{}}}", _latex)
        header = ["run", *(_latex(column.title) for column in self.columns)]
        note = [f"\\par\\footnotesize {_latex(self.note)}"] if self.note else []
        lines = [
            "% wants \\usepackage{booktabs}",
            "\\begin{table}",
            "\\centering",
            f"\\caption{{{_latex(self.title)}}}",
            f"\\begin{{tabular}}{{l{'r' * len(self.columns)}}}",
            "\\toprule",
            " & ".join(header) + " \\\\",
            "\\midrule",
            *(" & ".join(row) + " \\\\" for row in rows),
            "\\bottomrule",
            "\\end{tabular}",
            *note,
            "\\end{table}",
        ]
        return "\n".join(lines) + "\n"

    def csv(self) -> str:
        """Comma-separated, all digits, nothing marked, an empty cell for no number; the title is the first column."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["table", "run", *(column.title for column in self.columns)])
        for i, run in enumerate(self.runs):
            values = (column.values[i] for column in self.columns)
            writer.writerow([self.title, run, *("" if math.isnan(v) else repr(float(v)) for v in values)])
        return text.getvalue()


FORMATS: dict[str, Callable[[Matrix], str]] = {
    "latex": Matrix.latex, "markdown": Matrix.markdown, "csv": Matrix.csv,
}  # fmt: skip
"""Name of a format -> text of a matrix."""


def written(report: EvaluationReport, form: str) -> str:
    """Every wide table of a report, in one of ``FORMATS``; ConfigError for another."""
    if form not in FORMATS:
        raise ConfigError(f"--format: want {', '.join(FORMATS)} (got {form!r})")
    made = [matrix for section in report.sections for matrix in (*of_scenes(section), *of_measures(section))]
    return "\n".join(FORMATS[form](matrix) for matrix in made)


def of_scenes(section: Section) -> list[Matrix]:
    """The headline in every region, by scene."""
    return [by_scene(section, section.protocol.headline, mask) for mask in section.masks]


def by_scene(section: Section, measure: Measure, mask: str) -> Matrix:
    """One measure in one region: a column a scene, then the means and, where they are known, times."""
    key, larger = (measure, mask), measure.larger_is_better
    columns = []
    for scene in section.scenes:
        results = [next(r for r in section.of(run) if r.scene == scene) for run in section.runs]
        if any(key in r.by_key for r in results):
            values = tuple(r.by_key[key].value if key in r.by_key else math.nan for r in results)
            marks = tuple("*" * bool(r.error) for r in results)
            columns.append(Column(short(scene), values, larger, marks, scene=scene))
    columns += _means(section, key, section.protocol.pooling) if len(section.scenes) > 1 else []
    headline = section.protocol.headline == measure
    if headline and len(section.runs) > 1 and len(section.scenes) > 1:
        ranks = tuple(average_rank(section, [key]).values())
        columns.append(Column("avg rank", ranks, False, digits=1))
    title = f"{section.data_set}: {measure.heading}{f', {measure.unit}' if measure.unit else ''}, {mask}"
    return Matrix(title, section.runs, (*columns, *times(section)), _note(section))


def of_measures(section: Section) -> list[Matrix]:
    """Means of every measure: a table a region, a column a measure."""
    made = []
    for mask in section.masks:
        keys = dict.fromkeys((s.measure, mask) for r in section.results for s in r.scores if s.mask == mask)
        columns = [c for key in keys for c in _means(section, key, key[0].heading, one=True)]
        many = len(section.scenes)
        title = f"{section.data_set}: {f'means over {many} scenes' if many > 1 else short(section.scenes[0])}, {mask}"
        made.append(Matrix(title, section.runs, (*columns, *times(section)), _note(section)))
    return made


def times(section: Section) -> list[Column]:
    """Mean seconds of a scene, a megapixel, and a gigadisparity (pixels x disparities), where some run has them."""
    runs = [section.of(run) for run in section.runs]
    seconds = tuple(mean(r.seconds for r in results) for results in runs)
    sizes = tuple(mean(1e6 * r.seconds / r.size for r in results if r.size) for results in runs)
    searched = tuple(
        mean(1e9 * r.seconds / (r.size * r.disparities) for r in results if r.size and r.disparities)
        for results in runs
    )
    found = [Column("seconds", seconds, False), Column("s/MP", sizes, False), Column("s/GD", searched, False)]
    return [column for column in found if not all(map(math.isnan, column.values))]


def _means(section: Section, key: Any, title: str, one: bool = False) -> list[Column]:
    """Over all scenes, and over those that all runs have where these are fewer."""
    columns = []
    for common in (False, True) if section.common and section.incomplete and not one else (False,):
        found = [section.means(run, common).get(key) for run in section.runs]
        values = tuple(math.nan if score is None else score.value for score in found)
        marks = tuple("*" * bool(section.lacking(run) and not common) for run in section.runs)
        name = f"{title} of {len(section.common)} common" if common else title
        columns.append(Column(name, values, key[0].larger_is_better, marks))
    return columns


def _note(section: Section) -> str:
    return "*: no map, counted as wholly wrong; means over scenes that all runs have beside" * section.incomplete


_LATEX = {
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    **{char: "\\" + char for char in "&%$#_{}"}, "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip


def _latex(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in text)


def best_of(values: Sequence[float], larger_is_better: bool) -> list[int]:
    """Indices of the values that are numbers, the best first."""
    known: Iterable[int] = (i for i, v in enumerate(values) if not math.isnan(v))
    return sorted(known, key=lambda i: -values[i] if larger_is_better else values[i])
