"""Our own layout of color and depth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.io.formats.files import naming
from depthcli.io.formats.images import IMAGE_SUFFIXES
from depthcli.io.formats.plain_text import numbers
from depthcli.io.layouts import Folder, Layout, Meta
from depthcli.io.scenes import Scene
from depthcli.io.scenes.rgbd import RgbdScene

if TYPE_CHECKING:
    from depthcli.core.cameras.color_and_depth import Place

DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".pfm", ".npy", ".exr")


class Rgbd(Layout):
    """One folder per frame; the name of each file says what it holds."""

    kind = RgbdScene
    wants = (
        "`color.*`, `depth.*`, or the latter alone for `refine-kinect`; where known `depth_true.*`, "
        "`mask_<name>.*` (255 = evaluate), `sparse.*` (a second depth map, known at some pixels) with "
        "`sparse_confidence.*`, `meta.json` (`depth_scale`: codes a meter, 1000 unless said; `intrinsics`: fx, fy, cx, "
        "cy; `fb`: focal length x baseline, pixels x meters; `pose`: 4 x 4, from the camera to the world, meters; of "
        "depth that is not registered to the color image, `depth_intrinsics`: fx, fy, cx, cy, and `depth_to_color`: "
        "`rotation` 3 x 3, `translation` in meters)"
    )

    def scenes(self, folder: Folder) -> list[Scene]:
        return [] if folder.one("ir", IMAGE_SUFFIXES) else frames_of(self, folder)  # of rgb-ir


def frames_of(layout: Layout, folder: Folder, **more: Any) -> list[Scene]:
    """Return the frame of ``color.*`` and ``depth.*`` in ``folder``, if it has one; ``more``: its other fields."""
    color = folder.one("color", IMAGE_SUFFIXES)
    depth = folder.one("depth", DEPTH_SUFFIXES) or folder.one("depth_raw", DEPTH_SUFFIXES)
    if folder.requested == "sun-rgbd" or (color is None and depth is None):
        return []
    if depth is None and folder.starting("disparity", IMAGE_SUFFIXES):  # of kinect-raw
        return []
    problem = f"{folder.path}: only half of a frame, no depth.*" if depth is None else ""
    depth = depth or folder.path / "depth.png"
    sparse = {role: folder.one(role, DEPTH_SUFFIXES) for role in ("sparse", "sparse_confidence")}
    return [frame(layout, folder, color, depth, problem=problem, **sparse, **more)]


def frame(layout: Layout, folder: Folder, color: Path | None, depth: Path, **more: Any) -> Scene:
    """Return the scene of one frame, with the facts of the folder's meta.json; ``more`` are fields of the scene."""
    meta = folder.meta
    number = more.get("name", folder.name).rpartition("/")[2]
    end = f"_{number}" if folder.one(f"depth_true_{number}", DEPTH_SUFFIXES) else ""
    masks = folder.starting("mask_", IMAGE_SUFFIXES)
    scale = meta.positive("depth_scale")
    values: dict[str, Any] = {
        "depth_true": folder.one(f"depth_true{end}", DEPTH_SUFFIXES),
        "masks": {n.removesuffix(end): file for n, file in masks.items() if n.endswith(end)},
        **cameras(meta),
        "fb": meta.positive("fb"),
        "pose": meta.pose(),
        "protocol": meta.text("protocol", "depth"),
    }
    return layout.scene(folder, color=color, depth=depth, **values | ({"depth_scale": scale} if scale else {}) | more)


def cameras(meta: Meta) -> dict[str, Any]:
    """Return what meta.json says of both cameras, as fields of the scene.

    ``intrinsics`` are those of the color camera, at the root of the file or below that key.
    """
    return {
        "intrinsics": _intrinsics(meta, "intrinsics", meta.fields),
        "depth_intrinsics": _intrinsics(meta, "depth_intrinsics", {}),
        "depth_to_color": _depth_to_color(meta),
    }


def _intrinsics(meta: Meta, name: str, default: dict[str, Any]) -> tuple[float, float, float, float] | None:
    """fx, fy, cx, cy below the key ``name``, or in ``default``."""
    inner = meta.fields.get(name, default)
    if not isinstance(inner, dict):
        raise meta.error(name, "fx, fy, cx, cy")
    place = f"{name}: " if name in meta.fields else ""  # messages tell both cameras apart
    named = Meta(meta.path, {f"{place}{key}": value for key, value in inner.items()})
    values = [named.positive(f"{place}{key}") for key in ("fx", "fy", "cx", "cy")]
    fx, fy, cx, cy = values
    if fx is None or fy is None or cx is None or cy is None:
        if any(values) or name in meta.fields:
            raise meta.error(name, "all of fx, fy, cx, cy")
        return None
    return fx, fy, cx, cy


def _depth_to_color(meta: Meta) -> Place | None:
    value = meta.fields.get("depth_to_color")
    if value is None:
        return None
    from depthcli.core.cameras.color_and_depth import check_place

    if not isinstance(value, dict):
        raise meta.error("depth_to_color", "rotation and translation")
    with naming(meta.path):
        rotation = numbers(value.get("rotation"), "depth_to_color: rotation", (3, 3))
        translation = numbers(value.get("translation"), "depth_to_color: translation", (3,))
        check_place(rotation, translation)
    return tuple(rotation.ravel().tolist()), tuple(translation.tolist())
