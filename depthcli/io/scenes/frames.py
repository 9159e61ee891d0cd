"""Layouts of RGB-D frames, and the frame that a command's options name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from depthcli.core.cameras.camera import Place, check_place
from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.plain_text import numbers, text_of
from depthcli.io.formats.poses import Poses, pose_of, read_poses
from depthcli.io.scenes.kinds import RgbdScene, RgbIrScene, Scene
from depthcli.io.scenes.rows import NUMBER, Folder, Found, Layout, LayoutRow, Layouts, Meta, name_of_file

_TUM_SCALE = 5000.0  # codes per meter in the benchmark's files
_TUM_DELAY = 0.02  # seconds, as in the benchmark's associate.py
_GENERIC_NAMES = ("color", "rgb", "image", "depth")  # file names that do not identify a frame


def cameras(meta: Meta) -> dict[str, Any]:
    """Return both cameras of meta.json as fields of the scene.

    The color camera's intrinsics are at the root of the file or below the key ``intrinsics``.
    """
    return {
        "intrinsics": _intrinsics(meta, "intrinsics", meta.fields),
        "depth_intrinsics": _intrinsics(meta, "depth_intrinsics", {}),
        "depth_to_color": _depth_to_color(meta),
    }


def _intrinsics(meta: Meta, name: str, default: dict[str, Any]) -> tuple[float, ...] | None:
    """Return fx, fy, cx, cy below the key ``name``, or in ``default``."""
    inner = meta.fields.get(name, default)
    if not isinstance(inner, dict):
        raise meta.error(name, "fx, fy, cx, cy")
    place = f"{name}: " if name in meta.fields else ""  # messages name the camera
    named = Meta(meta.path, {f"{place}{key}": value for key, value in inner.items()})
    values = [named.positive(f"{place}{key}") for key in ("fx", "fy", "cx", "cy")]
    known = tuple(value for value in values if value is not None)
    if len(known) < len(values) and (known or name in meta.fields):
        raise meta.error(name, "all of fx, fy, cx, cy")
    return known or None


def _depth_to_color(meta: Meta) -> Place | None:
    value = meta.fields.get("depth_to_color")
    if value is None:
        return None
    if not isinstance(value, dict):
        raise meta.error("depth_to_color", "rotation and translation")
    with naming(meta.path):
        rotation = numbers(value.get("rotation"), "depth_to_color: rotation", (3, 3))
        translation = numbers(value.get("translation"), "depth_to_color: translation", (3,))
        check_place(rotation, translation)
    return tuple(rotation.ravel().tolist()), tuple(translation.tolist())


def _meta(folder: Folder) -> dict[str, Any]:
    """Return the scene fields from ``meta.json``."""
    meta = folder.meta
    scale = meta.positive("depth_scale")
    facts: dict[str, Any] = {"fb": meta.positive("fb"), "pose": None, "protocol": meta.text("protocol", "depth")}
    facts["sparse_source"] = meta.text("sparse_source", "")
    if (pose := meta.fields.get("pose")) is not None:
        with naming(meta.path):
            facts["pose"] = pose_of(numbers(pose, "pose", (4, 4)))
    return cameras(meta) | facts | ({"depth_scale": scale, "scale_floats": True} if scale else {})


def _frame(found: Found) -> dict[str, Any] | None:
    if "depth" not in found.files and any(name.startswith("disparity") for name in found.folder.names):
        return None  # a frame of the layout kinect-raw
    return _meta(found.folder)


def _numbered(found: Found) -> dict[str, Any]:
    """Return the scene fields of a frame in folders of frames; frames with numbers as names form a sequence."""
    number = found.keys.get("number", "")
    if match := re.fullmatch(rf"(?:frame[-_]?)?({NUMBER})", found.keys.get("name", "")):
        number = match[1]
    order = int(number) if number.isdigit() else round(float(number or 0) * 1e6)  # or its time in microseconds
    return _meta(found.folder) | {"pose": None} | ({"sequence": found.folder.name, "number": order} if number else {})


def _sun(found: Found) -> dict[str, Any]:
    file = found.folder.path / "intrinsics.txt"
    camera = {"intrinsics": _matrix(file)} if file.name in found.folder.names else {}
    return _meta(found.folder) | {"rotated": True} | camera


def _matrix(path: Path) -> tuple[float, ...]:
    """Return fx, fy, cx, cy from a file with a 3 x 3 or 4 x 4 camera matrix."""
    text = text_of(read_bytes(path))
    with naming(path):
        values = numbers(text, "the camera matrix")
        if values.size not in (9, 16) or min(values[0], values[5 if values.size == 16 else 4]) <= 0:
            raise InputError("expected the numbers of a camera matrix, 3 x 3 or 4 x 4")
    rows = values.reshape(-1, 4 if values.size == 16 else 3)
    return float(rows[0, 0]), float(rows[1, 1]), float(rows[0, 2]), float(rows[1, 2])


def _with_poses(folder: Folder, scenes: list[Scene]) -> list[Scene]:
    """Return numbered frames with their poses, of which one file may have all."""
    if not folder.has("poses.txt"):
        return scenes
    poses = read_poses(folder.path / "poses.txt").of_frames(sorted(frame.number for frame in scenes))  # type: ignore[attr-defined]
    return [replace(frame, pose=poses[frame.number]) for frame in scenes]  # type: ignore[attr-defined, call-arg]


def _with_cameras(folder: Folder, scenes: list[Scene]) -> list[Scene]:
    """Return frames with the matrices of both cameras, by which the depth is registered."""
    place = "intrinsic/intrinsic_{}.txt" if "intrinsic" in folder.names else "intrinsics_{}.txt"
    color, depth = (_matrix(folder.path / place.format(kind)) for kind in ("color", "depth"))
    return [replace(frame, intrinsics=color, depth_intrinsics=depth) for frame in scenes]  # type: ignore[call-arg]


class _Sun(LayoutRow):
    """Frames recognized by the camera's file, since other data sets have folders ``image`` and ``depth``, too."""

    def scenes(self, folder: Folder) -> list[Scene]:
        known = folder.has("image", "depth", "intrinsics.txt") or folder.requested == self.name
        return super().scenes(folder) if known else []


