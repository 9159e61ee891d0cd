"""What a command computes of a scene: ``SceneJob``, and ``Problem``, which loads, solves and writes."""

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
    """How tables and pages show the results of a command."""

    columns: tuple[Column, ...] = ()  # of the printed table, in addition to scene, status, seconds and memory
    page_columns: tuple[Column, ...] | None = None  # shown on this page with its own; None: ``columns``
    palette: Palette | None = None  # colors of the status maps
    legend: tuple[int, ...] | None = None  # combinations of status bits that ``status.txt`` lists
    protocol: str = ""  # by which the page shows maps without truth


class SceneJob(Job[SceneT]):
    """The work of a command on its scenes, and what the command tells of it."""

    shown: ClassVar[Shown] = Shown()
    writes: ClassVar[tuple[str, ...]] = ()
    """Names, or patterns of these, of all files that a scene may have; none: not known."""

    def truth_scenes(self, scenes: Sequence[SceneT]) -> Sequence[Scene]:
        """Return the scenes whose ground truth ``--evaluate`` compares the results with."""
        return scenes

    def is_lower_bound(self, row: Row) -> bool:
        """Return whether the errors in a row are lower bounds, which tables and the page show as ``> 14``."""
        return False

    def notes(self, scenes: Sequence[SceneT], rows: Sequence[Row]) -> list[str]:
        """Return warnings about a whole run."""
        return []

    def problems(self, rows: Sequence[Row]) -> list[str]:
        """Return what could not be done of scenes that are done, a line each; the exit code is 3 then."""
        return []


def check_keep(job: SceneJob[Any], keep: Sequence[str]) -> None:
    """Raise ConfigError for a pattern of ``--keep`` that no file of the job can match, before anything is computed."""
    has_details = isinstance(job.config, RootConfig) and any(getattr(p, "details", 0) for p in parts_of(job.config))
    if not job.writes or has_details or used_plugins(job.config):
        return
    for pattern in keep:
        if not any(fnmatchcase(name, pattern) or fnmatchcase(pattern, name) for name in (*job.writes, "record.json")):
            names = ", ".join(job.writes)
            raise ConfigError(f"--keep {pattern}: no file of {job.command} has that name; it writes {names}")


class Inputs(Protocol):
    """What a problem is solved from, loaded from files or made of arrays."""

    @property
    def warnings(self) -> Sequence[str]:
        """What looks wrong with the inputs, a line each."""

    @property
    def saving(self) -> Mapping[str, Any]:
        """How the result is written: arguments of its ``save``."""

    @property
    def later(self) -> Callable[[Path], None] | None:
        """What writes further files of the scene while it is solved; None: nothing does."""


class Solution(Protocol):
    """The result of a problem."""

    @property
    def warnings(self) -> Sequence[str]:
        """What looks wrong with the result, a line each."""

    def save(self, folder: str | Path) -> None:
        """Write the files of the result."""


InputsT = TypeVar("InputsT", bound=Inputs)
ResultT = TypeVar("ResultT", bound=Solution)


class Problem(SceneJob[SceneT], Generic[SceneT, InputsT, ResultT]):
    """One problem, told once: its inputs, how it is solved, its result. Functions for Python call ``solve`` alone."""

    model: ClassVar[type[RootConfig]]  # of its config
    rows: ClassVar[Layouts[Any]]  # by which its scenes are found

    @classmethod
    def ready(cls, config: Any) -> Self:
        """Return the problem of a config; ConfigError or InputError where what the config names cannot be used."""
        return cls(config)  # type: ignore[call-arg]

    def units(self, scenes: Sequence[Any], reporter: Reporter) -> Sequence[SceneT]:
        """Return what is computed at a time, of the scenes that were found."""
        return scenes

    @abstractmethod
    def load(self, scene: SceneT, context: Context) -> InputsT:
        """Return the inputs from the files of a scene; InputError where they cannot be used."""

    @abstractmethod
    def solve(self, inputs: InputsT, context: Context) -> ResultT:
        """Return the result; InputError where sizes do not fit, or the memory of the context does not suffice."""

    @abstractmethod
    def row(self, inputs: InputsT, result: ResultT) -> Row:
        """Return the columns of the report, in their order."""

    def compute(self, scene: SceneT, folder: Path, context: Context) -> Outcome:
        """Load a scene, solve it, write the result, and return its row of the report."""
        inputs = self.load(scene, context)
        with ThreadPoolExecutor(1) as side:  # which starts no thread before it has work
            writing = None if inputs.later is None else side.submit(inputs.later, folder)
            result = self.solve(inputs, context)
            if writing is not None:
                writing.result()
        context.clock.start("save")
        result.save(folder, **inputs.saving)
        row = self.row(inputs, result)
        return Outcome(row, context.clock.seconds, [*inputs.warnings, *result.warnings])
