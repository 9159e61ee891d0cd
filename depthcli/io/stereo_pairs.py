"""Load rectified pairs and their ground truth from the files of a scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.io.formats.disparity import known_truth
from depthcli.io.formats.files import shown
from depthcli.io.formats.images import image_size, pair_of, read_grey, read_image, read_pair, read_two_frames
from depthcli.io.formats.videos import read_frame
from depthcli.io.scenes import StereoScene, check_same_size
from depthcli.io.scenes.kinds import FRAMES, LEFT_RIGHT, TOP_BOTTOM, read_masks

# Full-size images of Middlebury 2005 and 2006 are 1240 to 1396 px wide, so that the width gives the scale.
_SCALE_BY_WIDTH = ((900, 1.0), (550, 2.0), (0, 3.0))


@dataclass(frozen=True)
class StereoTruth:
    """Ground truth of a pair as stored; the protocol derives regions and occlusions from it."""

    disparity: NDArray[np.float32]  # (H, W) float32, pixels, NaN = unknown
    right: NDArray[np.float32] | None = None  # the same for the right view
    noc: NDArray[np.float32] | None = None  # the same for visible pixels only (KITTI)
    objects: NDArray[np.bool_] | None = None  # (H, W) bool, foreground objects (KITTI 2015)
    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)  # name -> (H, W) bool, True = evaluate
    scale: float | None = None  # codes per pixel used to read the files; None: by their format


def load_views(scene: StereoScene) -> tuple[Image, Image]:
    """Return both images as stored; their sizes and dtypes may differ. Raise InputError if one cannot be read."""
    scene.check()
    left, right = scene.left, scene.right
    if right is None:
        raise InputError(f"{left.parent}: scene {scene.name} has no right image")
    if scene.halves == FRAMES:
        return read_two_frames(left)
    if scene.halves:
        whole = read_image(left) if scene.frame_number is None else read_frame(left, scene.frame_number)
        axis = 1 if scene.halves == LEFT_RIGHT else 0
        if whole.shape[axis] % 2:
            sides = f"{whole.shape[1]} x {whole.shape[0]}"
            raise InputError(f"{shown(left)}: {sides} pixels cannot be two views of one size, {scene.halves}")
        one, other = np.split(whole, 2, axis=axis)
        return np.ascontiguousarray(one), np.ascontiguousarray(other)
    if scene.frame_number is not None:
        return read_frame(left, scene.frame_number), read_frame(right, scene.frame_number)
    return read_image(left), read_image(right)


def load_pair(scene: StereoScene) -> StereoPair:
    """Return left and right image, both grey if one is. Raise InputError if their sizes or dtypes differ."""
    scene.check()
    if scene.right is None or scene.halves or scene.frame_number is not None:
        return pair_of(*load_views(scene), (scene.left, scene.right or scene.left))
    return read_pair(scene.left, scene.right)


def view_size(scene: StereoScene) -> tuple[int, int]:
    """Return height and width of the left view by the header of its file."""
    height, width = image_size(scene.left)
    return height // (1 + (scene.halves == TOP_BOTTOM)), width // (1 + (scene.halves == LEFT_RIGHT))


def true_disparity(scene: StereoScene) -> StereoTruth:
    """Return ground truth and masks of the left view as stored. Raise InputError if there is none."""
    scene.check()
    if (file := scene.disparity_left) is None:
        raise InputError(f"{scene.left.parent}: scene {scene.name} has no ground truth")
    scale = scene.disparity_scale
    if scene.scale_by_width and scale is None:
        width = read_grey(file).shape[1]
        scale = next(scale for above, scale in _SCALE_BY_WIDTH if width > above)
    disparity, right, noc = (
        None if each is None else known_truth(each, scene.decode(each, scale), scene.invalid)
        for each in (file, scene.disparity_right, scene.disparity_noc)
    )
    assert disparity is not None
    objects = None if scene.objects is None else read_grey(scene.objects) > 0
    read: dict[str, tuple[Path, NDArray[np.bool_]]] = {}
    for name, path in (("all", scene.ignored), ("nonocc", scene.occluded)):
        if path is not None:
            read[name] = path, read_grey(path) == 0
    if scene.materials is not None:
        classes = read_grey(scene.materials)
        read |= {f"class_{k}": (scene.materials, classes == k) for k in range(4)}
    for path, array in ((scene.disparity_noc, noc), (scene.objects, objects), *read.values()):
        if path is not None and array is not None:
            check_same_size(path, array.shape, file, disparity.shape)
    counted = np.True_ if scene.ignored is None else read["all"][1]
    masks = read_masks(scene.masks, file, disparity.shape) | {name: mask for name, (_, mask) in read.items()}
    masks = {name: mask & counted for name, mask in masks.items()}
    return StereoTruth(disparity, right, noc, objects, masks, scale)
