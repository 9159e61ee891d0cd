"""The command line of every command that matches image pairs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from depthcli.cli import _options as o


def pair_command(name: str, summary: str) -> Callable[..., int]:
    """The command ``name``; its job is looked up under that name, ``summary`` is its help."""

    def command(
        config: o.Config,
        output: o.Output,
        input: Annotated[Path | None, typer.Option("--input", "-i", metavar="DIR", help="Folder of scenes.")] = None,
        left: Annotated[Path | None, typer.Option(metavar="FILE", help="Left image, instead of --input.")] = None,
        right: Annotated[Path | None, typer.Option(metavar="FILE", help="Right image, instead of --input.")] = None,
        max_disparity: Annotated[int | None, typer.Option(metavar="PIXELS", help="Largest disparity searched.")] = None,
        layout: o.Layout = None,
        scenes: o.Scenes = "*",
        set_: o.Set = None,
        jobs: o.Jobs = 1,
        threads: o.Threads = None,
        max_memory: o.MaxMemory = None,
        overwrite: o.Overwrite = False,
        evaluate: o.Evaluate = False,
        json: o.Json = False,
        verbose: o.Verbose = False,
        quiet: o.Quiet = False,
    ) -> int:
        from depthcli.jobs.commands import Request, run_batch

        settings = list(set_ or [])
        if max_disparity is not None:
            settings.append(f"max_disparity={max_disparity}")
        request = Request(config, settings, output, input, left, right, layout, scenes, evaluate, json)
        options = o.run_options(jobs, threads, max_memory, overwrite)
        return run_batch(name, request, options, o.reporter(verbose, quiet))

    command.__doc__ = summary
    return command