class Tum(Layout):
    """Sequences of the TUM RGB-D benchmark: images with times, paired by a table or by the nearest time."""

    name = "tum"
    kind = RgbdScene
    about = (
        "`rgb/`, `depth/` with `associations.txt`, or `rgb.txt` and `depth.txt`; 5000 codes a meter, unless "
        "`meta.json` says it; where known `groundtruth.txt` (poses)"
    )
    needs = ("rgb", "depth", "associations.txt|rgb.txt", "associations.txt|depth.txt")

    def scenes(self, folder: Folder) -> list[Scene]:
        if folder.has("associations.txt"):
            pairs = [(float(a), b, float(c), d) for a, b, c, d in _lines(folder.path / "associations.txt", 4)]
            if pairs and pairs[0][1].startswith("depth"):  # associate.py depth.txt rgb.txt
                pairs = [(c, d, a, b) for a, b, c, d in pairs]
        else:
            depths, colors = (
                sorted((float(time), file) for time, file in _lines(folder.path / name, 2))
                for name in ("depth.txt", "rgb.txt")
            )
            pairs = [(t, file, *min(depths, key=lambda d: abs(d[0] - t))) for t, file in colors if depths]
        if not pairs:
            raise InputError(f"{folder.path}: no line pairs a color image with a depth image")
        poses = read_poses(folder.path / "groundtruth.txt") if folder.has("groundtruth.txt") else Poses([], [])
        scenes = []
        for number, (time, color, depth_time, depth) in enumerate(pairs):
            late = abs(time - depth_time) > _TUM_DELAY
            problem = f"{folder.path / color}: the nearest depth is {abs(time - depth_time):.3f} s off" if late else ""
            facts = {"depth_scale": _TUM_SCALE, **_meta(folder), "pose": poses.at(time), "number": number}
            files = {"color": folder.path / color, "depth": folder.path / depth}
            name = f"{folder.prefix}{time:.6f}"
            scenes.append(self.scene(folder, name=name, problem=problem, sequence=folder.name, **files, **facts))
        return scenes


