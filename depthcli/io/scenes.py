"""Folders of scenes: which files make a stereo scene, in the layouts that people have.

======================  ==============================================================================
``scenes``              ``<scene>/left.* right.* disp_left.* disp_right.* mask_<name>.* meta.json``
``middlebury-v2``       ``<scene>/im2 im6`` or ``imL imR`` or ``view1 view5``, with ``disp2 disp6``,
                        ``groundtruth`` or ``disp1 disp5``, and ``nonocc all disc`` where there are masks
``middlebury-v3``       ``<scene>/im0 im1 calib.txt disp0GT.pfm mask0nocc.png``
``eth3d``               the same with ``cameras.txt`` and ``images.txt``
``kitti-2012``          ``colored_0 colored_1`` (or ``image_0 image_1``) ``disp_occ disp_noc``
``kitti-2015``          ``image_2 image_3 disp_occ_0 disp_noc_0 obj_map``
======================  ==============================================================================
"""

from __future__ import annotations

import fnmatch
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.disparity import MAP_SUFFIXES, read_disparity
from depthcli.io.files import read_bytes
from depthcli.io.images import IMAGE_SUFFIXES, Image, read_grey, read_image

LAYOUTS = ("scenes", "middlebury-v2", "middlebury-v3", "eth3d", "kitti-2012", "kitti-2015")

Metric = Literal["v2", "v3", "kitti"]

# The search range and the scale of the ground truth of the data sets of the taxonomy paper, which
# come without a file that says them (vision.middlebury.edu/stereo/data/scenes2001, scenes2003).
_V2_FACTS = {
    "tsukuba": (16, 15),
    "venus": (8, 19),
    "teddy": (4, 59),
    "cones": (4, 59),
    "sawtooth": (8, 19),
    "bull": (8, 20),
    "poster": (8, 20),
    "barn1": (8, 19),
    "barn2": (8, 19),
}
# Full-size widths of the 2005 and 2006 sets lie between 1240 and 1396: the width tells the size.
_SCALE_BY_WIDTH = ((900, 1), (550, 2), (0, 3))


@dataclass(frozen=True)
class Truth:
    """Ground truth of one scene.

    Attributes
    ----------
    disparity : (H, W) float32, pixels, NaN = unknown
    right : the same for the right view, or None
    masks : name -> (H, W) bool, True = evaluate; ``all`` (``occ`` for KITTI) is always there
    metric : which benchmark's measures apply
    """

    disparity: NDArray[np.float32]
    right: NDArray[np.float32] | None
    masks: dict[str, NDArray[np.bool_]]
    metric: Metric


