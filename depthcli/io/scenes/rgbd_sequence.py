"""Sequences of color and depth frames, for methods that carry state from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene


@dataclass(frozen=True, kw_only=True)
class SequenceScene(Scene):
    """The frames of a sequence, in order."""

    frames: tuple[RgbdScene, ...]

    @property
    def input_files(self) -> dict[str, Path]:
        """Frame and role -> file."""
        return {f"{frame.name}: {role}": file for frame in self.frames for role, file in frame.input_files.items()}

    @property
    def has_truth(self) -> bool:
        """True where any frame has ground truth."""
        return any(frame.has_truth for frame in self.frames)

    def load(self) -> None:
        """Raise InputError where the sequence cannot be used; its frames are loaded one by one."""
        self.check()


def sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes with the frames of every sequence as one scene, by name; a single frame is one as well."""
    groups: dict[tuple[Path, str], list[RgbdScene]] = {}
    others: list[Scene] = []
    for scene in scenes:
        if isinstance(scene, RgbdScene) and not scene.problem:
            groups.setdefault((scene.folder, scene.sequence or scene.name), []).append(scene)
        else:
            others.append(scene)
    for (folder, sequence), frames in groups.items():
        ordered = tuple(sorted(frames, key=lambda frame: frame.number))
        name = ordered[0].name.rpartition("/")[0] if ordered[0].sequence else ordered[0].name
        others.append(SequenceScene(name=name or sequence.rpartition("/")[2], folder=folder, frames=ordered))
    return sorted(others, key=lambda scene: scene.name)
