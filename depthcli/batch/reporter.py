"""Lines and the progress bar for people on stderr, data for programs on stdout."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from depthcli.core.errors import IncompleteError

if TYPE_CHECKING:
    from tqdm import tqdm

_HEARTBEAT = 30.0  # seconds between lines where there is no terminal for a bar


class Reporter:
    """Says what a person wants to know, and prints what a program reads.

    A reader of stdout or stderr who goes away never stops the computation.

    Parameters
    ----------
    level : -1 only errors, 0 the usual lines, 1 details as well
    """

    def __init__(self, level: int = 0) -> None:
        self.level = level
        self._bar: tqdm[Any] | None = None
        self._what, self._total, self._done, self._failed = "", 0, 0, 0
        self._start = self._said = 0.0
        self._once: set[str] = set()

    def error(self, text: str) -> None:
        """Say what went wrong; never silenced."""
        self._line(text)

    def info(self, text: str) -> None:
        """Say something unless quiet."""
        if self.level >= 0:
            self._line(text)

    def once(self, text: str) -> None:
        """As ``info``, but the same line only once."""
        if text not in self._once:
            self._once.add(text)
            self.info(text)

    def detail(self, text: str) -> None:
        """Say something when verbose."""
        if self.level >= 1:
            self._line(text)

    def data(self, text: str) -> None:
        """Print ``text`` on stdout; nothing happens where its reader has gone (``| head``).

        Raises
        ------
        IncompleteError
            It cannot be written for another reason, such as a full disk.
        """
        try:
            print(text, end="" if text.endswith("\n") else "\n", flush=True)
        except (OSError, ValueError) as error:  # ValueError: stdout was closed
            self._close_stdout()
            number = getattr(error, "errno", None)
            if isinstance(error, OSError) and number not in (errno.EPIPE, errno.EBADF):
                raise IncompleteError(f"stdout: cannot be written ({error.strerror or error})") from error

    def start(self, total: int, done: int, what: str) -> None:
        """Begin to show progress: a bar on a terminal, else a line now and then."""
        self._what, self._total, self._done, self._failed = what, total, done, 0
        self._start = self._said = time.monotonic()
        if self.level >= 0 and _is_terminal():
            from tqdm import tqdm

            self._bar = tqdm(total=total, initial=done, desc=what, unit="scene", file=sys.stderr, leave=False)

    def step(self, failed: bool = False) -> None:
        """One more scene is through."""
        self._done += 1
        self._failed += failed
        if self._bar is not None:
            self._bar.update()
            return
        now = time.monotonic()
        if now - self._said >= _HEARTBEAT:
            self._said = now
            rate = self._done / (now - self._start)
            left = (self._total - self._done) / rate
            failures = f", {self._failed} failed" if self._failed else ""
            self.info(
                f"{self._what}: {self._done} of {self._total}{failures}, {60 * rate:.1f} a minute, {_time(left)} left"
            )

    def __enter__(self) -> Reporter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _line(self, text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody listens any more
            if self._bar is not None:
                self._bar.write(text, file=sys.stderr)
            else:
                print(text, file=sys.stderr, flush=True)

    @staticmethod
    def _close_stdout() -> None:
        """Let the interpreter's last flush go nowhere instead of failing once more."""
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_terminal() -> bool:
    try:
        return sys.stderr.isatty()
    except ValueError:  # closed
        return False


def _time(seconds: float) -> str:
    return (
        f"{seconds / 3600:.1f} h"
        if seconds >= 5400
        else f"{seconds / 60:.0f} min"
        if seconds >= 90
        else f"{seconds:.0f} s"
    )
