"""Generated scenes with exact truth, one file a kind of scene.

``depthcli sample --NAME`` makes the scenes of the module ``NAME``, without a name those of ``stereo``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from depthcli.io.scenes import Scene


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
        """Role -> file that it is made from."""
        return self.files

    def load(self) -> dict[str, Any]:
        """Return the settings."""
        self.check()
        return self.settings


class Sample(ABC):
    """A kind of generated scenes."""

    name: ClassVar[str]
    """Name of its module; with dashes that of its option."""
    options: ClassVar[tuple[str, ...]]
    """The options of ``sample`` that it takes."""
    by_scene: ClassVar[frozenset[str]] = frozenset({"count", "kind", "seed", "from_"})
    """Options that choose scenes and say nothing about one of them beyond its settings."""

    def check(self, values: Mapping[str, Any]) -> None:
        """Raise ConfigError where options do not fit together."""
        return

    @abstractmethod
    def scenes(self, values: Mapping[str, Any]) -> list[SampleScene]:
        """Return the scenes that the options ask for."""

    @abstractmethod
    def make(self, values: Mapping[str, Any], scene: SampleScene, folder: Path) -> dict[str, Any]:
        """Write one scene into the empty ``folder``, in a layout of ours, and return facts for the report."""
