"""Run one program until it and all processes that it started have ended; a script of the standard library alone.

``python _supervisor.py TASK`` with a JSON object: ``words``, ``folder``, ``timeout`` (seconds), ``memory`` (bytes or
null). It prints a JSON object: ``ended`` (exit, timeout, memory, stayed, or missing: it cannot be started),
``code`` (exit code, negative for a signal) or ``why``, ``wall`` and ``cpu`` (seconds), ``memory`` (peak, bytes),
``stdout`` and ``stderr`` (their ends). On Linux the processes that outlive their parents become children of this one,
so that none is missed; elsewhere only those of the program's own process group are ended, and memory is not limited.

The end of standard input, which comes when the process that asked for the program dies, ends the program, too; nothing
is printed then.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time

_TAIL = 1 << 14  # bytes that are kept of each stream
_READ = 1 << 18  # bytes read at a time
_MIN_WAIT = 0.02  # seconds between two looks at the processes, at least
_LOOK_SHARE = 20  # looking at the processes takes at most 1 / this of the time
_GRACE = 1.0  # seconds that other processes of the program have to end after it
_KILL_SECONDS = 20.0  # after which processes that cannot be killed (waiting for a disk) are left
_PR_SET_CHILD_SUBREAPER = 36
_PAGE = os.sysconf("SC_PAGE_SIZE")


class _Watched:
    """A running program, its output and its processes."""

    def __init__(self, words: list[str], folder: str) -> None:
        self.started = time.monotonic()
        self.program = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=folder,
            start_new_session=True,
        )  # fmt: skip
        assert self.program.stdout is not None and self.program.stderr is not None
        self.streams = [self.program.stdout.fileno(), self.program.stderr.fileno()]
        self.tails = {stream: bytearray() for stream in self.streams}
        self.status: int | None = None
        self.wall = 0.0
        self.memory = 0
        self.alive = True  # the program, or a process that it started
        for stream in self.streams:
            os.set_blocking(stream, False)

    def read(self, streams: list[int]) -> None:
        """Read what is there, and keep the end of it."""
        for stream in streams:
            with contextlib.suppress(BlockingIOError):
                data = os.read(stream, _READ)
                self.tails[stream] = (self.tails[stream] + data)[-_TAIL:]
                if not data:
                    self.streams.remove(stream)

    def reap(self) -> None:
        """Take notice of the processes that have ended."""
        with contextlib.suppress(ChildProcessError):
            while True:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    return
                if pid == self.program.pid:
                    self.status = os.waitstatus_to_exitcode(status)
                    self.wall = time.monotonic() - self.started
        self.alive = False

    def measure(self) -> None:
        """Take notice of the memory that all processes have together."""
        pages = 0
        for pid in _descendants():
            with contextlib.suppress(OSError, ValueError, IndexError), open(f"/proc/{pid}/statm", "rb") as file:
                pages += int(file.read().split()[1])
        self.memory = max(self.memory, pages * _PAGE)

    def wait(self, timeout: float, memory: float) -> str:
        """Return how the program ended."""
        look, exited = self.started, 0.0
        while True:
            ready = select.select([sys.stdin, *self.streams], [], [], _MIN_WAIT)[0]
            self.read([stream for stream in self.streams if stream in ready])
            self.reap()
            now = time.monotonic()
            if not self.alive:
                return "exit"
            if sys.stdin in ready and not os.read(0, 1):
                return "abandoned"
            if self.status is not None:
                exited = exited or now
                if now - exited > _GRACE:
                    return "stayed"
            elif now - self.started > timeout:
                return "timeout"
            if now >= look:
                self.measure()
                if self.memory > memory:
                    return "memory"
                look = time.monotonic() + max(_MIN_WAIT, _LOOK_SHARE * (time.monotonic() - now))

    def end(self) -> None:
        """Kill what still runs, and read the rest of the output."""
        until = time.monotonic() + _KILL_SECONDS
        self.reap()
        while self.alive and time.monotonic() < until:
            with contextlib.suppress(OSError):
                if self.status is None:  # later the number may be another process's
                    os.killpg(self.program.pid, signal.SIGKILL)
            for pid in _descendants():
                with contextlib.suppress(OSError):
                    os.kill(pid, signal.SIGKILL)
            time.sleep(0.005)
            self.reap()
        while ready := select.select(self.streams, [], [], 0)[0]:
            self.read(ready)


def _descendants() -> list[int]:
    """Return the processes below this one, as ``/proc`` shows them; empty where there is none."""
    children: dict[int, list[int]] = {}
    with contextlib.suppress(FileNotFoundError):
        for name in os.listdir("/proc"):
            if name.isdecimal():
                with contextlib.suppress(OSError, ValueError, IndexError), open(f"/proc/{name}/stat", "rb") as file:
                    parent = int(file.read().rpartition(b")")[2].split()[1])
                    children.setdefault(parent, []).append(int(name))
    found = list(children.get(os.getpid(), ()))
    for pid in found:
        found += children.get(pid, ())
    return found


def _run(words: list[str], folder: str, timeout: float, memory: float | None) -> dict[str, object]:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        watched = _Watched(words, folder)
    except OSError as error:
        return {"ended": "missing", "why": error.strerror or str(error)}
    ended = watched.wait(timeout, memory or float("inf"))
    wall = watched.wall or time.monotonic() - watched.started
    watched.end()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    largest = used.ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    tails = [bytes(tail).decode("utf-8", "backslashreplace") for tail in watched.tails.values()]
    return {
        "ended": ended, "code": watched.status, "wall": wall, "cpu": used.ru_utime + used.ru_stime,
        "memory": max(watched.memory, largest), "stdout": tails[0], "stderr": tails[1],
    }  # fmt: skip


if __name__ == "__main__":
    result = _run(**json.loads(sys.argv[1]))
    if result["ended"] != "abandoned":  # nobody would read it
        print(json.dumps(result), flush=True)
