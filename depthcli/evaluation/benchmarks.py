"""Submissions to the benchmarks: names, layouts and limits of their files.

Sources: the upload formats of vision.middlebury.edu/stereo/submit3 and eth3d.net/documentation, and the readme files
of KITTI's development kits of 2012 and 2015.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, NamedTuple

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
    size: tuple[int, int] | None = None  # (width, height) of the image, where it or the run's report says it


class Submission(NamedTuple):
    """A submission: the method's name, whether maps may have holes, and (width, height) of the maps by scene."""

    method: str
    sparse: bool
    sizes: Mapping[str, tuple[int, int]]


class Benchmark(ABC):
    """One benchmark."""

    protocol: ClassVar[str]  # name of the evaluation protocol, which knows where a run holds its maps
    scenes: ClassVar[Mapping[str, tuple[str, ...]]]  # of every split, which is submitted whole or not at all
    timed: ClassVar[bool] = False  # every map needs its run time

    def check_name(self, method: str) -> str:
        """Return what is wrong with the name of a method, or an empty text."""
        return ""

    def problems(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
        """Return the reasons why a map, (H, W) in pixels, NaN = no value, cannot be submitted."""
        found, (height, width) = [], values.shape
        if entry.size is not None and entry.size != (width, height):
            found.append(f"the map is {width} x {height}, the image {entry.size[0]} x {entry.size[1]}")
        with np.errstate(invalid="ignore"):
            if (values < 0).any():
                found.append(f"negative disparities, down to {np.nanmin(values):.4g}")
        if np.isnan(values).all():
            found.append("no pixel has a value")
        if self.timed and math.isnan(entry.seconds):
            found.append("no run time: the run has no report of this scene; say it with --seconds")
        return found

    def problems_together(self, submission: Submission) -> list[str]:
        """Return what is wrong with all maps together."""
        return []

    @abstractmethod
    def files(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
        """Return path in the archive -> content for the files of one map."""


class MiddleburyV3Benchmark(Benchmark):
    """PFM maps and times in the folders ``trainingX`` and ``testX``, X being the resolution."""

    protocol = "middlebury-v3"
    timed = True
    scenes: ClassVar[Mapping[str, tuple[str, ...]]] = {
        TRAINING: ("Adirondack", "ArtL", "Jadeplant", "Motorcycle", "MotorcycleE", "Piano", "PianoL", "Pipes",
                   "Playroom", "Playtable", "PlaytableP", "Recycle", "Shelves", "Teddy", "Vintage"),
        TEST: ("Australia", "AustraliaP", "Bicycle2", "Classroom2", "Classroom2E", "Computer", "Crusade", "CrusadeP",
               "Djembe", "DjembeL", "Hoops", "Livingroom", "Newkuba", "Plants", "Staircase"),
    }  # fmt: skip
    factors: ClassVar[Mapping[str, int]] = {"F": 1, "H": 2, "Q": 4}  # size of the full images / that of a resolution
    # Those of 2014 are 2632 to 2964 pixels wide; three come from older sets.
    width = 2800
    others: ClassVar[Mapping[str, int]] = {"ArtL": 1388, "Computer": 1328, "Teddy": 1800}

    def check_name(self, method: str) -> str:
        """Return what is wrong with the name as part of a file's name, in which ``_s`` marks sparse maps."""
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_+.-]{0,39}", method) or method.endswith("_s") or method == "GT":
            return f"expected letters, digits and _ + . - for file names, no _s at the end, not GT (got {method!r})"
        return ""

    def problems(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
        """Return also a reason for holes in a dense submission."""
        holes = 0 if submission.sparse else int(np.isnan(values).sum())
        why = [f"{holes} pixels without a value; fill them, or submit sparse maps with --sparse"]
        return super().problems(entry, values, submission) + why * bool(holes)

    def problems_together(self, submission: Submission) -> list[str]:
        """Return a reason where the maps have several resolutions."""
        found: dict[str, list[str]] = {}
        for scene, (width, _) in submission.sizes.items():
            found.setdefault(self.resolution(scene, width), []).append(scene)
        several = "; ".join(f"{r}: {', '.join(scenes)}" for r, scenes in sorted(found.items()))
        return [f"maps of several resolutions: {several}"] if len(found) > 1 else []

    @classmethod
    def resolution(cls, scene: str, width: int) -> str:
        """Return F, H or Q, by the width of a map of the benchmark's scene."""
        full = cls.others.get(scene, cls.width)
        return min(cls.factors, key=lambda name: abs(math.log(full / cls.factors[name] / width)))

    def files(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
        """Return ``disp0METHOD.pfm``, or ``disp0METHOD_s.pfm``, and ``timeMETHOD.txt``."""
        folder = f"{entry.split}{self.resolution(entry.scene, submission.sizes[entry.scene][0])}/{entry.scene}"
        kind = "_s" if submission.sparse else ""
        return {
            f"{folder}/disp0{submission.method}{kind}.pfm": encode_pfm(values),
            f"{folder}/time{submission.method}.txt": f"{round(entry.seconds, 6)}\n".encode(),
        }


class Eth3dBenchmark(Benchmark):
    """PFM maps and run times in the folder ``low_res_two_view``."""

    protocol = "eth3d"
    timed = True
    scenes: ClassVar[Mapping[str, tuple[str, ...]]] = {
        TRAINING: (*(f"{place}_{n}{kind}" for place in ("delivery_area", "electro", "playground")
                     for n in (1, 2, 3) for kind in "ls"),
                   "facade_1s", "forest_1s", "forest_2s", "terrace_1s", "terrace_2s",
                   "terrains_1l", "terrains_1s", "terrains_2l", "terrains_2s"),
        TEST: (*(f"{place}_{n}{kind}" for place in ("storage_room", "tunnel") for n in (1, 2, 3) for kind in "ls"),
               *(f"{place}_1{kind}" for place in ("lakeside", "sand_box") for kind in "ls"),
               *(f"storage_room_2_{n}{kind}" for n in (1, 2) for kind in "ls")),
    }  # fmt: skip

    def problems(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
        """Return also a reason for values beyond the width, which the benchmark counts as missing."""
        found = super().problems(entry, values, submission)
        with np.errstate(invalid="ignore"):
            if (values > values.shape[1]).any():
                found.append(f"disparities beyond the image's width, up to {np.nanmax(values):.4g}")
        return found

    def files(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
        """Return ``SCENE.pfm`` and ``SCENE.txt``."""
        return {
            f"low_res_two_view/{entry.scene}.pfm": encode_pfm(values),
            f"low_res_two_view/{entry.scene}.txt": f"runtime {round(entry.seconds, 6)}\n".encode(),
        }


class Kitti2015Benchmark(Benchmark):
    """16-bit PNG maps in the folder ``disp_0``."""

    protocol = "kitti-2015"
    scenes: ClassVar[Mapping[str, tuple[str, ...]]] = {TEST: tuple(f"{n:06d}_10" for n in range(200))}
    folder = "disp_0/"

    def problems(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> list[str]:
        """Return also reasons for values that a code cannot hold, and for maps of training images of the same names."""
        found = super().problems(entry, values, submission)
        with np.errstate(invalid="ignore"):
            if (np.rint(values.astype(np.float64) * KITTI_SCALE) > 65535).any():
                found.append(f"disparities up to {np.nanmax(values):.4g}; a 16-bit code holds less than 256")
        if entry.image is not None and "training" in entry.image.parts:
            found.append(f"made from {entry.image}, a training image; the benchmark takes the test images' maps")
        return found

    def files(self, entry: Entry, values: NDArray[np.float32], submission: Submission) -> dict[str, bytes]:
        """Return the one file of a map, ``NNNNNN_10.png``."""
        name = f"{self.folder}{entry.scene}.png"
        data = encode_disparity_png(values)
        if data is None:
            raise OutputError(f"{name}: cannot be encoded as PNG")
        return {name: data}


class Kitti2012Benchmark(Kitti2015Benchmark):
    """16-bit PNG maps in the archive's root."""

    protocol = "kitti-2012"
    scenes: ClassVar[Mapping[str, tuple[str, ...]]] = {TEST: tuple(f"{n:06d}_10" for n in range(195))}
    folder = ""


BENCHMARKS: Mapping[str, type[Benchmark]] = {
    each.protocol: each for each in (MiddleburyV3Benchmark, Kitti2012Benchmark, Kitti2015Benchmark, Eth3dBenchmark)
}


def benchmark(name: str) -> Benchmark:
    """Return the benchmark of that name; ConfigError where there is none."""
    found = BENCHMARKS.get(name.lower().replace("_", "-"))
    if found is None:
        raise ConfigError(f"--for: no benchmark called {name!r}; one of: {', '.join(BENCHMARKS)}")
    return found()
