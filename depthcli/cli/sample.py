"""``depthcli sample``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli import _options as o


def sample(
    output: o.Output,
    count: Annotated[int, typer.Option("--count", "-n", metavar="N", help="Number of scenes.")] = 6,
    kind: Annotated[
        list[str] | None, typer.Option(metavar="KIND", help="planes, foreground, repetitive, curved; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the first scenes.")] = 0,
    width: Annotated[int, typer.Option(metavar="PIXELS", help="Width.")] = 400,
    height: Annotated[int, typer.Option(metavar="PIXELS", help="Height.")] = 300,
    max_disparity: Annotated[int, typer.Option(metavar="PIXELS", help="Largest disparity, at most width / 2.")] = 48,
    noise: Annotated[float, typer.Option(metavar="LEVELS", help="Standard deviation of the noise, grey levels.")] = 0.0,
    radiometric: Annotated[
        float, typer.Option(metavar="SHARE", help="How differently the right camera sees the light, 0 to 1.")
    ] = 0.0,
    wall_contrast: Annotated[float, typer.Option(metavar="SHARE", help="Texture of the walls, 0 (bare) to 1.")] = 1.0,
    cross_modal: Annotated[bool, typer.Option("--cross-modal", help="Right image as an infrared camera's.")] = False,
    speckles: Annotated[
        float, typer.Option(metavar="SHARE", help="With --cross-modal: share of pixels with a dot.")
    ] = 0.0,
    source: Annotated[
        Path | None, typer.Option("--from", metavar="DIR", help="With --cross-modal: convert these scenes instead.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace scenes made with other options.")] = False,
    json: o.Json = False,
    verbose: o.Verbose = False,
    quiet: o.Quiet = False,
) -> int:
    """Generate stereo scenes with exact ground truth, for trying things out."""
    from depthcli.jobs.commands import run_sample

    options = {
        "count": count,
        **({"kinds": kind} if kind else {}),
        "seed": seed,
        "width": width,
        "height": height,
        "max_disparity": max_disparity,
        "noise": noise,
        "radiometric": radiometric,
        "wall_contrast": wall_contrast,
        "cross_modal": cross_modal,
        "speckles": speckles,
    }
    return run_sample(output, options, source, overwrite, json, o.reporter(verbose, quiet))
