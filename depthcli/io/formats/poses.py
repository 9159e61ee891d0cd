"""Files of camera poses, one for each frame of a recording."""

from __future__ import annotations

import bisect
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import is_rotation
from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.plain_text import text_of

Pose = tuple[float, ...]
"""The 16 numbers of a (4, 4) matrix, row by row: from the camera's coordinates to the world's, meters."""

_MAX_DELAY = 0.02  # seconds, as in the TUM RGB-D benchmark's associate.py
_TIME_TOLERANCE = 1e-6  # largest rounding error of times, seconds


class Poses(NamedTuple):
    """Poses with sorted times, or in the order of frames if ``times`` is empty."""

    times: list[float]  # seconds, or frame numbers
    matrices: list[NDArray[np.float64]]  # (4, 4)

    def at(self, time: float) -> Pose | None:
        """Return the pose at a time, interpolated between neighbors within 20 ms; None if there are none."""
        limit, after = _MAX_DELAY + _TIME_TOLERANCE, bisect.bisect_left(self.times, time)
        near = [k for k in (after - 1, after) if 0 <= k < len(self.times) and abs(self.times[k] - time) <= limit]
        if not near:
            return None
        one, other = (self.matrices[k] for k in (near[0], near[-1]))
        nearest = min(near, key=lambda k: abs(self.times[k] - time))
        if len(near) == 1 or self.times[nearest] == time:
            return tuple(self.matrices[nearest].ravel().tolist())
        share = (time - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        matrix = (1 - share) * one + share * other
        turn, _ = cv2.Rodrigues(one[:3, :3].T @ other[:3, :3])
        matrix[:3, :3] = one[:3, :3] @ cv2.Rodrigues(share * turn)[0]
        return tuple(matrix.ravel().tolist())

    def of_frames(self, numbers: list[int]) -> dict[int, Pose | None]:
        """Return frame number -> pose, by the times in the file or by order; None if a frame has no pose."""
        if self.times:
            return {number: self.at(number) for number in numbers}
        flat: list[Pose | None] = [tuple(matrix.ravel().tolist()) for matrix in self.matrices]
        return dict(zip(numbers, flat + [None] * len(numbers), strict=False))


def read_poses(path: Path) -> Poses:
    """Return poses from lines ``time tx ty tz qx qy qz qw``, or from 16 numbers per pose, on one line or on four.

    Lines that begin with ``#`` are ignored.
    """
    rows: list[list[float]] = []
    with naming(path):
        for number, line in enumerate(text_of(read_bytes(path)).splitlines(), 1):
            words = line.replace(",", " ").split()
            if not words or words[0].startswith("#"):
                continue
            try:
                values = [float(word) for word in words]
            except ValueError:
                values = []
            length = len(rows[0]) if rows else len(values)
            if len(values) not in (4, 8, 16) or len(values) != length or not np.isfinite(values).all():
                raise InputError(
                    f"line {number}: expected 'time tx ty tz qx qy qz qw', or a 4 x 4 matrix (got {line[:60]!r})"
                )
            rows.append(values)
        if not rows:
            raise InputError("holds no pose")
        if len(rows[0]) == 8:
            rows.sort()
            times = [values[0] for values in rows]
            if len(set(times)) < len(times):
                raise InputError("two poses of one time")
            return Poses(times, [_of_quaternion(values[1:]) for values in rows])
        if len(rows) % (16 // len(rows[0])):
            raise InputError("the last matrix has not 4 rows")
        matrices = np.array(rows).reshape(-1, 4, 4)
        for matrix in matrices:
            pose_of(matrix)
        return Poses([], list(matrices))


def pose_of(matrix: NDArray[np.float64]) -> Pose:
    """Return a (4, 4) matrix as a pose. Raise InputError if it is no pose."""
    if not is_rotation(matrix[:3, :3]) or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise InputError("not the matrix of a pose: expected a rotation, a translation in meters, and 0 0 0 1 below")
    return tuple(matrix.ravel().tolist())


def _of_quaternion(values: list[float]) -> NDArray[np.float64]:
    """Return the (4, 4) pose of a translation and a unit quaternion, x, y, z, qx, qy, qz, qw."""
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1) > 0.01:
        raise InputError(f"the quaternion {values[3:]} (qx qy qz qw) has a length of {length:.3g} instead of 1")
    x, y, z, w = (value / length for value in values[3:])
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = values[:3]
    return matrix
