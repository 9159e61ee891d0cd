"""The page of an evaluation or of a run: its options, and where it is written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.command import Values
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from depthcli.report.page import Page

PAGE_BUDGET = "50MB"
"""Size of a page's pictures beyond which they are scaled down."""

HTML = (
    Option("html", bool, "Also write report.html: maps and errors in a browser.", default=False, group="Report"),
    Option("html_budget", str, "Size of its pictures beyond which they are scaled down.", "SIZE", default=PAGE_BUDGET,
           group="Report"),
)  # fmt: skip
PAGE_FILE = "report.html"
"""The page, in the folder of an evaluation."""

RESULTS = (
    "scores.*", "report.md", PAGE_FILE, "contact_sheet.png", "errors/**/*", "curves/**/*", "points/**/*",
    "assets/*",
)  # fmt: skip
"""Shell patterns of the files of an evaluation."""


def write_page(page: Page, reporter: Reporter) -> None:
    """Write the page of a run without any truth where an evaluation of the run would be.

    Raises
    ------
    ConfigError
        The folder holds files that no evaluation wrote.
    OutputError
        The page cannot be written.
    """
    from depthcli.run.install import staging_folder
    from depthcli.run.run_folder import saved_config

    assert page.run is not None
    with staging_folder(page.folder, "evaluate", RESULTS, reporter.info) as folder:
        page.folder = folder
        page.write(None, "{}", {page.run.name: saved_config(page.run.folder)})


def new_page(line: str, values: Values, output: Path | None) -> Page | None:
    """Return the page that ``--html`` requests, which shows the command ``line``; None without ``--html``.

    ConfigError where there is no folder for it.
    """
    if not values["html"]:
        return None
    if output is None:
        raise ConfigError("--html wants --output, the folder to write the page into")
    from depthcli.report.page import Page
    from depthcli.run.resources import parse_bytes

    return Page(output, line, parse_bytes(values["html_budget"], "--html-budget"))
