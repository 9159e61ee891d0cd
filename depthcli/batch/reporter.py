"""Lines and the progress bar for people, on stderr; data for programs goes to stdout elsewhere."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm


class Reporter:
    """Writes to stderr what a person wants to know.

    Parameters
    ----------
    level : -1 only errors, 0 the usual lines, 1 details as well
    """

    def __init__(self, level: int = 0) -> None:
        self.level = level
        self._bar: tqdm[Any] | None = None

    def error(self, text: str) -> None:
        """Say what went wrong; never silenced."""
        self._line(text)

    def info(self, text: str) -> None:
        """Say something unless quiet."""
        if self.level >= 0:
            self._line(text)

    def detail(self, text: str) -> None:
        """Say something when verbose."""
        if self.level >= 1:
            self._line(text)

    def start(self, total: int, done: int, what: str) -> None:
        """Show a progress bar where stderr is a terminal."""
        if self.level >= 0 and sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=total, initial=done, desc=what, unit="scene", file=sys.stderr, leave=False)

    def step(self) -> None:
        """One more scene is through."""
        if self._bar is not None:
            self._bar.update()

    def __enter__(self) -> Reporter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _line(self, text: str) -> None:
        if self._bar is not None:
            self._bar.write(text, file=sys.stderr)
        else:
            print(text, file=sys.stderr, flush=True)
