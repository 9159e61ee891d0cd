"""How the numbers and maps of a protocol are shown: words and units of tables, hints for the viewer, error pictures."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import color8
from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.render import Table
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import Palette
from depthcli.io.scenes import Scene

UNKNOWN, RIGHT, WRONG, HIDDEN_RIGHT, HIDDEN_WRONG, EMPTY = range(6)
"""Kinds of pixel; ``HIDDEN``: occluded in the other view, ``EMPTY``: without a value."""


class SliceAxis(NamedTuple):
    """An axis of a volume that is shown.

    Attributes
    ----------
    plane : name of the slices across it
    ends : letters of the sides where its first and its last voxel is
    first, step : where the first voxel is, and how much further the next one, mm; positive towards the first side
    """

    plane: str
    ends: str
    first: float
    step: float


@dataclass(frozen=True)
class ShownMap:
    """A run's map as it is shown, read without a look at any truth.

    Attributes
    ----------
    values : (H, W), or (Z, Y, X) of a volume, float, in the presentation's unit; NaN = none
    confidence : name -> array of that shape, higher is surer
    expected_error : array of that shape in the presentation's unit, NaN = none; or None
    axes : of a volume; empty: it is an image
    figures : heading with unit -> number, by which scenes are ordered: larger is worse, the first counts most
    note : explanation of the figures
    """

    values: NDArray[np.floating[Any]]
    confidence: dict[str, NDArray[Any]] = field(default_factory=dict)
    expected_error: NDArray[np.floating[Any]] | None = None
    axes: tuple[SliceAxis, ...] = ()
    figures: dict[str, float] = field(default_factory=dict)
    note: str = ""


def planes_beside(path: Path, files: MapFiles) -> dict[str, NDArray[Any]]:
    """Return name -> confidence map beside a map; those that cannot be read are left out."""
    found = {}
    for name, file in files.confidences(path).items():
        with contextlib.suppress(InputError):
            found[name] = read_plane(file)
    return found


def _plane(path: Path, scene: Scene, files: MapFiles) -> ShownMap:
    """Return one run's map as stored, with the confidence maps beside it."""
    return ShownMap(read_plane(path), planes_beside(path, files))


def first_image(scene: Scene) -> NDArray[np.uint8] | None:
    """Return the left image of a scene, or its first, (H, W, 3) uint8 RGB; None if it is no picture."""
    try:
        files = scene.input_files
        return color8(read_image(files.get("left") or next(iter(files.values()))))
    except (InputError, StopIteration):
        return None


@dataclass(frozen=True)
class Presentation:
    """How a protocol's tables are worded and its maps are shown; it computes no score.

    Attributes
    ----------
    title : heading of the tables
    unit : of the errors
    note : explanation of the numbers, below the tables
    digits : decimals of the scores
    mean_heading : heading of the means over the scenes
    scene_rows : tables have a row for every scene beside those of the means
    quantity : what a map holds, in a word
    threshold_axis : label of the axis of a plot against the threshold
    error_pictures : a picture of right, wrong and missing pixels is written for every map
    visible_region : name of the region that both views see, outside of which pixels are shown as occluded; or empty
    palette : colors and words of the status map beside a map
    opacity : initial opacity of a map's colors over the scene's image, 0 to 1
    verdicts : words for a pixel that is right, and for one that is wrong
    scale : lowest and highest value of the colors if no truth is known; None: by the map
    show : returns one run's map as it is shown if no truth is known; InputError if it cannot be read
    image : returns the picture of a scene that is shown beneath its maps: (H, W, 3) uint8 RGB, or (Z, Y, X) uint8 grey
        levels of a volume; None if there is none
    on_grid : returns an array of a region's shape as an image or volume, NaN or False where it has no point, given the
        truth; None: the points lie on no grid and cannot be shown
    axes : returns the axes of what is shown if it is a volume, given the truth; empty: it is an image
    at_points : returns whether the truth is known at few points, so that the whole map is shown
    tables : returns further tables of a run, from what the protocol keeps of every scene with a map
    """

    title: str = ""
    unit: str = ""
    note: str = ""
    digits: int = 2
    mean_heading: str = "mean"
    scene_rows: bool = True
    quantity: str = "value"
    threshold_axis: str = "threshold"
    error_pictures: bool = False
    visible_region: str = ""
    palette: Palette = field(default_factory=dict)
    opacity: float = 1.0
    verdicts: tuple[str, str] = ("right", "wrong")
    scale: tuple[float, float] | None = None
    show: Callable[[Path, Scene, MapFiles], ShownMap] = _plane
    image: Callable[[Scene], NDArray[np.uint8] | None] = first_image
    on_grid: Callable[[NDArray[Any], Any], NDArray[Any] | None] = lambda points, _: points if points.ndim > 1 else None
    axes: Callable[[Any], tuple[SliceAxis, ...]] = lambda _: ()
    at_points: Callable[[Any], bool] = lambda _: False
    tables: Callable[[str, Sequence[Any]], list[Table]] = lambda _, __: []

    @property
    def pixel_kind_names(self) -> tuple[str, ...]:
        """Words for the kinds of pixel, ``UNKNOWN`` to ``EMPTY``."""
        right, wrong = self.verdicts
        return ("truth unknown or not evaluated", right, wrong, f"{right}, occluded", f"{wrong}, occluded", "no value")

    @property
    def legend(self) -> str:
        """Colors of the error pictures in words."""
        words = [f"{color}: {kind}" for (color, _), kind in zip(_COLORS, self.pixel_kind_names, strict=True)]
        return "; ".join(words[1:] + words[:1])


_COLORS = (
    ("white", (255, 255, 255)), ("grey", (170, 170, 170)), ("black", (0, 0, 0)), ("light blue", (176, 196, 222)),
    ("dark blue", (40, 70, 130)), ("dark red", (140, 30, 20)),
)  # fmt: skip
"""Name and RGB of every kind of pixel in an error picture."""


def pixel_kinds(
    known: NDArray[np.bool_], hidden: NDArray[np.bool_], wrong: NDArray[np.bool_], missing: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Return the kind of every pixel, ``UNKNOWN`` to ``EMPTY``, as uint8.

    Parameters
    ----------
    known : the truth is known and counts
    hidden : occluded in the other view
    wrong : the value disagrees with the truth
    missing : there is no value
    """
    kind = np.where(wrong, np.where(hidden, HIDDEN_WRONG, WRONG), np.where(hidden, HIDDEN_RIGHT, RIGHT))
    return np.where(known, np.where(missing, EMPTY, kind), UNKNOWN).astype(np.uint8)


def error_picture(kinds: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (H, W) kinds of pixel as (H, W, 3) uint8 RGB; ``Presentation.legend`` says what the colors mean."""
    return np.array([color for _, color in _COLORS], np.uint8)[kinds]
