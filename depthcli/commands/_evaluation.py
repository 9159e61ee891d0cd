"""Files and printed tables of an evaluation."""

from __future__ import annotations

from pathlib import Path

from depthcli.commands._shared_options import TableOptions, parse_bytes
from depthcli.core.errors import ConfigError
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import PAGE_FILE, Viewer
from depthcli.report.contact_sheet import ContactSheet
from depthcli.report.document import Document
from depthcli.report.page import Page
from depthcli.report.tables import check_names, chosen_text, headline_text
from depthcli.report.without_truth import RunWithoutTruth
from depthcli.run.console import Reporter
from depthcli.show.table import FORMATS


def viewers(
    reporter: Reporter, output: Path | None, html: bool, html_budget: str = "50MB", run: RunWithoutTruth | None = None
) -> list[Viewer]:
    """Return what shows the maps of an evaluation: document, contact sheet, and the page that ``--html`` requests.

    ConfigError if the page has no folder, or ``html_budget`` is no size.
    """
    made: list[Viewer] = [Document(), ContactSheet()]
    if not html:
        return made
    if output is None:
        raise ConfigError("--html needs --output, the folder to write the page into")
    return [*made, Page(reporter.command_line, parse_bytes(html_budget, "--html-budget"), run)]


def check_tables(options: TableOptions) -> None:
    """Raise ConfigError where a format or the name of a table is none."""
    if options.format is not None and options.format not in FORMATS:
        raise ConfigError(f"--format: must be one of {', '.join(FORMATS)} (got {options.format!r})")
    check_names(_listed(options.tables))


def print_tables(report: EvaluationReport, reporter: Reporter, options: TableOptions, quiet: bool) -> None:
    """Print the tables that the options choose, or else the headline."""
    names, columns, form = _listed(options.tables), _listed(options.columns), options.format
    if form is None and columns == [] and options.caption is None and names in ([], ["headline"]):
        text = "" if quiet else headline_text(report)
    else:
        names = names or ([] if form else ["overview", "headline"])
        text = chosen_text(report, names, columns, form, options.caption)
    if text:
        reporter.data(text)


def print_place(report: EvaluationReport, output: Path, html: bool, reporter: Reporter) -> None:
    """Print which file to open; ``html``: a page was requested."""
    if html and PAGE_FILE not in report.unwritten:
        what = "report, with all tables and pictures" if report.results else "page to open in a browser"
        reporter.info(f"{what}: {output / PAGE_FILE}")
    elif report.results:
        more = "" if html else "; --html makes a page of it"
        reporter.info(f"report, with all tables and pictures: {output / 'report.md'}{more}")


def _listed(text: str | None) -> list[str]:
    """Return the parts of ``a,b`` without spaces around them."""
    return [part for each in (text or "").split(",") if (part := each.strip())]
