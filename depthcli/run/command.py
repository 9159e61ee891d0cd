"""The interface of a sub-command, and its result for a scene. It imports nothing heavy, so ``--help`` is fast."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias, TypeVar

from depthcli.core.option import Option
from depthcli.core.registry import registered_name
from depthcli.io.scenes import Scene
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from pydantic import BaseModel

ConfigT = TypeVar("ConfigT", bound="BaseModel | Mapping[str, object]")
ModelT = TypeVar("ModelT", bound="BaseModel")
SceneT = TypeVar("SceneT", bound=Scene)

Values: TypeAlias = Mapping[str, Any]
"""Name -> value of every argument and option of one call, each of the type that its :class:`Option` declares."""

SOME_FAILED = 3
"""Exit code of a command that finished, but not for every scene."""

FLAGGED = 4
"""Exit code of a command with ``--fail-flagged`` that flagged a row."""

EXIT_CODES = {
    0: "all done",
    1: "a bug in depthcli; the traceback is printed",
    2: "wrong usage, config or folder, nothing was computed; or the disk became full",
    SOME_FAILED: "finished, but something failed or could not be written; the report says what",
    FLAGGED: "finished, and rows are flagged that count as failures here, or a condition has no values",
    130: "ended by Ctrl-C; the same command goes on where it stopped",
    143: "ended by SIGTERM; the same command goes on where it stopped",
}
"""Exit code -> what it means."""


class Command(ABC):
    """One sub-command: a module of ``commands/`` holds one, in ``COMMAND``.

    Its name is the module's, its help the first paragraph of the module's docstring, one line. Every command has
    ``--json``, ``--verbose`` and ``--quiet`` beside its own options.
    """

    examples: ClassVar[tuple[str, ...]] = ()
    """One to three command lines, at most 77 characters each, that the help shows."""

    page: ClassVar[str] = "index"
    """Page of the documentation that the help names, without its ending."""

    @property
    def name(self) -> str:
        """Name on the command line."""
        return registered_name(type(self)).replace("_", "-")

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
            for each in value if isinstance(value, list) else [value]:
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


@dataclass
class Outcome:
    """What the report says of one scene.

    Attributes
    ----------
    facts : columns of the report that are the same in every run (size, density, counts)
    seconds : time by stage, in order
    warnings : lines that are shown to the user
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


_Config = TypeVar("_Config", contravariant=True)
_Scene = TypeVar("_Scene", contravariant=True)


class SceneCommand(Protocol[_Config, _Scene]):
    """What a run calls of a command, picklable for workers; ``BatchCommand`` of ``commands/`` implements it."""

    @property
    def name(self) -> str:
        """Name on the command line."""

    @property
    def results(self) -> tuple[str, ...]:
        """Shell patterns of the files that it writes for a scene, checked before it computes."""

    def compute(self, config: _Config, scene: _Scene, folder: Path, memory: int, /) -> Outcome:
        """Compute ``scene`` with at most ``memory`` bytes and write its files into the empty ``folder``."""

    def files(self, config: _Config, scene: _Scene, /) -> dict[str, Path]:
        """Return role -> file, for all files whose content the result depends on."""

    def settings(self, config: _Config, scene: _Scene, /) -> dict[str, str]:
        """Return what the result depends on beside the config and files."""

    def effort(self, config: _Config, scene: _Scene, /) -> int | None:
        """Return an estimate of the computing time in any unit; None: in proportion to the size of its files."""
