"""What the scripts that measure share: presets, scenes of the groups, times in turns, tables."""

import re
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import _env
import numpy as np
import yaml

from depthcli.commands import config_model
from depthcli.core.config_file import find_config, load_config
from depthcli.core.frames import StereoPair
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair
from depthcli.problems.fusion import Fuse
from depthcli.show.table import Table

THESIS = yaml.safe_load((_env.ROOT / "scripts" / "thesis.yaml").read_text("utf-8"))
Rows = dict[str, dict[str, float]]  # row -> column -> number


@dataclass(frozen=True)
class Experiment:
    """A measurement of each of some items, independent of the others, for scripts/thesis."""

    chapter: str
    items: Callable[[Path], Iterable[tuple[str, Any]]]  # of the folder of data sets: names, and what is measured
    measure: Callable[[Any], Rows]
    checked: int = 0  # number of items, the first ones, that --check measures again; 0: times, or too slow
    on_page: bool = True


GROUPS = yaml.safe_load((_env.ROOT / "scripts" / "stereo_groups.yaml").read_text())


def config_of(command: str, name: str, *settings: str) -> Any:
    """Return the config of a preset of a command, or of a file, with settings such as ``maps.choice=energy``."""
    return load_config(config_model(command), find_config(command, name), settings)


def matcher(name: str, *settings: str) -> Callable[[Any, int], Any]:
    """Return what computes a map of a pair and its range: a preset, ``fuse/NAME`` for one of fuse, or a file."""
    if name.startswith("fuse/"):
        return Fuse.ready(config_of("fuse", name.removeprefix("fuse/"), *settings)).config
    return config_of("stereo", name, *settings).pipeline  # type: ignore[no-any-return]


def scenes_in(folder: Path, *names: str) -> list[Any]:
    """Return the stereo scenes of a folder, or those of these names."""
    return discover_scenes(folder, PAIRS, patterns=names or ("*",))


def real_scenes(data: Any, group: str) -> Iterator[tuple[str, Any]]:
    """Yield folder and scene of a group of ``stereo_groups.yaml``, as far as they are in the data."""
    for folder, names in GROUPS[group].items():
        if folder != "generated" and (data / folder).is_dir():
            yield from ((folder, scene) for scene in scenes_in(data / folder, *names))


def middlebury_scenes(data: Path) -> list[Any]:
    """Return the scenes of Middlebury 2001 to 2006, the four of v2 first."""
    folders = [data / f"middlebury_{name}" for name in ("v2", "2001", "2005", "2006")]
    return [scene for folder in folders for scene in scenes_in(folder)]


def generated_scenes(group: str) -> Iterator[tuple[str, str, int, dict[str, float]]]:
    """Yield name, kind, seed and look of the generated scenes of a group."""
    for name, how in GROUPS[group]["generated"].items():
        look = {key: value for key, value in how.items() if key not in ("kinds", "seeds")}
        yield from ((name, kind, seed, look) for kind in how["kinds"] for seed in how["seeds"])


def seconds_in_turns(jobs: Mapping[str, Callable[[], object]], repeats: int, warm: int = 1) -> dict[str, list[float]]:
    """Return the sorted seconds of jobs that take turns, without those of the first ``warm`` turns."""
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for turn in range(repeats + warm):
        for name, job in jobs.items():
            begun = time.perf_counter()
            job()
            if turn >= warm:
                taken[name].append(time.perf_counter() - begun)
    return {name: sorted(found) for name, found in taken.items()}


def on_new_pair(method: Callable[[Any, int], Any], scene: Any) -> Callable[[], object]:
    """Return what matches a new pair each time: what a pair remembers (grey images) is part of the work."""
    pair = load_pair(scene)
    return lambda: method(StereoPair(pair.left, pair.right), scene.max_disparity)


def device_ms(device: Any, run: Callable[[], object], repeats: int) -> tuple[float, int]:
    """Return the median milliseconds that a device computes, after a first run, and the bytes of its kernels."""
    times, size = [], 0
    for _ in range(repeats + 1):
        device.launches = []
        run()
        device.finish()
        times.append(1e3 * sum(launch.seconds for launch in device.launches))
        size = sum(launch.nbytes for launch in device.launches)
    device.launches = None
    return statistics.median(times[1:]), size


def milliseconds(jobs: Mapping[str, Callable[[], object]], repeats: int, warm: int = 1) -> Rows:
    """Return the shortest milliseconds of jobs that take turns."""
    return {name: {"ms": 1e3 * found[0]} for name, found in seconds_in_turns(jobs, repeats, warm).items()}


def kept(folder: Path | None, name: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the arrays in ``name.npz`` of a folder, or those that ``make`` returns, which are kept there."""
    file = None if folder is None else folder / f"{name}.npz"
    if file is not None and file.exists():
        return dict(np.load(file))
    arrays = make()
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savez(file, **arrays)
    return arrays


def bad(found: np.ndarray, truth: np.ndarray, pixels: np.ndarray, limit: float = 1.0) -> float:
    """Return the share of pixels that are off by more than a limit, or have no value, %."""
    return 100 * float(np.mean(~(np.abs(found - truth) <= limit)[pixels]))


def mean_known(values: Iterable[float] | np.ndarray) -> float:
    """Return the mean of the numbers that are finite; NaN where there are none."""
    numbers = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.float64)
    known = numbers[np.isfinite(numbers)]
    return float(known.mean()) if known.size else float("nan")


def renewed(page: str, made: Mapping[str, str]) -> str:
    """Return a page with these texts between their markers."""
    return re.sub(
        r"(?s)(<!-- begin (\S+) -->\n).*?(<!-- end -->)",
        lambda found: f"{found[1]}\n{made[found[2]]}\n\n{found[3]}" if found[2] in made else found[0],
        page,
    )


def show(title: str, header: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> None:
    """Print a table as Markdown."""
    print(Table.of_cells(title, header, list(rows), note).markdown(), flush=True)
