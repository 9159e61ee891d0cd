"""What a sub-command is. Nothing heavy is imported here, so that ``--help`` answers at once."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from depthcli.batch.console import Reporter
from depthcli.core.option import Option
from depthcli.data.scenes import Scene

if TYPE_CHECKING:
    from pydantic import BaseModel

ConfigT = TypeVar("ConfigT", bound="BaseModel | Mapping[str, object]")
ModelT = TypeVar("ModelT", bound="BaseModel")
SceneT = TypeVar("SceneT", bound=Scene)

Values: TypeAlias = Mapping[str, Any]
"""Name -> value of every argument and option of one call, each of the type that its :class:`Option` declares."""

SOME_FAILED = 3
"""Exit code of a command that finished, but not for every scene."""


class Command(ABC):
    """One sub-command: a module of ``commands/`` holds one, in ``COMMAND``.

    Its name is the module's, its help the first paragraph of the module's docstring. Every command has ``--json``,
    ``--verbose`` and ``--quiet`` beside its own options.
    """

    @property
    def name(self) -> str:
        """Name on the command line."""
        return type(self).__module__.rpartition(".")[2].replace("_", "-")

    @property
    def arguments(self) -> tuple[Option, ...]:
        """Positional arguments, in order."""
        return ()

    @property
    def options(self) -> tuple[Option, ...]:
        """Options beside ``--json``, ``--verbose`` and ``--quiet``."""
        return ()

    def line(self, values: Values) -> str:
        """Return the command line that gives these values."""
        words = ["depthcli", self.name]
        for argument in self.arguments:
            value = values[argument.name]
            words += [] if value is None else [*map(str, value)] if argument.repeatable else [str(value)]
        for option in self.options:
            value = values[option.name]
            if value == option.default or value is None or value == []:
                continue
            if option.type is bool:
                words.append(option.flag)
                continue
            for each in value if option.repeatable else [value]:
                words += [option.flag, str(each)]
        return shlex.join(words)

    @abstractmethod
    def run(self, values: Values, reporter: Reporter) -> int:
        """Run the command and return the exit code.

        Parameters
        ----------
        values : name -> value of every argument and option
        reporter : takes messages for stderr and, by ``reporter.data``, data for stdout

        Raises
        ------
        DepthcliError
            The config, the options or the folders are wrong; nothing was computed.
        """
