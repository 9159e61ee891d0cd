"""Layouts of stereo pairs, and pairs from a command line, two patterns, two videos or a table of files."""

from __future__ import annotations

import glob
import itertools
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry, disparity_of_depth
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.text import without_secrets
from depthcli.io.calibration_photos import SIDES, without_word
from depthcli.io.formats.disparity import KITTI_SCALE, read_disparity, read_plane
from depthcli.io.formats.files import naming, read_bytes
from depthcli.io.formats.images import IMAGE_SUFFIXES, read_image
from depthcli.io.formats.plain_text import json_object, key_values, numbers, table_rows, text_of
from depthcli.io.formats.videos import VIDEO_SUFFIXES, frames_and_rate
from depthcli.io.scenes.kinds import FRAMES, LEFT_RIGHT, MAX_DISPARITY, TOP_BOTTOM, Scene, StereoScene
from depthcli.io.scenes.rows import Folder, Found, LayoutRow, Layouts, dropped, name_of_file

STDIN = Path("-")
"""The table's path for standard input."""

_KITTI_RANGE = 255  # largest disparity that KITTI's files can encode; the frames have no range of their own
_SCENE_FLOW_RANGE = 192  # as evaluations in the literature; the files have larger disparities, too

# Ground truth scale and search range of the taxonomy paper's data sets, whose files do not contain them
# (vision.middlebury.edu/stereo/data/scenes2001, scenes2003).
_MIDDLEBURY_FACTS: dict[str, tuple[float, int]] = {
    "tsukuba": (16, 15), "venus": (8, 19), "teddy": (4, 59), "cones": (4, 59), "sawtooth": (8, 19), "bull": (8, 20),
    "poster": (8, 20), "barn1": (8, 19), "barn2": (8, 19),
}  # fmt: skip
_SINTEL_PIXELS = (4.0, 2.0**-6, 2.0**-14)  # pixels per code of the red, green and blue channel
_MANY_VIEWS = ("rig_calibration", "dslr_calibration")  # prefixes of the folders next to ``images`` in ETH3D


def _meta(found: Found) -> dict[str, Any]:
    """Return the scene fields from ``meta.json``."""
    meta = found.folder.meta
    return {
        "protocol": meta.text("protocol", "middlebury_v2"),
        "disparity_scale": meta.positive("disp_scale"),
        "round_disparity": meta.fields.get("isint") is True,
        "masks": {name: file for name, file in found.masks.items() if not name.endswith("_right")},
        **meta.disparities(),
    }


def _middlebury_v2(found: Found) -> dict[str, Any] | None:
    if not found.files.keys() & {"right", "disparity_left"}:
        return None
    later, meta = found.files["left"].stem == "view1", found.folder.meta
    scale, top = (None, None) if later else _MIDDLEBURY_FACTS.get(found.folder.path.name.lower(), (None, None))
    return {
        "disparity_scale": meta.positive("disp_scale") or scale,
        "scale_by_width": later,
        "max_disparity": meta.whole("max_disparity", 1) or top,
    }


def _middlebury_v3(found: Found) -> dict[str, Any]:
    calib: dict[str, float] = {}
    if (path := found.files.get("calibration")) is not None:
        with naming(path):
            fields = key_values(text_of(read_bytes(path)))
            calib = {k: float(numbers(v, k)[0]) for k, v in fields.items() if re.fullmatch(r"[-+0-9.eE]+", v)}
    top = calib.get("ndisp")
    if top is not None and top > MAX_DISPARITY:
        raise InputError(f"{path}: ndisp: expected at most {MAX_DISPARITY}, got {top:g}")
    # ETH3D writes the image width where Middlebury writes the search range.
    if top is not None and (top < 1 or top >= calib.get("width", float("inf"))):
        top = None
    return {"max_disparity": None if top is None else int(top), "round_disparity": calib.get("isint", 0) == 1}


class _Eth3d(LayoutRow):
    """ETH3D: like Middlebury v3, but the ground truth may be in a folder next to the scenes' folder."""

    def scenes(self, folder: Folder) -> list[Scene]:
        if "images" in folder.names and any(name.startswith(_MANY_VIEWS) for name in folder.names):
            raise InputError(
                f"{folder.path}: a many-view scene of ETH3D, without rectified pairs; its two-view scenes can be used"
            )
        found = super().scenes(folder) if folder.has("cameras.txt", "images.txt") else []
        place = folder.path.absolute()
        truth = place.parent.with_name(f"{place.parent.name}_gt") / place.name
        if not (truth / "disp0GT.pfm").is_file():
            return found
        mask = truth / "mask0nocc.png"
        masks = {"nonocc": mask} if mask.is_file() else {}
        return [
            replace(scene, disparity_left=truth / "disp0GT.pfm", masks=masks)
            if isinstance(scene, StereoScene) and scene.disparity_left is None
            else scene
            for scene in found
        ]


