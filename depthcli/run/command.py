"""The interface of a sub-command, and its result for a scene. It imports nothing heavy, so ``--help`` is fast."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias, TypeVar

from depthcli.core.option import Option
from depthcli.core.registry import registered_name
from depthcli.io.scenes import Scene
from depthcli.run.batch import Outcome
from depthcli.run.console import Reporter

if TYPE_CHECKING:
    from pydantic import BaseModel

ConfigT = TypeVar("ConfigT", bound="BaseModel | Mapping[str, object]")
ModelT = TypeVar("ModelT", bound="BaseModel")
SceneT = TypeVar("SceneT", bound=Scene)

Values: TypeAlias = Mapping[str, Any]
"""Name -> value of every argument and option of one call, each of the type that its :class:`Option` declares."""


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
