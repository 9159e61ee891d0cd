"""``depthcli evaluate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli import _options as o


def evaluate(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Run folders, or folders of others' maps.")],
    truth: Annotated[Path, typer.Option("--truth", metavar="DIR", help="Folder of scenes with ground truth.")],
    output: o.Output,
    scenes: o.Scenes = "*",
    layout: o.Layout = None,
    scale: Annotated[
        float | None, typer.Option(metavar="CODES", min=1e-6, help="Codes per pixel of the maps' PNG files.")
    ] = None,
    json: o.Json = False,
    verbose: o.Verbose = False,
    quiet: o.Quiet = False,
) -> int:
    """Compare the maps of one or more runs with the ground truth, side by side."""
    from depthcli.jobs.commands import run_evaluate

    return run_evaluate(runs, truth, output, scenes, layout, scale, json, o.reporter(verbose, quiet))
