"""What the terminal shows: messages, progress and tables. Data go to stdout, everything else to stderr."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

from depthcli.batch.json_csv import Row
from depthcli.core.errors import IncompleteError
from depthcli.core.text import one_line, printable

if TYPE_CHECKING:
    from tqdm import tqdm

_HEARTBEAT = 30.0  # seconds between lines of progress where there is no terminal
_MAX_ROWS = 50  # of a table; of longer ones only the failed scenes and a summary are shown


def silence_warnings() -> None:
    """Hide warnings of libraries, which quote code that a user does not know; ``python -W`` shows them."""
    if not sys.warnoptions:
        warnings.showwarning = lambda *arguments, **options: None


class Reporter:
    """Prints messages and progress on stderr and data on stdout.

    The computation goes on when the reader of either has closed it.

    Parameters
    ----------
    level : -1 only errors, 0 also messages, 1 also details
    """

    def __init__(self, level: int = 0) -> None:
        self.level = level
        self._bar: tqdm[Any] | None = None
        self._what, self._total, self._done, self._failed = "", 0, 0, 0
        self._start = self._said = 0.0
        self._once: set[str] = set()

    def error(self, text: str) -> None:
        """Print an error, at any level."""
        self._line(text)

    def info(self, text: str) -> None:
        """Print a message, unless quiet."""
        if self.level >= 0:
            self._line(text)

    def once(self, text: str) -> None:
        """Print a message as ``info`` does, unless the same one was printed before."""
        if text not in self._once:
            self._once.add(text)
            self.info(text)

    def detail(self, text: str) -> None:
        """Print a message when verbose."""
        if self.level >= 1:
            self._line(text)

    def data(self, text: str) -> None:
        """Print ``text`` on stdout, or nothing where its reader has closed it (``| head``).

        Raises
        ------
        IncompleteError
            It cannot be written for another reason, such as a full disk.
        """
        try:
            print(text, end="" if text.endswith("\n") else "\n", flush=True)
        except (OSError, ValueError) as error:  # ValueError: stdout was closed
            self.close_stdout()
            number = getattr(error, "errno", None)
            if isinstance(error, OSError) and number not in (errno.EPIPE, errno.EBADF):
                raise IncompleteError(f"stdout: cannot be written ({error.strerror or error})") from error

    def start(self, total: int, done: int, what: str, unit: str = "scene") -> None:
        """Begin to show progress: a bar on a terminal, otherwise a line every 30 seconds."""
        self._what, self._total, self._done, self._failed = what, total, done, 0
        self._start = self._said = time.monotonic()
        if self.level >= 0 and _is_terminal():
            from tqdm import tqdm

            self._bar = tqdm(total=total, initial=done, desc=what, unit=unit, file=sys.stderr, leave=False)

    def step(self, failed: bool = False) -> None:
        """Count one more scene."""
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
        text = printable(text)
        with contextlib.suppress(OSError, ValueError):  # stderr was closed
            if self._bar is not None:
                self._bar.write(text, file=sys.stderr)
            else:
                print(text, file=sys.stderr, flush=True)

    @staticmethod
    def close_stdout() -> None:
        """Send the interpreter's last flush to the null device, where it cannot fail."""
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_terminal() -> bool:
    try:
        return sys.stderr.isatty()
    except ValueError:  # closed
        return False


def _time(seconds: float) -> str:
    if seconds >= 5400:
        return f"{seconds / 3600:.1f} h"
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"


@dataclass(frozen=True)
class Column:
    """A column of a command's table: its title, and the function that gives its text for a finished row."""

    title: str
    text: Callable[[Row], str]


def percent(key: str) -> Callable[[Row], str]:
    """Return the function that gives the text of a column whose values are shares."""
    return lambda row: f"{100 * row[key]:.1f} %" if isinstance(row.get(key), int | float) else "-"


SIZE = Column("size", lambda row: f"{row['width']}x{row['height']}" if "width" in row else "-")


def run_table(rows: Sequence[Row], columns: Sequence[Column]) -> str:
    """Return the table of a run: one line per scene, or for a long run its failed scenes and a summary."""
    shown = [row for row in rows if len(rows) <= _MAX_ROWS or row["status"] != "done"]
    lines = [("scene", "status", *(column.title for column in columns), "seconds", "memory")]
    for row in shown:
        seconds, peak = sum(row["seconds"].values()), row["peak_memory"]
        cells = (column.text(row) if row["status"] == "done" else "-" for column in columns)
        memory = f"{peak / 2**20:.0f} MiB" if peak else "-"
        lines.append((str(row["scene"]), str(row["status"]), *cells, f"{seconds:.2f}" if seconds else "-", memory))
    if len(shown) < len(rows):
        seconds = sum(sum(row["seconds"].values()) for row in rows)
        blank = ("-",) * len(columns)
        lines.append((f"all {len(rows)}", f"{len(rows) - len(shown)} done", *blank, f"{seconds:.2f}", "-"))
    return aligned(lines)


def aligned(lines: Sequence[tuple[str, ...]]) -> str:
    """Return rows of cells as a table whose first two columns are aligned left and the others right."""
    lines = [tuple(map(one_line, line)) for line in lines]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    table = []
    for line in lines:
        cells = [c.ljust(w) if k < 2 else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))]
        table.append("  ".join(cells).rstrip())
    return "\n".join(table)
