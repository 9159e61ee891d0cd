#!/usr/bin/env python3
"""Figure 3.2 of the thesis: aggregation on a device, naive against made for it, over window sizes.

    python scripts/fig_3_2.py OUT [--device opencl] [--windows 3,11,33] [--repeat 50]

OUT receives ``fig_3_2.md``, ``fig_3_2.csv`` and ``fig_3_2.png``. The scene is generated (450 x 375 pixels, 60
disparities, as in the thesis), the costs are AD + census. Times are the device's own, the median of ``--repeat`` runs
after one that is not counted; whole pipelines are timed by the clock, from two images on the host to the map there.
Bytes: what the kernels' arrays hold, each counted once a kernel; their share of the bandwidth is measured against a
plain copy on the same device. CROSS chooses its own support: windows bound its arms.
"""

from __future__ import annotations

import argparse
import csv
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import _env  # (first: continues in the checkout's environment)

from depthcli.api.inputs import load_config
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.device import Device, open_device
from depthcli.evaluation.render import Table
from depthcli.methods.stereo.aggregation import Aggregator
from depthcli.methods.stereo.aggregation import _device as implementations
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.config import StereoConfig
from depthcli.methods.stereo.cost.combined import Combined
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume
from depthcli.methods.stereo.pipeline._device import local
from depthcli.simulate.stereo_scenes import make_scene

WIDTH, HEIGHT, DISPARITIES = 450, 375, 60
# Milliseconds on a Quadro 5000, for windows of 33 x 33 where there are windows: naive, optimized.
THESIS = {"CW": (30.0, 9.0), "CROSS": (67.0, 37.0), "AW": (16000.0, 670.0)}
PRESETS = ("fast", "thesis/cross", "thesis/adaptive-weight", "ad-census", "accurate")


