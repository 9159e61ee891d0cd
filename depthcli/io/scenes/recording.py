"""Recordings of cameras, from which frames are extracted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.recordings import find_recordings, recording_files
from depthcli.io.scenes import Scene


@dataclass(frozen=True, kw_only=True)
class RecordingScene(Scene):
    """One recording.

    Attributes
    ----------
    path : the file, or the folder of a bag of ROS 2
    """

    path: Path

    @property
    def input_files(self) -> dict[str, Path]:
        """``recording``, or the files of the folder by name."""
        files = [] if self.problem else recording_files(self.path)
        return {f"recording: {file.name}" if len(files) > 1 else "recording": file for file in files}

    def load(self) -> None:
        """Raise InputError where the recording cannot be used; its messages are read one by one."""
        self.check()


def recording_scenes(paths: Sequence[Path]) -> list[RecordingScene]:
    """Return the recordings that paths name, or that lie in folders; one that cannot be used has a ``problem``.

    Raises
    ------
    ConfigError
        Two of them have one name.
    InputError
        The only path names no recording.
    """
    scenes = []
    for path in paths:
        try:
            found = [(each, "") for each in find_recordings(path)]
        except InputError as error:
            if len(paths) == 1:
                raise
            found = [(path, str(error))]
        scenes += [
            RecordingScene(name=each.stem or each.name, folder=each.parent, path=each, problem=problem)
            for each, problem in found
        ]
    if twice := [name for name, count in Counter(scene.name for scene in scenes).items() if count > 1]:
        raise ConfigError(f"two recordings are called {twice[0]!r}; extract them into different folders")
    return sorted(scenes, key=lambda scene: scene.name)
