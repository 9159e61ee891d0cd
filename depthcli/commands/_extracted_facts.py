"""What is known of the frames of a recording, as the files that commands read: calibration, poses, times."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.commands._extraction import Frame, Written
from depthcli.commands._recorded_topics import FrameTopics, is_rectified
from depthcli.commands._recording_survey import Survey
from depthcli.core.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from depthcli.io.formats.ros_cameras import CameraInfo

_MIN_TURN = 1e-9  # of a rotation matrix's entries; less is none
_MAX_TURN = 1e-3  # of those of the cameras of a rectified pair


@dataclass
class Calibration:
    """What became of the calibration.

    Attributes
    ----------
    kept : names of files that hold it, or ``none``, or ``refused``: it contradicts itself or the images
    meta : fields of ``meta.json``
    notes : lines for the user
    """

    kept: str = "none"
    meta: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def write_calibration(found: Survey, topics: FrameTopics, written: Written, folder: Path) -> Calibration:
    """Write the calibration of a pair into ``folder``; that of color and depth is in the result's ``meta``."""
    infos: dict[str, CameraInfo] = {}
    for role, stream in found.streams.items():
        if stream.info is not None and stream.info.is_calibrated:
            infos[role] = stream.info
    missing = [role for role in topics.images if role not in infos]
    try:
        for role, info in infos.items():
            height, width = written.shapes[role]
            if info.size != (width, height):
                raise InputError(
                    f"camera_info of {topics.images[role]} is of {info.size[0]} x {info.size[1]} pixels, the images "
                    f"have {width} x {height}"
                )
        if not topics.is_stereo:
            return _of_color_and_depth(found, topics, infos, missing)
        if missing:
            return Calibration(notes=[_no_info(topics, missing)])
        return _of_pair(found, topics, infos, folder)
    except InputError as error:
        return Calibration("refused", notes=[f"no calibration is written: {error}"])


def _no_info(topics: FrameTopics, missing: list[str]) -> str:
    return f"no camera_info of {', '.join(topics.images[role] for role in missing)}: the frames have no calibration"


def _of_pair(found: Survey, topics: FrameTopics, infos: dict[str, CameraInfo], folder: Path) -> Calibration:
    import numpy as np

    from depthcli.io.formats.pair_geometry import write_geometry
    from depthcli.io.formats.ros_cameras import rectified_geometry, write_raw_pair

    left, right = infos["left"], infos["right"]
    says = [is_rectified(topics.images[role]) for role in ("left", "right")]
    if all(says) or (left.is_undistorted and right.is_undistorted):
        baseline = None
        if not (left.projection[0, 3] or right.projection[0, 3]):
            baseline, place = found.baseline, _place(found, "right", "left")
            if place is not None:
                if np.abs(place[:3, :3] - np.eye(3)).max() > _MAX_TURN:
                    raise InputError("the right camera is turned against the left one: these are no rectified images")
                baseline = float(f"{place[0, 3]:.9g}")
        write_geometry(folder / "calib.txt", rectified_geometry(left, right, baseline))
        return Calibration("calib.txt")
    if says[0] != says[1]:
        raise InputError(f"one of {topics.images['left']} and {topics.images['right']} is rectified, the other is not")
    names = write_raw_pair(folder, left, right)
    kept = ", ".join(names)
    return Calibration(kept, notes=[f"the images are not rectified yet: depthcli rectify takes {kept}"])


def _of_color_and_depth(
    found: Survey, topics: FrameTopics, infos: dict[str, CameraInfo], missing: list[str]
) -> Calibration:
    import numpy as np

    result = Calibration("meta.json" if infos else "none")
    if "color" in infos and "depth" in missing:
        if not _is_one_frame(found):
            name = topics.images["depth"]
            result.notes.append(f"no camera_info of {name}: the depth is taken to be registered to the color image")
    elif missing:
        result.notes.append(_no_info(topics, missing))
    cameras = {role: info.intrinsics(is_rectified(topics.images[role])) for role, info in infos.items()}
    for role, info in infos.items():
        if any(info.distortion) and not is_rectified(topics.images[role]):
            result.notes.append(f"the lens distortion of {topics.images[role]} is left out")
    fields = {
        role: {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy} for role, camera in cameras.items()
    }
    if found.baseline is not None and "depth" in cameras:
        result.meta["fb"] = float(f"{cameras['depth'].fx * found.baseline:.9g}")
    if "color" not in topics.images or "color" not in cameras:
        only = fields.get("depth")
        result.meta |= {"intrinsics": only} if only and ("color" not in topics.images or _is_one_frame(found)) else {}
        return result
    result.meta["intrinsics"] = fields["color"]
    if "depth" not in cameras:
        return result
    alike = infos["color"].size == infos["depth"].size and cameras["color"] == cameras["depth"]
    place = _place(found, "depth", "color")
    if alike and (place is None or np.allclose(place, np.eye(4), atol=1e-9)):
        return result  # registered: one camera
    result.meta["depth_intrinsics"] = fields["depth"]
    if place is not None:
        rotation = [[_plain(value) for value in row] for row in place[:3, :3].tolist()]
        translation = [_plain(value) for value in place[:3, 3].tolist()]
        result.meta["depth_to_color"] = {"rotation": rotation, "translation": translation}
    elif not _is_one_frame(found):
        result.notes.append("nothing says where the depth camera is: it is taken to be where the color camera is")
    return result


