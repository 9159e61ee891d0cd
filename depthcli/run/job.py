"""``Job``, a command's computation for every scene; ``Execution``, the options of a run; cores and memory to use."""

from __future__ import annotations

import contextlib
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.text import show_bytes

if TYPE_CHECKING:
    from depthcli.core.context import Context
    from depthcli.io.scenes import Scene

SceneT = TypeVar("SceneT", bound="Scene")


@dataclass
class Outcome:
    """A scene's row of the report: reproducible columns, time by stage, and warnings."""

    facts: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Execution:
    """Options for the execution of a run; only ``keep`` changes the results."""

    jobs: int | None = 1  # worker processes; 1: this process; None: the fastest number
    threads: int | None = None  # per process; None divides the cores among processes
    max_memory: int | None = None  # bytes, for all processes together; None: all available memory
    overwrite: bool = False
    shard: tuple[int, int] | None = None  # (I, N): every N-th scene, from the I-th
    fail_fast: bool = False
    keep: tuple[str, ...] = ()  # shell patterns of a scene's files to keep; empty: all
    scheduler: str | None = None  # address of a dask.distributed cluster

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
    """Return the shard from a text such as ``3/8`` or Slurm's job array, or None. Raise ConfigError for others."""
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
    """A command's work on its scenes. It is sent to workers and must be picklable."""

    command: ClassVar[str]

    config: Any
    """The config, or a mapping for commands without one; together with all versions, it identifies the run."""

    @abstractmethod
    def compute(self, scene: SceneT, folder: Path, context: Context) -> Outcome:
        """Compute a scene with at most ``context.memory`` bytes, and write its files into an empty folder."""

    def files(self, scene: SceneT) -> dict[str, Path]:
        """Return role -> file for all files that the result depends on, except files named in the config."""
        return scene.input_files

    def settings(self, scene: SceneT) -> dict[str, str]:
        """Return further values that the result depends on, in addition to config and files."""
        return {}

    def memory(self, scene: SceneT) -> int | None:
        """Return an estimate of the peak memory, in bytes, from the files' headers, or None if it is unknown."""
        return None

    def memory_bound(self, scene: SceneT) -> int | None:
        """Return the largest peak memory in bytes; if it is None, scenes are computed one at a time by default."""
        return self.memory(scene)


def cores() -> int:
    """Return the number of cores that this process may use, within the control group's limit."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError):  # no such file, or "max" (no limit)
        quota, period = map(int, Path("/sys/fs/cgroup/cpu.max").read_text("ascii").split())
        count = min(count, max(quota // period, 1))
    return count


def check_memory(need: int, limit: int, size: str, keys: str = "") -> None:
    """Raise InputError if a process needs more than ``limit`` bytes; ``need`` is for a scene of ``size`` alone.

    The message suggests ``keys`` of the config.
    """
    from depthcli.core.memory import BASE_BYTES  # imports numpy, which --help should not

    need += BASE_BYTES
    if need > limit:
        hint = f"; see {keys}" if keys else ""
        raise InputError(f"needs about {show_bytes(need)} of memory ({size}), {show_bytes(limit)} may be used{hint}")


def available_memory() -> int:
    """Return the free memory in bytes, within the control group's limit."""
    free = _kilobytes("/proc/meminfo", "MemAvailable:")
    found = [1 << 62] if free is None else [1 << 62, free * 1024]
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ):
        with contextlib.suppress(OSError, ValueError):
            found.append(int(Path(limit).read_text("ascii")) - int(Path(used).read_text("ascii")))
    if len(found) == 1 and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(min(found), 1)


def reset_peak() -> None:
    """Start a new measurement of the peak memory, if the system supports it (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", "ascii")


def peak_memory() -> int | None:
    """Return the largest resident size, in bytes, since :func:`reset_peak` or the start of the process."""
    if (peak := _kilobytes("/proc/self/status", "VmHWM:")) is not None:
        return peak * 1024
    try:
        import resource
    except ImportError:
        return None
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(largest) * (1 if os.uname().sysname == "Darwin" else 1024)


def _kilobytes(file: str, key: str) -> int | None:
    """Return the number after a key in a file of Linux's /proc, or None if it is missing."""
    with contextlib.suppress(OSError, ValueError):
        for line in Path(file).read_text("ascii", "replace").splitlines():
            if line.startswith(key):
                return int(line.split()[1])
    return None
