"""The sub-commands, one file each: options in, exit code out.

A public module here is a command: it defines a function of its own name, whose parameters typer reads as arguments and
options (``_options``), and the module's docstring is its help. The function returns the exit code.
Nothing heavy is imported before it runs: each imports the module that does the work where it needs it.

A command that makes a run folder gives its options to ``run_problem`` (``_run``), which takes the problem from
:mod:`depthcli.problems`, finds the scenes (``io/scenes/find``), has every scene computed by
:func:`depthcli.run.runner.run_scenes`, evaluates if that is requested, and prints the table.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from depthcli import problems
from depthcli.core import plugins

if TYPE_CHECKING:
    from pydantic import BaseModel

_GROUPS = {
    "Match and refine": ("stereo", "fuse", "refine-kinect", "transparent", "confidence", "register-confidence"),
    "Prepare and convert": ("sample", "calibrate", "rectify", "depth"),
    "Evaluate and report": ("evaluate", "sweep", "export", "presets"),
}
"""Heading of ``depthcli --help`` -> commands; other commands come last, under their own heading."""

CommandT = TypeVar("CommandT", bound=Callable[..., int])


def names() -> list[str]:
    """Return the names of all commands as typed: the package's, sorted, then the plug-ins'."""
    return [*own_names(), *sorted(plugins.commands)]


@cache
def own_names() -> tuple[str, ...]:
    """Return the sorted names of the package's commands as typed."""
    found = (module.name for module in pkgutil.iter_modules(__path__))
    return tuple(sorted(name.replace("_", "-") for name in found if not name.startswith("_")))


def grouped_names() -> dict[str, list[str]]:
    """Return heading -> names of its commands, in the order of ``depthcli --help``."""
    groups = {heading: list(group) for heading, group in _GROUPS.items()}
    if more := [name for name in names() if not any(name in group for group in groups.values())]:
        groups["More"] = more
    return groups


def command(config: type[BaseModel] | None = None) -> Callable[[CommandT], CommandT]:
    """Return a decorator that makes a plug-in's function a command. It raises ValueError if the name is taken.

    Parameters
    ----------
    config : class of its configs, for ``depthcli presets show``
    """

    def mark(function: CommandT) -> CommandT:
        if function.__name__.replace("_", "-") in own_names() and not function.__module__.startswith("depthcli."):
            raise ValueError(f"depthcli has a command {function.__name__} already")
        vars(function).update(is_command=True, config=config)
        return function

    return mark


def config_model(name: str) -> type[BaseModel] | None:
    """Return the class of a command's configs, or None if it has no configs or does not exist."""
    if name in problems.PROBLEMS:
        return problems.config_model(name)
    return getattr(find(name), "config", None)


def find(name: str) -> Callable[..., int] | None:
    """Return the function of a command, or None if there is no such command."""
    plain = name.replace("-", "_")
    if name.replace("_", "-") not in own_names():
        return plugins.commands.get(name.replace("_", "-"))
    function: Callable[..., int] = getattr(importlib.import_module(f"{__name__}.{plain}"), plain)
    return function


def text_of(function: Callable[..., int]) -> str:
    """Return the help of a command: the docstring of its module or of a plug-in's function."""
    own = function.__module__.startswith(f"{__name__}.")
    return inspect.cleandoc((sys.modules[function.__module__] if own else function).__doc__ or "")


def help_of(name: str) -> str:
    """Return the first paragraph of a command's help; the package's commands are not imported for it."""
    if name in own_names():
        text = Path(__path__[0], f"{name.replace('-', '_')}.py").read_text("utf-8").split('"""')[1]
    else:
        text = text_of(plugins.commands[name])
    return " ".join(text.strip().split("\n\n")[0].split())
