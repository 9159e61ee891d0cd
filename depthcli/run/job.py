"""``Job``, the computation of a command for every scene, and how a run is carried out."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from depthcli.core.errors import ConfigError
from depthcli.run.resources import available_memory, cores

if TYPE_CHECKING:
    from depthcli.core.context import Context
    from depthcli.io.scenes import Scene

SceneT = TypeVar("SceneT", bound="Scene")


@dataclass
class Outcome:
    """The row of one scene in the report: columns that are the same in every run, time by stage, and warnings."""

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Execution:
    """How a run is carried out; none of it but ``keep`` changes the results."""

    jobs: int | None = 1  # worker processes; 1 computes in this process, None in as many as finish first
    threads: int | None = None  # of each process; None divides the cores among them
    max_memory: int | None = None  # bytes, of all processes together; None: all that is available
    overwrite: bool = False
    shard: tuple[int, int] | None = None  # (I, N): every N-th scene, from the I-th; other processes have the others
    fail_fast: bool = False
    keep: tuple[str, ...] = ()  # shell patterns of the files that are kept of a scene; none: all
    scheduler: str | None = None  # address of the dask.distributed cluster that computes

    def threads_each(self) -> int:
        """Return the number of threads of one worker."""
        return self.threads or max(1, cores() // (self.jobs or 1))

    def memory_each(self) -> int:
        """Return the bytes that one worker may use."""
        return (self.max_memory or available_memory()) // (self.jobs or 1)

    def own(self, scenes: Sequence[SceneT]) -> list[SceneT]:
        """Return the scenes that this process computes."""
        first, step = self.shard or (1, 1)
        return list(scenes[first - 1 :: step])


def shard_of(text: str | None, environment: Mapping[str, str]) -> tuple[int, int] | None:
    """Return the shard that ``3/8`` or a job array of Slurm describes, or None; ConfigError for no such part."""
    if text is None and "SLURM_ARRAY_TASK_COUNT" in environment:
        names = ("ID", "MIN", "STEP", "COUNT")
        values = {name: environment.get(f"SLURM_ARRAY_TASK_{name}", "1") for name in names}
        if wrong := [name for name, value in values.items() if not re.fullmatch(r"\s*\d{1,9}\s*", value)]:
            text = f"SLURM_ARRAY_TASK_{wrong[0]}: expected a whole number (got {values[wrong[0]][:40]!r})"
            raise ConfigError(f"{text}; unset SLURM_ARRAY_TASK_COUNT, or give --shard")
        task, first, step, parts = map(int, values.values())
        text = f"{(task - first) // max(step, 1) + 1}/{parts}"
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    if found is None or not 1 <= int(found[1]) <= int(found[2]):
        raise ConfigError(f"--shard: must be part/parts such as 3/8, from 1/8 to 8/8 (got {text!r})")
    return int(found[1]), int(found[2])


class Job(ABC, Generic[SceneT]):
    """A command's work on its scenes: all that a run knows of the command. It goes to workers, so it is picklable."""

    command: ClassVar[str]

    config: Any
    """The config, a mapping for commands without one; it decides with all versions which run this is."""

    @abstractmethod
    def compute(self, scene: SceneT, folder: Path, context: Context) -> Outcome:
        """Compute a scene with at most ``context.memory`` bytes, and write its files into an empty folder."""

    def files(self, scene: SceneT) -> dict[str, Path]:
        """Return role -> file, for all files that the result depends on, except files that the config names."""
        return scene.input_files

    def settings(self, scene: SceneT) -> dict[str, str]:
        """Return the facts of the layout that the result depends on, in addition to config and files."""
        return {}

    def memory(self, scene: SceneT) -> int | None:
        """Estimate the peak memory in bytes from the headers of the files; None where that is not known."""
        return None

    def memory_bound(self, scene: SceneT) -> int | None:
        """Return the largest peak memory in bytes; where it is None, one scene is computed at a time by default."""
        return self.memory(scene)