def _decode_scene_flow(file: Path, scale: float | None) -> NDArray[np.float32]:
    """Return positive disparities; FlyingThings3D's subset for DispNet has negative ones."""
    disparity = read_disparity(file, scale)
    return -disparity if np.count_nonzero(disparity < 0) > np.count_nonzero(disparity > 0) else disparity


def _decode_sintel(file: Path, scale: float | None) -> NDArray[np.float32]:
    """Return the disparities that Sintel packs into three 8-bit channels; black is unknown."""
    codes = read_image(file)
    if codes.ndim != 3 or codes.dtype != np.uint8:
        raise InputError(f"{file}: expected disparities packed into three channels of 8 bit")
    disparity: NDArray[np.float32] = (codes @ np.array(_SINTEL_PIXELS)).astype(np.float32)
    disparity[~codes.any(axis=2)] = np.nan
    return disparity


def _decode_booster(file: Path, scale: float | None) -> NDArray[np.float32]:
    disparity = read_disparity(file, scale)
    return np.where(disparity > 0, disparity, np.float32(np.nan))


def _decode_depth(file: Path, scale: float | None, fb: float) -> NDArray[np.float32]:
    """Return the disparities of a depth map; ``fb`` is focal length x baseline in pixels x the map's unit."""
    return disparity_of_depth(read_plane(file).astype(np.float32), fb)


def _falling_things(found: Found) -> dict[str, Any]:
    """Return the cameras of a scene, and the function that decodes its depths (10000 codes per meter)."""
    with naming(file := found.folder.path / _FALLING_THINGS):
        settings = json_object(read_bytes(file, _MAX_SETTINGS)).get("camera_settings")
        first = settings[0] if isinstance(settings, list) and settings and isinstance(settings[0], dict) else {}
        inner = first.get("intrinsic_settings")
        fields = inner if isinstance(inner, dict) else {}
        camera = Intrinsics(*(float(numbers(fields.get(key), key, (1,))[0]) for key in ("fx", "fy", "cx", "cy")))
        geometry = PairGeometry(camera, _FALLING_THINGS_BASELINE)
    return {"geometry": geometry, "decode": partial(_decode_depth, fb=geometry.fb * _FALLING_THINGS_CODES)}


def _booster(found: Found) -> dict[str, Any]:
    if "camera_02" in found.folder.names:
        return {}
    place = found.folder.path
    return {"problem": f"{place}: an unbalanced pair, of two sizes; use camera_02, as in Booster's balanced split"}


def _scene_flow(found: Found) -> dict[str, Any]:
    left = found.files["left"]
    return {"problem": f"{left}: WebP is not read; use the set's PNG images"} if left.suffix == ".webp" else {}


def _driving_stereo(found: Found) -> dict[str, Any]:
    scale = 128.0 if found.files["left"].parent.name == "left-image-full-size" else 256.0
    return {"disparity_scale": scale, "max_disparity": int(65535 / scale)}  # the largest that a file can encode


def _grey_cameras(found: Found) -> dict[str, Any]:
    """The numbers of KITTI's grey cameras if a view is theirs; those of the color cameras are the default."""
    view = found.files.get("left") or found.files["right"]
    folder = view.parent.parent if view.parent.name == "data" else view.parent
    return {"cameras": (0, 1)} if folder.name in ("image_0", "image_1", "image_00", "image_01") else {}


def _pairs(found: Found) -> dict[str, Any] | None:
    """Return the scene fields of a pair, or None for names of maps and masks."""
    return None if found.keys["name"].startswith(("disp", "mask", "confidence")) else _meta(found)


def _variants(files: Mapping[str, str], *words: tuple[str, ...]) -> tuple[dict[str, str], ...]:
    """Return one variant of ``files`` per tuple of words, which replace ``<0>``, ``<1>`` ... in the file names."""

    def filled(name: str, chosen: tuple[str, ...]) -> str:
        for number, word in enumerate(chosen):
            name = name.replace(f"<{number}>", word)
        return name

    return tuple({role: filled(name, chosen) for role, name in files.items()} for chosen in words)


