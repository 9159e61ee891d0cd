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

from depthcli.commands._options import (
    BoundOptions,
    ConfigArgument,
    RangeOptions,
    ScoredRunOptions,
    SetOption,
)
from depthcli.run.console import Reporter
from depthcli.show.table import aligned


def _printed_devices(name: str | None) -> str | None:
    """Print the devices with their measured bandwidth, and reasons for missing kinds, for ``--device list``."""
    if name != "list":
        return name
    from depthcli.device import DeviceError, devices, open_device, why_no_device

    lines = [("device", "name", "memory", "bandwidth", "driver")]
    for info in devices():
        try:
            device = open_device(info.address)
            speed = "-" if device is None else f"{device.measure_bandwidth() / 1e9:.1f} GB/s"
        except DeviceError as error:
            speed = str(error)
        lines.append((info.address, info.name, f"{info.memory / 2**30:.1f} GiB", speed, info.driver))
    if len(lines) > 1:
        Reporter().data(aligned(lines))
    if reason := why_no_device():
        Reporter().info(reason)
    raise typer.Exit


def stereo(
    config: ConfigArgument,
    pairs: RangeOptions,
    run: ScoredRunOptions,
    set: SetOption = None,
    *,
    bounds: BoundOptions,
    device: Annotated[
        str | None,
        Option(
            "--device",
            metavar="NAME",
            is_eager=True,
            callback=_printed_devices,
            help="Where to match: cpu, auto (a GPU if there is one), opencl or cuda, also with :N; list prints all. "
            "Default: cpu.",
        ),
    ] = None,
) -> int:
    """Match every pair with the configured pipeline, on the CPU or a device."""
    from depthcli.commands._run import run_problem

    options = pairs.settings() | {"device": device, "bound": bounds.promise()}
    return run_problem("stereo", config, pairs, run, set, **options)
