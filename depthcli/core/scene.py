"""The scene that is computed, as methods that run programs need to know it, and what its programs used."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

BASE_BYTES = 160 << 20
"""Interpreter, libraries and kernels, beside what the estimates of methods hold (measured: 125 to 155 MiB)."""


@dataclass
class ComputedScene:
    """A scene that is computed."""

    name: str = "scene"
    memory: int | None = None  # bytes that a program may take, with all processes that it starts; None: all
    # Columns of the report about its programs: their processor time, seconds, and the largest memory of one, bytes.
    used: dict[str, float] = field(default_factory=dict)
    # What was read from files of its own as they are, and these files; None: nothing was.
    originals: tuple[object, tuple[Path, ...]] | None = None


_current: ContextVar[ComputedScene | None] = ContextVar("scene", default=None)


def current_scene() -> ComputedScene:
    """Return the scene of the innermost :func:`computing`; one of no folder where there is none."""
    return _current.get() or ComputedScene()


@contextlib.contextmanager
def computing(name: str, memory: int) -> Iterator[ComputedScene]:
    """Name the scene that the block computes, with at most ``memory`` bytes."""
    scene = ComputedScene(name, memory)
    token = _current.set(scene)
    try:
        yield scene
    finally:
        _current.reset(token)
