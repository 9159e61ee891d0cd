"""What a sub-command is. Nothing heavy is imported here, so that ``--help`` answers at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from depthcli.core.option import Option

if TYPE_CHECKING:
    from depthcli.batch.reporter import Reporter

SOME_FAILED = 3
"""Exit code of a command that finished, though not for every item."""


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