_V3_FILES = {
    "left": "im0.*", "right": "im1.*", "disparity_left": "disp0GT.pfm|disp0.pfm",
    "disparity_right": "disp1GT.pfm|disp1.pfm", "mask.nonocc": "mask0nocc.*", "calibration": "calib.txt",
}  # fmt: skip
_KITTI_VALUES = {"disparity_scale": KITTI_SCALE, "max_disparity": _KITTI_RANGE}
_KITTI_FILES = {
    "left": "<0>/{frame}_10.png", "right": "<1>/{frame}_10.png", "disparity_left": "disp_occ/{frame}_10.png",
    "disparity_noc": "disp_noc/{frame}_10.png", "calibration": "calib/{frame}.txt", "name": "{frame}_10",
}  # fmt: skip
# Cameras of TartanAir, pixels and meters (data_type.md of its tools). Codes per meter and baseline in meters of Falling
# Things (its authors' readme).
_TARTAN_AIR = PairGeometry(Intrinsics(320.0, 320.0, 320.0, 240.0), 0.25, 0.0, (640, 480))
_FALLING_THINGS, _FALLING_THINGS_CODES, _FALLING_THINGS_BASELINE = "_camera_settings.json", 10_000, 0.06
_MAX_SETTINGS = 1 << 20  # bytes of the settings file
_ARGOVERSE = (
    "rectified_stereo_images_v1.1/{{path}}/stereo_front_{0}_rect/stereo_front_{0}_rect_{{frame}}.jpg"  # for both sides
)
_SIDES = (("L", "R", "_"), ("l", "r", "_"), ("left", "right", "_"), ("left", "right", "-"), ("Left", "Right", "_"))
_DRIVING_CALIB = "<0>-image-calib/{sequence}.txt"