@dataclass(frozen=True)
class Scene:
    """The files of one scene. Nothing is opened before ``load_pair`` or ``load_truth``.

    Attributes
    ----------
    name : unique in its listing, with ``/`` where the scene lies in a data set's folder
    left, right : image files; ``right`` is None where there is only one view
    disparity_left, disparity_right : ground truth files or None
    disparity_scale : codes per pixel of the ground truth; None = what the file's kind says
    disparity_noc : KITTI's ground truth of the non-occluded pixels, or None
    masks : name -> file; a pixel counts where the value is 255
    objects : KITTI 2015 object map (> 0: foreground) or None
    max_disparity : largest disparity to search, inclusive, or None
    round_disparity : the truth is whole pixels, so that results are rounded first (v3: ``isint``)
    layout : one of ``LAYOUTS``
    metric : which benchmark's measures apply
    problem : why the scene's folder cannot be used (``load_pair`` and ``load_truth`` raise it), or empty
    """

    name: str
    left: Path
    right: Path | None = None
    disparity_left: Path | None = None
    disparity_right: Path | None = None
    disparity_scale: float | None = None
    disparity_noc: Path | None = None
    masks: dict[str, Path] = field(default_factory=dict)
    objects: Path | None = None
    max_disparity: int | None = None
    round_disparity: bool = False
    layout: str = "scenes"
    metric: Metric = "v2"
    problem: str = ""

    @property
    def input_files(self) -> tuple[Path, ...]:
        """The images a method may look at."""
        return (self.left,) if self.right is None else (self.left, self.right)

    def load_pair(self) -> tuple[Image, Image]:
        """Left and right image, same size, dtype and number of channels; InputError otherwise."""
        if self.problem:
            raise InputError(self.problem)
        if self.right is None:
            raise InputError(f"{self.left.parent}: scene {self.name} has no right image")
        left, right = read_image(self.left), read_image(self.right)
        if left.shape != right.shape or left.dtype != right.dtype:
            raise InputError(
                f"{self.right}: {_kind(right)}, but {self.left.name} is {_kind(left)}; the pair must agree"
            )
        return left, right

    def load_truth(self) -> Truth:
        """Ground truth and masks of the left view.

        Where a Middlebury scene brings both disparity maps but no masks, ``nonocc`` and ``disc`` are
        derived: nonocc = left and right truth agree within 1 px; disc = within 4 px of a jump
        of more than 2 px or of an occluded pixel.

        Raises
        ------
        InputError
            No ground truth, an unreadable file, or files of different sizes.
        """
        if self.problem:
            raise InputError(self.problem)
        if self.disparity_left is None:
            raise InputError(f"{self.left.parent}: scene {self.name} has no ground truth")
        disparity = self._read(self.disparity_left)
        right = None if self.disparity_right is None else self._read(self.disparity_right)
        known = ~np.isnan(disparity)
        masks: dict[str, NDArray[np.bool_]] = {}
        if self.metric == "kitti":
            masks["occ"] = known
            if self.disparity_noc is not None:
                masks["noc"] = ~np.isnan(self._same(self._read(self.disparity_noc), disparity, self.disparity_noc))
            if self.objects is not None:
                objects = self._same(read_grey(self.objects), disparity, self.objects) > 0
                masks["bg"], masks["fg"] = known & ~objects, known & objects
        else:
            for name, path in self.masks.items():
                masks[name] = self._same(_read_mask(path), disparity, path)
            masks.setdefault("all", known)
            if self.layout == "middlebury-v2" and right is not None and right.shape == disparity.shape:
                for name, mask in derive_masks(disparity, right).items():
                    masks.setdefault(name, mask)
        order: list[str] = [name for name in ("nonocc", "all", "disc", "noc", "occ") if name in masks]
        order += sorted(set(masks) - set(order))
        return Truth(disparity, right, {name: masks[name] for name in order}, self.metric)

    def _read(self, path: Path) -> NDArray[np.float32]:
        return read_disparity(path, self.disparity_scale)

    def _same(self, array: NDArray[Any], truth: NDArray[np.float32], path: Path) -> NDArray[Any]:
        if array.shape != truth.shape:
            assert self.disparity_left is not None
            raise InputError(f"{path}: {_size(array)}, but {self.disparity_left.name} is {_size(truth)}")
        return array


