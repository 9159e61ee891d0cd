"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from depthcli.batch.reporter import Reporter
    from depthcli.batch.runner import Options

Config = Annotated[str, typer.Argument(metavar="CONFIG", help="YAML file, or the name of a preset.")]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write into.")]
Scenes = Annotated[str, typer.Option("--scenes", metavar="GLOB", help="Only scenes whose name matches.")]
Layout = Annotated[
    str | None, typer.Option("--layout", metavar="NAME", help="Layout of the folder, where it is not recognized.")
]
Set = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override one key; repeatable.")]
Jobs = Annotated[
    int, typer.Option("--jobs", "-j", metavar="N", min=1, max=512, help="Scenes at a time, each in a process.")
]
Threads = Annotated[
    int | None, typer.Option("--threads", metavar="N", min=1, max=1024, help="Threads of each process.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run; compute everything anew.")]
MaxMemory = Annotated[
    str | None, typer.Option("--max-memory", metavar="SIZE", help="Such as 2GiB. Default: all that is free.")
]
Evaluate = Annotated[bool, typer.Option("--evaluate", help="Compare with the ground truth of the input folder.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say more on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say only errors.")]


def reporter(verbose: bool, quiet: bool) -> Reporter:
    """Where lines for people go."""
    from depthcli.batch.reporter import Reporter

    return Reporter(-1 if quiet else int(verbose))


def run_options(jobs: int, threads: int | None, max_memory: str | None, overwrite: bool) -> Options:
    """How a run is done; ConfigError for a wrong size."""
    from depthcli.batch.resources import parse_bytes
    from depthcli.batch.runner import Options

    return Options(jobs, threads, parse_bytes(max_memory) if max_memory else None, overwrite)