def _lines(path: Path, fields: int) -> list[list[str]]:
    rows = []
    for number, line in enumerate(text_of(read_bytes(path)).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            times = [float(word) for word in words[0:fields:2]]
        except ValueError:
            times = []
        if len(words) < fields or len(times) * 2 != fields or any(".." in Path(w).parts for w in words[1:fields:2]):
            raise InputError(f"{path}:{number}: expected {'time file ' * (fields // 2)}(got {line[:60]!r})")
        rows.append(words[:fields])
    return rows


_RGBD_FILES = {
    "color": "color.*", "depth": "depth.*|depth_raw.*", "depth_true": "depth_true.*", "masks": "mask_{mask}.*",
    "sparse": "sparse.*", "sparse_confidence": "sparse_confidence.*",
}  # fmt: skip
_NUMBERED = {
    "depth_true": "depth_true_{number}.*|depth_true.*", "masks": "mask_{mask}_{number}.*", "name": "{number}",
}  # fmt: skip

FRAMES = Layouts.of(
    RgbdScene,
    LayoutRow(
        title="rgbd", kind=RgbdScene,
        about="`color.*`, `depth.*`, or the latter alone for `refine-kinect`; where known `depth_true.*`, "
        "`mask_<name>.*` (255 = evaluate), `sparse.*` (a second depth map, known at some pixels) with "
        "`sparse_confidence.*`, `meta.json` (`depth_scale`: codes a meter, 1000 unless said; `intrinsics`: fx, fy, "
        "cx, cy; `fb`: focal length x baseline, pixels x meters; `pose`: 4 x 4, from the camera to the world, meters; "
        "of depth that is not registered to the color image, `depth_intrinsics`: fx, fy, cx, cy, and "
        "`depth_to_color`: `rotation` 3 x 3, `translation` in meters)",
        files=(_RGBD_FILES,), without=("ir.*",), facts=_frame, either=True, single=True,
    ),
    LayoutRow(
        title="rgb-ir", kind=RgbIrScene,
        about="as `rgbd`, with `ir.*` (8 or 16 bit) and `calib.json` or OpenCV's `calib.yml` (M1 D1 M2 D2 R T); "
        "calib.json has `color`, `infrared` (K, distortion, size), R and t, or `rectified`: true and `fb` (focal "
        "length x baseline, pixels x meters); where known `ir_noprojector.*`",
        files=({**_RGBD_FILES, "infrared": "ir.*", "infrared_plain": "ir_noprojector.*",
                "calibration": "calib.json|calib.yml|calib.yaml"},),
        needs=("ir.*",),
        facts=lambda found: {**_meta(found.folder), "max_disparity": found.folder.meta.whole("max_disparity", 1)},
        either=True, single=True,
    ),
    LayoutRow(
        title="rgbd-sequence", kind=RgbdScene, after=_with_poses,
        about="`color_00000.*` and `depth_00000.*`, or `color/` and `depth/` with numbered files; `meta.json` as "
        "`rgbd`; where known `poses.txt`",
        files=({"color": "color/{_}{number}.*", "depth": "depth/{_}{number}.*", **_NUMBERED},
               {"color": "color_{number}.*", "depth": "depth_{number}.*", **_NUMBERED}),
        without=("intrinsic", "intrinsics_color.txt"), facts=_numbered, either=True,
    ),
    LayoutRow(
        title="rgb-depth", kind=RgbdScene, needs=("rgb", "depth"), without=("associations.txt", "rgb.txt"),
        about="`rgb/NAME.*` and `depth/NAME.*` (also `rgb/NAME_rgb.*` or `rgb/rgb_NAME.*` and so on); where known "
        "`depth_true/NAME.*`, `mask_transparent/NAME.*`, and `meta.json` of all frames as `rgbd`",
        files=tuple(
            {"color": f"rgb/{color}.*", "depth": f"depth/{depth}.*", "depth_true": "depth_true/{name}.*",
             "mask.transparent": "mask_transparent/{name}.*", "name": "{name}"}
            for color, depth in (
                ("{name}", "{name}"), ("rgb_{name}", "depth_{name}"), ("color_{name}", "depth_{name}"),
                ("{name}_rgb", "{name}_depth"), ("{name}_color", "{name}_depth"),
            )
        ), facts=_numbered, either=True,
    ),
    LayoutRow(
        title="scannet", kind=RgbdScene, after=_with_cameras, needs=("intrinsic*",),
        about="`color/0.jpg`, `depth/0.png` (millimeters), `intrinsic/intrinsic_color.txt`, "
        "`intrinsic/intrinsic_depth.txt`",
        files=({"color": "color/{number}.*", "depth": "depth/{number}.*", **_NUMBERED},), facts=_numbered, either=True,
    ),
    LayoutRow(
        title="kinect-raw", kind=RgbdScene, after=_with_poses,
        about="`color.*` and `disparity*.*`, or `color_0000.*` and `disparity_0000.*`; `calib.json` with "
        "`dc_beta.npy` after Herrera et al., else a typical calibration",
        files=({"color": "color.*", "depth": "disparity{_}.*", "depth_true": "depth_true.*", "masks": "mask_{mask}.*",
                "calibration": "calib.json"},
               {"color": "color_{number}.*", "depth": "disparity_{number}.*", "calibration": "calib.json",
                **_NUMBERED}),
        needs=("disparity*",),
        facts=lambda found: {**(_numbered(found) if "number" in found.keys else _meta(found.folder)), "raw": True},
    ),
    _Sun(
        title="sun-rgbd", kind=RgbdScene,
        about="`image/`, `depth/` and `intrinsics.txt`; with `--layout sun-rgbd` also `color.*`, `depth.*`",
        files=({"color": "image/{_}.*", "depth": "depth/{_}.*"}, {"color": "color.*", "depth": "depth.*"}),
        needs=("image|color.*", "depth|depth.*"), facts=_sun,
    ),
    LayoutRow(
        title="cleargrasp", kind=RgbdScene, protocol="depth", needs=("mask_transparent.png",),
        about="`rgb_transparent.*`, `depth_sensor_mm.png`, `depth_opaque_gt_mm.png`, or `rgb.*`, `depth_gt_mm.png`; "
        "`mask_transparent.png`",
        files=({"color": "rgb_transparent.*", "depth": "depth_sensor_mm.png", "depth_true": "depth_opaque_gt_mm.png",
                "mask.transparent": "mask_transparent.png"},
               {"color": "rgb.*", "depth": "depth_gt_mm.png", "depth_true": "depth_gt_mm.png",
                "mask.transparent": "mask_transparent.png", "hidden": "mask_transparent.png"}),
        facts=lambda found: {} if found.files.keys() & {"depth", "depth_true"} else None,
    ),
    Tum(),
)  # fmt: skip


def named_frame(values: Mapping[str, Any]) -> list[Scene]:
    """Return the frame that the options ``depth`` and, if given, ``color`` name; an empty list without them."""
    color, depth = values.get("color"), values.get("depth")
    if depth is None and color is not None:
        raise ConfigError("--color needs --depth, too")
    if depth is None:
        return []
    image = color or depth
    return [RgbdScene(name=name_of_file(image, *_GENERIC_NAMES), folder=image.parent, color=color, depth=depth)]
