"""The sub-commands, one file each; the only place where files meet algorithms.

A public module here is a command: its name is the module's, its help the first paragraph of the module's docstring,
and ``COMMAND`` the object that does it. Nothing heavy is imported before a command runs.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from depthcli.batch.command import Command


def command_names() -> list[str]:
    """Names of all commands, as typed, sorted."""
    return sorted(m.name.replace("_", "-") for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_"))


def load_command(name: str) -> Command:
    """The command of that name; KeyError where there is none."""
    if name not in command_names():
        raise KeyError(name)
    command: Command = importlib.import_module(f"{__name__}.{name.replace('-', '_')}").COMMAND
    return command


def help_of(command: Command) -> str:
    """The first paragraph of its module's docstring."""
    doc = importlib.import_module(type(command).__module__).__doc__ or ""
    return " ".join(doc.strip().split("\n\n")[0].split())
