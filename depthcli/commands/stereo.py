"""Match image pairs: disparity maps, status and previews.

Examples:
  depthcli stereo accurate --input scenes --output runs/accurate --html
  depthcli stereo fast --left l.png --right r.png --max-disparity 64 -o pair
  depthcli stereo accurate -i scenes -o runs/p2 --set optimization.p2=6
"""

from __future__ import annotations

from typing import Annotated

import typer
from typer import Option

from depthcli.commands._options import ConfigArgument, RangeOptions, ScoredRunOptions, SetOption
from depthcli.run.console import Reporter


def _listed(device: str | None) -> str | None:
    if device == "list":
        from depthcli.commands._devices import print_devices

        print_devices(Reporter())
        raise typer.Exit
    return device


def stereo(
    config: ConfigArgument,
    pairs: RangeOptions,
    run: ScoredRunOptions,
    set: SetOption = None,
    device: Annotated[
        str | None,
        Option(
            "--device",
            metavar="NAME",
            is_eager=True,
            callback=_listed,
            help="Where to match: cpu, auto (a GPU if there is one), opencl or cuda, also with :N; list prints all. "
            "Default: cpu.",
        ),
    ] = None,
) -> int:
    """Match every pair by a pipeline of ``methods/stereo/pipeline``, here or on a device."""
    from depthcli.commands import _pairs

    batch, scenes = _pairs.prepare(config, pairs, run, set, device=device)
    return _pairs.run_batch(batch, scenes, run, pairs)
