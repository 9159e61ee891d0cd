"""Frames of a recording: which messages belong together, and their images as files.

The recording is read twice: for the times of all messages, and for the images of those that belong together. No more
than one image is in memory at a time, and which frames there are does not depend on the order of the messages.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.commands._recorded_topics import FrameTopics
from depthcli.commands._recording_survey import Survey
from depthcli.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.io.formats.recordings import Message, Recording

_MIN_DIGITS = 6  # of the number of a frame


def nearest_pairs(first: Iterable[int], second: Iterable[int], tolerance: int) -> list[tuple[int, int]]:
    """Return the pairs of places in two lists of times, each of which is nearest to the other, in the order of time.

    Of several of one distance, the earlier one counts; of several of one time, the first one. Those that are more than
    ``tolerance`` apart are no pair.
    """
    import numpy as np

    times = [np.array(list(each), np.int64) for each in (first, second)]
    if not all(each.size for each in times):
        return []
    orders = [np.argsort(each, kind="stable") for each in times]
    one, two = (each[order] for each, order in zip(times, orders, strict=True))
    to_two, to_one = _nearest(one, two), _nearest(two, one)
    return [
        (int(orders[0][k]), int(orders[1][n]))
        for k, n in enumerate(to_two.tolist())
        if to_one[n] == k and abs(int(one[k]) - int(two[n])) <= tolerance
    ]


def _nearest(times: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """Place of the nearest of ``others``, sorted, for each of ``times``; of equal ones the first."""
    import numpy as np

    after = np.clip(np.searchsorted(others, times), 0, len(others) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(times - others[before]) <= np.abs(others[after] - times), before, after)
    return np.searchsorted(others, others[nearest])


@dataclass(frozen=True)
class Frame:
    """One frame: its number (the place of the first topic's message), the places of all messages, and their times."""

    number: int
    places: dict[str, int]
    times: dict[str, int]

    @property
    def time(self) -> int:
        """Time of the first topic's message, nanoseconds."""
        return next(iter(self.times.values()))

    @property
    def offset(self) -> int:
        """How much later the second topic's message is, nanoseconds; 0 where there is one topic."""
        times = list(self.times.values())
        return times[-1] - times[0]


def match_frames(found: Survey, topics: FrameTopics, tolerance: float, every: int) -> tuple[list[Frame], int]:
    """Return every n-th frame whose messages are at most ``tolerance`` milliseconds apart, and how many there are.

    Raises
    ------
    InputError
        No two messages belong together.
    """
    known: dict[str, list[tuple[int, int]]] = {}  # role -> place and time of every message that has one
    for role, stream in found.streams.items():
        times = [r if s is not None and found.by_recorder else s
                 for s, r in zip(stream.stamps, stream.recorded, strict=True)]  # fmt: skip
        known[role] = [(place, time) for place, time in enumerate(times) if time is not None]
        if not known[role]:
            raise InputError(
                "; ".join([f"{topics.images[role]}: holds no image that can be read", *found.problems[:1]])
            )
    roles = list(known)
    first = known[roles[0]]
    if len(roles) == 1:
        pairs = [(k, k) for k in range(len(first))]
    else:
        stamps = [[time for _, time in known[role]] for role in roles]
        pairs = nearest_pairs(stamps[0], stamps[1], round(tolerance * 1e6))
        if not pairs:
            near = nearest_pairs(stamps[0], stamps[1], 1 << 62)
            apart = sorted(abs(stamps[0][a] - stamps[1][b]) for a, b in near)
            raise InputError(
                f"no two images are within {tolerance:g} ms: the nearest are {apart[0] / 1e6:.1f} ms apart, half of "
                f"them {apart[len(apart) // 2] / 1e6:.1f} ms or less; see --tolerance"
            )
    frames = []
    for pair in pairs[::every]:
        both = {role: known[role][k] for role, k in zip(roles, pair, strict=False)}
        frames.append(
            Frame(first[pair[0]][0], {r: p for r, (p, _) in both.items()}, {r: t for r, (_, t) in both.items()})
        )
    return frames, len(pairs)


@dataclass
class Written:
    """The frames whose images are written.

    Attributes
    ----------
    frames : in order
    shapes : role -> (height, width)
    digits : of their numbers, in names of files
    """

    frames: list[Frame]
    shapes: dict[str, tuple[int, int]]
    digits: int


def write_images(
    recording: Recording, topics: FrameTopics, frames: list[Frame], folder: Path, found: Survey
) -> Written:
    """Write the images of ``frames`` into ``folder``; frames of which one is damaged are left out.

    Raises
    ------
    InputError
        None of them can be read.
    """
    from depthcli.io.formats.files import write_bytes

    digits = max(_MIN_DIGITS, len(str(frames[-1].number)))
    roles = {name: role for role, name in topics.images.items()}
    numbers = {role: {frame.places[role]: frame.number for frame in frames} for role in topics.images}
    files: dict[int, dict[str, Path]] = {frame.number: {} for frame in frames}
    shapes: dict[str, tuple[int, int]] = {}
    place = dict.fromkeys(topics.images, -1)
    try:
        for message in recording.messages(roles):
            role = roles[message.topic]
            place[role] += 1
            number = numbers[role].get(place[role])
            if number is None or number not in files:
                continue
            try:
                data, suffix, shape = _image(recording, message, role)
                if shapes.setdefault(role, shape) != shape:
                    raise InputError(
                        f"{shape[1]} x {shape[0]} pixels, those before have {shapes[role][1]} x {shapes[role][0]}"
                    )
                file = folder / _file(topics, role, f"{number:0{digits}}", suffix)
                write_bytes(file, data)
                files[number][role] = file
            except InputError as error:
                found.damaged(f"{message.topic}: message {place[role] + 1}: {error}")
                _drop(files.pop(number), folder)
    except InputError:  # said in the survey; frames behind are not complete
        pass
    for number in [number for number, parts in files.items() if len(parts) < len(topics.images)]:
        _drop(files.pop(number), folder)
    if not files:
        raise InputError("; ".join(["no frame can be read", *found.problems[:1]]))
    return Written([frame for frame in frames if frame.number in files], shapes, digits)


def _file(topics: FrameTopics, role: str, number: str, suffix: str) -> str:
    return f"{number}/{role}{suffix}" if topics.is_depth_alone else f"{role}/{number}{suffix}"


def _drop(files: dict[str, Path], folder: Path) -> None:
    for file in files.values():
        file.unlink()
        with contextlib.suppress(OSError):  # other frames are in it
            file.parent.rmdir()


def _image(recording: Recording, message: Message, role: str) -> tuple[bytes, str, tuple[int, int]]:
    """Return the bytes, the ending and the (height, width) of the file of an image."""
    import numpy as np

    from depthcli.io.formats.disparity import encode_pfm
    from depthcli.io.formats.images import png_bytes
    from depthcli.io.formats.ros_images import depth_of, stored_image

    if role != "depth":
        return recording.read(message, stored_image)
    depth = recording.read(message, depth_of)
    shape = (depth.shape[0], depth.shape[1])
    if depth.dtype == np.uint16:
        return png_bytes(depth), ".png", shape
    return encode_pfm(depth.astype(np.float32)), ".pfm", shape
