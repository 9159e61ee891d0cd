"""Terminal output: data on stdout, messages and progress on stderr."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TextIO

from depthcli.core.errors import IncompleteError
from depthcli.core.text import kind_of_warning, printable, without_file

_HEARTBEAT = 30.0  # seconds between lines without a terminal
_PROGRESS = 5.0  # the same for progress within a scene


def silence_warnings() -> None:
    """Hide warnings of libraries, which quote code; ``python -W`` shows them."""
    if not sys.warnoptions:
        warnings.showwarning = lambda *warning, **place: None


@dataclass(eq=False)
class Reporter:
    """Print messages and progress on stderr and data on stdout.

    The computation continues if either is closed. ``level`` is -1 for errors only, 0 for messages, too, and 1 for
    details, too. ``command_line`` is this call, quoted for a shell, for reports.
    """

    level: int = 0
    command_line: str = ""
    _once: set[str] = field(default_factory=set)
    _what: str = ""
    _total: int = 0
    _done: int = 0
    _failed: int = 0
    _said: float = 0.0  # when a line was printed
    _bar: Any = None

    def error(self, text: str) -> None:
        """Print an error, at any level."""
        text = printable(text)
        with contextlib.suppress(OSError, ValueError):  # stderr was closed
            if self._bar is not None:
                self._bar.write(text, file=sys.stderr)
            else:
                print(text, file=sys.stderr, flush=True)

    def info(self, text: str) -> None:
        """Print a message, unless quiet."""
        if self.level >= 0:
            self.error(text)

    def once(self, text: str) -> None:
        """Print a message as ``info`` does, unless the same one was printed before."""
        if text not in self._once:
            self._once.add(text)
            self.info(text)

    def detail(self, text: str) -> None:
        """Print a message when verbose."""
        if self.level >= 1:
            self.error(text)

    def data(self, text: str) -> None:
        """Print ``text`` on stdout, or nothing if its reader has closed it (``| head``).

        Raises
        ------
        IncompleteError
            If it cannot be written for another reason, such as a full disk.
        """
        try:
            print(text, end="" if text.endswith("\n") else "\n", flush=True)
        except (OSError, ValueError) as error:  # ValueError: stdout was closed
            self.close(sys.stdout)
            number = getattr(error, "errno", None)
            if isinstance(error, OSError) and number not in (errno.EPIPE, errno.EBADF):
                raise IncompleteError(f"stdout: cannot be written ({error.strerror or error})") from error

    @contextlib.contextmanager
    def counting(self, total: int, done: int, what: str) -> Iterator[None]:
        """Show in the block how many scenes of a command are done: a bar on a terminal, lines elsewhere."""
        self._what, self._total, self._done, self._failed, self._said = what, total, done, 0, time.monotonic()
        with contextlib.suppress(OSError, ValueError):  # stderr was closed
            if self.level >= 0 and sys.stderr.isatty():
                from tqdm import tqdm

                bar: dict[str, Any] = {"total": total, "initial": done, "unit": "scene", "file": sys.stderr}
                tqdm.monitor_interval = 0  # its thread would prevent forks
                self._bar = tqdm(desc=what, **bar, leave=False, dynamic_ncols=True, mininterval=0.2)
        try:
            yield
        finally:
            if self._bar is not None:
                with contextlib.suppress(OSError, ValueError):
                    self._bar.close()
                self._bar = None

    def step(self, failed: bool = False) -> None:
        """Count one more scene."""
        self._done += 1
        self._failed += failed
        failures = f", {self._failed} failed" if self._failed else ""
        if self._bar is not None:
            with contextlib.suppress(OSError, ValueError):
                self._bar.set_postfix_str(failures.removeprefix(", "), refresh=False)
                self._bar.update()
        elif time.monotonic() - self._said > _HEARTBEAT:
            self._said = time.monotonic()
            self.info(f"{self._what}: {self._done} of {self._total} scenes{failures}")

    def progress(self, text: str, seconds: float) -> None:
        """Show the progress within a scene: next to the bar on a terminal, as a line every few seconds elsewhere."""
        if self._bar is not None:
            with contextlib.suppress(OSError, ValueError):
                self._bar.set_postfix_str(f"{text}, {seconds:.0f} s")
        elif time.monotonic() - self._said > _PROGRESS:
            self._said = time.monotonic()
            self.info(f"{text}, {seconds:.0f} s")

    @staticmethod
    def close(stream: TextIO) -> None:
        """Redirect a stream to the null device, so that the interpreter's last flush cannot fail."""
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@dataclass(eq=False)
class WarningCounts:
    """Print one warning of each kind (warnings that differ only in numbers and files), and the number of its scenes."""

    _reporter: Reporter
    _kinds: dict[str, tuple[str, int]] = field(default_factory=dict)  # the text of the first one, and how many scenes

    def add(self, scene: str, lines: Sequence[str]) -> None:
        """Add the warnings of a scene; ``-v`` prints all of them."""
        of_scene: dict[str, str] = {}
        for line in lines:
            text = without_file(line)
            kind = kind_of_warning(scene, text)
            is_new = kind not in self._kinds or kind in of_scene
            (self._reporter.info if is_new else self._reporter.detail)(f"{scene}: warning: {line}")
            of_scene[kind] = text
            self._kinds.setdefault(kind, (text, 0))
        for kind in of_scene:
            text, count = self._kinds[kind]
            self._kinds[kind] = text, count + 1

    def close(self) -> None:
        """Print the number of scenes for each kind of warning that several scenes have."""
        for text, count in self._kinds.values():
            if count > 1:
                self._reporter.info(f"warning: {text} ({count} scenes; -v names each)")
