"""How the numbers and maps of a protocol are shown: words and units of tables, hints for the viewer, error pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import color8
from depthcli.data.formats.images import read_image
from depthcli.data.formats.pictures import Palette
from depthcli.data.scenes import Scene
from depthcli.evaluation.render import Table


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
    legend : colors of :func:`error_picture` in words; empty: no error pictures are written
    visible_region : name of the region that both views see, outside of which pixels are shown as occluded; or empty
    palette : colors and words of the status map beside a map
    opacity : initial opacity of a map's colors over the scene's image, 0 to 1
    verdicts : words for a pixel that is right, and for one that is wrong
    """

    title: str = ""
    unit: str = ""
    note: str = ""
    digits: int = 2
    mean_heading: str = "mean"
    scene_rows: bool = True
    quantity: str = "value"
    threshold_axis: str = "threshold"
    legend: str = ""
    visible_region: str = ""
    palette: Palette = field(default_factory=dict)
    opacity: float = 1.0
    verdicts: tuple[str, str] = ("right", "wrong")

    def tables(self, run: str, kept: Sequence[Any]) -> list[Table]:
        """Return further tables of a run, from what the protocol keeps of every scene with a map."""
        return []

    def on_grid(self, points: NDArray[Any], truth: Any) -> NDArray[Any] | None:
        """Return an array of a region's shape as an image or volume, NaN or False where it has no point.

        None: the points lie on no grid and cannot be shown.
        """
        return points if points.ndim > 1 else None

    def spacing(self, truth: Any) -> tuple[float, ...] | None:
        """Return the size of a pixel or voxel along every axis of what is shown; None: all sizes are equal."""
        return None

    def image(self, scene: Scene) -> NDArray[np.uint8] | None:
        """Return the first input file of a scene, to be shown beneath its maps; None where it is no picture.

        Returns
        -------
        (H, W, 3) uint8 RGB, or (Z, Y, X) uint8 grey levels of a volume, or None
        """
        try:
            return color8(read_image(next(iter(scene.input_files.values()))))
        except (InputError, StopIteration):
            return None


LEGEND = {
    "right": (170, 170, 170),
    "wrong": (0, 0, 0),
    "no value": (140, 30, 20),
    "right, occluded": (176, 196, 222),
    "wrong, occluded": (40, 70, 130),
    "truth unknown or not evaluated": (255, 255, 255),
}
"""RGB color of every kind of pixel in an error picture."""

LEGEND_TEXT = (
    "grey: right; black: wrong; dark red: no value; light blue: right, occluded; "
    "dark blue: wrong, occluded; white: truth unknown or not evaluated"
)
"""``LEGEND`` in words."""


def error_picture(
    estimate: NDArray[np.floating[Any]],
    wrong: NDArray[np.bool_],
    evaluated: NDArray[np.bool_],
    visible: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Color every pixel by :data:`LEGEND`: grey right, black wrong, blue tint where occluded.

    Parameters
    ----------
    estimate : (H, W) float, NaN = none
    wrong : (H, W) bool, the value disagrees with the truth
    evaluated : (H, W) bool, the truth is known and counts
    visible : (H, W) bool, not occluded; None where that is not known

    Returns
    -------
    (H, W, 3) uint8 RGB
    """
    names = list(LEGEND)
    kind = np.full(wrong.shape, names.index("truth unknown or not evaluated"), np.uint8)
    hidden = np.zeros_like(wrong) if visible is None else ~visible
    for name, pixels in (
        ("right", ~wrong & ~hidden), ("wrong", wrong & ~hidden), ("right, occluded", ~wrong & hidden),
        ("wrong, occluded", wrong & hidden), ("no value", np.isnan(estimate)),
    ):  # fmt: skip
        np.copyto(kind, np.uint8(names.index(name)), where=pixels & evaluated)
    return np.array(list(LEGEND.values()), np.uint8)[kind]