def aggregations(windows: list[int]) -> list[tuple[str, int, Aggregator]]:
    """Return (name, window, method) of every bar of the figure."""
    rows: list[tuple[str, int, Aggregator]] = [("CW", w, ConstantWindow(window=w)) for w in windows]
    rows += [("CROSS", w, Cross(iterations=1, length=max(1, w // 2), inner_length=max(1, w // 2))) for w in windows]
    rows += [("AW", w, AdaptiveWeight(window=w)) for w in windows]
    return rows


def on_device(device: Device, run: Callable[[], object], repeat: int) -> tuple[float, int]:
    """Return the median milliseconds that the kernels of ``run`` take, and the bytes of their arrays."""
    totals, nbytes = [], 0
    for n in range(repeat + 1):
        device.launches = []
        run()
        device.finish()
        if n:
            totals.append(1e3 * sum(launch.seconds for launch in device.launches))
            nbytes = sum(launch.nbytes for launch in device.launches)
    device.launches = None
    return statistics.median(totals), nbytes


def by_clock(run: Callable[[], object], repeat: int) -> float:
    """Return the median milliseconds of ``run``, after one that is not counted."""
    seconds = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return 1e3 * statistics.median(seconds[1:])


def measure_aggregations(device: Device, pair: StereoPair, windows: list[int], repeat: int) -> list[dict[str, object]]:
    """Return a row for each aggregation and window."""
    parts = [{"cost": "absolute_difference", "lambda": 10.0}, {"cost": "census", "lambda": 30.0}]
    volume = Combined.model_validate({"parts": parts})(pair, DISPARITIES)
    there, copied = DevicePair(device, pair), DeviceVolume.upload(device, volume)
    bandwidth = device.measure_bandwidth()
    rows: list[dict[str, object]] = []
    for name, window, method in aggregations(windows):
        fast_version, naive_version = (getattr(implementations, way + method.method_name()) for way in ("", "naive_"))
        naive, _ = on_device(device, lambda m=method, run=naive_version: run(m, copied, there), min(repeat, 3))  # type: ignore[misc]
        fast, nbytes = on_device(device, lambda m=method, run=fast_version: run(m, copied, there), repeat)  # type: ignore[misc]
        processor = by_clock(lambda m=method: m(volume, pair), min(repeat, 5))  # type: ignore[misc]
        share = 100 * nbytes / (fast / 1e3) / bandwidth
        rows.append({
            "aggregation": name, "window": window, "naive_ms": round(naive, 4), "optimized_ms": round(fast, 4),
            "processor_ms": round(processor, 3), "bytes": nbytes, "bandwidth_share": round(share, 1),
        })  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def measure_presets(device: Device, pair: StereoPair, repeat: int) -> list[tuple[str, ...]]:
    """Return rows of whole pipelines: milliseconds on the device and on the processor."""
    rows = []
    for preset in PRESETS:
        pipeline = load_config(StereoConfig, preset).pipeline
        there = by_clock(lambda p=pipeline: local(p, DevicePair(device, pair), DISPARITIES - 1, Clock()), repeat)  # type: ignore[misc]
        here = by_clock(lambda p=pipeline: p(pair, DISPARITIES - 1), min(repeat, 5))  # type: ignore[misc]
        rows.append((preset, f"{there:.2f}", f"{here:.1f}", f"{here / there:.1f}"))
        print(rows[-1], flush=True)
    return rows


def markdown(device: Device, rows: list[dict[str, object]], presets: list[tuple[str, ...]]) -> str:
    thesis = {(name, column): f"{ms:g}" for name, pair in THESIS.items() for column, ms in zip("no", pair, strict=True)}
    body = [
        (str(r["aggregation"]), str(r["window"]), f"{r['naive_ms']:.3f}", f"{r['optimized_ms']:.3f}",
         f"{float(str(r['naive_ms'])) / float(str(r['optimized_ms'])):.1f}", f"{r['processor_ms']:.1f}",
         f"{int(str(r['bytes'])) / 1e6:.0f}", f"{r['bandwidth_share']:.0f}",
         thesis[str(r["aggregation"]), "n"], thesis[str(r["aggregation"]), "o"])
        for r in rows
    ]  # fmt: skip
    header = ("aggregation", "window", "naive, ms", "optimized, ms", "ratio", "processor, ms", "moved, MB",
              "of bandwidth, %", "thesis: naive", "optimized")  # fmt: skip
    where = f"{device.info.address}, {device.info.name}; {device.info.driver}; {WIDTH} x {HEIGHT} x {DISPARITIES}"
    note = f"{where}. The thesis's numbers (windows of 33, CROSS as it chooses) are those of a Quadro 5000."
    whole = Table("Whole pipelines, with transfers", ("preset", "device, ms", "processor, ms", "ratio"), tuple(presets))
    return "\n".join([Table("Aggregation on a device", header, tuple(body), note).markdown(), whole.markdown(), ""])


def plot(rows: list[dict[str, object]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 5), layout="constrained")
    for color, name in zip(("tab:blue", "tab:green", "tab:red"), THESIS, strict=True):
        own = [row for row in rows if row["aggregation"] == name]
        for column, style in (("naive_ms", "--"), ("optimized_ms", "-")):
            label = f"{name}, {column.removesuffix('_ms')}"
            axes.plot(
                [r["window"] for r in own], [r[column] for r in own], style, color=color, marker="o", ms=3, label=label
            )
    axes.set(xlabel="window side, pixels", ylabel="milliseconds", yscale="log")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="folder for the table, the numbers and the plot")
    parser.add_argument("--device", default="auto", help="as of depthcli stereo (default: the first GPU)")
    _env.add_list(parser, "--windows", [3, 5, 7, 9, 11, 15, 21, 27, 33], kind=int, help="sides, pixels")
    parser.add_argument("--repeat", type=int, default=50)
    arguments = parser.parse_args()
    device = open_device(arguments.device)
    if device is None:
        raise SystemExit(f"--device {arguments.device}: no GPU here; --device opencl takes a processor's OpenCL")
    scene = make_scene("foreground", 0, WIDTH, HEIGHT, DISPARITIES - 1)
    pair = StereoPair(scene.left, scene.right)
    rows = measure_aggregations(device, pair, arguments.windows, arguments.repeat)
    presets = measure_presets(device, pair, arguments.repeat)
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.out / "fig_3_2.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    text = markdown(device, rows, presets)
    (arguments.out / "fig_3_2.md").write_text(text)
    plot(rows, arguments.out / "fig_3_2.png")
    print(text)


if __name__ == "__main__":
    main()
