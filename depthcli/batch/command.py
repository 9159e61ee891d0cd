"""What a sub-command is. Nothing heavy is imported here, so that ``--help`` answers at once."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.reporter import Reporter

SOME_FAILED = 3
"""Exit code of a command that finished, though not for every scene."""


class Command(ABC):
    """One sub-command: a module of ``jobs/`` holds one, in ``COMMAND``.

    Its name is the module's, its help the first paragraph of the module's docstring. Every command has ``--json``,
    ``--verbose`` and ``--quiet`` beside its own options.
    """

    @property
    def name(self) -> str:
        """As typed on the command line."""
        return type(self).__module__.rpartition(".")[2].replace("_", "-")

    @property
    def arguments(self) -> tuple[Option, ...]:
        """Positional arguments, in order."""
        return ()

    @property
    @abstractmethod
    def options(self) -> tuple[Option, ...]:
        """Options beside the common ones."""

    def line(self, values: Mapping[str, Any]) -> str:
        """The command line that gives these values."""
        words = ["depthcli", self.name]
        for argument in self.arguments:
            value = values[argument.name]
            words += [] if value is None else [*map(str, value)] if argument.many else [str(value)]
        for option in self.options:
            value = values[option.name]
            if value == option.default or value is None or value == []:
                continue
            if option.type is bool:
                words.append(option.flag)
                continue
            for each in value if option.many else [value]:
                words += [option.flag, str(each)]
        return shlex.join(words)

    @abstractmethod
    def run(self, values: Mapping[str, Any], reporter: Reporter) -> int:
        """Do it; the exit code.

        Parameters
        ----------
        values : name -> value of every argument and option
        reporter : where lines for people go; data go to stdout by ``reporter.data``

        Raises
        ------
        DepthcliError
            Nothing can be done: wrong config, options or folders.
        """