def derive_masks(left: NDArray[np.float32], right: NDArray[np.float32]) -> dict[str, NDArray[np.bool_]]:
    """Evaluation masks from the ground truth of both views.

    Parameters
    ----------
    left, right : (H, W) float32, pixels, NaN = unknown

    Returns
    -------
    ``nonocc``, ``all``, ``disc`` : (H, W) bool. all: left truth known. nonocc: all, right truth at
    round(x - d) known and within 1 px. disc: a 9x9 dilation of 4-neighbour jumps > 2 px (unknown counted as 0)
    and of occluded pixels, inside nonocc (the construction of the Middlebury v2 masks).
    """
    known = ~np.isnan(left)
    filled = np.where(known, left, 0).astype(np.float32)
    rows, cols = np.indices(left.shape)
    target = cols - np.floor(filled + 0.5).astype(np.int64)
    inside = known & (target >= 0)
    other = right[rows, np.clip(target, 0, left.shape[1] - 1)]
    with np.errstate(invalid="ignore"):
        nonocc = inside & (np.abs(other - left) <= 1)
    edge = known & ~nonocc
    for axis in (0, 1):
        jump = np.abs(np.diff(filled, axis=axis)) > 2
        before = [(0, 1) if a == axis else (0, 0) for a in (0, 1)]
        after = [(1, 0) if a == axis else (0, 0) for a in (0, 1)]
        edge |= np.pad(jump, before) | np.pad(jump, after)
    near = cv2.dilate(edge.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    return {"nonocc": nonocc, "all": known, "disc": near & nonocc}


def find_scenes(folder: Path | str, layout: str | None = None, pattern: str = "*") -> list[Scene]:
    """The scenes of a folder, sorted by name.

    ``folder`` may be one scene, a folder of scenes, or a folder of such folders (names are then
    ``<data set>/<scene>``). Folders that hold no scene are passed over.

    Parameters
    ----------
    folder : where to look
    layout : one of ``LAYOUTS``; None recognizes it, for every scene folder by itself
    pattern : shell pattern that the name, or its last part, must match

    Raises
    ------
    InputError
        No such folder, no scene, no match; or ``folder`` is itself a scene that fits two layouts, has a broken
        meta.json or the like. A scene below it with such a ``problem`` is listed with it.
    """
    folder = Path(folder)
    if layout is not None and layout not in LAYOUTS:
        raise InputError(f"no layout called {layout!r}; one of: {', '.join(LAYOUTS)}")
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    found = _scenes_at(folder, folder.resolve().name, "", layout)
    if not found:
        for child in _subfolders(folder):
            here = _scenes_or_problem(child, child.name, layout)
            if not here:
                for grandchild in _subfolders(child):
                    name = f"{child.name}/{grandchild.name}"
                    here += _scenes_or_problem(grandchild, name, layout)
            found += here
    if not found:
        wanted = f"layout {layout}" if layout else "none of the layouts " + ", ".join(LAYOUTS)
        raise InputError(
            f"{folder}: no scenes found ({wanted}); looked for left/right, im0/im1, im2/im6, imL/imR, view1/view5 "
            f"image pairs in it and two levels below, and for image_2/image_3 or colored_0/colored_1 folders"
        )
    found.sort(key=lambda scene: scene.name)
    chosen = [
        s
        for s in found
        if fnmatch.fnmatchcase(s.name, pattern) or fnmatch.fnmatchcase(s.name.rpartition("/")[2], pattern)
    ]
    if not chosen:
        names = ", ".join(scene.name for scene in found[:6])
        raise InputError(
            f"{folder}: no scene matches {pattern!r}; there are: {names}{', ...' if len(found) > 6 else ''}"
        )
    return chosen


def _scenes_or_problem(folder: Path, name: str, layout: str | None) -> list[Scene]:
    """As ``_scenes_at``; a folder that cannot be used is one scene with its problem, and spoils no other."""
    try:
        return _scenes_at(folder, name, name + "/", layout)
    except InputError as error:
        return [Scene(name, folder, problem=str(error))]


def _scenes_at(folder: Path, name: str, prefix: str, layout: str | None) -> list[Scene]:
    """Scenes that ``folder`` itself holds: one by its own files, or many as a KITTI root."""
    try:
        names = {entry.name for entry in folder.iterdir()}
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error
    fitting = {kind: pair for kind, pair in _candidates(folder, names).items() if layout in (None, kind)}
    if len(fitting) > 1:
        raise InputError(f"{folder}: fits the layouts {' and '.join(sorted(fitting))}; say which with --layout")
    for kind, (left, right) in fitting.items():
        if kind == "scenes":
            return [_own_scene(folder, name, left, right)]
        if kind == "middlebury-v2":
            return [_v2_scene(folder, name, left, right)]
        return [_v3_scene(folder, name, left, right, kind)]
    return _kitti_scenes(folder, prefix, names, layout)


def _candidates(folder: Path, names: set[str]) -> dict[str, tuple[Path, Path | None]]:
    def pair(left: str, right: str) -> tuple[Path | None, Path | None]:
        return _one(folder, names, left, IMAGE_SUFFIXES), _one(folder, names, right, IMAGE_SUFFIXES)

    found: dict[str, tuple[Path, Path | None]] = {}
    left, right = pair("left", "right")
    if left is not None and (right is not None or any(_stem(n) == "disp_left" for n in names)):
        found["scenes"] = (left, right)
    left, right = pair("im0", "im1")
    if left is not None and right is not None:
        found["eth3d" if {"cameras.txt", "images.txt"} <= names else "middlebury-v3"] = (left, right)
    for stems in (("im2", "im6"), ("imL", "imR"), ("view1", "view5")):
        left, right = pair(*stems)
        if left is not None and right is not None:
            found["middlebury-v2"] = (left, right)
            break
    return found


def _own_scene(folder: Path, name: str, left: Path, right: Path | None) -> Scene:
    names = {entry.name for entry in folder.iterdir()}
    meta = _read_meta(folder / "meta.json") if "meta.json" in names else {}
    masks = {}
    for entry in sorted(names):
        stem, suffix = _stem(entry), Path(entry).suffix.lower()
        if stem.startswith("mask_") and suffix in IMAGE_SUFFIXES and not stem.endswith("_right"):
            masks[stem.removeprefix("mask_")] = folder / entry
    truth = _one(folder, names, "disp_left", MAP_SUFFIXES)
    scale = meta.get("disp_scale")
    metric: Metric = "v2"
    described = meta.get("masks")
    sparse = isinstance(described, str) and "sparse" in described
    if not masks and truth is not None and (sparse or (scale == 256 and truth.suffix.lower() == ".png")):
        metric = "kitti"
    elif "disc" not in masks and truth is not None and truth.suffix.lower() in (".pfm", ".npy"):
        metric = "v3"
    return Scene(
        name=name,
        left=left,
        right=right,
        disparity_left=truth,
        disparity_right=_one(folder, names, "disp_right", MAP_SUFFIXES),
        disparity_scale=scale,
        disparity_noc=_one(folder, names, "disp_left_noc", MAP_SUFFIXES),
        masks=masks,
        max_disparity=meta.get("max_disparity"),
        metric=metric,
    )


def _v2_scene(folder: Path, name: str, left: Path, right: Path | None) -> Scene:
    names = {entry.name for entry in folder.iterdir()}
    meta = _read_meta(folder / "meta.json") if "meta.json" in names else {}
    later = _stem(left.name) == "view1"
    truth = truth_right = None
    for stems in (("disp1", "disp5"),) if later else (("disp2", "disp6"), ("groundtruth", "")):
        truth = _one(folder, names, stems[0], MAP_SUFFIXES)
        truth_right = _one(folder, names, stems[1], MAP_SUFFIXES) if stems[1] else None
        if truth is not None:
            break
    scale, top = _V2_FACTS.get(folder.name.lower(), (None, None))
    if later and truth is not None:
        width = read_grey(truth).shape[1]
        scale, top = next(factor for least, factor in _SCALE_BY_WIDTH if width > least), None
    masks = {}
    for mask in ("nonocc", "all", "disc"):
        path = _one(folder, names, mask, IMAGE_SUFFIXES) or _one(folder, names, f"mask_{mask}", IMAGE_SUFFIXES)
        if path is not None:
            masks[mask] = path
    return Scene(
        name=name,
        left=left,
        right=right,
        disparity_left=truth,
        disparity_right=truth_right,
        disparity_scale=meta.get("disp_scale", scale),
        masks=masks,
        max_disparity=meta.get("max_disparity", top),
        layout="middlebury-v2",
    )


def _v3_scene(folder: Path, name: str, left: Path, right: Path | None, layout: str) -> Scene:
    names = {entry.name for entry in folder.iterdir()}
    calib = _read_calib(folder / "calib.txt") if "calib.txt" in names else {}
    top = calib.get("ndisp")
    # ETH3D writes the image width where Middlebury writes the search range.
    if top is not None and (top < 1 or top >= calib.get("width", np.inf)):
        top = None
    mask = _one(folder, names, "mask0nocc", IMAGE_SUFFIXES)
    return Scene(
        name=name,
        left=left,
        right=right,
        disparity_left=_one(folder, names, "disp0GT", (".pfm",)) or _one(folder, names, "disp0", (".pfm",)),
        disparity_right=_one(folder, names, "disp1GT", (".pfm",)) or _one(folder, names, "disp1", (".pfm",)),
        masks={} if mask is None else {"nonocc": mask},
        max_disparity=None if top is None else int(top),
        round_disparity=calib.get("isint", 0) == 1,
        layout=layout,
        metric="v3",
    )


def _kitti_scenes(folder: Path, prefix: str, names: set[str], layout: str | None) -> list[Scene]:
    roots = []
    if {"image_2", "image_3"} <= names and layout in (None, "kitti-2015"):
        roots.append(("kitti-2015", "image_2", "image_3", "disp_occ_0", "disp_noc_0"))
    for views in (("colored_0", "colored_1"), ("image_0", "image_1")):
        if set(views) <= names and layout in (None, "kitti-2012"):
            roots.append(("kitti-2012", *views, "disp_occ", "disp_noc"))
            break
    if len(roots) > 1:
        raise InputError(f"{folder}: fits the layouts kitti-2012 and kitti-2015; say which with --layout")
    found = []
    for kind, view_0, view_1, occ, noc in roots:
        for left in sorted(folder.joinpath(view_0).glob("*_10.png")):

            def beside(where: str, name: str = left.name) -> Path | None:
                path = folder / where / name
                return path if path.is_file() else None

            found.append(
                Scene(
                    name=prefix + left.stem,
                    left=left,
                    right=beside(view_1),
                    disparity_left=beside(occ),
                    disparity_scale=256.0,
                    disparity_noc=beside(noc),
                    objects=beside("obj_map") if kind == "kitti-2015" else None,
                    layout=kind,
                    metric="kitti",
                )
            )
    return found


def _one(folder: Path, names: Iterable[str], stem: str, suffixes: tuple[str, ...]) -> Path | None:
    """The file of that stem; InputError where several endings compete."""
    fitting = sorted(n for n in names if _stem(n) == stem and Path(n).suffix.lower() in suffixes)
    if len(fitting) > 1:
        raise InputError(f"{folder}: both {fitting[0]} and {fitting[1]}; keep one")
    return folder / fitting[0] if fitting else None


def _stem(name: str) -> str:
    return Path(name).stem


def _subfolders(folder: Path) -> list[Path]:
    return sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))


