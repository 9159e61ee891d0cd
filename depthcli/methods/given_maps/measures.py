"""Single measures of the confidence of a map; larger values are surer in every one.

They are planes that the network also gets, with the sign turned where that is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.methods.given_maps._evidence import Evidence
from depthcli.methods.given_maps._planes import ALONE, ONE_VIEW, OTHERS

Plane = NDArray[np.float32]
_MAX_DIFFERENCE = np.float32(16.0)  # pixels


@dataclass(frozen=True)
class Judged:
    """A map and what was found out about it."""

    values: NDArray[np.float32]  # (H, W) float32 disparities without gaps, pixels
    missing: NDArray[np.bool_]  # (H, W) bool, where the map has no value
    # alone, others: planes of the map itself, and of its relation to others, float32 (F, H, W)
    alone: NDArray[np.float32]
    others: NDArray[np.float32]

    def plane(self, name: str) -> Plane:
        """Return one of the planes."""
        plane: Plane = self.alone[ALONE.index(name)] if name in ALONE else self.others[OTHERS.index(name)]
        return plane


def _left_right(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    other = evidence.right.astype(np.float32) if right is None else right
    columns = np.rint(np.arange(judged.values.shape[1], dtype=np.float32) - judged.values).astype(np.int64)
    match = np.take_along_axis(other, columns.clip(0), axis=1)
    difference = np.where((columns < 0) | ~np.isfinite(match), _MAX_DIFFERENCE, np.abs(judged.values - match))
    return np.asarray(-np.minimum(difference, _MAX_DIFFERENCE), np.float32)


def _gradient(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    left, other = (cv2.Sobel(image, cv2.CV_32F, 1, 0) / 8 for image in evidence.grey)
    height, width = judged.values.shape
    rows = np.broadcast_to(np.arange(height, dtype=np.float32)[:, None], judged.values.shape)
    columns = np.arange(width, dtype=np.float32) - judged.values
    warped = cv2.remap(other, columns, np.ascontiguousarray(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(-np.abs(left - warped), np.float32)


def _agreement(judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    if judged.plane("maps").any():
        return np.asarray(1 - judged.plane("disagreement_narrow"), np.float32)
    return np.asarray(1 - judged.plane("other_reference_narrow"), np.float32)


def _plane(name: str, sign: int) -> Callable[[Judged, Evidence, Plane | None], Plane]:
    return lambda judged, evidence, right: np.asarray(sign * judged.plane(name), np.float32)


_OF_ONE_VIEW = {
    "smoothness": ("deviation_of_map_11", -1),
    "texture": ("deviation_5", 1),
    "discontinuity": ("edge_distance", 1),
    "border": ("border_distance", 1),
}
"""Measures that need no right image: plane and sign."""

_MEASURES: dict[str, tuple[str, Callable[[Judged, Evidence, Plane | None], Plane]]] = {
    "left_right": (
        "-|difference from the map of the right view at the match|, pixels; without such a map, from that of the costs",
        _left_right,
    ),
    "census": (
        "-mean census difference of the match over pixels of similar color, 1 from 30 of 48 on",
        _plane("cost_narrow", -1),
    ),
    "zncc": (
        "-(1 - correlation of 7 x 7 pixels with the warped right image)",
        _plane("decorrelation", -1),
    ),
    "gradient": ("-|difference of the gradients along the row|, grey levels", _gradient),
    "rank": ("-share of the disparities whose costs, with smoothness, are smaller", _plane("rank", -1)),
    "margin": ("log(smallest cost elsewhere / cost), with smoothness", _plane("margin", 1)),
    "smoothness": ("-standard deviation of the map in 11 x 11 pixels", _plane(*_OF_ONE_VIEW["smoothness"])),
    "texture": (
        "standard deviation of 5 x 5 pixels of the left image, at most 40 levels",
        _plane(*_OF_ONE_VIEW["texture"]),
    ),
    "discontinuity": (
        "distance to the next step of the map, at most 30 pixels",
        _plane(*_OF_ONE_VIEW["discontinuity"]),
    ),
    "border": ("distance to the border of the image, at most 20 pixels", _plane(*_OF_ONE_VIEW["border"])),
    "agreement": (
        "share of the witnesses that agree, over pixels of similar color; without any, agreement with stereo fast",
        _agreement,
    ),
}


def map_measures() -> dict[str, str]:
    """Return the name of every measure and one line about it."""
    return {name: line for name, (line, _) in _MEASURES.items()}


def measure_name(name: str) -> str:
    """Return the name; ValueError where there is no such measure."""
    if name not in _MEASURES:
        raise ValueError(f"no measure called {name!r}; one of: {', '.join(_MEASURES)}")
    return name


def measured(name: str, judged: Judged, evidence: Evidence, right: Plane | None) -> Plane:
    """Return a measure as (H, W) float32, NaN where the map has no value.

    Parameters
    ----------
    right : (H, W) float32, the right view's map by the same program; None: there is none
    """
    values = _MEASURES[name][1](judged, evidence, right)
    return np.where(judged.missing, np.float32(np.nan), values).astype(np.float32)


def measured_in_one_view(name: str, planes: NDArray[np.float32], missing: NDArray[np.bool_]) -> Plane | None:
    """Return a measure as :func:`measured` does, where there is no right image; None for one that needs it.

    Parameters
    ----------
    planes : ``ONE_VIEW``, (F, H, W) float32
    missing : (H, W) bool, where the map has no value
    """
    if name not in _OF_ONE_VIEW:
        return None
    plane, sign = _OF_ONE_VIEW[name]
    return np.where(missing, np.float32(np.nan), sign * planes[ONE_VIEW.index(plane)]).astype(np.float32)
