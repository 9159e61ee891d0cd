"""The topics of a recording that frames are made of: those that are named, or the only pair that there is."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.text import one_line

if TYPE_CHECKING:
    from depthcli.io.formats.recordings import Topic

_IMAGES = ("Image", "CompressedImage")
_TRANSPORTS = ("/compressed", "/compressedDepth")
_MAX_NAMED = 12  # topics that a message names

# What a left camera's topic is called, and its right one's.
_SIDES = (
    ("left", "right"), ("Left", "Right"), ("infra1", "infra2"), ("Infrared_1", "Infrared_2"), ("cam0", "cam1"),
    ("camera0", "camera1"),
)  # fmt: skip
_DEPTH = re.compile(r"depth", re.IGNORECASE)
_COLOR = re.compile(r"colou?r|rgb", re.IGNORECASE)
_NO_COLOR = re.compile(r"left|right|infra|(^|[/_])ir[/_]", re.IGNORECASE)


@dataclass(frozen=True)
class FrameTopics:
    """Topics of the images of frames, by role: ``left`` and ``right``, or ``depth``, with ``color`` or without.

    Attributes
    ----------
    images : role -> topic; the first one is that whose frames are numbered
    pose : topic of the poses, or empty
    """

    images: dict[str, str]
    pose: str = ""

    @property
    def is_stereo(self) -> bool:
        """True for the two views of a pair."""
        return "left" in self.images

    @property
    def is_depth_alone(self) -> bool:
        """True for depth maps without color."""
        return list(self.images) == ["depth"]


def check_roles(given: Mapping[str, str | None]) -> None:
    """Raise ConfigError where the topics that are named, by role, make no frames."""
    stereo = [role for role in ("left", "right") if given[role]]
    depth = [role for role in ("color", "depth") if given[role]]
    if stereo and depth:
        raise ConfigError(
            "frames are pairs (--left-topic, --right-topic) or color and depth (--color-topic, --depth-topic): extract "
            "both one after the other, into two folders"
        )
    if len(stereo) == 1:
        raise ConfigError("--left-topic and --right-topic belong together")
    if depth == ["color"]:
        raise ConfigError("--color-topic wants --depth-topic beside it")


def choose_topics(topics: Mapping[str, Topic], given: Mapping[str, str | None]) -> FrameTopics:
    """Return the topics that are ``given`` by role, or else the only pair of image topics that there is.

    Raises
    ------
    InputError
        A topic is not there, is none of images or poses, or holds no message; or it is not clear which to take.
    """
    from depthcli.io.formats.ros_poses import POSE_KINDS

    for role, name in given.items():
        if name:
            _check(topics, role, name, POSE_KINDS if role == "pose" else _IMAGES)
    images = {role: name for role in ("left", "right", "color", "depth") if (name := given[role])}
    if len(set(images.values())) < len(images):
        first, second = images
        raise InputError(f"--{first}-topic and --{second}-topic are both {next(iter(images.values()))}")
    return FrameTopics(images or _only_pair(topics), given["pose"] or "")


def base_of(topic: str) -> str:
    """Return the topic without the name of its compression."""
    return next((topic.removesuffix(end) for end in _TRANSPORTS if topic.endswith(end)), topic)


def info_topic(topic: str) -> str:
    """Return the topic of an image topic's ``CameraInfo``: beside it, by the conventions of ROS and librealsense."""
    parent, _, last = base_of(topic).rpartition("/")
    if last == "data" and parent.endswith("/image"):
        return f"{parent.removesuffix('/image')}/info/camera_info"
    return f"{parent}/camera_info"


def is_rectified(topic: str) -> bool:
    """Return whether a topic says that its images are rectified: ``image_rect``, ``image_rect_color``."""
    return "rect" in base_of(topic).rpartition("/")[2]


def _check(topics: Mapping[str, Topic], role: str, name: str, kinds: tuple[str, ...]) -> None:
    if name not in topics:
        fitting = [topic.name for topic in topics.values() if topic.kind in kinds]
        raise InputError(f"no topic {one_line(name)!r} for --{role}-topic; there are: {_named(fitting)}")
    if topics[name].kind not in kinds:
        raise InputError(f"{name}: holds {topics[name].kind}, --{role}-topic wants {', '.join(kinds)}")
    if not topics[name].count:
        raise InputError(f"{name}: holds no message")


def _only_pair(topics: Mapping[str, Topic]) -> dict[str, str]:
    images = {name for name, topic in topics.items() if topic.kind in _IMAGES and topic.count}
    plain = {name for name in images if base_of(name) == name}
    images -= {name for name in images - plain if base_of(name) in plain}  # stored twice: as it is, and compressed
    pairs = [
        {"left": left, "right": right}
        for left in sorted(images)
        if (right := next((r for one, two in _SIDES if (r := left.replace(one, two)) != left and r in images), None))
    ]
    depths = [name for name in sorted(images) if _DEPTH.search(name)]
    colors = [n for n in sorted(images) if _COLOR.search(n) and not _DEPTH.search(n) and not _NO_COLOR.search(n)]
    pairs += [{"color": color, "depth": depth} for color in colors for depth in depths]
    if len(pairs) == 1:
        return pairs[0]
    found = (
        f"several pairs of topics: {_named(sorted(images))}" if pairs else f"images are in: {_named(sorted(images))}"
    )
    raise InputError(
        f"it is not clear which topics to take; name --left-topic and --right-topic, or --depth-topic, with "
        f"--color-topic or without ({found})"
    )


def _named(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return f"{', '.join(one_line(name) for name in names[:_MAX_NAMED]) or 'none'}{more}"
