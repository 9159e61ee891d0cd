"""What the segment-based pipeline tells beside the map: status, figures, tables, pictures."""

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
from depthcli.methods.stereo.segments.scene import Scene


def nothing_known(shape: tuple[int, ...]) -> DisparityMap:
    """The map of a pair in which no pixel could be trusted: no values."""
    return DisparityMap(np.full(shape, np.nan, np.float32), np.full(shape, Status.NO_DATA, np.uint8))


def finished(values: NDArray[np.float32], first: FirstEstimate) -> DisparityMap:
    """The planes' disparities (H, W) with what is known about every pixel.

    Trusted pixels that agree with their plane within a pixel were measured, and smoothed. All others are filled:
    occluded where the plane's partner lies outside the right image or the right view sees something
    nearer there, mismatched otherwise.
    """
    columns = np.arange(values.shape[1])[None] - np.rint(values).astype(np.int64)
    there = np.take_along_axis(first.right, np.clip(columns, 0, values.shape[1] - 1), axis=1)
    hidden = (columns < 0) | (there > values + 1)
    reason = np.where(hidden & ~first.trusted, Status.OCCLUDED, Status.MISMATCH) | Status.FILLED
    agrees = first.trusted & (np.abs(values - first.values) <= 1)
    return DisparityMap(values, np.where(agrees, Status.SMOOTHED, reason).astype(np.uint8))


def figures(scene: Scene, assignment: Assignment | None, matches: Matches | None) -> dict[str, float]:
    """Numbers for the scene's row of the report."""
    return {
        "segments": len(scene.graph.sizes),
        "keypoints": 0 if matches is None else len(matches),
        "trusted": float(scene.first.trusted.mean()),
        "planes": 0 if assignment is None else len(assignment.planes),
        "planes_used": 0 if assignment is None else len(np.unique(assignment.labels)),
        "energy_before": 0.0 if assignment is None else assignment.energy_before,
        "energy": 0.0 if assignment is None else assignment.energy,
    }


def tables(
    scene: Scene, assignment: Assignment | None, matches: Matches | None, ranges: NDArray[np.int32]
) -> dict[str, list[dict[str, Any]]]:
    """Planes, the plane and the search range of every segment, matched key points."""
    result: dict[str, list[dict[str, Any]]] = {}
    if assignment is not None:
        used = np.bincount(assignment.labels, minlength=len(assignment.planes))
        result["planes"] = [
            {"plane": k, "a": float(a), "b": float(b), "c": float(c), "support": int(n), "segments": int(used[k])}
            for k, ((a, b, c), n) in enumerate(
                zip(assignment.planes.coefficients, assignment.planes.support, strict=True)
            )
        ]
        result["segment_labels"] = [
            {
                "segment": t,
                "plane": int(assignment.labels[t]),
                "pixels": int(scene.graph.sizes[t]),
                "trusted": int(scene.trusted.sizes[t]),
                "lowest": int(ranges[t, 0]),
                "highest": int(ranges[t, 1]),
            }
            for t in range(len(scene.graph.sizes))
        ]
    if matches is not None:
        result["keypoints"] = [
            {
                "x": round(float(x), 3),
                "y": round(float(y), 3),
                "disparity": round(float(d), 3),
                "distance": round(float(q), 4),
            }
            for x, y, d, q in zip(matches.x, matches.y, matches.disparity, matches.distance, strict=True)
        ]
    return result


def pictures(pair: StereoPair, labels: NDArray[np.int32], matches: Matches | None) -> dict[str, NDArray[Any]]:
    """Segments as numbers and in colors, and the key points of both images joined by lines."""
    result: dict[str, NDArray[Any]] = {"segments_preview": _colored(labels, pair.color8[0])}
    if labels.max() <= 0xFFFF:
        result["segments"] = labels.astype(np.uint16)
    if matches is not None:
        result["keypoints"] = _lines(pair, matches)
    return result


def _colored(labels: NDArray[np.int32], image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Every segment in its mean color, boundaries in white."""
    flat = labels.ravel()
    sizes = np.maximum(np.bincount(flat), 1)[:, None]
    channels = image.reshape(-1, 3)
    means = np.stack([np.bincount(flat, channels[:, c]) for c in range(3)], axis=1) / sizes
    picture = np.rint(means).astype(np.uint8)[labels]
    picture[:, 1:][labels[:, 1:] != labels[:, :-1]] = 255
    picture[1:][labels[1:] != labels[:-1]] = 255
    return picture


def _lines(pair: StereoPair, matches: Matches) -> NDArray[np.uint8]:
    """Left over right image; a line a match, its color the disparity."""
    left, right = pair.color8
    picture = np.vstack([left, right]) // 2 + 60
    height = left.shape[0]
    top = max(float(matches.disparity.max()) if len(matches) else 1.0, 1.0)
    colors = (
        cv2.applyColorMap(
            np.clip(matches.disparity / top * 255, 0, 255).astype(np.uint8).reshape(-1, 1), cv2.COLORMAP_TURBO
        )
        if len(matches)
        else np.zeros((0, 1, 3), np.uint8)
    )
    for x, y, d, color in zip(matches.x, matches.y, matches.disparity, colors[:, 0, ::-1], strict=True):
        one = round(float(x)), round(float(y))
        other = round(float(x - d)), round(float(y)) + height
        shade = tuple(int(c) for c in color)
        cv2.line(picture, one, other, shade, 1, cv2.LINE_AA)
        cv2.circle(picture, one, 2, shade, -1, cv2.LINE_AA)
        cv2.circle(picture, other, 2, shade, -1, cv2.LINE_AA)
    return picture.astype(np.uint8)
