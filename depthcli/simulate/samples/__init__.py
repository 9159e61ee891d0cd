"""Generated scenes with exact truth, one file a kind of scene; the folder is the registry.

``depthcli sample --NAME`` makes the scenes of the module ``NAME``, without a name those of ``stereo``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from depthcli.core.option import Option
from depthcli.core.registry import Registry, registered_name
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

    about: ClassVar[str]
    """What ``--NAME`` gives, for the help."""
    options: ClassVar[tuple[Option, ...]]
    """Its own options; the ones that other kinds have too are the same."""
    by_scene: ClassVar[frozenset[str]] = frozenset({"count", "kind", "seed", "from_"})
    """Options that choose scenes and say nothing about one of them beyond its settings."""

    @property
    def name(self) -> str:
        """Name on the command line: its module's or its plug-in's."""
        return registered_name(type(self))

    def check(self, values: Mapping[str, Any]) -> None:
        """Raise ConfigError where options do not fit together."""
        return

    @abstractmethod
    def scenes(self, values: Mapping[str, Any]) -> list[SampleScene]:
        """Return the scenes that the options ask for."""

    @abstractmethod
    def make(self, values: Mapping[str, Any], scene: SampleScene, folder: Path) -> dict[str, Any]:
        """Write one scene into the empty ``folder``, in a layout of ours, and return facts for the report."""


_REGISTRY = Registry[Sample](__name__)


def samples() -> dict[str, Sample]:
    """Return name -> kind of sample, ``stereo`` first, those of plug-ins last."""
    names = sorted(_REGISTRY.names(), key=lambda name: (name != "stereo", name not in _REGISTRY.own_names))
    return {name: _REGISTRY.load(name)() for name in names}
