"""Command-line options as data: declared by commands and kinds of input, built by ``cli/``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

OptionGroup: TypeAlias = Literal["Input", "Scenes", "Method", "Output", "Report", "Run"]
"""Headings of the help of a command, in their order."""


@dataclass(frozen=True)
class Option:
    """One option, or one positional argument where a command lists it as such.

    Attributes
    ----------
    name : ``max_disparity`` is ``--max-disparity`` on the command line, ``from_`` is ``--from``
    type : ``str``, ``int``, ``float``, ``bool`` or ``Path``
    help : one sentence
    metavar : what the value is called in the help
    default : value where it is not given; None for nothing
    repeatable : may be given several times; the value is a list
    short : one-letter form, such as ``-i``
    required : must be given
    min_value, max_value : bounds of a number
    sets : the config key that it overrides, as ``--set`` does; the command itself does not receive it
    group : the heading under which the help shows it
    """

    name: str
    type: type
    help: str
    metavar: str = ""
    default: Any = None
    repeatable: bool = False
    short: str = ""
    required: bool = False
    min_value: float | None = None
    max_value: float | None = None
    sets: str = ""
    group: OptionGroup = "Method"

    @property
    def flag(self) -> str:
        """The option as it is written on the command line."""
        return "--" + self.name.rstrip("_").replace("_", "-")
