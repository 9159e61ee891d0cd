"""Poses in recordings of ROS: of messages of one pose, and of trees of transforms (tf)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.poses import Poses

POSE_KINDS = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry", "TFMessage", "tfMessage")
"""Types of messages that hold poses."""

MAX_DELAY = 0.1
"""Seconds that the poses before and after an image may be away, between which its own is interpolated."""

_MAX_DEPTH = 64  # transforms from a frame to the root of its tree
_MAX_NORM_ERROR = 0.01  # of a quaternion
_MAX_PLACE = 1e9  # meters


@dataclass(frozen=True)
class StampedPose:
    """The place of the frame ``child`` in ``parent`` at a time (ns); ``child`` is empty where it is not said."""

    time: int
    parent: str
    child: str
    matrix: NDArray[np.float64]


def poses_in(message: Any, kind: str) -> list[StampedPose]:
    """Return the poses that a message of a kind of ``POSE_KINDS`` holds; InputError for numbers that are no pose."""
    if kind.lower() == "tfmessage":
        return [pose for each in message.transforms for pose in poses_in(each, "TransformStamped")]
    time = nanoseconds(message.header.stamp)
    parent, child = _frame(message.header.frame_id), _frame(getattr(message, "child_frame_id", ""))
    if kind == "TransformStamped":
        return [StampedPose(time, parent, child, transform_matrix(message.transform))]
    pose = message.pose if kind == "PoseStamped" else message.pose.pose
    return [StampedPose(time, parent, child, _matrix(pose.position, pose.orientation))]


def nanoseconds(stamp: Any) -> int:
    """Return a time of ROS 1 or 2 in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def transform_matrix(transform: Any) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a ``geometry_msgs/Transform``; InputError where it is none."""
    return _matrix(transform.translation, transform.rotation)


def _frame(name: Any) -> str:
    return str(name).removeprefix("/")


def _matrix(place: Any, turn: Any) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    quaternion = np.array([turn.x, turn.y, turn.z, turn.w], np.float64)
    matrix = np.eye(4)
    matrix[:3, 3] = (place.x, place.y, place.z)
    if (
        not np.all(np.abs(matrix[:3, 3]) < _MAX_PLACE)
        or not abs(float(np.linalg.norm(quaternion)) - 1) <= _MAX_NORM_ERROR
    ):
        raise InputError(f"no pose: position {matrix[:3, 3].tolist()}, quaternion {quaternion.tolist()}")
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    return matrix


@dataclass
class Track:
    """The places of one frame in another, in time."""

    parent: str
    times: list[int] = field(default_factory=list)
    matrices: list[NDArray[np.float64]] = field(default_factory=list)
    _sorted: Poses | None = None
    _start: int = 0

    def at(self, time: int) -> NDArray[np.float64] | None:
        """Return the place at a time (ns), or None where none is near."""
        if self._sorted is None:
            first = {t: k for k, t in reversed(list(enumerate(self.times)))}  # of several of one time, the first
            order = sorted(first)
            # Seconds since the first one: those since 1970 have 22 bits for the parts of a second.
            self._start = order[0] if order else 0
            seconds = tuple((t - self._start) / 1e9 for t in order)
            self._sorted = Poses(seconds, tuple(self.matrices[first[t]] for t in order))
        pose = self._sorted.at((time - self._start) / 1e9, MAX_DELAY)
        return None if pose is None else np.array(pose).reshape(4, 4)


class Transforms:
    """A tree of frames: fixed ones (``/tf_static``) and moving ones."""

    def __init__(self) -> None:
        self._fixed: dict[str, tuple[str, NDArray[np.float64]]] = {}
        self._moving: dict[str, Track] = {}

    def add_fixed(self, poses: Iterable[StampedPose]) -> None:
        """Add places that hold at all times."""
        self._fixed |= {pose.child: (pose.parent, pose.matrix) for pose in poses}

    def add(self, poses: Iterable[StampedPose]) -> None:
        """Add places at their times."""
        for pose in poses:
            track = self._moving.setdefault(pose.child, Track(pose.parent))
            if track.parent != pose.parent:
                raise InputError(f"the frame {pose.child!r} has two parents, {track.parent!r} and {pose.parent!r}")
            track.times.append(pose.time)
            track.matrices.append(pose.matrix)

    def fixed(self, frame: str, other: str) -> NDArray[np.float64] | None:
        """Return the matrix from the coordinates of ``frame`` to those of ``other`` by fixed places alone, or None."""
        to_root = [self._up(_frame(each)) for each in (frame, other)]
        common = next((name for name in to_root[0] if name in to_root[1]), None)
        return None if common is None else np.linalg.inv(to_root[1][common]) @ to_root[0][common]

    def at(self, frame: str, time: int) -> NDArray[np.float64] | None:
        """Return the place of ``frame`` in the root of its tree at a time (ns).

        None where no frame above it moves, or the place of one is not known at that time.
        """
        place, name, moves = np.eye(4), _frame(frame), False
        for _ in range(_MAX_DEPTH):
            if name in self._moving:
                moved = self._moving[name].at(time)
                if moved is None:
                    return None
                place, name, moves = moved @ place, self._moving[name].parent, True
            elif name in self._fixed:
                parent, matrix = self._fixed[name]
                place, name = matrix @ place, parent
            else:
                return place if moves else None
        return None

    def _up(self, frame: str) -> dict[str, NDArray[np.float64]]:
        """Frame above, or itself -> matrix into its coordinates."""
        above, place = {frame: np.eye(4)}, np.eye(4)
        while frame in self._fixed and len(above) < _MAX_DEPTH:
            frame, matrix = self._fixed[frame]
            place = matrix @ place
            if frame in above:
                break
            above[frame] = place
        return above


def pose_line(number: int, matrix: NDArray[np.float64]) -> str:
    """Return a line ``number tx ty tz qx qy qz qw`` as files of poses have it."""
    from scipy.spatial.transform import Rotation

    values = [*matrix[:3, 3].tolist(), *Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()]
    return " ".join([str(number), *(repr(round(value, 12) + 0.0) for value in values)]) + "\n"
