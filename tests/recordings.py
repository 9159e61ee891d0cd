"""Recordings of ROS that tests write, by the library that reads them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FORMATS = ("bag", "mcap", "db3")
START = 1_700_000_000_000_000_000  # nanoseconds


class Record(NamedTuple):
    """A message to write: topic, time in nanoseconds, and the message."""

    topic: str
    time: int
    message: Any


@cache
def store(ros: int) -> Any:
    """The types of ROS 1 or 2."""
    if ros == 2:
        return get_typestore(Stores.ROS2_HUMBLE)
    found = get_typestore(Stores.ROS1_NOETIC)
    found.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return found


class Messages:
    """Makes messages of ROS 1 or 2, by the ending of the recording that they are for."""

    def __init__(self, kind: str) -> None:
        self.ros = 1 if kind == "bag" else 2
        self.types = store(self.ros).types

    def make(self, name: str, **fields: Any) -> Any:
        return self.types[name.replace("/", "/msg/")](**fields)

    def header(self, time: int, frame: str = "camera") -> Any:
        stamp = self.make("builtin_interfaces/Time", sec=time // 10**9, nanosec=time % 10**9)
        more = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/Header", stamp=stamp, frame_id=frame, **more)

    def image(
        self, pixels: NDArray[Any], encoding: str, time: int = START, frame: str = "camera", padding: int = 0
    ) -> Any:
        row = pixels.dtype.itemsize * int(np.prod(pixels.shape[1:]))
        data = np.frombuffer(pixels.tobytes(), np.uint8).reshape(pixels.shape[0], row)
        data = np.pad(data, ((0, 0), (0, padding)), constant_values=7)
        big = pixels.dtype.byteorder == ">"
        return self.make(
            "sensor_msgs/Image", header=self.header(time, frame), height=pixels.shape[0], width=pixels.shape[1],
            encoding=encoding, is_bigendian=int(big), step=data.shape[1], data=data.ravel(),
        )  # fmt: skip

    def compressed(self, data: bytes, form: str, time: int = START, frame: str = "camera") -> Any:
        pixels = np.frombuffer(data, np.uint8)
        return self.make("sensor_msgs/CompressedImage", header=self.header(time, frame), format=form, data=pixels)

    def info(
        self,
        size: tuple[int, int],
        matrix: Any,
        projection: Any = None,
        rotation: Any = None,
        distortion: Sequence[float] = (0, 0, 0, 0, 0),
        model: str = "plumb_bob",
        frame: str = "camera",
        **more: Any,
    ) -> Any:
        k = np.asarray(matrix, float).reshape(3, 3)
        p = np.hstack([k, np.zeros((3, 1))]) if projection is None else np.asarray(projection, float)
        r = np.eye(3) if rotation is None else np.asarray(rotation, float)
        names = ("K", "R", "P", "D") if self.ros == 1 else ("k", "r", "p", "d")
        values = (k.ravel(), r.ravel(), p.ravel(), np.array(distortion, float))
        region = self.make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.make(
            "sensor_msgs/CameraInfo",
            **{"header": self.header(START, frame), "height": size[1], "width": size[0], "distortion_model": model,
               **dict(zip(names, values, strict=True)), "binning_x": 0, "binning_y": 0, "roi": region} | more,
        )  # fmt: skip

    def pose(self, place: Sequence[float], turn: Sequence[float]) -> Any:
        """A ``geometry_msgs/Pose``; the turn is a quaternion x y z w."""
        return self.make(
            "geometry_msgs/Pose",
            position=self.make("geometry_msgs/Point", **dict(zip("xyz", place, strict=True))),
            orientation=self.make("geometry_msgs/Quaternion", **dict(zip("xyzw", turn, strict=True))),
        )

    def pose_stamped(self, time: int, place: Sequence[float], turn: Sequence[float] = (0, 0, 0, 1)) -> Any:
        return self.make(
            "geometry_msgs/PoseStamped", header=self.header(time, "world"), pose=self.pose(place, turn)
        )  # fmt: skip

    def odometry(self, time: int, child: str, place: Sequence[float], turn: Sequence[float] = (0, 0, 0, 1)) -> Any:
        zero = self.make("geometry_msgs/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/Twist", linear=zero, angular=zero)
        return self.make(
            "nav_msgs/Odometry", header=self.header(time, "odom"), child_frame_id=child,
            pose=self.make("geometry_msgs/PoseWithCovariance", pose=self.pose(place, turn), covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip

    def transform(self, place: Sequence[float], turn: Sequence[float] = (0, 0, 0, 1)) -> Any:
        return self.make(
            "geometry_msgs/Transform",
            translation=self.make("geometry_msgs/Vector3", **dict(zip("xyz", place, strict=True))),
            rotation=self.make("geometry_msgs/Quaternion", **dict(zip("xyzw", turn, strict=True))),
        )

    def tf(
        self, time: int, *edges: tuple[str, str, Sequence[float]] | tuple[str, str, Sequence[float], Sequence[float]]
    ) -> Any:
        """A ``TFMessage`` of (parent, child, place) or (parent, child, place, turn)."""
        return self.make(
            "tf2_msgs/TFMessage",
            transforms=[
                self.make(
                    "geometry_msgs/TransformStamped", header=self.header(time, parent), child_frame_id=child,
                    transform=self.transform(*place),
                )
                for parent, child, *place in edges
            ],
        )  # fmt: skip


def write_recording(path: Path, records: Sequence[Record]) -> Path:
    """Write a recording in the order of its times; its ending says which kind, return where it lies.

    That of ROS 2 is the file in a folder of the name without ending, of which the folder is returned.
    """
    kind = path.suffix[1:]
    types = store(1 if kind == "bag" else 2)
    if kind == "bag":
        writer: Any = Ros1Writer(path)
    else:
        path = path.with_suffix("")
        writer = Ros2Writer(
            path, version=9, storage_plugin={"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}[kind]
        )
    with writer:
        topics: dict[str, Any] = {}
        for record in sorted(records, key=lambda each: each.time):
            name = record.message.__msgtype__
            if record.topic not in topics:
                topics[record.topic] = writer.add_connection(record.topic, name, typestore=types)
            serialize = types.serialize_ros1 if kind == "bag" else types.serialize_cdr
            writer.write(topics[record.topic], record.time, serialize(record.message, name))
    return path
