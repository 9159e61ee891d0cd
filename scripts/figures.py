#!/usr/bin/env python3
"""Measure the tables of docs/figures.md and of the README, and write them between their markers.

    scripts/figures.py [DATA] [--only tuning,validation] [--kept FOLDER]

figures.yaml says which script measures a table, and which of its rows and columns are shown. All of it takes hours;
``--only`` names some tables. Outputs of the scripts stay in the folder of ``--kept``, and are read from there again.
"""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import _env  # first: continues in the checkout's environment
import yaml
from _experiments import renewed

PAGES = (_env.ROOT / "docs" / "figures.md", _env.ROOT / "README.md")
SETTINGS = yaml.safe_load((_env.ROOT / "scripts" / "figures.yaml").read_text("utf-8"))
Rows = list[list[str]]  # the first one is the header


def main() -> None:
    options = _env.options(__doc__, "[data]", only=tuple(SETTINGS["tables"]), kept=None)
    printed: dict[str, str] = {}
    for page in PAGES:
        text = page.read_text("utf-8")
        for name in options.only:
            if f"<!-- begin {name} -->" in text:
                table = SETTINGS["tables"][name]
                run = table["run"]
                printed[run] = printed.get(run) or output(run, options.data, options.kept)
                text = renewed(text, {name: markdown(selected(tables(printed[run]), table))})
        page.write_text(text, "utf-8")


def output(run: str, data: Path, kept: Path | None) -> str:
    """Return what a script prints, or what it printed when its output was kept."""
    file = None if kept is None else kept / f"{run}.txt"
    if file is not None and file.exists():
        return file.read_text("utf-8")
    words = [word.replace("DATA", str(data)) for word in SETTINGS["runs"][run].split()]
    print(f"scripts/{SETTINGS['runs'][run]}", file=sys.stderr, flush=True)
    command = [sys.executable, str(_env.ROOT / "scripts" / words[0]), *words[1:]]
    text = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    return text


def tables(text: str) -> dict[str, Rows]:
    """Return title -> header and rows of the Markdown tables of a text, without marks of the best ones."""
    found: dict[str, Rows] = {}
    for title, body in re.findall(r"^## (.*)\n\n((?:\|.*\n)+)", text, re.M):
        rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in body.splitlines()]
        clean = [[re.sub(r"\*\*|</?u>|\\", "", cell) for cell in row] for row in rows]
        found[title] = [clean[0], *clean[2:]]
    return found


def selected(found: dict[str, Rows], table: dict[str, Any]) -> Rows:
    """Return the columns and rows of a table that are shown, under the names that they have on the page."""
    header, *rows = next(rows for title, rows in found.items() if title.startswith(table["title"]))
    cells = [dict(zip(header, row, strict=True)) for row in rows]
    for column, values in table.get("only", {}).items():
        cells = [each for each in cells if each[column] in map(str, values)]
    names = {str(own): shown for own, shown in table.get("rows", {}).items()}
    if names:
        by_name = {each[header[0]]: each for each in cells}
        cells = [by_name[own] | {header[0]: shown} for own, shown in names.items()]
    shown = [[" / ".join(each[own] for own in str(owns).split(" & ")) for owns in table["columns"].values()]
             for each in cells]  # fmt: skip
    return [list(map(str, table["columns"])), *shown, *([str(cell) for cell in row] for row in table.get("fixed", ()))]


def markdown(rows: Rows) -> str:
    """Return rows as a Markdown table, columns of numbers aligned to the right."""
    header, *others = rows
    numeric = (all(re.match(r"[-+.\d]", cell) for cell in cells) for cells in zip(*others, strict=True))
    marks = ["---:" if each else "---" for each in numeric]
    return "\n".join(f"| {' | '.join(row)} |" for row in (header, marks, *others))


if __name__ == "__main__":
    main()
