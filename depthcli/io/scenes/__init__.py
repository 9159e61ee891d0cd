"""Scenes: what a command works on one at a time, one module per kind of input.

A scene knows its files and how to load them; none is opened before ``load`` or ``truth``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from depthcli.core.errors import ConfigError, InputError


@dataclass(frozen=True, kw_only=True)
class Scene(ABC):
    """The base class of all kinds of scene."""

    name: str  # unique in its listing, with ``/`` where the scene lies in a data set's folder
    folder: Path  # the folder it was found in
    layout: str = ""  # name of the layout that found it; empty for files named on the command line
    protocol: str = ""  # name of the evaluation protocol that its ground truth asks for
    problem: str = ""  # why the scene cannot be used (``load`` and ``truth`` raise it), or empty

    @property
    @abstractmethod
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at; ground truth is not among them."""

    @property
    def has_truth(self) -> bool:
        """True where there is ground truth to compare with."""
        return False

    @abstractmethod
    def load(self) -> Any:
        """Return the input of a method; InputError where the files cannot be used."""

    def truth(self) -> Any:
        """Return the ground truth as stored; InputError where there is none or it cannot be used."""
        self.check()
        raise InputError(f"{self.folder}: {self.name} has no ground truth")

    @classmethod
    def single(cls, values: Mapping[str, Any]) -> Self | None:
        """Return the scene whose files the command line names; None: none; ConfigError where an option is missing."""
        return None

    @classmethod
    def named(cls, values: Mapping[str, Any]) -> list[Self]:
        """Return all scenes whose files the command line names: the single one, unless the kind knows of more."""
        one = cls.single(values)
        return [] if one is None else [one]

    @classmethod
    def of_table(cls, path: Path) -> list[Self]:
        """Return the scenes that a table of files lists; ConfigError where this kind has no such table."""
        raise ConfigError(f"{path}: want a folder")

    def check(self) -> None:
        """Raise the scene's problem, if it has one, as an InputError."""
        if self.problem:
            raise InputError(self.problem)


def together(values: Mapping[str, Any], *names: str) -> bool:
    """Return True where all of the options are given, False where none is; ConfigError otherwise."""
    given = [name for name in names if values.get(name) is not None]
    if given and len(given) < len(names):
        missing = " and ".join(f"--{name.replace('_', '-')}" for name in names if name not in given)
        raise ConfigError(f"--{given[0].replace('_', '-')} wants {missing} beside it")
    return bool(given)


def check_same_size(file: Path, shape: Sequence[int], other: Path, wanted: Sequence[int], why: str = "") -> None:
    """Raise an InputError where an image of ``file`` has another (height, width) than that of ``other``."""
    if tuple(shape[:2]) != tuple(wanted[:2]):
        have, want = (f"{size[1]} x {size[0]}" for size in (shape, wanted))
        raise InputError(f"{file}: {have}, but {other.name} is {want}{why}")


def name_of(file: Path, generic: tuple[str, ...]) -> str:
    """Return the name of a single scene: its file's, or its folder's where that is a ``generic`` one."""
    folder, stem = file.absolute().parent.name, file.stem
    if file.suffix.lower() == ".gz":  # of a compressed file the other ending goes, too: scan.nii.gz is scan
        stem = Path(stem).stem
    return folder if stem.lower() in generic and folder else stem
