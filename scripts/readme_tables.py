#!/usr/bin/env python3
"""Write the README's table of commands from the code itself, and check which files the documentation names.

    scripts/readme_tables.py [--check]

The table stands between ``<!-- table: commands -->`` and ``<!-- end -->``. ``--check`` changes nothing; it names what
is out of date, and ends with 1 then: the table is not what the code says, or the README, CONTRIBUTING.md or a page of
docs/ names a file of this repository that is not there.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

import _env

from depthcli.commands import help_of, own_names

README, CONTRIBUTING = _env.ROOT / "README.md", _env.ROOT / "CONTRIBUTING.md"
TABLE = re.compile(r"(<!-- table: commands -->\n)(.*?)(<!-- end -->)", re.DOTALL)
FILE_NAME = re.compile(r"(?<![\w/])((?:scripts|depthcli|tests|configs|docs)/[\w./-]*[\w/])")
NOT_THERE_YET = {"depthcli/methods/stereo/cost/squared_difference.py"}  # CONTRIBUTING.md adds it as its example


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing, report what is out of date")
    options = parser.parse_args(arguments)
    text = README.read_text("utf-8")
    fresh = TABLE.sub(lambda found: found[1] + table() + found[3], text)
    if not options.check:
        README.write_text(fresh, "utf-8")
        return 0
    problems = missing_files()
    if fresh != text:
        problems.append("README.md: the table of commands is out of date (scripts/readme_tables.py)")
    print(*problems, sep="\n", end="\n" if problems else "")
    return int(bool(problems))


def table() -> str:
    """Return the table of all commands as Markdown."""
    rows = [("command", "what it does"), ("---", "---"), *((f"`{name}`", help_of(name)) for name in own_names())]
    return "".join(f"| {a} | {b} |\n" for a, b in rows)


def missing_files() -> list[str]:
    """Return a line for each file of the repository that a document names and that does not exist."""
    documents: list[Path] = [README, CONTRIBUTING, *sorted((_env.ROOT / "docs").rglob("*.md"))]
    return [
        f"{document.name}: {name} does not exist"
        for document in documents
        for name in sorted(set(FILE_NAME.findall(document.read_text("utf-8"))) - NOT_THERE_YET)
        if not (_env.ROOT / name).exists()
    ]


if __name__ == "__main__":
    sys.exit(main())