PAIRS = Layouts.of(
    StereoScene,
    LayoutRow(
        title="scenes",
        about="`left.*`, `right.*`; where known `disp_left.*`, `disp_right.*`, `mask_<name>.*` (255 = evaluate), "
        "`calib.txt` (as `middlebury-v3`), `meta.json` (`max_disparity`, `min_disparity`, `disp_scale`, `protocol`)",
        files=({"left": "left.*", "right": "right.*", "disparity_left": "disp_left.*", "masks": "mask_{mask}.*",
                "disparity_right": "disp_right.*", "disparity_noc": "disp_left_noc.*", "objects": "objects.*",
                "calibration": "calib.txt"},),
        without=("left_disp.png",), facts=_meta, either=True, single=True,
    ),
    LayoutRow(
        title="views",
        about="`left/NAME.*`, `right/NAME.*` (also `image_left`, `camera_left`, `cam0`, `cam0/data`, or "
        "`left/NAME_L.*`, `right/NAME_R.*`); where known `disp_left/NAME.*`, and `calib.txt`, `meta.json` of all pairs",
        files=_variants(
            {"left": "<0>.*", "right": "<1>.*", "disparity_left": "disp_left/{name}.*", "calibration": "calib.txt",
             "name": "{name}"},
            *((f"{left}/{{name}}", f"{right}/{{name}}") for left, right in (
                ("left", "right"), ("Left", "Right"), ("l", "r"), ("L", "R"), ("image_left", "image_right"),
                ("left_images", "right_images"), ("camera_left", "camera_right"), ("cam0", "cam1"),
                ("cam0/data", "cam1/data"),
            )),
            *((f"left/{{name}}{gap}{left}", f"right/{{name}}{gap}{right}") for left, right, gap in _SIDES),
        ), facts=_meta, either=True, without=("depth_left", "pose_left.txt"),
    ),
    LayoutRow(
        title="pairs",
        about="`NAME_L.*`/`NAME_R.*`, `NAME_left.*`/`NAME_right.*` or `left_NAME.*`/`right_NAME.*`; where known "
        "`calib.txt` and `meta.json` of all pairs",
        files=_variants(
            {"left": "<0>{name}<2>.*", "right": "<1>{name}<3>.*", "calibration": "calib.txt", "name": "{name}"},
            *(("", "", f"{gap}{left}", f"{gap}{right}") for left, right, gap in _SIDES),
            *((f"{left}{gap}", f"{right}{gap}", "", "") for left, right, gap in _SIDES),
        ), facts=_pairs, either=True,
        without=("left.*", "right.*", "*_left.disp.*"),
    ),
    LayoutRow(
        title="middlebury-v2", protocol="middlebury_v2",
        about="`im2`/`im6`, `imL`/`imR` or `view1`/`view5` with `disp2`/`disp6`, `groundtruth` or `disp1`/`disp5`, and "
        "`nonocc`, `all`, `disc` where there are masks; the 2001, 2003, 2005 and 2006 sets",
        files=_variants(
            {"left": "<0>.*", "right": "<1>.*", "disparity_left": "<2>", "disparity_right": "<3>",
             **{f"mask.{name}": f"{name}.*|mask_{name}.*" for name in ("nonocc", "all", "disc")}},
            ("im2", "im6", "disp2.*|groundtruth.*", "disp6.*"), ("imL", "imR", "disp2.*|groundtruth.*", "disp6.*"),
            ("view1", "view5", "disp1.*", "disp5.*"),
        ),
        facts=_middlebury_v2,
    ),
    LayoutRow(
        title="middlebury-v3", protocol="middlebury_v3",
        about="`im0`, `im1`, `calib.txt`, `disp0GT.pfm`, `mask0nocc.png`; of the sets of 2014 and 2021 `disp0.pfm`, "
        "`disp1.pfm`, by which pixels hidden in the right view are found",
        files=(_V3_FILES,), without=("cameras.txt",), facts=_middlebury_v3,
    ),
    _Eth3d(
        title="eth3d", protocol="eth3d",
        about="as `middlebury-v3`, with `cameras.txt`, `images.txt`; the truth in the scene's folder or in one of the "
        "same name in `two_view_training_gt`, next to `two_view_training`",
        files=(_V3_FILES,), needs=("cameras.txt|rig_calibration*|dslr_calibration*", "images.txt|images"),
        facts=_middlebury_v3,
    ),
    LayoutRow(
        title="kitti-2012", protocol="kitti_2012", values=_KITTI_VALUES, single=True,
        about="`colored_0`/`colored_1` or `image_0`/`image_1`, `disp_noc`, `disp_occ`, `calib`",
        files=_variants(_KITTI_FILES, ("colored_0", "colored_1"), ("image_0", "image_1")),
        facts=_grey_cameras,
    ),
    LayoutRow(
        title="kitti-2015", protocol="kitti_2015", values=_KITTI_VALUES, single=True,
        about="`image_2`, `image_3`, `disp_noc_0`, `disp_occ_0`, `obj_map`, `calib_cam_to_cam`",
        files=({"left": "image_2/{frame}_10.png", "right": "image_3/{frame}_10.png", "name": "{frame}_10",
                "disparity_left": "disp_occ_0/{frame}_10.png", "disparity_noc": "disp_noc_0/{frame}_10.png",
                "objects": "obj_map/{frame}_10.png", "calibration": "calib_cam_to_cam/{frame}.txt"},),
    ),
    LayoutRow(
        title="kitti-odometry", protocol="kitti_2015", either=True,
        about="`image_2`, `image_3` or `image_0`, `image_1` with `000000.png`; `calib.txt`",
        files=_variants({"left": "<0>/{number}.png", "right": "<1>/{number}.png", "calibration": "calib.txt",
                         "name": "{number}"}, ("image_2", "image_3"), ("image_0", "image_1")),
        values={"max_disparity": _KITTI_RANGE},
        facts=_grey_cameras,
    ),
    LayoutRow(
        title="kitti-raw", protocol="kitti_2015", either=True, values={"max_disparity": _KITTI_RANGE},
        about="`image_02/data/0000000000.png`, `image_03/data` or `image_00`, `image_01` of a `..._sync` drive; "
        "`calib_cam_to_cam.txt` in it or in the folder of its day",
        files=_variants({"left": "<0>/data/{number}.png", "right": "<1>/data/{number}.png", "name": "<0>/{number}",
                         "calibration": "calib_cam_to_cam.txt|../calib_cam_to_cam.txt"},
                        ("image_02", "image_03"), ("image_00", "image_01")),
        facts=_grey_cameras,
    ),
    LayoutRow(
        title="tartanair", protocol="scene_flow", needs=("image_left", "image_right"),
        about="`image_left/000000_left.png`, `image_right/000000_right.png`, `depth_left/000000_left_depth.npy`: a "
        "folder such as `P001`",
        files=({"left": "image_left/{frame}_left.png", "right": "image_right/{frame}_right.png", "name": "{frame}",
                "disparity_left": "depth_left/{frame}_left_depth.npy"},),
        values={"geometry": _TARTAN_AIR, "decode": partial(_decode_depth, fb=_TARTAN_AIR.fb)},
    ),
    LayoutRow(
        title="falling-things", protocol="scene_flow", needs=(_FALLING_THINGS,), facts=_falling_things,
        about="`000000.left.jpg`, `000000.right.jpg`, `000000.left.depth.png`, `_camera_settings.json`",
        files=({"left": "{frame}.left.jpg", "right": "{frame}.right.jpg", "name": "{frame}",
                "disparity_left": "{frame}.left.depth.png"},),
    ),
    # 16-bit codes are divided by 256, and 0 is unknown: get_disparity_map in data_loading/stereo_dataloader.py of the
    # development kit, argoverse-api. Its benchmark counts errors above 3, 5 or 10 px and 10 %, KITTI's 3 px and 5 %.
    LayoutRow(
        title="argoverse-stereo", protocol="kitti_2015", values=_KITTI_VALUES,
        about="`rectified_stereo_images_v1.1/**/stereo_front_left_rect/stereo_front_left_rect_TIME.jpg`, "
        "`stereo_front_right_rect`, `disparity_maps_v1.1/**/stereo_front_left_rect_disparity` (Argoverse 1)",
        files=({"left": _ARGOVERSE.format("left"), "right": _ARGOVERSE.format("right"), "name": "{path_}{frame}",
                "disparity_left": "disparity_maps_v1.1/{path}/stereo_front_left_rect_disparity/"
                "stereo_front_left_rect_disparity_{frame}.png"},),
    ),
    LayoutRow(
        title="sceneflow", protocol="scene_flow",
        values={"max_disparity": _SCENE_FLOW_RANGE, "decode": _decode_scene_flow},
        about="`frames_cleanpass/**/left/0006.png`, `right/0006.png`, `disparity/**/left/0006.pfm` (FlyingThings3D, "
        "Driving, Monkaa; or `frames_finalpass`); of the subset `image_clean`, `disparity_occlusions`",
        files=_variants(
            {"left": "<0>/{path}/left/{frame}.png|<0>/{path}/left/{frame}.webp",
             "right": "<0>/{path}/right/{frame}.png|<0>/{path}/right/{frame}.webp",
             "disparity_left": "disparity/{path}/left/{frame}.pfm|frames_disparity/{path}/left/{frame}.pfm",
             "disparity_right": "disparity/{path}/right/{frame}.pfm|frames_disparity/{path}/right/{frame}.pfm",
             "occluded": "disparity_occlusions/{path}/left/{frame}.png", "name": "<0>/{path_}{frame}"},
            ("frames_cleanpass",), ("frames_finalpass",), ("image_clean",), ("image_final",),
        ),
        facts=_scene_flow,
    ),
    LayoutRow(
        title="sintel", protocol="middlebury_v2", values={"decode": _decode_sintel},
        about="`clean_left/SEQUENCE/frame_0001.png`, `clean_right` (or `final_left`, `final_right`), `disparities`, "
        "`occlusions`, `outofframe`: the folder `training` of MPI Sintel's stereo data",
        files=_variants(
            {"left": "<0>_left/{path}/{frame}.png", "right": "<0>_right/{path}/{frame}.png",
             "disparity_left": "disparities/{path}/{frame}.png", "occluded": "occlusions/{path}/{frame}.png",
             "ignored": "outofframe/{path}/{frame}.png", "name": "<0>/{path_}{frame}"}, ("clean",), ("final",),
        ),
    ),
    LayoutRow(
        title="booster", protocol="booster", values={"decode": _decode_booster}, facts=_booster,
        about="`camera_00/im0.png`, `camera_02/im0.png`, `disp_00.npy`, `disp_02.npy`, `mask_00.png`, `mask_cat.png`, "
        "`calib_00-02.xml`: a folder of the balanced split",
        needs=("camera_0[12]",),
        files=({"left": "camera_00/{image}.png", "right": "camera_02/{image}.png", "disparity_left": "disp_00.npy",
                "disparity_right": "disp_02.npy", "mask.nonocc": "mask_00.png", "materials": "mask_cat.png",
                "calibration": "calib_00-02.xml", "name": "{folder}_{image}"},),
    ),
    LayoutRow(
        title="crestereo", protocol="middlebury_v2", values={"disparity_scale": 32.0},
        facts=lambda found: {} if "disparity_left" in found.files else None,
        about="`NAME_left.jpg`, `NAME_right.jpg`, `NAME_left.disp.png`, `NAME_right.disp.png` (codes / 32)",
        needs=("*_left.disp.png",),
        files=({"left": "{name}_left.jpg|{name}_left.png", "right": "{name}_right.jpg|{name}_right.png",
                "disparity_left": "{name}_left.disp.png", "disparity_right": "{name}_right.disp.png",
                "name": "{name}"},),
    ),
    LayoutRow(
        title="instereo2k", protocol="middlebury_v2", values={"disparity_scale": 100.0}, needs=("left_disp.png",),
        about="`left.png`, `right.png`, `left_disp.png`, `right_disp.png` (codes / 100)",
        files=({"left": "left.*", "right": "right.*", "disparity_left": "left_disp.png",
                "disparity_right": "right_disp.png"},),
    ),
    LayoutRow(
        title="driving-stereo", protocol="kitti_2015", values={"cameras": (101, 103)}, facts=_driving_stereo,
        about="`train-left-image`, `train-right-image`, `train-disparity-map` (or `test-...`, or "
        "`left-image-half-size`, `left-image-full-size` ... of a weather), "
        "`calib_train/half-image-calib/SEQUENCE.txt`",
        files=({"left": "{split}-left-image/{path}/{frame}.*", "right": "{split}-right-image/{path}/{frame}.*",
                "disparity_left": "{split}-disparity-map/{path}/{frame}.*", "name": "{split}-left-image/{frame}",
                "calibration": "calib_{split}/half-image-calib/{path}.txt"},
               *_variants({"left": "left-image-<0>-size/{sequence}_{frame}.*",
                           "right": "right-image-<0>-size/{sequence}_{frame}.*",
                           "disparity_left": "disparity-map-<0>-size/{sequence}_{frame}.*",
                           "name": "left-image-<0>-size/{sequence}_{frame}",
                           "calibration": f"../calib_train/{_DRIVING_CALIB}|../calib_test/{_DRIVING_CALIB}|"
                           f"calib/{_DRIVING_CALIB}|{_DRIVING_CALIB}"}, ("full",), ("half",))),
    ),
)  # fmt: skip


