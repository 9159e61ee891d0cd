"""Figure 3.2 of the thesis: times of costs and aggregations, sequential, naive and optimized, and frames a second."""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numba
import numpy as np
from _experiments import Rows, device_ms, matcher, milliseconds, on_new_pair, seconds_in_turns

from depthcli.core.frames import StereoPair
from depthcli.device import open_device
from depthcli.io.stereo_pairs import load_pair
from depthcli.methods.stereo._device_table import TABLE
from depthcli.methods.stereo.aggregation.cross import cross_arms
from depthcli.methods.stereo.on_device import DevicePair, DeviceVolume
from tests.naive import loops

TIMED = (3, 11, 21, 33)
FRAMES = ("thesis/ch3-ad-cw", "thesis/ch3-ad-rank-cross", "fast")
STRIP = 15  # rows of the image that sequential and naive adaptive weights are timed on


@cache
def local(cost: str, way: str, window: int = 0) -> Any:
    """Return a literal method of chapter 3, with a window of this size."""
    return matcher(f"thesis/ch3-{cost}-{way}", *([f"aggregation.window={window}"] if window else []))


def plain(parallel: bool, pair: StereoPair, volume: Any) -> dict[str, Callable[[], object]]:
    """Return the plain programs: four costs, and aggregations by window (0: any)."""
    compiled = {name: numba.njit(parallel=parallel, fastmath=True)(getattr(loops, name)) for name in loops.__all__}
    costs, out = volume.costs.astype(np.float32), np.empty(volume.costs.shape, np.float32)
    color = [image.astype(np.float32) for image in pair.color8]
    grey = [image.astype(np.float32) for image in pair.grey]
    steps = np.arange(-2, 3)
    smooth = np.exp(-(steps**2) / 2)
    taps = np.stack([np.outer(smooth, steps * smooth), np.outer(steps * smooth, smooth)]).astype(np.float32)
    own, other = (cross_arms(image, 17, 20, 17, 20).astype(np.int64) for image in pair.color8)
    turned, half = out.transpose(1, 0, 2), np.empty_like(out)

    def cw(window: int) -> None:
        compiled["box"](costs, half, window // 2)
        compiled["box"](half.transpose(1, 0, 2), turned, window // 2)

    def cross(_: int) -> None:
        compiled["arms"](costs, half, own[:2], other[:2], True)
        compiled["arms"](half.transpose(1, 0, 2), turned, *(a[2:].transpose(0, 2, 1) for a in (own, other)), False)

    def aw(window: int) -> None:  # some rows: each takes the same time
        compiled["weights"](costs, out[:STRIP], *color, window // 2, 150)

    def transformed(name: str, compare: str, depth: int, dtype: type, *more: Any) -> None:
        maps = [np.zeros((*image.shape, depth) if depth else image.shape, dtype) for image in grey]
        for image, target in zip(grey, maps, strict=True):
            compiled[name](image, target, *more)
        compiled[compare](*maps, out)

    return {
        "AD": lambda: compiled["difference"](*color, out),
        "Gradient": lambda: transformed("derivatives", "difference", 2, np.float32, taps),
        "Rank": lambda: transformed("ranks", "difference", 1, np.float32),
        "Census": lambda: transformed("signatures", "hamming", 0, np.uint64),
        **{f"CW {w}": partial(cw, w) for w in TIMED},
        "CROSS": partial(cross, 0),
        **{f"AW {w}": partial(aw, w) for w in TIMED},
    }


def figure_3_2(scene: Any) -> Rows:
    """Return milliseconds: sequential, naive, optimized, and on a GPU where there is one."""
    pair, count = load_pair(scene), scene.max_disparity + 1
    measures = {name: local(f"ad-{name.lower()}", "cw").cost.parts[1].cost for name in ("Gradient", "Rank", "Census")}
    costs = {"AD": local("ad", "cw").cost, **measures}
    volume = local("ad-census", "cw").cost(pair, count)
    aggregations = {
        **{f"CW {w}": local("ad-census", "cw", w).aggregation for w in TIMED},
        "CROSS": local("ad-census", "cross").aggregation,
        **{f"AW {w}": local("ad-census", "aw", w).aggregation for w in TIMED},
    }
    fast: dict[str, Any] = {name: partial(cost, pair, count) for name, cost in costs.items()}
    fast |= {name: partial(method, volume, pair) for name, method in aggregations.items()}
    sequential, naive = plain(False, pair, volume), plain(True, pair, volume)
    device, rows = open_device("auto"), {}
    for name, run in fast.items():
        jobs = {"sequential": sequential[name], "naive": naive[name], "optimized": run}
        part = pair.shape[0] / STRIP if name.startswith("AW") else 1.0
        taken = seconds_in_turns(jobs, 2 if part > 1 else 5)
        best = {way: 1e3 * found[0] * (part if way != "optimized" else 1) for way, found in taken.items()}
        if device:
            there, copied = DevicePair(device, pair, TABLE), DeviceVolume.upload(device, volume)
            what = (costs[name], there, count) if name in costs else (aggregations[name], copied, there)
            best["GPU"], _ = device_ms(device, partial(there.run, *what), 10)
        rows[name] = best
    return rows


def cross_times(scene: Any) -> Rows:
    """Return milliseconds of cross-based aggregation by the largest length of its arms."""
    pair = load_pair(scene)
    volume = local("ad-census", "cw").cost(pair, scene.max_disparity + 1)
    cross = local("ad-census", "cross").aggregation
    jobs = {
        f"CROSS {length}": partial(cross.model_copy(update={"length": length}), volume, pair) for length in (5, 17, 33)
    }
    return milliseconds(jobs, 20)


def frames(scene: Any) -> Rows:
    """Return milliseconds of whole pipelines, and of OpenCV's SGBM in turn with them."""
    jobs = {name: on_new_pair(matcher(name), scene) for name in (*FRAMES, "opencv-sgbm")}
    return milliseconds(jobs, 60, warm=2)