def _read_meta(path: Path) -> dict[str, Any]:
    """meta.json, with the fields we use checked."""
    try:
        meta = json.loads(read_bytes(path).decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error})") from error
    if not isinstance(meta, dict):
        raise InputError(f"{path}: want a JSON object, got {type(meta).__name__}")
    meta = {key: value for key, value in meta.items() if value is not None}
    for key in ("disp_scale", "max_disparity"):
        if key in meta:
            value = meta[key]
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e6:
                raise InputError(f"{path}: {key}: want a positive number (got {value!r})")
    if "disp_scale" in meta:
        meta["disp_scale"] = float(meta["disp_scale"])
    if "max_disparity" in meta:
        if meta["max_disparity"] != int(meta["max_disparity"]):
            raise InputError(f"{path}: max_disparity: want whole pixels (got {meta['max_disparity']!r})")
        meta["max_disparity"] = int(meta["max_disparity"])
    return meta


def _read_calib(path: Path) -> dict[str, float]:
    """The plain numbers of a Middlebury calib.txt (``key=value`` lines)."""
    text = read_bytes(path).decode("utf-8", "replace")
    values = {}
    for key, value in re.findall(r"^\s*(\w+)\s*=\s*([-+0-9.eE]+)\s*$", text, re.MULTILINE):
        try:
            values[key] = float(value)
        except ValueError:
            raise InputError(f"{path}: {key}: want a number (got {value!r})") from None
    return values


def _read_mask(path: Path) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = read_grey(path) == 255
    return mask


def _size(array: NDArray[Any]) -> str:
    return f"{array.shape[1]} x {array.shape[0]}"


def _kind(array: NDArray[Any]) -> str:
    return f"{_size(array)} {'grey' if array.ndim == 2 else 'colour'} {array.dtype}"