_MAX_BYTES = 1 << 28  # largest table
_COLUMNS = ("left", "right", "name", "calibration", "max_disparity", "min_disparity")
_WILD = re.compile(r"[*?\[]")
_GENERIC_NAMES = ("left", "im0", "im2", "iml", "view0", "view1", "image_0", "image_2", "colored_0")  # identify no scene
_MAX_RATE_DIFFERENCE = 0.005  # largest relative difference of two frame rates; 30000/1001 and 30 differ by 0.001
_MAX_FOLDERS = 8  # folders to search for two with matching images


# Keys of an image of a pattern, from the texts of its wildcards and from its path: two images with the same key are a
# pair. Words for left and right, as in left_0001 and right_0001, do not count. The first key with any pair is used.
_KEYS: tuple[Callable[[str, str], str], ...] = (
    lambda captured, path: without_word(captured, SIDES),
    lambda captured, path: without_word(path, SIDES),
    lambda captured, path: number[1] if (number := re.search(r"(\d+)\D*$", path)) else "",
)


def named_pairs(values: Mapping[str, Any]) -> list[Scene]:
    """Return the pairs that ``left`` and ``right`` name: two images, patterns, folders or videos.

    With ``halves``, or for an MPO file, the files of ``left`` contain both views.
    """
    left, right, halves = map(values.get, ("left", "right", "halves"))
    if halves is not None and halves not in (LEFT_RIGHT, TOP_BOTTOM):
        raise ConfigError(f"--halves: must be {LEFT_RIGHT} or {TOP_BOTTOM} (got {halves[:40]!r})")
    if halves is not None and (left is None or right is not None):
        raise ConfigError("--halves goes with --left alone, whose files hold both views")
    if left is None and right is None:
        return []
    if left is not None and right is None and (halves or left.suffix.lower() == ".mpo"):
        halves = halves or FRAMES
        if _is_many(left):
            return [_named(name, file, file, halves=halves) for name, file in _files_by_name(left)]
        right = left
    if left is None or right is None:
        raise ConfigError("--left needs --right, too" if right is None else "--right needs --left, too")
    if not halves and (_is_many(left) or _is_many(right)):
        return [*pairs_of_patterns(left, right)]
    pair = _named(name_of_file(left, *_GENERIC_NAMES), left, right, halves=halves or "")
    return [*_frames_of(pair, left, right)] if left.suffix.lower() in VIDEO_SUFFIXES else [pair]


