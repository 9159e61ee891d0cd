"""Generate scenes with exact ground truth.

Without the name of a kind these are stereo pairs; options that a kind does not take are refused.

Examples:
  depthcli sample --output scenes --count 4 --noise 2
  depthcli sample --kinect --output frames
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from depthcli.commands._options import RunOptions


def sample(
    run: RunOptions,
    count: Annotated[int, Option("--count", "-n", metavar="N", min=1, max=10_000, help="Number of scenes.")] = 6,
    kind: Annotated[
        list[str] | None,
        Option(
            "--kind",
            metavar="KIND",
            help="planes, foreground, repetitive, curved, street; repeatable. Default: the first four.",
        ),
    ] = None,
    seed: Annotated[int, Option("--seed", metavar="N", min=0, max=2**31 - 1, help="Seed of the first scenes.")] = 0,
    width: Annotated[int, Option("--width", metavar="N", min=16, max=8192, help="Width, pixels.")] = 400,
    height: Annotated[int, Option("--height", metavar="N", min=16, max=8192, help="Height, pixels.")] = 300,
    max_disparity: Annotated[
        int, Option("--max-disparity", metavar="N", min=4, max=4096, help="At most width / 2.")
    ] = 48,
    noise: Annotated[
        float, Option("--noise", metavar="LEVELS", min=0, max=100, help="Standard deviation of noise, in levels.")
    ] = 0.0,
    radiometric: Annotated[
        float, Option("--radiometric", metavar="SHARE", min=0, max=1, help="Change of light in the right image.")
    ] = 0.0,
    brightness: Annotated[
        float, Option("--brightness", metavar="SHARE", min=0, max=1, help="Factor on all levels; 0.08: a night scene.")
    ] = 1.0,
    wall_contrast: Annotated[
        float, Option("--wall-contrast", metavar="SHARE", min=0, max=1, help="Texture of the walls, 0 (bare) to 1.")
    ] = 1.0,
    cross_modal: Annotated[bool, Option("--cross-modal", help="Right image as an infrared camera's.")] = False,
    kinect: Annotated[bool, Option("--kinect", help="Color, and depth as a Kinect measures it.")] = False,
    registration: Annotated[
        bool, Option("--registration", help="Volumes with a known smooth registration error.")
    ] = False,
    transparent: Annotated[bool, Option("--transparent", help="Transparent objects, with sparse depth.")] = False,
    speckles: Annotated[
        float, Option("--speckles", metavar="SHARE", min=0, max=1, help="Share of the right pixels with a dot.")
    ] = 0.0,
    frames: Annotated[
        int, Option("--frames", metavar="N", min=0, max=100_000, help="Frames of a sequence; 0: none.")
    ] = 10,
    fattening: Annotated[
        int, Option("--fattening", metavar="PIXELS", min=0, max=64, help="How far foreground is widened.")
    ] = 4,
    share: Annotated[
        float, Option("--share", metavar="SHARE", min=0, max=1, help="Share of the pixels with sparse depth.")
    ] = 0.02,
    outliers: Annotated[
        float, Option("--outliers", metavar="SHARE", min=0, max=1, help="Share of it that is wrong.")
    ] = 0.1,
    at_edges: Annotated[bool, Option("--at-edges", help="Sparse depth along edges of color only.")] = False,
    from_: Annotated[
        Path | None, Option("--from", metavar="DIR", help="Make them from the scenes of this folder instead.")
    ] = None,
) -> int:
    """Generate the scenes of one kind into a run folder."""
    values = dict(locals())
    from depthcli.commands._sample import prepare, run_batch

    return run_batch(*prepare(values, sample), run)
