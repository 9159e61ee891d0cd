"""Warnings of scenes: the first of a kind is printed when it comes, the others are counted."""

from __future__ import annotations

from dataclasses import dataclass

from depthcli.core.text import kind_of_warning, without_file
from depthcli.run.console import Reporter


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
            text = without_file(line)
            kind = kind_of_warning(scene, text)
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