def _is_one_frame(found: Survey) -> bool:
    return found.streams["color"].frame == found.streams["depth"].frame != ""


def _plain(value: float) -> float:
    return round(value, 12) + 0.0


def _place(found: Survey, role: str, other: str) -> NDArray[np.float64] | None:
    """Return the matrix from the coordinates of one camera to those of the other, where the recording says it."""
    import numpy as np

    if role in found.places and other in found.places:
        # Each is from one camera of the sensor, the same for all, to its own.
        return np.asarray(found.places[other] @ np.linalg.inv(found.places[role]))
    frames = [found.streams[each].frame for each in (role, other)]
    return found.transforms.fixed(*frames) if all(frames) and frames[0] != frames[1] else None


def poses_of(
    found: Survey, topics: FrameTopics, frames: list[Frame]
) -> tuple[dict[int, NDArray[np.float64]], list[str]]:
    """Return number of a frame -> where the camera of the first topic was, of those where it is known; and warnings."""
    import numpy as np

    from depthcli.io.formats.poses import MAX_SINGLE_DELAY
    from depthcli.io.formats.ros_poses import MAX_DELAY

    role, name = next(iter(topics.images.items()))
    stream, notes, inside = found.streams[role], list[str](), np.eye(4)
    if found.track is not None and found.tracked and found.tracked != stream.frame.removeprefix("/"):
        place = found.transforms.fixed(stream.frame, found.tracked)
        if place is None:
            notes.append(
                f"no fixed transform from {stream.frame!r} to {found.tracked!r}: the poses of {found.tracked!r} are "
                "taken for those of the camera"
            )
        else:
            inside = place
    if is_rectified(name) and stream.info is not None:
        turn = stream.info.rotation
        if np.abs(turn - np.eye(3)).max() > _MIN_TURN:  # rectified images are those of a camera that is turned by R
            inside = inside @ np.block([[turn.T, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])
    poses = {}
    for frame in frames:
        of_topic = found.track
        place = found.transforms.at(stream.frame, frame.time) if of_topic is None else of_topic.at(frame.time)
        if place is not None:
            poses[frame.number] = place @ inside
    if len(poses) < len(frames):
        near = f"within {MAX_DELAY * 1000:g} ms on both sides, nor one within {MAX_SINGLE_DELAY * 1000:g} ms"
        notes.append(f"{len(frames) - len(poses)} of {len(frames)} frames have no poses of {topics.pose} {near}")
    return poses, notes


def write_poses(poses: dict[int, NDArray[np.float64]], folder: Path) -> None:
    """Write ``poses.txt``, number of a frame and its pose, unless there is none."""
    from depthcli.io.formats.files import write_text
    from depthcli.io.formats.ros_poses import pose_line

    if poses:
        lines = [pose_line(number, matrix) for number, matrix in poses.items()]
        write_text(folder / "poses.txt", "# frame tx ty tz qx qy qz qw\n" + "".join(lines))


def write_times(frames: list[Frame], folder: Path) -> None:
    """Write ``times.csv``: the time of every frame, and how much later its second image is."""
    from depthcli.io.formats.files import write_text

    lines = ["frame,seconds,offset_ms"]
    for frame in frames:
        second, rest = divmod(frame.time, 1_000_000_000)
        lines.append(f"{frame.number},{second}.{rest:09d},{frame.offset / 1e6:.6f}")
    write_text(folder / "times.csv", "\n".join(lines) + "\n")


def write_meta(meta: dict[str, Any], topics: FrameTopics, source: str, folder: Path) -> None:
    """Write ``meta.json`` into ``folder``."""
    from depthcli.io.formats.files import write_text

    of = ", ".join(topics.images.values())
    text = json.dumps({"source": f"extracted by depthcli from {source}: {of}", **meta}, indent=1) + "\n"
    write_text(folder / "meta.json", text)
