"""The sub-commands, one file each; the only place where files meet algorithms.

A public module here is a command: its name is the module's, its help the first paragraph of the module's docstring,
and ``COMMAND`` the object that does it. Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import importlib.util
import pkgutil
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.batch.command import Command


def command_names() -> list[str]:
    """Return the names of all commands, as typed, sorted."""
    return sorted(m.name.replace("_", "-") for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))


def load_command(name: str) -> Command:
    """Return the command of that name; KeyError where there is none."""
    if name not in command_names():
        raise KeyError(name)
    command: Command = importlib.import_module(f"{__name__}.{name.replace('-', '_')}").COMMAND
    return command


def help_of(name: str) -> str:
    """Return the first paragraph of its module's docstring, without importing it: ``--help`` shows all commands."""
    spec = importlib.util.find_spec(f"{__name__}.{name.replace('-', '_')}")
    source = "" if spec is None or spec.origin is None else Path(spec.origin).read_text("utf-8")
    doc = source.split('"""')[1] if source.startswith('"""') else ""
    return " ".join(doc.strip().split("\n\n")[0].split())
