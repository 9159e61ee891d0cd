"""Match image pairs: disparity maps, status and previews.

Examples:
  depthcli stereo accurate --input scenes --output runs/accurate --html
  depthcli stereo fast --left l.png --right r.png --max-disparity 64 -o pair
  depthcli stereo accurate -i scenes -o runs/p2 --set optimization.p2=6
"""

from __future__ import annotations

from typing import Annotated

from typer import Option

from depthcli.commands._options import ConfigArgument, RangeOptions, ScoredRunOptions, SetOption


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
            help="Where to match: cpu, auto (a GPU if there is one), opencl or cuda, also with :N; list prints all. "
            "Default: cpu.",
        ),
    ] = None,
) -> int:
    """Match every pair by a pipeline of ``methods/stereo/pipeline``, here or on a device."""
    from depthcli.commands import _pairs

    if device == "list":
        return _pairs.list_devices(run)
    batch, scenes = _pairs.prepare(config, pairs, run, set, device=device)
    return _pairs.run_batch(batch, scenes, run, pairs)
