"""Cores and memory that this process may use."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.core.text import show_bytes


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
