#!/usr/bin/env python3
"""Write the README's tables of methods, layouts, protocols, presets and status bits from the code itself.

    scripts/readme_tables.py [--check]

A table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``. ``--check`` changes nothing; it names what is out
of date, and ends with 1 then: a table that is not what the code says, a family of methods that has no table, a file of
this repository that the README or CONTRIBUTING.md names and that is not there.
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from enum import IntFlag
from pathlib import Path
from typing import Any

import _env  # noqa: F401  (first: continues in the checkout's environment)

from depthcli.batch.presets import list_presets
from depthcli.commands import command_names, help_of
from depthcli.core.maps import DEPTH_STATUS_HELP, STATUS_HELP, DepthStatus, Status
from depthcli.core.method import Family
from depthcli.data.layouts import layouts
from depthcli.evaluation import protocols
from depthcli.methods.confidence import measures
from depthcli.methods.registration.search import MEASURES

ROOT = Path(__file__).resolve().parent.parent
README, CONTRIBUTING = ROOT / "README.md", ROOT / "CONTRIBUTING.md"
TABLE = re.compile(r"(<!-- table: ([\w/-]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
FILE_NAME = re.compile(r"\b((?:scripts|depthcli|tests|configs)/[\w./-]*[\w/])")
NOT_THERE_YET = {"depthcli/methods/stereo/cost/squared_difference.py"}  # CONTRIBUTING.md adds it as its example


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing, report what is out of date")
    options = parser.parse_args(arguments)
    if options.check:
        problems = [*stale_tables(), *families_without_table(), *missing_files()]
        print(*problems, sep="\n", end="\n" if problems else "")
        return int(bool(problems))
    text = README.read_text("utf-8")
    README.write_text(TABLE.sub(lambda found: found[1] + table(found[2]) + found[4], text), "utf-8")
    return 0


def stale_tables() -> list[str]:
    """Return a line for each table of the README that differs from the code."""
    tables = TABLE.finditer(README.read_text("utf-8"))
    return [
        f"README.md: the table {found[2]} is out of date (scripts/readme_tables.py)"
        for found in tables
        if found[3] != table(found[2])
    ]


def families_without_table() -> list[str]:
    """Return a line for each family of exchangeable methods that the README has no table of."""
    sources = (ROOT / "depthcli").rglob("__init__.py")
    folders = [source.parent for source in sources if "method_of(" in source.read_text("utf-8")]
    families = {folder.relative_to(ROOT / "depthcli").as_posix() for folder in folders}
    tables = {found[2] for found in TABLE.finditer(README.read_text("utf-8"))}
    return [f"README.md: no table of depthcli/{family}" for family in sorted(families - tables)]


def missing_files() -> list[str]:
    """Return a line for each file of the repository that a document names and that does not exist."""
    return [
        f"{document.name}: {name} does not exist"
        for document in (README, CONTRIBUTING)
        for name in sorted(set(FILE_NAME.findall(document.read_text("utf-8"))) - NOT_THERE_YET)
        if not (ROOT / name).exists()
    ]


def table(name: str) -> str:
    """One table as Markdown; KeyError for an unknown name."""
    if name == "commands":
        return _rows(("command", "what it does"), ((f"`{n}`", help_of(n)) for n in command_names()))
    if name == "layouts":
        return _rows(("layout", "files"), ((f"`{each.name}`", each.wants) for each in layouts()))
    if name == "protocols":
        found = ((f"`{n}`", protocols.load(n).presentation.title) for n in protocols.names())
        return _rows(("protocol", "what it measures"), found)
    if name == "confidence":
        return _rows(("measure", "what it is"), ((f"`{n}`", text) for n, text in measures().items()))
    if name == "registration":
        return _rows(("measure", "what it is"), ((f"`{n}`", text) for n, text in MEASURES.items()))
    if name == "presets":
        return _rows(("preset", "what it is"), _presets(thesis=False))
    if name == "thesis-presets":
        return _rows(("preset", "what it is"), _presets(thesis=True))
    if name == "status":
        return _rows(("bit of `status.png`", "meaning"), _bits(Status, STATUS_HELP))
    if name == "depth-status":
        return _rows(("bit of a depth map's `status.png`", "meaning"), _bits(DepthStatus, DEPTH_STATUS_HELP))
    if (ROOT / "depthcli" / name).is_dir():
        return _methods(name)
    raise KeyError(name)


def _presets(thesis: bool) -> Iterable[tuple[str, str]]:
    for command, preset, about in list_presets():
        if preset.startswith("thesis/") == thesis:
            yield f"`{command} {preset}`", about


def _bits(flags: type[IntFlag], meanings: Mapping[Any, str]) -> list[tuple[str, str]]:
    bits = [*flags] if flags(0) in [*flags] else [flags(0), *flags]
    return [(str(int(bit)), meanings[bit]) for bit in bits]


def _methods(folder: str) -> str:
    family = Family.of(f"depthcli.{folder.replace('/', '.')}")
    importlib.import_module(family.package)
    rows = []
    for name in family.names():
        doc = (family.load(name).__doc__ or "").strip().split("\n\n")[0]
        rows.append((f"`{name}`", " ".join(doc.split()).replace("``", "`")))
    return _rows(("method", "what it does"), rows)


def _rows(header: tuple[str, str], rows: Iterable[tuple[str, str]]) -> str:
    lines = [header, ("---", "---"), *((a, b.replace("|", "\\|")) for a, b in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    sys.exit(main())
