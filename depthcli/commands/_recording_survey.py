"""What a recording says beside the pixels of its images: their times, the cameras, poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from depthcli.commands._recorded_topics import FrameTopics, info_topic
from depthcli.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.io.formats.recordings import Message, Recording
    from depthcli.io.formats.ros_cameras import CameraInfo
    from depthcli.io.formats.ros_poses import Track, Transforms

_FIXED = "/tf_static"
_MAX_PROBLEMS = 3  # damaged messages that warnings describe
_UNITS = ("Depth_Units", "Depth Units")
_BASELINE = ("Stereo_Baseline", "Stereo Baseline")


@dataclass
class Stream:
    """The messages of one image topic.

    Attributes
    ----------
    stamps : time of each, nanoseconds, by the camera's clock; None of a damaged one
    recorded : the same by the recorder's clock
    frame : name of the camera's coordinates
    info : its camera, or None where nothing says it
    """

    stamps: list[int | None] = field(default_factory=list)
    recorded: list[int] = field(default_factory=list)
    frame: str = ""
    info: CameraInfo | None = None


@dataclass
class Survey:
    """What a recording says beside its images.

    Attributes
    ----------
    streams : role -> messages of its topic
    transforms, track : places of frames, and those of one frame, whose name is ``tracked`` or empty
    places : role -> (4, 4) from the coordinates of the sensor to those of the camera, as librealsense has it
    depth_unit, baseline : meters a code, and meters, as librealsense has them; or None
    problems : what is damaged, or contradicts itself, one line each
    n_damaged : number of damaged messages
    by_recorder : the times are those of the recorder, as the messages have none
    """

    streams: dict[str, Stream]
    transforms: Transforms
    track: Track | None = None
    tracked: str = ""
    places: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    depth_unit: float | None = None
    baseline: float | None = None
    problems: list[str] = field(default_factory=list)
    n_damaged: int = 0
    by_recorder: bool = False

    def damaged(self, text: str) -> None:
        """Count a damaged message; the first ones are described."""
        self.n_damaged += 1
        if self.n_damaged <= _MAX_PROBLEMS:
            self.problems.append(text)


def survey(recording: Recording, topics: FrameTopics) -> Survey:
    """Read the times of all images, and what the recording says of cameras and poses.

    A recording that is damaged somewhere is read up to there.
    """
    from depthcli.io.formats.ros_poses import Transforms

    found = Survey({role: Stream() for role in topics.images}, Transforms())
    readers: dict[str, list[Callable[[Message], None]]] = {}

    def add(topic: str, read: Callable[[Message], None]) -> None:
        readers.setdefault(topic, []).append(read)

    for name in recording.topics:
        if reader := _constant_reader(name, recording, found):
            add(name, reader)
    if topics.pose:
        add(topics.pose, partial(_read_poses, recording, found))
    for role, name in topics.images.items():
        add(name, partial(_read_stamp, recording, found.streams[role]))
        add(info_topic(name), partial(_read_info, recording, found.streams[role]))
        for place in _extrinsic_topics(recording, name):
            add(place, partial(_read_place, recording, found, role))
    try:
        for message in recording.messages(readers):
            for read in readers[message.topic]:
                try:
                    read(message)
                except InputError as error:
                    found.damaged(f"{message.topic}: {error}")
    except InputError as error:
        found.damaged(f"the recording is used up to where it is {error}")
    if any(stamp == 0 for stream in found.streams.values() for stamp in stream.stamps):
        found.by_recorder = True
    return found


def _read_stamp(recording: Recording, stream: Stream, message: Message) -> None:
    from depthcli.io.formats.ros_poses import nanoseconds

    stream.recorded.append(message.time)
    stream.stamps.append(None)
    stamp, frame = recording.read(message, lambda image: (nanoseconds(image.header.stamp), str(image.header.frame_id)))
    stream.stamps[-1], stream.frame = stamp, stream.frame or frame


def _read_info(recording: Recording, stream: Stream, message: Message) -> None:
    from depthcli.io.formats.ros_cameras import camera_info

    info = recording.read(message, camera_info)
    if stream.info is None:
        stream.info = info
    elif not info.same_camera(stream.info):
        raise InputError("the camera changes; the first one counts")


def _read_poses(recording: Recording, found: Survey, message: Message) -> None:
    from depthcli.io.formats.ros_poses import Track, poses_in

    kind = message.kind.rpartition("/")[2]
    poses = recording.read(message, partial(poses_in, kind=kind))
    if kind.lower() == "tfmessage":
        found.transforms.add(poses)
        return
    found.track = found.track or Track(poses[0].parent)
    if poses[0].parent != found.track.parent:
        raise InputError(f"poses in {poses[0].parent!r}, those before are in {found.track.parent!r}")
    found.tracked = poses[0].child
    found.track.times += [pose.time for pose in poses]
    found.track.matrices += [pose.matrix for pose in poses]


def _read_place(recording: Recording, found: Survey, role: str, message: Message) -> None:
    from depthcli.io.formats.ros_poses import transform_matrix

    found.places.setdefault(role, recording.read(message, transform_matrix))


def _constant_reader(name: str, recording: Recording, found: Survey) -> Callable[[Message], None] | None:
    """Return what reads a topic that all recordings may have: fixed transforms, and librealsense's options."""
    from depthcli.io.formats.ros_poses import poses_in

    if name == _FIXED:
        fixed = partial(poses_in, kind="TFMessage")
        return lambda message: found.transforms.add_fixed(recording.read(message, fixed))
    option = name.removesuffix("/value").rpartition("/")[2] if name.endswith("/value") and "/option/" in name else ""

    def unit(message: Message) -> None:
        found.depth_unit = _positive(recording, message)

    def baseline(message: Message) -> None:
        found.baseline = _positive(recording, message) / 1000  # it is in millimeters

    return unit if option in _UNITS else baseline if option in _BASELINE else None


def _positive(recording: Recording, message: Message) -> float:
    value = recording.read(message, lambda option: float(option.data))
    if not 0 < value < 1e6:
        raise InputError(f"want a positive number (got {value:g})")
    return float(f"{value:.6g}")  # of 32 bit


def _extrinsic_topics(recording: Recording, topic: str) -> list[str]:
    start = topic.removesuffix("/image/data") + "/tf/"
    return [name for name in recording.topics if topic.endswith("/image/data") and name.startswith(start)]