def _files_by_name(place: Path) -> list[tuple[str, Path]]:
    """Return name and file of the images of a pattern or folder; names that repeat are preceded by the folder's."""
    files = [image.file for image in _images(place)]
    names = [file.stem for file in files]
    if len(set(names)) < len(names):
        names = ["_".join(file.with_suffix("").parts[-2:]) for file in files]
    return list(zip(names, files, strict=True))


def _frames_of(pair: StereoScene, left: Path, right: Path) -> list[StereoScene]:
    """Return the pairs of frames of two videos, or of one that holds both views.

    Raise ConfigError if one cannot be read, or their frame rates differ; warn if their lengths differ.
    """
    try:
        count, rate = frames_and_rate(left)
        other, other_rate = (count, rate) if pair.halves else frames_and_rate(right)
    except InputError as error:
        raise ConfigError(str(error)) from None
    if rate and other_rate and abs(rate / other_rate - 1) > _MAX_RATE_DIFFERENCE:
        raise ConfigError(
            f"{left} has {rate:g} frames a second, {right} {other_rate:g}: frames of the same number are not of one "
            "moment; bring both to one rate"
        )
    warnings: tuple[str, ...] = ()
    if count != other:
        line = (
            f"{left} has {count} frames, {right} {other}: the last {abs(count - other)} are not used; if a frame was "
            "dropped, all frames after it are paired with others than their own"
        )
        warnings = (line,)
    digits = max(6, len(str(max(count, other))))
    return [
        replace(pair, name=f"{number:0{digits}}", frame_number=number, warnings=warnings)
        for number in range(min(count, other))
    ]


