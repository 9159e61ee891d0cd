"""Cores and memory of the machine that this process may use."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.core.text import show_bytes


def cores() -> int:
    """Return the number of cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_memory(need: int, limit: int, size: str, keys: str = "") -> None:
    """Raise InputError where a scene needs more bytes than ``limit``.

    Parameters
    ----------
    size : size of the scene, for the message
    keys : config keys that help
    """
    if need > limit:
        hint = f"; see {keys}" if keys else ""
        raise InputError(f"needs about {show_bytes(need)} of memory ({size}), {show_bytes(limit)} may be used{hint}")


def available_memory() -> int:
    """Return the free memory, within the limit of the control group, in bytes."""
    found = [1 << 62]
    try:
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) * 1024)
    except (OSError, ValueError):
        pass
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ):
        try:
            found.append(int(Path(limit).read_text("ascii")) - int(Path(used).read_text("ascii")))
        except (OSError, ValueError):
            continue
    if len(found) == 1 and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(min(found), 1)


def reset_peak() -> None:
    """Start a new measurement of the peak, where the system can (Linux)."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", "ascii")


def peak_memory() -> int | None:
    """Return the largest resident size since :func:`reset_peak`, or since the start of the process, in bytes."""
    try:
        for line in Path("/proc/self/status").read_text("ascii", "replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError):
        pass
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak) * (1 if os.uname().sysname == "Darwin" else 1024)
