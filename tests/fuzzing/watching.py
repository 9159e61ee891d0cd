"""Watching one case: how long it takes, how much memory it needs, and what it leaves open."""

from __future__ import annotations

import contextlib
import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

from tests.fuzzing.common import Fault

SECONDS, MEMORY = 60, 4 << 30


def limit() -> int:
    """Return the seconds that a case may take: a minute where a core is free, longer where processes share one."""
    return int(SECONDS * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1)))


def peak() -> int:
    """Return the peak of resident memory, bytes; on Linux since the last ``start_of_peak``."""
    with contextlib.suppress(OSError, IndexError):
        return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def start_of_peak() -> int:
    """Forget the peak where Linux can; return the resident memory that the next case starts from, bytes."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # 5 forgets the peak
    return peak()


def hang(*_: object) -> None:
    raise Fault("no end in time")


@contextlib.contextmanager
def watched() -> Iterator[None]:
    """Raise Fault where the block takes too long, leaves files open, or lets memory grow too far."""
    opened = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else 0
    held = start_of_peak()
    before = signal.signal(signal.SIGALRM, hang)
    signal.alarm(limit())
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    if opened and len(os.listdir("/proc/self/fd")) > opened:
        raise Fault(f"files left open: {len(os.listdir('/proc/self/fd')) - opened}")
    if (grown := peak() - held) > MEMORY:
        raise Fault(f"{grown / 2**30:.1f} GiB of memory, more than {MEMORY / 2**30:g}")