def _named(name: str, left: Path, right: Path, **values: Any) -> StereoScene:
    """Return the pair of two files, which need not exist."""
    return StereoScene(name=name, folder=left.parent, left=left, right=right, **values)


def _is_many(path: Path) -> bool:
    """Return whether a path is a pattern or a folder."""
    return os.path.isdir(path) or (bool(_WILD.search(str(path))) and not os.path.lexists(path))


class _Image(NamedTuple):
    """An image of a pattern."""

    file: Path
    captured: str  # texts of the wildcards, without the ending
    path: str  # from the first part with a wildcard on, without the ending


def _images(place: Path) -> list[_Image]:
    """Return the images of a pattern or a folder, sorted. Raise ConfigError if there are none."""
    is_folder = os.path.isdir(place)
    parts = (*place.parts, "*") if is_folder else place.parts
    wild = [k for k, part in enumerate(parts) if _WILD.search(part)]
    n_fixed = wild[0] if wild and not is_folder else len(parts) - 1
    expressions = [re.compile(_with_groups(part)) for part in parts[n_fixed:]]
    images = []
    for file in sorted(map(Path, glob.glob(f"{glob.escape(str(place))}/*" if is_folder else str(place)))):
        if file.suffix.lower() in IMAGE_SUFFIXES:
            varying = file.parts[n_fixed:]
            matches = (one.fullmatch(part) for one, part in zip(expressions, varying, strict=True))
            texts = ("".join(match.groups()) for match in matches if match)
            captured = "/".join(filter(None, texts)).removesuffix(file.suffix)
            images.append(_Image(file, captured, str(Path(*varying).with_suffix(""))))
    if not images:
        if is_folder:
            Folder(place, "", "")  # raises InputError if it cannot be read
        query = "; a query behind its URL is read of archives alone" if ":/" in str(place) else ""
        raise ConfigError(f"{place}: matches no image{query}")
    return images


def _with_groups(part: str) -> str:
    """Return the regular expression for a part of a pattern, with a group for each wildcard."""
    groups = {"*": "(.*)", "?": "(.)"}
    pieces = re.split(r"(\*+|\?|\[[^\]]+\])", part)
    pieces[1::2] = [groups.get(each[0]) or f"({each.replace('[!', '[^', 1)})" for each in pieces[1::2]]
    pieces[::2] = map(re.escape, pieces[::2])
    return "".join(pieces)


def _by_key(images: Sequence[_Image], key: Callable[[str, str], str]) -> dict[str, Path]:
    """Return key -> image; images that share a key are left out, so that no wrong pair arises."""
    keys = [key(image.captured, image.path) for image in images]
    count = Counter(keys)
    return {key: image.file for key, image in zip(keys, images, strict=True) if key and count[key] == 1}


def pairs_of_patterns(left: Path, right: Path) -> list[StereoScene]:
    """Return the pairs of two patterns such as ``left/*.png`` and ``right/*.png``, or of two folders.

    An image without a partner is a pair with a problem. Raise ConfigError if no two images match.
    """
    images = _images(left), _images(right)
    for key in _KEYS:
        lefts, rights = (_by_key(some, key) for some in images)
        if lefts.keys() & rights.keys():
            break
    else:
        raise ConfigError(f"{left} and {right}: no two names belong together ({images[0][0].file.name}, ...)")
    scenes = {}
    for name in lefts | rights:
        file = lefts.get(name) or rights[name]
        absent = "right" if name not in rights else "left" if name not in lefts else ""
        problem = f"{file}: no {absent} image belongs to it" if absent else ""
        scenes[name] = StereoScene(name=name, folder=file.parent, left=file, right=rights.get(name), problem=problem)
    views = {"left": lefts, "right": rights}
    there = {name: {role: files[name] for role, files in views.items() if name in files} for name in scenes}
    for name, line in dropped(("left", "right"), there).items():
        scenes[name] = replace(scenes[name], warnings=(line,))
    return list(scenes.values())


