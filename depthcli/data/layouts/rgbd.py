"""Our own layout of color and depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from depthcli.data.formats.images import IMAGE_SUFFIXES
from depthcli.data.layouts import Folder, Layout, Meta
from depthcli.data.scenes import Scene
from depthcli.data.scenes.rgbd import RgbdScene

DEPTH_SUFFIXES = (".png", ".pgm", ".tif", ".tiff", ".pfm", ".npy", ".exr")


class Rgbd(Layout):
    """One folder per frame; the name of each file says what it holds."""

    kind = RgbdScene
    wants = (
        "`color.*`, `depth.*`; where known `depth_true.*`, `mask_<name>.*` (255 = evaluate), `sparse.*` (a second "
        "depth map, known at some pixels) with `sparse_confidence.*`, `meta.json` "
        "(`depth_scale`: codes a meter, 1000 unless said; `intrinsics`: fx, fy, cx, cy; "
        "`fb`: focal length x baseline, pixels x meters)"
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
    missing = "color" if color is None else "depth" if depth is None else ""
    problem = f"{folder.path}: only half of a frame, no {missing}.*" if missing else ""
    color, depth = color or folder.path / "color.png", depth or folder.path / "depth.png"
    sparse = {role: folder.one(role, DEPTH_SUFFIXES) for role in ("sparse", "sparse_confidence")}
    return [frame(layout, folder, color, depth, problem=problem, **sparse, **more)]


def frame(layout: Layout, folder: Folder, color: Path, depth: Path, **more: Any) -> Scene:
    """Return the scene of one frame, with the facts of the folder's meta.json; ``more`` are fields of the scene."""
    meta = folder.meta
    number = more.get("name", folder.name).rpartition("/")[2]
    end = f"_{number}" if folder.one(f"depth_true_{number}", DEPTH_SUFFIXES) else ""
    masks = folder.starting("mask_", IMAGE_SUFFIXES)
    scale = meta.positive("depth_scale")
    values: dict[str, Any] = {
        "depth_true": folder.one(f"depth_true{end}", DEPTH_SUFFIXES),
        "masks": {n.removesuffix(end): file for n, file in masks.items() if n.endswith(end)},
        "intrinsics": intrinsics(meta),
        "fb": meta.positive("fb"),
        "protocol": meta.text("protocol", "depth"),
    }
    return layout.scene(folder, color=color, depth=depth, **values | ({"depth_scale": scale} if scale else {}) | more)


def intrinsics(meta: Meta) -> tuple[float, float, float, float] | None:
    """Return fx, fy, cx, cy of meta.json, at its root or below ``intrinsics``."""
    inner = meta.fields.get("intrinsics", meta.fields)
    if not isinstance(inner, dict):
        raise meta.error("intrinsics", "fx, fy, cx, cy")
    values = [Meta(meta.path, inner).positive(key) for key in ("fx", "fy", "cx", "cy")]
    fx, fy, cx, cy = values
    if fx is None or fy is None or cx is None or cy is None:
        if any(values):
            raise meta.error("intrinsics", "all of fx, fy, cx, cy")
        return None
    return fx, fy, cx, cy
