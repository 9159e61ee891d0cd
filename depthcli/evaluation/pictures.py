"""Pictures of where a disparity map is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEGEND = {
    "right": (170, 170, 170),
    "wrong": (0, 0, 0),
    "no value": (140, 30, 20),
    "right, occluded": (176, 196, 222),
    "wrong, occluded": (40, 70, 130),
    "truth unknown or not evaluated": (255, 255, 255),
}
"""RGB color of every kind of pixel."""

LEGEND_TEXT = (
    "grey: right; black: wrong; dark red: no value; light blue: right, occluded; "
    "dark blue: wrong, occluded; white: truth unknown or not evaluated"
)
"""The same in words."""


def error_picture(
    estimate: NDArray[np.float32],
    wrong: NDArray[np.bool_],
    evaluate: NDArray[np.bool_],
    visible: NDArray[np.bool_] | None = None,
) -> NDArray[np.uint8]:
    """Color every pixel by :data:`LEGEND`: grey right, black wrong, blue tint where occluded.

    Parameters
    ----------
    estimate : (H, W) float32, NaN = none
    wrong : (H, W) bool, the value disagrees with the truth
    evaluate : (H, W) bool, the truth is known and counts
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
        np.copyto(kind, np.uint8(names.index(name)), where=pixels & evaluate)
    return np.array(list(LEGEND.values()), np.uint8)[kind]
