"""The computation of a scene by a command: ``SceneJob``, and ``Problem``, which loads, solves and writes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, Self, TypeVar

from depthcli.core.context import Context
from depthcli.core.errors import ConfigError
from depthcli.core.method import RootConfig, parts_of, used_plugins
from depthcli.io.scenes import Layouts, Scene
from depthcli.run.console import Reporter
from depthcli.run.job import Job, Outcome, SceneT
from depthcli.show.table import Column, Row
from depthcli.show.view import Palette

MAP_FILES = (
    "disp_left.pfm", "disp_left.png", "status.png", "preview.png", "bound.pfm", "probability.pfm", "confidence_*",
)  # fmt: skip
"""The files of a disparity map."""
DEPTH_FILES = ("depth.pfm", "depth.png", "status.png", "preview.png", "bound.pfm", "points.ply")
"""The files of a depth map."""


class Shown(NamedTuple):
    """How tables and pages show a command's results."""

    columns: tuple[Column, ...] = ()  # of the printed table, in addition to scene, status, seconds and memory
    page_columns: tuple[Column, ...] | None = None  # columns on the HTML page; None: ``columns``
    palette: Palette | None = None  # colors of the status maps
    legend: tuple[int, ...] | None = None  # combinations of status bits to list in ``status.txt``
    protocol: str = ""  # protocol for showing maps without ground truth


class SceneJob(Job[SceneT]):
    """A command's work on its scenes, with its tables and messages."""

    shown: ClassVar[Shown] = Shown()
    writes: ClassVar[tuple[str, ...]] = ()
    """Names or patterns of all files that a scene may have; empty if they are unknown."""

    def truth_scenes(self, scenes: Sequence[SceneT]) -> Sequence[Scene]:
        """Return the scenes with the ground truth for ``--evaluate``."""
        return scenes

    def is_lower_bound(self, row: Row) -> bool:
        """Return whether a row's errors are lower bounds, shown as ``> 14``."""
        return False

    def notes(self, scenes: Sequence[SceneT], rows: Sequence[Row]) -> list[str]:
        """Return warnings about a whole run."""
        return []

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return one line per missing part of finished scenes; any line makes the exit code 3."""
        return []


def check_keep(job: SceneJob[Any], keep: Sequence[str]) -> None:
    """Raise ConfigError for a pattern of ``--keep`` that no file of the job can match."""
    if not keep or not job.writes or used_plugins(job.config):
        return
    if isinstance(job.config, RootConfig) and any(getattr(part, "details", 0) for part in parts_of(job.config)):
        return
    for pattern in keep:
        if not any(fnmatchcase(name, pattern) or fnmatchcase(pattern, name) for name in (*job.writes, "record.json")):
            names = ", ".join(job.writes)
            raise ConfigError(f"--keep {pattern}: no file of {job.command} has that name; it writes {names}")


class Inputs:
    """The inputs of a problem, from files or arrays."""

    warnings: Sequence[str] = ()
    """Warnings about the inputs, one line each."""
    save_options: Mapping[str, Any] = {}
    """Arguments for the result's ``save``."""
    write_meanwhile: Callable[[Path], None] | None = None
    """A function that writes further files into a folder while the problem is solved."""


class Solution(Protocol):
    """The result of a problem; ``save`` writes its files."""

    @property
    def warnings(self) -> Sequence[str]:
        """Warnings about the result, one line each."""

    def save(self, folder: str | Path) -> None: ...


InputsT = TypeVar("InputsT", bound=Inputs)
ResultT = TypeVar("ResultT", bound=Solution)


class Problem(SceneJob[SceneT], Generic[SceneT, InputsT, ResultT]):
    """A problem: its inputs, solution and result.

    A command calls ``ready`` with its config, then ``units`` with the found scenes. The run calls ``compute`` for each
    scene: ``load``, ``solve``, ``save`` of the result, ``row``. A Python function makes the inputs from its arrays (of
    pairs and frames by a method ``take``), and calls only ``solve``. Functions of pairs begin with ``Pairs.of``, which
    reads the config and calls ``ready``.
    """

    model: ClassVar[type[RootConfig]]  # class of its config
    layouts: ClassVar[Layouts[Any]]  # those of its scenes

    @classmethod
    def ready(cls, config: Any) -> Self:
        """Return the problem for a config. Raise ConfigError or InputError if a file or device in it is unusable."""
        return cls(config)  # type: ignore[call-arg]

    def units(self, scenes: Sequence[Any], reporter: Reporter) -> Sequence[SceneT]:
        """Return the scenes to compute one at a time, e.g. sequences instead of frames."""
        return scenes

    @abstractmethod
    def load(self, scene: SceneT, context: Context) -> InputsT:
        """Return the inputs from a scene's files. Raise InputError if they cannot be used."""

    @abstractmethod
    def solve(self, inputs: InputsT, context: Context) -> ResultT:
        """Return the result. Raise InputError if sizes differ or the context's memory is not enough."""

    @abstractmethod
    def row(self, inputs: InputsT, result: ResultT) -> Row:
        """Return the report's columns in order."""

    def compute(self, scene: SceneT, folder: Path, context: Context) -> Outcome:
        """Load a scene, solve the problem, write the result, and return its row of the report."""
        inputs = self.load(scene, context)
        with ThreadPoolExecutor(1) as side:  # starts its thread only when it gets work
            writing = None if inputs.write_meanwhile is None else side.submit(inputs.write_meanwhile, folder)
            result = self.solve(inputs, context)
            if writing is not None:
                writing.result()
        context.clock.start("save")
        result.save(folder, **inputs.save_options)
        row = self.row(inputs, result)
        return Outcome(row, context.clock.seconds, [*inputs.warnings, *result.warnings])
