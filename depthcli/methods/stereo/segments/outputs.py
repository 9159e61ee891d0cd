"""Outputs of the segment-based pipeline: the map with its status, and figures, tables and pictures beside it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.stereo.keypoint_matching import Matches
from depthcli.methods.stereo.segments.assignment import Assignment
from depthcli.methods.stereo.segments.first_estimate import FirstEstimate
from depthcli.methods.stereo.segments.segmented_image import SegmentedImage


def empty_map(shape: tuple[int, ...]) -> DisparityMap:
    """Return the map of a pair without any trusted pixel: no values."""
    return DisparityMap(np.full(shape, np.nan, np.float32), np.full(shape, Status.NO_DATA, np.uint8))


def map_with_status(values: NDArray[np.float32], first: FirstEstimate) -> DisparityMap:
    """Return the disparities (H, W) of planes with the status of every pixel.

    Trusted pixels within a pixel of their plane are smoothed measurements. All others are filled: occluded where the
    plane's match lies outside the right image or the right view has a larger disparity there, mismatched otherwise.
    """
    columns = np.arange(values.shape[1])[None] - np.rint(values).astype(np.int64)
    right = np.take_along_axis(first.right, np.clip(columns, 0, values.shape[1] - 1), axis=1)
    hidden = (columns < 0) | (right > values + 1)
    reason = np.where(hidden & ~first.trusted, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    agrees = first.trusted & (np.abs(values - first.values) <= 1)
    return DisparityMap(values, np.where(agrees, Status.SMOOTHED, reason).astype(np.uint8))


def figures(segments: SegmentedImage, assignment: Assignment | None, matches: Matches | None) -> dict[str, float]:
    """Return numbers for the scene's row of the report."""
    return {
        "segments": len(segments.graph.sizes),
        "keypoints": 0 if matches is None else len(matches),
        "trusted": float(segments.first.trusted.mean()),
        "planes": 0 if assignment is None else len(assignment.planes),
        "planes_used": 0 if assignment is None else len(np.unique(assignment.labels)),
        "energy_before": 0.0 if assignment is None else assignment.energy_before,
        "energy": 0.0 if assignment is None else assignment.energy,
    }


def tables(
    segments: SegmentedImage, assignment: Assignment | None, matches: Matches | None, ranges: NDArray[np.int32]
) -> dict[str, list[dict[str, Any]]]:
    """Return tables of the planes, of the segments with their plane and search range, and of the matched key points."""
    result: dict[str, list[dict[str, Any]]] = {}
    if assignment is not None:
        used = np.bincount(assignment.labels, minlength=len(assignment.planes))
        result["planes"] = [
            {"plane": k, "a": float(a), "b": float(b), "c": float(c), "support": int(n), "segments": int(used[k])}
            for k, ((a, b, c), n) in enumerate(
                zip(assignment.planes.coefficients, assignment.planes.support, strict=True)
            )
        ]
        columns: dict[str, NDArray[Any]] = {
            "plane": assignment.labels,
            "pixels": segments.graph.sizes,
            "trusted": segments.trusted.sizes,
            "lowest": ranges[:, 0],
            "highest": ranges[:, 1],
        }
        result["segment_labels"] = [
            {"segment": t, **{name: int(column[t]) for name, column in columns.items()}}
            for t in range(len(segments.graph.sizes))
        ]
    if matches is not None:
        digits = {"x": 3, "y": 3, "disparity": 3, "distance": 4}
        result["keypoints"] = [
            {name: round(float(getattr(matches, name)[k]), n) for name, n in digits.items()}
            for k in range(len(matches))
        ]
    return result


def pictures(pair: StereoPair, labels: NDArray[np.int32], matches: Matches | None) -> dict[str, NDArray[Any]]:
    """Return the segments as numbers and in colors, and the matched key points of both images joined by lines."""
    result: dict[str, NDArray[Any]] = {"segments_preview": _colored(labels, pair.color8[0])}
    if labels.max() <= 0xFFFF:
        result["segments"] = labels.astype(np.uint16)
    if matches is not None:
        result["keypoints"] = _lines(pair, matches)
    return result


def _colored(labels: NDArray[np.int32], image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # Every segment in its mean color, boundaries in white.
    flat = labels.ravel()
    sizes = np.maximum(np.bincount(flat), 1)[:, None]
    channels = image.reshape(-1, 3)
    means = np.stack([np.bincount(flat, channels[:, c]) for c in range(3)], axis=1) / sizes
    picture = np.rint(means).astype(np.uint8)[labels]
    picture[:, 1:][labels[:, 1:] != labels[:, :-1]] = 255
    picture[1:][labels[1:] != labels[:-1]] = 255
    return picture


def _lines(pair: StereoPair, matches: Matches) -> NDArray[np.uint8]:
    # The left image above the right one; a line for every match, its color shows the disparity.
    left, right = pair.color8
    picture = np.vstack([left, right]) // 2 + 60
    height = left.shape[0]
    top = max(float(matches.disparity.max()) if len(matches) else 1.0, 1.0)
    palette = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO).reshape(256, 3)[:, ::-1].tolist()
    for x, y, d in zip(matches.x, matches.y, matches.disparity, strict=True):
        color = palette[int(np.clip(d / top * 255, 0, 255))]
        ends = (round(float(x)), round(float(y))), (round(float(x - d)), round(float(y)) + height)
        cv2.line(picture, *ends, color, 1, cv2.LINE_AA)
        for end in ends:
            cv2.circle(picture, end, 2, color, -1, cv2.LINE_AA)
    return picture.astype(np.uint8)
