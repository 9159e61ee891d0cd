"""What a command computes of every scene, as a run knows it: this, and nothing else of the command."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from depthcli.io.scenes import Scene

if TYPE_CHECKING:
    from pydantic import BaseModel

    from depthcli.io.formats.pictures import Palette
    from depthcli.run.console import Column
    from depthcli.run.json_csv import Row

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

SceneT = TypeVar("SceneT", bound=Scene)


@dataclass
class Outcome:
    """What the report says of one scene.

    Attributes
    ----------
    facts : columns of the report that are the same in every run (size, density, counts)
    seconds : time by stage, in order
    warnings : lines that are shown to the user and kept in the record
    """

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def _nothing(*args: object) -> Any:
    return {}


@dataclass(frozen=True, kw_only=True)
class Batch(Generic[SceneT]):
    """A command's work on its scenes. Picklable: ``compute`` goes to worker processes.

    Attributes
    ----------
    command : name of the command
    config : the config, or the options of a command without one; it decides with all versions which run this is
    compute : computes a scene with at most so many bytes of memory, and writes its files into an empty folder
    columns : of the printed table, beside scene, status, seconds and memory
    results : shell patterns of the files that ``compute`` writes: files of these names that no run wrote stay
    files : returns role -> file, for all files whose content the result depends on
    settings : returns what the result depends on beside config and files: facts that the layout found
    memory : estimates the peak memory in bytes from the headers of the files; None where that is not known
    notes : returns warnings about a whole run, once its rows are there
    problems : returns what could not be done of scenes that are done, a line each; the exit code is 3 then
    palette, legend : colors of the status maps, and the combinations of status bits that the legend shows
    shown_as : protocol of its maps, which says how the page shows them where there is no truth
    page_columns : columns that this page shows beside its own figures; None: ``columns``
    truth_kinds : kinds of scene that ``--evaluate`` looks for in the input; none: those of the scenes
    """

    command: str
    config: BaseModel | Mapping[str, object]
    compute: Callable[[SceneT, Path, int], Outcome]
    columns: tuple[Column, ...]
    results: tuple[str, ...]
    files: Callable[[SceneT], dict[str, Path]] | None = None
    settings: Callable[[SceneT], dict[str, str]] = _nothing
    memory: Callable[[SceneT], int | None] | None = None
    notes: Callable[[Sequence[Row]], list[str]] | None = None
    problems: Callable[[Sequence[Row]], list[str]] | None = None
    palette: Palette | None = None
    legend: tuple[int, ...] | None = None
    shown_as: str = ""
    page_columns: tuple[Column, ...] | None = None
    truth_kinds: tuple[type[Scene], ...] = ()
