"""Warnings of scenes: the first of a kind is printed when it comes, the others are counted."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from depthcli.batch.console import Reporter

_NUMBER = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?")


@dataclass
class _Kind:
    """Warnings that differ in numbers and files alone: what the first one said, and the number of scenes."""

    text: str
    count: int = 0


class WarningCounts:
    """Prints the warnings of the scenes of a run: one line a kind, and at the end how many scenes have it.

    Verbose, every warning is printed.
    """

    def __init__(self, reporter: Reporter) -> None:
        self._reporter = reporter
        self._kinds: dict[str, _Kind] = {}

    def add(self, scene: str, lines: list[str]) -> None:
        """Take the warnings of a scene."""
        of_scene = {}
        for line in lines:
            text = _without_file(line)
            kind = _kind_of(scene, text)
            print_it = self._reporter.info if kind not in self._kinds or kind in of_scene else self._reporter.detail
            print_it(f"{scene}: warning: {line}")
            of_scene[kind] = self._kinds.setdefault(kind, _Kind(text))
        for each in of_scene.values():
            each.count += 1

    def close(self) -> None:
        """Print how many scenes have the warnings that not all were printed of."""
        for kind in self._kinds.values():
            if kind.count > 1:
                self._reporter.info(f"warning: {kind.text} ({kind.count} scenes; -v names each)")
        self._kinds.clear()


def summarized(warnings: Iterable[tuple[str, str]]) -> list[str]:
    """Return one line a kind of warning, that of its first scene, with the number of the other scenes that have it.

    Parameters
    ----------
    warnings : scene and line
    """
    kinds: dict[str, list[tuple[str, str]]] = {}
    for scene, line in warnings:
        kinds.setdefault(_kind_of(scene, _without_file(line)), []).append((scene, line))
    more = {kind: len(of) - 1 for kind, of in kinds.items()}
    return [f"{of[0][0]}{f' and {more[k]} more' if more[k] else ''}: {of[0][1]}" for k, of in kinds.items()]


def _kind_of(scene: str, text: str) -> str:
    return _NUMBER.sub("#", re.sub(rf"(?<!\w){re.escape(scene)}(?!\w)", "#", text))


def _without_file(line: str) -> str:
    """Return the line without the path that it begins with, if it does."""
    start, colon, rest = line.partition(": ")
    return rest if colon and "/" in start else line
