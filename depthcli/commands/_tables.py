"""The tables that an evaluation prints, and the options that choose them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.command import Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from depthcli.evaluation.comparison import EvaluationReport

TABLES = (
    Option("tables", str, "Tables to print: all, or metrics,scenes-nonocc ... Default: headline.", "NAMES",
           group="Report"),
    Option("format", str, "Print wide tables: latex, markdown or csv.", "FORMAT", group="Report"),
    Option("columns", str, "Of the tables, print only these columns.", "NAMES", group="Report"),
    Option("caption", str, "Caption of the one table that --tables chooses.", "TEXT", group="Report"),
)  # fmt: skip


def check_tables(values: Values) -> None:
    """Raise ConfigError where a format or the name of a table is none."""
    from depthcli.evaluation.printing import check_names
    from depthcli.evaluation.render import FORMATS

    form = values["format"]
    if form is not None and form not in FORMATS:
        raise ConfigError(f"--format: want {', '.join(FORMATS)} (got {form!r})")
    check_names(_listed(values["tables"]))


def print_tables(report: EvaluationReport, values: Values, reporter: Reporter) -> None:
    """Print the tables that the options ``TABLES`` choose, or else the headline."""
    from depthcli.evaluation.printing import chosen_text, headline_text

    names, columns, form = _listed(values.get("tables")), _listed(values.get("columns")), values.get("format")
    caption = values.get("caption")
    if form is None and columns == [] and caption is None and names in ([], ["headline"]):
        text = "" if values["quiet"] else headline_text(report)
    else:
        names = names or ([] if form else ["overview", "headline"])
        text = chosen_text(report, names, columns, form, caption)
    if text:
        reporter.data(text)


def print_place(output: Path, html: bool, reporter: Reporter) -> None:
    """Print which file to open."""
    more = "" if html else "; --html makes a page of it"
    reporter.info(f"report, with all tables and pictures: {output / ('report.html' if html else 'report.md')}{more}")


def _listed(text: str | None) -> list[str]:
    """Return the parts of ``a,b`` without spaces around them."""
    return [part for each in (text or "").split(",") if (part := each.strip())]
