"""Generated scenes with exact truth, one file a kind of scene; the folder is the registry.

``depthcli sample --NAME`` makes the scenes of the module ``NAME``, without a name those of ``stereo``.
"""

from __future__ import annotations

import importlib
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from depthcli.core.option import Option
from depthcli.data.scenes import Scene


@dataclass(frozen=True, kw_only=True)
class SampleScene(Scene):
    """A scene to be generated.

    Attributes
    ----------
    settings : what it is made from, beside the options that all scenes share
    files : role -> file that it is made from; none where it comes from nothing
    origin : the scene that it is made from, or None
    """

    settings: dict[str, Any] = field(default_factory=dict)
    files: dict[str, Path] = field(default_factory=dict)
    origin: Scene | None = None

    @property
    def input_files(self) -> dict[str, Path]:
        """What it is made from."""
        return self.files

    def load(self) -> dict[str, Any]:
        """The settings."""
        self.check()
        return self.settings


class Sample(ABC):
    """A kind of generated scenes. Nothing heavy is imported before ``make``."""

    about: ClassVar[str]
    """What ``--NAME`` gives, for the help."""
    options: ClassVar[tuple[Option, ...]]
    """Its own options; the ones that other kinds have too are the same."""
    by_scene: ClassVar[frozenset[str]] = frozenset({"count", "kind", "seed", "from_"})
    """Options that choose scenes and say nothing about one of them beyond its settings."""

    @property
    def name(self) -> str:
        """Its module's name."""
        return type(self).__module__.rpartition(".")[2]

    def check(self, values: Mapping[str, Any]) -> None:  # noqa: B027  # most have nothing to check
        """Raise ConfigError where options do not fit together."""

    @abstractmethod
    def scenes(self, values: Mapping[str, Any]) -> list[SampleScene]:
        """The scenes that the options ask for."""

    @abstractmethod
    def make(self, values: Mapping[str, Any], scene: SampleScene, folder: Path) -> dict[str, Any]:
        """Write one scene into the empty ``folder``, in a layout of ours; facts for its row of the report."""


@cache
def samples() -> dict[str, Sample]:
    """Name -> kind, ``stereo`` first."""
    names = sorted((m.name for m in pkgutil.iter_modules(__path__) if not m.name.startswith("_")), key=_stereo_first)
    return {name: importlib.import_module(f"{__name__}.{name}").SAMPLE for name in names}


def _stereo_first(name: str) -> tuple[bool, str]:
    return name != "stereo", name
