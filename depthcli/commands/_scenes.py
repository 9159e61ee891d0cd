"""The scenes that a command line names: a folder, a table of files, the files of a single scene, or maps of a run."""

from __future__ import annotations

import gc
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from depthcli.commands._options import RunOptions, SceneOptions
from depthcli.core.errors import ConfigError
from depthcli.io.inputs import local
from depthcli.io.layouts import Layouts
from depthcli.io.named_files import STDIN, is_table, named_scenes, patterns_in, scenes_of_table
from depthcli.io.scenes import RgbdScene, Scene, StereoScene
from depthcli.io.walk import NoScenesError, chosen_scenes, discover_scenes
from depthcli.run.console import Reporter
from depthcli.run.job import SceneT

_MIN_SCENES_TO_FREEZE = 1000  # scenes, whose objects take long to look through

_OWN_NAMES: dict[type[Scene], str] = {  # kind of scene -> names that are easy to give, for messages
    StereoScene: "NAME_L.* and NAME_R.*",
    RgbdScene: "NAME/color.* and NAME/depth.*",
}


def find_scenes(layouts: Layouts[SceneT], source: SceneOptions, run: RunOptions) -> list[SceneT]:
    """Return the scenes that ``--input``, or the options for the files of a single scene, name.

    ``layouts`` belong to the command's kind of scene: ``PAIRS``, ``FRAMES`` or ``VOLUMES``.

    Raises
    ------
    ConfigError
        Neither or both are given, or an option that does not go with them.
    InputError
        As :func:`depthcli.io.walk.discover_scenes`.
    """
    place, name, single = source.input, source.name, source.single_files
    files = {key: local(value) if isinstance(value, Path) else value for key, value in vars(source).items()}
    if named := cast("list[SceneT]", named_scenes(layouts.kind, files)):
        if place is not None:
            raise ConfigError(f"--input and {single} exclude each other")
        if run.evaluate:
            raise ConfigError("--evaluate needs --input: a single scene has no ground truth")
        if name is None:
            return _chosen(named, source.patterns, "the command line")
        if len(named) > 1:
            raise ConfigError(f"--name is for a single scene, these are {len(named)}")
        return [replace(named[0], name=name)]
    if place is None:
        raise ConfigError(f"give --input DIR, or {single}")
    if name is not None:
        raise ConfigError(f"--name is for a single scene, given by {single}")
    if run.evaluate and (place == STDIN or os.path.isfile(local(place))):
        raise ConfigError(f"{place}: --evaluate needs a folder of scenes, with their ground truth")
    try:
        return scenes_at(place, layouts, source.layout, source.patterns, run.reporter)
    except NoScenesError as error:
        found = patterns_in(local(place)) if issubclass(StereoScene, layouts.kind) else None
        hint = single if found is None else "--left {} --right {}".format(*map(shlex.quote, found))
        names = next((names for kind, names in _OWN_NAMES.items() if issubclass(kind, layouts.kind)), None)
        other = f"call your own {names}, describe theirs in --layout FILE.yaml, or " if names else ""
        raise NoScenesError(f"{error}; {other}give files of other names by {hint}") from error


def scenes_at(
    place: Path, layouts: Layouts[SceneT], layout: str | None, patterns: Sequence[str], reporter: Reporter
) -> list[SceneT]:
    """Return the scenes of a folder, or those that a table of files lists."""
    if is_table(place):
        if not issubclass(StereoScene, layouts.kind):
            raise ConfigError(f"{place}: tables list stereo pairs only; expected a folder with one folder per scene")
        return _chosen(cast("list[SceneT]", scenes_of_table(place)), patterns, place)
    # Folders that cannot be read are among them as scenes with a ``problem``, which are reported and not computed.
    found = cast("list[SceneT]", discover_scenes(place, layouts, layout, patterns, reporter.info))
    if len(found) >= _MIN_SCENES_TO_FREEZE:
        gc.freeze()  # they stay to the end: no later search for garbage has to look at them
    return found


def _chosen(scenes: Sequence[SceneT], patterns: Sequence[str], place: Path | str) -> list[SceneT]:
    return cast("list[SceneT]", chosen_scenes(cast("Sequence[Scene]", scenes), patterns, place))
