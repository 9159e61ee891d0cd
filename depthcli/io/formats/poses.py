"""Files of camera poses: where the camera was for each frame of a recording."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import is_rotation
from depthcli.core.errors import InputError
from depthcli.io.formats.files import read_bytes

Pose = tuple[float, ...]
"""The 16 numbers of a (4, 4) matrix, row by row: from the camera's coordinates to the world's, meters."""

MAX_SINGLE_DELAY = 0.02  # seconds, as of the TUM RGB-D benchmark's associate.py
_NO_POSE = "not the matrix of a pose: want a rotation, a translation in meters, and 0 0 0 1 below"
_TIME_TOLERANCE = 1e-6  # seconds by which times differ that were rounded


@dataclass(frozen=True)
class Poses:
    """The poses in a file.

    Attributes
    ----------
    times : in order; seconds or numbers of frames. Empty where the poses are in the order of the frames
    matrices : as many (4, 4) float64
    """

    times: tuple[float, ...]
    matrices: tuple[NDArray[np.float64], ...]

    def at(self, time: float, max_delay: float = MAX_SINGLE_DELAY) -> Pose | None:
        """Return the pose at a time, interpolated between the two beside it; None where none is near.

        Where not both are at most ``max_delay`` (seconds) away, one that is at most 20 ms away counts as it is.
        """
        after = bisect.bisect_left(self.times, time)
        if after < len(self.times) and self.times[after] == time:
            return _flat(self.matrices[after])
        if 0 < after < len(self.times):
            start, end = self.times[after - 1], self.times[after]
            if max(time - start, end - time) <= max_delay + _TIME_TOLERANCE:
                return _flat(_between(self.matrices[after - 1], self.matrices[after], (time - start) / (end - start)))
        near = [k for k in (after - 1, after) if 0 <= k < len(self.times)]
        nearest = min(near, key=lambda k: abs(self.times[k] - time), default=None)
        if nearest is None or abs(self.times[nearest] - time) > min(max_delay, MAX_SINGLE_DELAY) + _TIME_TOLERANCE:
            return None
        return _flat(self.matrices[nearest])

    def of_frames(self, numbers: list[int]) -> dict[int, Pose | None]:
        """Return frame number -> pose, by the numbers in the file, or in their order; None after the last one."""
        if self.times:
            return {number: self.at(number) for number in numbers}
        flat: list[Pose | None] = [_flat(matrix) for matrix in self.matrices]
        return dict(zip(numbers, flat + [None] * len(numbers), strict=False))


def read_poses(path: Path) -> Poses:
    """Read poses: lines ``time tx ty tz qx qy qz qw``, or 16 numbers a pose, on one line or on four.

    Lines that begin with ``#`` are passed over.

    Raises
    ------
    InputError
        A line that is neither, numbers that are no pose, or two poses of one time.
    """
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(read_bytes(path).decode("utf-8", "replace").splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if (
            len(values) not in (4, 8, 16)
            or not np.isfinite(values).all()
            or len(values) != len((rows or [(0, values)])[0][1])
        ):
            raise InputError(
                f"{path}:{number}: want 'time tx ty tz qx qy qz qw', or a matrix of 4 x 4 numbers (got {line[:60]!r})"
            )
        rows.append((number, values))
    if not rows:
        raise InputError(f"{path}: holds no pose")
    if len(rows[0][1]) == 8:
        timed = sorted(((values[0], _of_quaternion(path, number, values[1:])) for number, values in rows), key=_time)
        times = tuple(time for time, _ in timed)
        if len(set(times)) < len(times):
            raise InputError(f"{path}: has two poses of one time")
        return Poses(times, tuple(matrix for _, matrix in timed))
    whole = 16 // len(rows[0][1])  # lines a pose
    if len(rows) % whole:
        raise InputError(f"{path}:{rows[-1][0]}: the last matrix has {len(rows) % whole} rows instead of 4")
    matrices = [np.array([row for _, row in rows[k : k + whole]]).reshape(4, 4) for k in range(0, len(rows), whole)]
    for k, matrix in enumerate(matrices):
        if not is_rotation(matrix[:3, :3]) or not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise InputError(f"{path}:{rows[k * whole][0]}: {_NO_POSE}")
    return Poses((), tuple(matrices))


def pose_of(matrix: NDArray[np.float64]) -> Pose:
    """Return a (4, 4) matrix as a pose; InputError where it is none."""
    if not is_rotation(matrix[:3, :3]) or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise InputError(_NO_POSE)
    return _flat(matrix)


def _time(row: tuple[float, NDArray[np.float64]]) -> float:
    return row[0]


def _of_quaternion(path: Path, line: int, values: list[float]) -> NDArray[np.float64]:
    x, y, z, w = values[3:]
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1) > 0.01:
        raise InputError(f"{path}:{line}: the quaternion qx qy qz qw has a length of {length:.3g} instead of 1")
    x, y, z, w = x / length, y / length, z / length, w / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = values[:3]
    return matrix


def _between(one: NDArray[np.float64], other: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    import cv2

    matrix = (1 - share) * one + share * other
    turn, _ = cv2.Rodrigues(one[:3, :3].T @ other[:3, :3])
    matrix[:3, :3] = one[:3, :3] @ cv2.Rodrigues(share * turn)[0]
    return matrix


def _flat(matrix: NDArray[np.float64]) -> Pose:
    return tuple(matrix.ravel().tolist())
