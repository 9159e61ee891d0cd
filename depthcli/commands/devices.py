"""List the GPUs and other devices that stereo can run on."""

from __future__ import annotations

from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter, aligned
from depthcli.run.json_csv import Row, to_json


class DevicesCommand(Command):
    """Lists devices by their drivers, and copies an array on each."""

    page = "how_to/gpu"
    examples = ("depthcli devices",)

    def run(self, values: Values, reporter: Reporter) -> int:
        """Print the list, and on stderr why there is none of a kind; return the exit code."""
        from depthcli.device import DeviceError, devices, open_device, why_no_device

        rows: list[Row] = []
        for info in devices():
            row: Row = {"device": info.address, "name": info.name, "gpu": info.is_gpu, "memory": info.memory,
                   "bandwidth": None, "driver": info.driver, "problem": ""}  # fmt: skip
            try:
                device = open_device(info.address)
                assert device is not None
                row["bandwidth"] = round(device.measure_bandwidth())
            except DeviceError as error:
                row["problem"] = str(error)
            rows.append(row)
        if values["json"]:
            reporter.data(to_json(rows))
        elif rows:
            lines = [("device", "name", "memory", "bandwidth", "driver")]
            for row in rows:
                speed = f"{row['bandwidth'] / 1e9:.1f} GB/s" if row["bandwidth"] else row["problem"]
                memory = f"{row['memory'] / 2**30:.1f} GiB"
                lines.append((row["device"], row["name"], memory, speed, row["driver"]))
            reporter.data(aligned(lines))
        if why_no_device():
            reporter.info(why_no_device())
        return 0


COMMAND = DevicesCommand()
