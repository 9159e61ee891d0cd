"""Write the README's tables of methods, layouts, protocols and presets from the code itself.

    scripts/readme_tables.py [--check]

A table stands between ``<!-- table: NAME -->`` and ``<!-- end -->``. ``--check`` changes nothing and ends with 1 where
a table is not what the code says.
"""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path

from depthcli.batch.presets import list_presets
from depthcli.commands import command_names, help_of
from depthcli.core.method import Family
from depthcli.data.layouts import layouts
from depthcli.evaluation import protocols
from depthcli.methods.confidence import measures
from depthcli.methods.registration.search import MEASURES

README = Path(__file__).resolve().parent.parent / "README.md"
MARKS = re.compile(r"(<!-- table: ([\w/-]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    before = README.read_text("utf-8")
    after = filled(before)
    if options.check:
        return int(before != after)
    README.write_text(after, "utf-8")
    return 0


def filled(text: str) -> str:
    """The README with every table written anew."""
    return MARKS.sub(lambda mark: mark[1] + table(mark[2]) + mark[3], text)


def table(name: str) -> str:
    """One table as Markdown; KeyError for an unknown name."""
    if name == "commands":
        return _rows(("command", "what it does"), ((f"`{n}`", help_of(n)) for n in command_names()))
    if name == "layouts":
        return _rows(("layout", "files"), ((f"`{each.name}`", each.wants) for each in layouts()))
    if name == "protocols":
        found = ((f"`{n}`", protocols.load(n).title) for n in protocols.names())
        return _rows(("protocol", "what it measures"), found)
    if name == "confidence":
        return _rows(("measure", "what it is"), ((f"`{n}`", text) for n, text in measures().items()))
    if name == "registration":
        return _rows(("measure", "what it is"), ((f"`{n}`", text) for n, text in MEASURES.items()))
    if name == "presets":
        return _rows(("preset", "what it is"), _presets(thesis=False))
    if name == "thesis-presets":
        return _rows(("preset", "what it is"), _presets(thesis=True))
    if name.startswith("methods/"):
        return _methods(name.removeprefix("methods/"))
    raise KeyError(name)


def _presets(thesis: bool) -> Iterable[tuple[str, str]]:
    for command, preset, about in list_presets():
        if preset.startswith("thesis/") == thesis:
            yield f"`{command} {preset}`", about


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
