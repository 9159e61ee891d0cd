"""The scene that is computed, as programs need to know it, and what they used."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Scene:
    """A scene that is computed.

    Attributes
    ----------
    name : its name
    memory : bytes that a program may take, with all processes that it starts; None: all
    used : columns of the report about its programs: their processor time, seconds, and the largest memory of one, bytes
    originals : what was read from files of its own as they are, and these files; None: nothing was
    """

    name: str
    memory: int | None
    used: dict[str, float] = field(default_factory=dict)
    originals: tuple[object, tuple[Path, ...]] | None = None

    def add(self, cpu_seconds: float, memory: int) -> None:
        """Count what a program used."""
        self.used["program_cpu"] = round(self.used.get("program_cpu", 0.0) + cpu_seconds, 6)
        self.used["program_memory"] = max(self.used.get("program_memory", 0), memory)

    def files_of(self, read: object) -> tuple[Path, ...] | None:
        """Return the whole paths of the files that ``read`` was read from; None where it is not as any files are."""
        if self.originals is None or self.originals[0] is not read:
            return None
        return tuple(file.absolute() for file in self.originals[1])


_current: ContextVar[Scene | None] = ContextVar("scene", default=None)


def current_scene() -> Scene:
    """Return the scene of the innermost :func:`computing`; one without a name where there is none."""
    return _current.get() or Scene("scene", None)


@contextlib.contextmanager
def computing(name: str, memory: int) -> Iterator[Scene]:
    """Say that the block computes a scene of that name, with at most ``memory`` bytes."""
    scene = Scene(name, memory)
    token = _current.set(scene)
    try:
        yield scene
    finally:
        _current.reset(token)
