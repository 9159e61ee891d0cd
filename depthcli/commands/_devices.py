"""The devices that ``--device`` takes."""

from __future__ import annotations

from depthcli.device import DeviceError, devices, open_device, why_no_device
from depthcli.run.console import Reporter, aligned


def print_devices(reporter: Reporter) -> None:
    """Print the list, with the measured bandwidth, and on stderr why there is no device of a kind."""
    lines = [("device", "name", "memory", "bandwidth", "driver")]
    for info in devices():
        try:
            device = open_device(info.address)
            speed = "-" if device is None else f"{device.measure_bandwidth() / 1e9:.1f} GB/s"
        except DeviceError as error:
            speed = str(error)
        lines.append((info.address, info.name, f"{info.memory / 2**30:.1f} GiB", speed, info.driver))
    if len(lines) > 1:
        reporter.data(aligned(lines))
    if reason := why_no_device():
        reporter.info(reason)
