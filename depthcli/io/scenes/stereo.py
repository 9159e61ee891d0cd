"""Rectified stereo pairs."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.triangulation import PairGeometry
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image, StereoPair
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.formats.images import IMAGE_SUFFIXES, pair_of, read_grey, read_image, read_pair
from depthcli.io.formats.videos import VIDEO_SUFFIXES, count_frames, read_frame
from depthcli.io.pairs import NamedPair, is_many, match_patterns, read_table
from depthcli.io.scenes import Scene, check_same_size, name_of, together

MAX_DISPARITY = 1 << 20
"""Largest disparity, of either sign, that a file may ask for, pixels; no image is as wide."""

# Full-size widths of the Middlebury 2005 and 2006 sets lie between 1240 and 1396: the width tells the size.
_SCALE_BY_WIDTH = ((900, 1.0), (550, 2.0), (0, 3.0))
_GENERIC_NAMES = ("left", "im0", "im2", "iml", "view0", "view1", "image_0", "image_2", "colored_0")


@dataclass(frozen=True)
class StereoTruth:
    """Ground truth of one pair, as stored; the protocol derives regions and occlusions from it.

    Attributes
    ----------
    right, noc : the same for the right view, and for the visible pixels alone (KITTI); or None
    """

    disparity: NDArray[np.float32]  # (H, W) float32, pixels, NaN = unknown
    right: NDArray[np.float32] | None = None
    noc: NDArray[np.float32] | None = None
    objects: NDArray[np.bool_] | None = None  # (H, W) bool, foreground objects (KITTI 2015), or None
    masks: dict[str, NDArray[np.bool_]] = field(default_factory=dict)  # name -> (H, W) bool, True = evaluate
    scale: float | None = None  # codes per pixel that the files were read with; None = what their kind says


@dataclass(frozen=True, kw_only=True)
class StereoScene(Scene):
    """The files of one pair.

    Attributes
    ----------
    left, right : image files, or videos; ``right`` is None where there is only one view
    disparity_left, disparity_right, disparity_noc : ground truth files or None
    masks : name -> file; a pixel counts where the value is 255
    occluded, ignored : masks of pixels that the right view does not show, and of those that do not count (both: > 0);
        without a file of their own, ``nonocc`` and ``all`` are the others; or None
    decode : reads a truth map with a number of codes per pixel, (H, W) float32, pixels, NaN = unknown
    geometry : how disparities become depth, where the data set says so in another way; or None
    sequence : the first, the middle and the last frame of the sequence that this one belongs to, in order; empty for a
        single pair; see :func:`with_sequences`
    """

    left: Path
    right: Path | None = None
    frame_number: int | None = None  # of the videos' frames, from 0; None: ``left`` and ``right`` are images
    disparity_left: Path | None = None
    disparity_right: Path | None = None
    disparity_noc: Path | None = None
    disparity_scale: float | None = None  # codes per pixel of the ground truth; None = what the file's kind says
    scale_by_width: bool = False  # the scale follows from the map's width, as in the Middlebury 2005 and 2006 sets
    masks: dict[str, Path] = field(default_factory=dict, hash=False)
    occluded: Path | None = None
    ignored: Path | None = None
    objects: Path | None = None  # KITTI 2015 object map (> 0: foreground) or None
    materials: Path | None = None  # map of classes from 0 to 3, each a mask ``class_<k>`` (Booster), or None
    decode: Callable[[Path, float | None], NDArray[np.float32]] = read_disparity
    max_disparity: int | None = None  # largest disparity to search, inclusive, or None
    min_disparity: int = 0  # smallest disparity to search
    round_disparity: bool = False  # the truth is whole pixels, so that results are rounded first (v3: ``isint``)
    calibration: Path | None = None  # file that says how disparities become depth, or None
    cameras: tuple[int, int] = (2, 3)  # numbers of the pair's cameras in a calibration of several (KITTI)
    geometry: PairGeometry | None = None
    sequence: tuple[StereoScene, ...] = ()

    @classmethod
    def single(cls, values: Mapping[str, Any]) -> Self | None:
        """Return the pair of ``--left`` and ``--right``."""
        if not together(values, "left", "right"):
            return None
        left, right = values["left"], values["right"]
        return cls(name=name_of(left, _GENERIC_NAMES), folder=left.parent, left=left, right=right)

    @classmethod
    def named(cls, values: Mapping[str, Any]) -> list[Self]:
        """Return the pair of ``--left`` and ``--right``, those of two patterns or folders, the frames of two videos."""
        one = cls.single(values)
        if one is None or one.right is None:
            return []
        if is_many(one.left) or is_many(one.right):
            return [cls._of_pair(pair, Path()) for pair in match_patterns(one.left, one.right, IMAGE_SUFFIXES)]
        if one.left.suffix.lower() in VIDEO_SUFFIXES:
            try:
                counts = count_frames(one.left), count_frames(one.right)
            except InputError as error:
                raise ConfigError(str(error)) from None
            digits = max(6, len(str(max(counts))))
            return [replace(one, name=f"{number:0{digits}}", frame_number=number) for number in range(min(counts))]
        return [one]

    @classmethod
    def of_table(cls, path: Path) -> list[Self]:
        """Return the pairs of a CSV file."""
        return [cls._of_pair(pair, path.parent) for pair in read_table(path)]

    @classmethod
    def _of_pair(cls, pair: NamedPair, folder: Path) -> Self:
        there = pair.left or pair.right
        assert there is not None
        problem = ""
        if pair.left is None or pair.right is None:
            problem = f"{there}: no {'right' if pair.left else 'left'} image belongs to it"
        known: dict[str, Any] = {}
        for key in {"max_disparity", "min_disparity"} & pair.more.keys():
            text = pair.more[key]
            if re.fullmatch(r"[-+]?[0-9]{1,7}", text) and abs(int(text)) <= MAX_DISPARITY:
                known[key] = int(text)
            else:
                problem = f"{there}: {key}: want a whole number up to {MAX_DISPARITY} (got {text[:40]!r})"
        if "calibration" in pair.more:
            known["calibration"] = folder / pair.more["calibration"]
        return cls(
            name=pair.name, folder=there.parent, left=pair.left or there, right=pair.right, problem=problem, **known
        )

    @property
    def input_files(self) -> dict[str, Path]:
        """``left`` and, where there is one, ``right``."""
        return {"left": self.left} if self.right is None else {"left": self.left, "right": self.right}

    @property
    def is_first(self) -> bool:
        """True for a single pair and for the first frame of a sequence."""
        return not self.sequence or self.sequence[0].name == self.name

    @property
    def has_truth(self) -> bool:
        """True where the left view's disparity is known."""
        return self.disparity_left is not None

    def load_views(self) -> tuple[Image, Image]:
        """Return both images as they are, which need not agree; InputError where one cannot be read."""
        right = self._right()
        if self.frame_number is not None:
            return read_frame(self.left, self.frame_number), read_frame(right, self.frame_number)
        return read_image(self.left), read_image(right)

    def _right(self) -> Path:
        self.check()
        if self.right is None:
            raise InputError(f"{self.left.parent}: scene {self.name} has no right image")
        return self.right

    def load(self) -> StereoPair:
        """Return left and right image of one size and dtype, both grey where one is; InputError otherwise."""
        right = self._right()
        if self.frame_number is None:
            return read_pair(self.left, right)
        return pair_of(*self.load_views(), (self.left, right))

    def truth(self) -> StereoTruth:
        """Return ground truth and masks of the left view, as stored."""
        self.check()
        if self.disparity_left is None:
            raise InputError(f"{self.left.parent}: scene {self.name} has no ground truth")
        scale = self.disparity_scale
        if self.scale_by_width and scale is None:
            width = read_grey(self.disparity_left).shape[1]
            scale = next(scale for above, scale in _SCALE_BY_WIDTH if width > above)
        disparity = self.decode(self.disparity_left, scale)
        right, noc = (
            None if file is None else self.decode(file, scale) for file in (self.disparity_right, self.disparity_noc)
        )
        objects = None if self.objects is None else read_grey(self.objects) > 0
        masks = self.read_masks()
        others = [(self.disparity_noc, noc), (self.objects, objects), *masks.values()]
        for file, array in others:
            if file is not None and array is not None:
                check_same_size(file, array.shape, self.disparity_left, disparity.shape)
        counted = masks["all"][1] if self.ignored is not None else np.True_
        chosen = {name: mask & counted for name, (_, mask) in masks.items()}
        return StereoTruth(disparity, right, noc, objects, chosen, scale)

    def read_masks(self) -> dict[str, tuple[Path, NDArray[np.bool_]]]:
        """Return name -> file and (H, W) mask, True = evaluate."""
        masks = {name: (path, read_grey(path) == 255) for name, path in self.masks.items()}
        for name, file in (("all", self.ignored), ("nonocc", self.occluded)):
            if file is not None:
                masks[name] = file, read_grey(file) == 0
        if self.materials is not None:
            classes = read_grey(self.materials)
            masks |= {f"class_{k}": (self.materials, classes == k) for k in range(4)}
        return masks


def with_sequences(scenes: Sequence[Scene]) -> list[Scene]:
    """Return the scenes by name, of which stereo pairs know three frames of their sequence.

    Pairs whose left and right images lie in the same two folders, or which are frames of the same two videos, are a
    sequence in the order of their names.
    """
    ordered = sorted(scenes, key=lambda scene: scene.name)
    frames: dict[tuple[str, str, bool], list[StereoScene]] = {}
    for scene in ordered:
        if isinstance(scene, StereoScene) and scene.right is not None and not scene.problem:
            views, of_video = (str(scene.left), str(scene.right)), scene.frame_number is not None
            left, right = views if of_video else map(os.path.dirname, views)  # Path.parent takes long
            frames.setdefault((left, right, of_video), []).append(scene)
    three: dict[str, tuple[StereoScene, ...]] = {}
    for same in frames.values():
        if len(same) > 1:
            some = tuple(dict.fromkeys((same[0], same[len(same) // 2], same[-1])))
            three |= {scene.name: some for scene in same}
    return [
        replace(scene, sequence=three[scene.name]) if isinstance(scene, StereoScene) and scene.name in three else scene
        for scene in ordered
    ]
