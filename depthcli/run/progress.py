"""The progress of a run: a bar on a terminal, else a line now and then; and warnings, each kind printed once."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from typing import Any

from depthcli.core.text import kind_of_warning, without_file

_HEARTBEAT = 30.0  # seconds between lines where there is no terminal


class Progress:
    """Counts what is done, and shows it.

    Parameters
    ----------
    what : name of the command
    total, done : number of scenes, and how many of them were done before
    say : prints a line
    bar : draw a bar on stderr; else say lines
    """

    def __init__(self, what: str, total: int, done: int, say: Callable[[str], None], bar: bool) -> None:
        self._what, self._total, self._done, self._failed, self._say = what, total, done, 0, say
        self._said = time.monotonic()
        self._bar: Any = None
        if bar:
            from tqdm import tqdm

            with contextlib.suppress(OSError, ValueError):  # stderr was closed
                self._bar = tqdm(desc=what, total=total, initial=done, unit="scene", file=sys.stderr, leave=False,
                                 dynamic_ncols=True, mininterval=0.2)  # fmt: skip

    def step(self, failed: bool) -> None:
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
            self._say(f"{self._what}: {self._done} of {self._total} scenes{failures}")

    def write(self, text: str) -> None:
        """Print a line on stderr, above the bar."""
        if self._bar is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._bar.write(text, file=sys.stderr)

    def close(self) -> None:
        """Take the bar away."""
        if self._bar is not None:
            with contextlib.suppress(OSError, ValueError):
                self._bar.close()


class WarningCounts:
    """Prints the warnings of the scenes of a run: one line a kind, and at the end how many scenes have it.

    Warnings of a kind differ in numbers and files alone.

    Parameters
    ----------
    say, detail : print a line; ``detail`` only where every warning is wanted
    """

    def __init__(self, say: Callable[[str], None], detail: Callable[[str], None]) -> None:
        self._say, self._detail = say, detail
        self._kinds: dict[str, tuple[str, int]] = {}  # the text of the first one, and the number of scenes

    def add(self, scene: str, lines: list[str]) -> None:
        """Take the warnings of a scene."""
        of_scene: dict[str, str] = {}
        for line in lines:
            text = without_file(line)
            kind = kind_of_warning(scene, text)
            print_it = self._say if kind not in self._kinds or kind in of_scene else self._detail
            print_it(f"{scene}: warning: {line}")
            of_scene[kind] = text
            self._kinds.setdefault(kind, (text, 0))
        for kind in of_scene:
            text, count = self._kinds[kind]
            self._kinds[kind] = text, count + 1

    def close(self) -> None:
        """Print how many scenes have the warnings that not all were printed of."""
        for text, count in self._kinds.values():
            if count > 1:
                self._say(f"warning: {text} ({count} scenes; -v names each)")
        self._kinds.clear()
