"""The scenes that the options of a command name, and its options for sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence

from depthcli.commands._options import DepthOptions, RunOptions, SceneOptions
from depthcli.core.errors import ConfigError
from depthcli.io.scenes import Layouts, RgbdScene, find
from depthcli.io.scenes.rows import SceneT
from depthcli.run.console import Reporter


def find_scenes(layouts: Layouts[SceneT], source: SceneOptions, run: RunOptions) -> list[SceneT]:
    """Return the scenes that ``--input``, or the options for the files of a single scene, name.

    ``layouts`` belong to the command's kind of scene: ``PAIRS``, ``FRAMES`` or ``VOLUMES``. Errors are those of
    :func:`depthcli.io.scenes.find.find_scenes`.
    """
    single = source.single_files
    return find.find_scenes(layouts, vars(source), single, source.patterns, bool(run.evaluate), run.reporter.info)


def camera_of(option: str, text: str) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of an option; ConfigError if no camera can have them."""
    try:
        fx, fy, cx, cy = (float(number) for number in text.split(","))
    except ValueError:
        fx = fy = cx = cy = math.nan
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and min(fx, fy) > 0):
        raise ConfigError(f"{option}: expected fx,fy,cx,cy in pixels, focal lengths above 0 (got {text[:64]!r})")
    return fx, fy, cx, cy


def depth_settings(options: DepthOptions) -> dict[str, object]:
    """Return config key -> value, None: not given; ConfigError if no camera can have the intrinsics."""
    given = vars(options) | {"ply": options.ply or None}
    if options.intrinsics is not None:
        camera_of("--intrinsics", options.intrinsics)
        given["intrinsics"] = f"[{options.intrinsics}]"
    return given | {"bound.level": given.pop("level"), "bound.within": given.pop("within")}


def say_typical_cameras(scenes: Sequence[RgbdScene], reporter: Reporter) -> None:
    """Warn of frames without intrinsics, whose clouds take the intrinsics of a typical Kinect."""
    own = [scene for scene in scenes if not (scene.problem or scene.raw)]
    if n_without := sum(frame.intrinsics is None for frame in own):
        reporter.info(
            f"warning: {n_without} of {len(own)} frames have no intrinsics; point clouds assume a "
            "typical Kinect (fx, fy 525 at a width of 640); see --intrinsics, or meta.json"
        )
