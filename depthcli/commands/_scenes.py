"""The scenes that a command line means: a folder of them, a table of files, or the files of a single one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from depthcli.batch.command import SceneT, Values
from depthcli.batch.console import Reporter
from depthcli.core.errors import ConfigError
from depthcli.data.pairs import TABLE_SUFFIXES
from depthcli.data.scenes import Scene
from depthcli.data.walk import chosen_scenes, discover_scenes


def find_scenes(kinds: tuple[type[SceneT], ...], values: Values, reporter: Reporter) -> list[SceneT]:
    """Return the scenes that ``--input``, or the options for the files of a single scene, name.

    Raises
    ------
    ConfigError
        Neither or both are given, or an option that does not go with them.
    InputError
        As :func:`depthcli.data.walk.discover_scenes`.
    """
    place, name, patterns = values["input"], values["name"], values["scenes"] or ["*"]
    evaluates = values.get("evaluate") or values.get("html")
    flags = (" and ".join(f"{o.flag} FILE" for o in kind.options if o.type is Path) for kind in kinds)
    single = ", or ".join(filter(None, flags))
    if named := next((scenes for kind in kinds if (scenes := kind.named(values))), []):
        if place is not None:
            raise ConfigError(f"--input and {single} exclude each other")
        if evaluates:
            raise ConfigError("--evaluate needs --input: a single scene has no ground truth")
        if name is None:
            return _chosen(named, patterns, "the command line")
        if len(named) > 1:
            raise ConfigError(f"--name is for a single scene, these are {len(named)}")
        return [replace(named[0], name=name)]
    if place is None:
        raise ConfigError(f"give --input DIR, or {single}")
    if name is not None:
        raise ConfigError(f"--name is for a single scene, given by {single}")
    if evaluates and place.is_file():
        raise ConfigError(f"{place}: --evaluate needs a folder of scenes, with their ground truth")
    return scenes_at(place, kinds, values["layout"], patterns, reporter)


def scenes_at(
    place: Path, kinds: tuple[type[SceneT], ...], layout: str | None, patterns: Sequence[str], reporter: Reporter
) -> list[SceneT]:
    """Return the scenes of a folder, or those that a table of files lists."""
    if place.is_file() and place.suffix.lower() in TABLE_SUFFIXES:
        return _chosen(kinds[0].of_table(place), patterns, place)
    # Folders that cannot be read are among them as scenes with a ``problem``, which are reported and not computed.
    return cast("list[SceneT]", discover_scenes(place, kinds, layout, patterns, reporter.info))


def _chosen(scenes: Sequence[SceneT], patterns: Sequence[str], place: Path | str) -> list[SceneT]:
    return cast("list[SceneT]", chosen_scenes(cast("Sequence[Scene]", scenes), patterns, place))
