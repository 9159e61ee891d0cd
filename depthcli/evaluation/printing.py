"""What an evaluation prints on a terminal, the headline or tables chosen by name, and what stands in ``report.md``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from depthcli.core.errors import ConfigError
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.render import FORMATS, Table, markdown_code, markdown_link, markdown_text
from depthcli.evaluation.tables import (
    MISSING,
    TEST_COLUMNS,
    TESTS_NOTE,
    density_heading,
    overview,
    region_heading,
    report_tables,
    summary,
    tests_note,
)  # fmt: skip
from depthcli.evaluation.wide_tables import wide_tables

NAMES = ("headline", "overview", "metrics", "scenes", "further", "confidence", "hidden", "missing")
"""Names of tables; behind them may stand a region or run and a data set, as in ``metrics-nonocc``."""

_WIDTH = 100  # characters of a line of the headline table


def headline_text(report: EvaluationReport) -> str:
    """Return the headline for a terminal, at most 100 columns wide: of one data set by region, of several by set."""
    if len(report.sections) == 1:
        (section,) = report.sections
        table = summary(section)
        spare = [
            "avg rank",
            density_heading(section),
            "seconds",
            *(region_heading(section, r) for r in section.regions[:0:-1]),
        ]
        note = ". ".join(filter(None, [MISSING * section.incomplete, tests_note(section)]))
        return replace(table, note=note).fitted(_WIDTH, spare, ["run"]).text(_WIDTH)
    fitted = (each.fitted(_WIDTH, ["protocol", "losses", "mean of"], ["data set", "run"]) for each in overview(report))
    return "".join(table.text(_WIDTH) for table in fitted)


def chosen_text(
    report: EvaluationReport,
    names: Sequence[str],
    columns: Sequence[str] = (),
    form: str | None = None,
    caption: str | None = None,
) -> str:
    """Return tables for a terminal, or in a format.

    Parameters
    ----------
    report : the evaluation
    names : names of tables, or their beginnings up to a dash; ``all``: all. Empty: all of a format are the wide ones
    columns : headings of the columns to show beside the first one; empty: all
    form : name of one of ``FORMATS``, in which tables of scenes and metrics are wide; None: aligned text, titles and
        notes wrapped
    caption : title in place of the table's own

    Raises
    ------
    ConfigError
        There is no such table or column, or a caption for several tables.
    """
    narrow = report_tables(report)
    if form is None:
        tables = narrow
    else:
        tables = wide_tables(report)
        tables += [t for t in narrow if t.name.partition("-")[0] not in ("scenes", "metrics")] if names else []
    chosen = choose(tables, names) if names else tables
    if columns:
        known = dict.fromkeys(heading for table in chosen for heading in table.header[1:])
        if absent := [name for name in columns if name not in known]:
            raise ConfigError(f"--columns: no {', '.join(absent)} in these tables, which have {', '.join(known)}")
        chosen = [table.only(columns) for table in chosen if set(columns) & set(table.header[1:])]
        if not set(columns) & set(TEST_COLUMNS):
            chosen = [replace(table, note=table.note.partition(TESTS_NOTE)[0].rstrip(". ")) for table in chosen]
    if caption is not None:
        if len(chosen) != 1:
            raise ConfigError(f"--caption: is for one table; give --tables {' or '.join(t.name for t in chosen)}")
        chosen = [replace(table, title=caption) for table in chosen]
    return "\n".join(table.text(_WIDTH) if form is None else FORMATS[form](table) for table in chosen)


def check_names(names: Sequence[str]) -> None:
    """Raise ConfigError where a name can be that of no table."""
    wrong = [name for name in names if name.partition("-")[0] not in (*NAMES, "all")]
    if wrong:
        raise ConfigError(f"--tables: want all, {', '.join(NAMES)} (got {', '.join(wrong)})")


def choose(tables: Sequence[Table], names: Sequence[str]) -> list[Table]:
    """Return the tables whose name is one of ``names`` or begins with it and a dash; ConfigError where a name has none.

    ``all`` is the name of all; ``headline`` and the like may be of no table where there is nothing for it to show.
    """
    for name in names:
        if name not in ("all", *NAMES) and not any(f"{t.name}-".startswith(f"{name}-") for t in tables):
            raise ConfigError(f"--tables: no table {name}; there are {', '.join(t.name for t in tables)}")
    return [t for t in tables if "all" in names or any(f"{t.name}-".startswith(f"{name}-") for name in names)]


def report_markdown(report: EvaluationReport) -> str:
    """Return ``report.md``: all tables and warnings, with links to error pictures and plots."""
    runs = ", ".join(map(markdown_code, report.runs))
    out = ["# Evaluation", "", f"Ground truth: {markdown_code(report.truth)}. Runs: {runs}.", ""]
    if report.plugins:
        used = ", ".join(f"{package} {version}" for package, version in report.plugins.items())
        out += [f"Plug-ins: {markdown_code(used)}.", ""]
    out += [f"**Warning:** {markdown_text(line)}\n" for line in report.warnings]
    out += [table.markdown() for table in report_tables(report)]
    out += ["## Error pictures", ""]
    shown = ((p.name, p.presentation) for p in report.protocols.values())
    out += [f"{name}: {presentation.legend}.\n" for name, presentation in shown if presentation.error_pictures]
    for r in report.results:
        if not r.error:
            scene = markdown_text(r.scene)
            out += [f"{markdown_text(r.run)}, {scene}:", "", f"![{scene}]({markdown_link(r.picture)})", ""]
            out += [f"![{of}, {region}]({markdown_link(path)})\n" for (region, of), path in r.plots.items()]
    return "\n".join(out)