def suggested_patterns(folder: Path) -> tuple[str, str] | None:
    """Return patterns for two folders in ``folder`` whose images match by name, or None if there are none."""
    places = sorted(Path(folder, name) for name in os.listdir(folder) if name[0] != ".")
    for both in itertools.combinations([place for place in places if os.path.isdir(place)][:_MAX_FOLDERS], 2):
        try:
            pairs = [scene for scene in pairs_of_patterns(*both) if not scene.problem]
        except (ConfigError, InputError):
            continue
        # With two images in each folder, each folder may just as well be a pair.
        if len(pairs) not in (0, 2):
            suffixes = [Counter(image.file.suffix for image in _images(place)).most_common(1)[0][0] for place in both]
            return f"{both[0]}/*{suffixes[0]}", f"{both[1]}/*{suffixes[1]}"
    return None


def scenes_of_table(path: Path) -> list[StereoScene]:
    """Return the pairs of a CSV or tab-separated file with one pair per line.

    Paths are relative to the file's folder, or to the current folder if the table is standard input (``-``).

    A first line with ``left`` and ``right`` names the columns; ``name``, ``calibration``, ``max_disparity`` and
    ``min_disparity`` are optional. Without such a line, the columns are left, right and name. Lines that begin with
    ``#`` are comments. The default name is the left file's, preceded by the line's number if names repeat.
    """
    with naming("standard input" if path == STDIN else path):
        data = sys.stdin.buffer.read() if path == STDIN else read_bytes(path, _MAX_BYTES)
        text = text_of(data, "surrogateescape")
        rows = table_rows(
            [line for line in text.splitlines(keepends=True) if line.strip() and not line.startswith("#")]
        )
        columns: tuple[str, ...] = _COLUMNS[:3]
        if rows and {"left", "right"} <= {word.strip().lower() for word in rows[0]}:
            columns = tuple(word.strip().lower() for word in rows.pop(0))
            if unknown := [word for word in columns if word not in _COLUMNS]:
                raise InputError(f"no such column: {', '.join(unknown)}; known: {', '.join(_COLUMNS)}")
            if len(set(columns)) < len(columns):
                raise InputError(f"two columns are called {Counter(columns).most_common(1)[0][0]!r}")
        if not rows:
            raise InputError("names no pair")
        fields = []
        for number, row in enumerate(rows, 1):
            fields.append({key: word.strip() for key, word in zip(columns, row, strict=False) if word.strip()})
            if len(row) > len(columns) or not {"left", "right"} <= fields[-1].keys():
                raise InputError(f"pair {number}: expected {', '.join(columns)} (got {','.join(row)[:60]!r})")
        taken = Counter(line["name"] for line in fields if "name" in line)
        if twice := [name for name, count in taken.items() if count > 1]:
            raise InputError(f"two lines are called {twice[0][:100]!r}")
    return [_pair_of_line(path.parent, name, line) for name, line in zip(_names_of(fields), fields, strict=True)]


def _pair_of_line(folder: Path, name: str, line: Mapping[str, str]) -> StereoScene:
    """Return the pair of a table's line; an invalid search range becomes its problem. Paths are below ``folder``."""
    left, values = folder / line["left"], dict[str, Any]()
    for key in {"max_disparity", "min_disparity"} & line.keys():
        if re.fullmatch(r"[-+]?[0-9]{1,7}", line[key]) and abs(int(line[key])) <= MAX_DISPARITY:
            values[key] = int(line[key])
        else:
            expected = f"expected a whole number up to {MAX_DISPARITY} (got {line[key][:40]!r})"
            values["problem"] = f"{left}: {key}: {expected}"
    if "calibration" in line:
        values["calibration"] = folder / line["calibration"]
    return _named(name, left, folder / line["right"], **values)


def _names_of(lines: Sequence[Mapping[str, str]]) -> list[str]:
    """Return the pairs' names; the default is the left file's, preceded by the line's number if names repeat."""
    names = [line.get("name") or Path(without_secrets(line["left"])).stem for line in lines]
    if len(set(names)) == len(names):
        return names
    taken = {line["name"] for line in lines if "name" in line}
    unique = []
    for number, (name, line) in enumerate(zip(names, lines, strict=True), 1):
        if "name" not in line:
            name = f"{number:0{len(str(len(names)))}}_{name}"
            while name in taken:
                name += "_"
            taken.add(name)
        unique.append(name)
    return unique
