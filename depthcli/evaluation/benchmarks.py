"""Submissions to the benchmarks: names, layouts and limits of their files.

Sources: the upload formats of vision.middlebury.edu/stereo/submit3 and eth3d.net/documentation, and the readme files
of KITTI's development kits of 2012 and 2015.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import ConfigError, OutputError
from depthcli.io.formats.disparity import KITTI_SCALE, encode_disparity_png, encode_pfm

TRAINING, TEST = "training", "test"


class Entry(NamedTuple):
    """One map of a submission."""

    scene: str  # its name at the benchmark
    split: str  # ``TRAINING`` or ``TEST``
    file: Path
    seconds: float = math.nan  # run time, where it is known
    image: Path | None = None  # the left image, where it is known
    size: tuple[int, int] | None = None  # (width, height) of the image, if it or the run's report is there


class Submission(NamedTuple):
    """A submission: the method's name, whether maps may have holes, and (width, height) of the maps by scene."""

    method: str
    sparse: bool
    sizes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class Benchmark:
    """One benchmark; maps are (H, W) in pixels, NaN = no value."""

    protocol: str  # name of the evaluation protocol, which knows the places of a run's maps
    scenes: Mapping[str, tuple[str, ...]]  # of every split, which is submitted whole or not at all
    timed: bool  # every map needs its run time
    limits: Callable[[Entry, NDArray[np.float32], Submission], list[str]]  # returns what breaks the benchmark's rules
    # Returns path in the archive -> content for the files of one map.
    files: Callable[[Entry, NDArray[np.float32], Submission], dict[str, bytes]]
    together: Callable[[Submission], list[str]] = lambda _: []  # returns the problems of a submission as a whole

    def problems(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
        """Return the reasons why a map cannot be submitted."""
        problems, (height, width) = [], values.shape
        if entry.size is not None and entry.size != (width, height):
            problems.append(f"the map is {width} x {height}, the image {entry.size[0]} x {entry.size[1]}")
        if (values < 0).any():
            problems.append(f"negative disparities, down to {np.nanmin(values):.4g}")
        if np.isnan(values).all():
            problems.append("no pixel has a value")
        if self.timed and math.isnan(entry.seconds):
            problems.append("no run time: the run has no report of this scene; set it with --seconds")
        return problems + self.limits(entry, values, submission)


_MIDDLEBURY_SCENES = {
    TRAINING: ("Adirondack", "ArtL", "Jadeplant", "Motorcycle", "MotorcycleE", "Piano", "PianoL", "Pipes",
               "Playroom", "Playtable", "PlaytableP", "Recycle", "Shelves", "Teddy", "Vintage"),
    TEST: ("Australia", "AustraliaP", "Bicycle2", "Classroom2", "Classroom2E", "Computer", "Crusade", "CrusadeP",
           "Djembe", "DjembeL", "Hoops", "Livingroom", "Newkuba", "Plants", "Staircase"),
}  # fmt: skip
MIDDLEBURY_FACTORS: Mapping[str, int] = {"F": 1, "H": 2, "Q": 4}
"""Resolution of Middlebury v3 -> size of the full images / size at this resolution."""

# Full images of 2014 are 2632 to 2964 pixels wide; three come from older sets.
_WIDTH = 2800
_WIDTHS = {"ArtL": 1388, "Computer": 1328, "Teddy": 1800}


def middlebury_resolution(scene: str, width: int) -> str:
    """Return F, H or Q, by the width of a map of the benchmark's scene."""
    full = _WIDTHS.get(scene, _WIDTH)
    return min(MIDDLEBURY_FACTORS, key=lambda name: abs(math.log(full / MIDDLEBURY_FACTORS[name] / width)))


def _middlebury_problems(submission: Submission) -> list[str]:
    """Return the problems of a submission to Middlebury v3 as a whole: the method's name, several resolutions.

    The name is part of files' names, in which ``_s`` marks sparse maps.
    """
    by_resolution: dict[str, list[str]] = {}
    for scene, (width, _) in submission.sizes.items():
        by_resolution.setdefault(middlebury_resolution(scene, width), []).append(scene)
    several = "; ".join(f"{r}: {', '.join(scenes)}" for r, scenes in sorted(by_resolution.items()))
    problems, method = [f"maps of several resolutions: {several}"] if len(by_resolution) > 1 else [], submission.method
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_+.-]{0,39}", method) or method.endswith("_s") or method == "GT":
        what = "expected letters, digits and _ + . - for file names, no _s at the end, not GT"
        problems.insert(0, f"--method: {what} (got {method!r})")
    return problems


