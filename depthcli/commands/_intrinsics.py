"""Cameras of frames that the command line says, and frames whose camera is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence

from depthcli.core.errors import ConfigError
from depthcli.io.scenes import RgbdScene
from depthcli.run.console import Reporter


def camera_of(option: str, text: str) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of an option; ConfigError where they cannot be those of a camera."""
    try:
        fx, fy, cx, cy = (float(number) for number in text.split(","))
    except ValueError:
        fx = fy = cx = cy = math.nan
    if not (all(map(math.isfinite, (fx, fy, cx, cy))) and min(fx, fy) > 0):
        raise ConfigError(f"{option}: expected fx,fy,cx,cy in pixels, focal lengths above 0 (got {text[:64]!r})")
    return fx, fy, cx, cy


def say_typical_cameras(scenes: Sequence[RgbdScene], reporter: Reporter) -> None:
    """Warn of frames without intrinsics, whose clouds take those of a typical Kinect."""
    own = [scene for scene in scenes if not (scene.problem or scene.raw)]
    if n_without := sum(frame.intrinsics is None for frame in own):
        reporter.info(
            f"warning: {n_without} of {len(own)} frames have no intrinsics; point clouds take those of a "
            "typical Kinect (fx, fy 525 at a width of 640); see --intrinsics, or meta.json"
        )
