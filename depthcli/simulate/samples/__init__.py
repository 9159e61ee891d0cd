"""Generated scenes with exact truth, one file a kind of scene.

``depthcli sample --NAME`` makes the scenes of the module ``NAME``, without a name those of ``stereo``.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import Scene
from depthcli.io.walk import discover_scenes


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


def scenes_from(
    folder: Path, kinds: tuple[type[Scene], ...], settings: dict[str, Any], needs_truth: str = ""
) -> list[SampleScene]:
    """Return a scene to be generated for every scene of ``folder``.

    Parameters
    ----------
    folder, kinds : where to look, and for which scenes
    settings : of every scene
    needs_truth : what a scene without ground truth lacks, where one cannot be used
    """
    scenes = []
    for scene in discover_scenes(folder, kinds):
        truth = {role: getattr(scene, role, None) for role in ("depth_true", "disparity_left", "disparity_right")}
        files = scene.input_files | {role: file for role, file in truth.items() if file is not None}
        files |= {f"mask_{name}": file for name, file in getattr(scene, "masks", {}).items()}
        problem = scene.problem
        if needs_truth and not problem and not scene.has_truth:
            problem = f"{scene.folder}: {needs_truth} to start from"
        scenes.append(
            SampleScene(
                name=scene.name, folder=scene.folder, problem=problem, origin=scene, files=files, settings=settings
            )
        )
    return scenes


def write_files(
    folder: Path, images: Mapping[str, Any], maps: Mapping[str, Any], masks: Mapping[str, Any], end: str = ""
) -> None:
    """Write arrays by name: images as PNG, maps as PFM, masks as PNG of their name behind ``mask_``; None is left out.

    Parameters
    ----------
    end : what all names end with
    """
    for name, image in (*images.items(), *((f"mask_{name}", mask) for name, mask in masks.items())):
        write_png(folder / f"{name}{end}.png", image)
    for name, values in maps.items():
        if values is not None:
            write_pfm(folder / f"{name}{end}.pfm", values)


def write_meta(folder: Path, meta: Mapping[str, Any]) -> None:
    """Write the ``meta.json`` of a scene."""
    write_text(folder / "meta.json", json.dumps(meta, indent=1) + "\n")