def _holes(entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
    n_holes = int(np.isnan(values).sum())
    why = f"{n_holes} pixels without a value; fill them, or submit sparse maps with --sparse"
    return [] if submission.sparse or not n_holes else [why]


def _middlebury_files(entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
    """Return ``disp0METHOD.pfm``, or ``disp0METHOD_s.pfm``, and ``timeMETHOD.txt``."""
    folder = f"{entry.split}{middlebury_resolution(entry.scene, submission.sizes[entry.scene][0])}/{entry.scene}"
    kind = "_s" if submission.sparse else ""
    return {
        f"{folder}/disp0{submission.method}{kind}.pfm": encode_pfm(values),
        f"{folder}/time{submission.method}.txt": f"{round(entry.seconds, 6)}\n".encode(),
    }


_ETH3D_SCENES = {
    TRAINING: (*(f"{place}_{n}{kind}" for place in ("delivery_area", "electro", "playground")
                 for n in (1, 2, 3) for kind in "ls"),
               "facade_1s", "forest_1s", "forest_2s", "terrace_1s", "terrace_2s",
               "terrains_1l", "terrains_1s", "terrains_2l", "terrains_2s"),
    TEST: (*(f"{place}_{n}{kind}" for place in ("storage_room", "tunnel") for n in (1, 2, 3) for kind in "ls"),
           *(f"{place}_1{kind}" for place in ("lakeside", "sand_box") for kind in "ls"),
           *(f"storage_room_2_{n}{kind}" for n in (1, 2) for kind in "ls")),
}  # fmt: skip


def _beyond_width(entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
    """Return a reason for values beyond the width, which ETH3D counts as missing."""
    beyond = (values > values.shape[1]).any()
    return [f"disparities beyond the image's width, up to {np.nanmax(values):.4g}"] if beyond else []


def _eth3d_files(entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
    """Return ``SCENE.pfm`` and ``SCENE.txt``."""
    return {
        f"low_res_two_view/{entry.scene}.pfm": encode_pfm(values),
        f"low_res_two_view/{entry.scene}.txt": f"runtime {round(entry.seconds, 6)}\n".encode(),
    }


def _not_in_codes(entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
    """Return reasons for values beyond the codes of KITTI, and for maps of training images of the same names."""
    problems = []
    if (np.rint(values.astype(np.float64) * KITTI_SCALE) > 65535).any():
        problems.append(f"disparities up to {np.nanmax(values):.4g}; 16-bit codes end below 256")
    if entry.image is not None and "training" in entry.image.parts:
        problems.append(f"made from {entry.image}, a training image; the benchmark takes the test images' maps")
    return problems


def _kitti(protocol: str, n_scenes: int, folder: str) -> Benchmark:
    """Return a benchmark of 16-bit PNG maps in a folder of the archive, ``NNNNNN_10.png``."""

    def files(entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
        name, data = f"{folder}{entry.scene}.png", encode_disparity_png(values)
        if data is None:
            raise OutputError(f"{name}: cannot be encoded as PNG")
        return {name: data}

    scenes = {TEST: tuple(f"{n:06d}_10" for n in range(n_scenes))}
    return Benchmark(protocol, scenes, False, _not_in_codes, files)


BENCHMARKS: Mapping[str, Benchmark] = {
    each.protocol: each
    for each in (
        Benchmark("middlebury-v3", _MIDDLEBURY_SCENES, True, _holes, _middlebury_files, _middlebury_problems),
        _kitti("kitti-2012", 195, ""),
        _kitti("kitti-2015", 200, "disp_0/"),
        Benchmark("eth3d", _ETH3D_SCENES, True, _beyond_width, _eth3d_files),
    )
}


def benchmark(name: str) -> Benchmark:
    """Return the benchmark of that name. Raise ConfigError if there is no such benchmark."""
    chosen = BENCHMARKS.get(name.lower().replace("_", "-"))
    if chosen is None:
        raise ConfigError(f"--for: no benchmark called {name!r}; one of: {', '.join(BENCHMARKS)}")
    return chosen
