"""The scenes of ``depthcli sample``, generated or real, written in our own layouts."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.cameras.triangulation import PairGeometry, depth_of_disparity
from depthcli.core.errors import ConfigError
from depthcli.core.frames import Image, RgbdFrame
from depthcli.core.maps import Mask
from depthcli.core.volumes import Grid
from depthcli.io.formats.calibrations import write_geometry
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.files import write_text
from depthcli.io.formats.images import read_color8, write_png
from depthcli.io.formats.volumes import write_array
from depthcli.io.rgbd_frames import load_frame, true_depth
from depthcli.io.scenes import Layouts, RgbdScene, Scene, StereoScene
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair, true_disparity
from depthcli.show.table import size_of
from depthcli.simulate.deformed_volumes import make_deformed_pair
from depthcli.simulate.depth_sensor import simulate_kinect
from depthcli.simulate.kinect_scenes import make_kinect_scene, make_kinect_sequence
from depthcli.simulate.stereo_scenes import KINDS, Kind, Radiometry, make_scene
from depthcli.simulate.transparent_scenes import (
    TransparentScene,
    cross_modal_pair,
    glass_of_pair,
    make_transparent_scene,
    sparse_samples,
)

_SEQUENCES = ("static", "moving")  # of Kinect frames
_MIN_WIDTH = 96  # pixels; twice the largest disparity of make_kinect_scene
_FB = 24.0  # pixel meters, of transparent scenes: a room of one to a few meters
_SPACING = (1.5, 1.5, 2.0)  # of volumes, x, y, z, mm
_SHAPE = (40, 56, 56)  # of volumes, z, y, x, voxels
_LARGEST_ERRORS = (3.0, 6.0, 1.0)  # of registration, voxels, in turn

_REAL_FILES = {"left": "motorcycle_left.png", "right": "motorcycle_right.png", "disparity_left": "motorcycle_disp.npz"}
_REAL_RANGE = 70  # px: ``ndisp`` of the benchmark's training scene at this size
# The calibration that ``skimage.data.stereo_motorcycle`` documents for its size.
_REAL_GEOMETRY = PairGeometry(Intrinsics(994.978, 994.978, 311.193, 254.877), 0.193001, 31.086, (741, 500))
_REAL_META = {
    "protocol": "middlebury_v2",
    "disp_scale": 1,
    "max_disparity": _REAL_RANGE,
    "masks": "none",
    "source": "Middlebury stereo data sets 2014, Motorcycle, a quarter of the full size, from scikit-image "
    "(skimage.data.stereo_motorcycle)",
    "citation": "D. Scharstein, H. Hirschmueller, Y. Kitajima, G. Krathwohl, N. Nesic, X. Wang, P. Westling: "
    "High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014",
    "notes": "Real photographs; true disparities of the left view, inf where unknown.",
}

Values = Mapping[str, Any]
"""Options of ``sample`` by name."""


@dataclass(frozen=True, kw_only=True)
class SampleScene(Scene):
    """A scene to generate, possibly from the files of another scene, ``origin``."""

    settings: dict[str, Any] = field(default_factory=dict)  # in addition to the options that all scenes share
    files: dict[str, Path] = field(default_factory=dict)
    origin: Scene | None = None

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that it is made from."""
        return self.files


def sample_scenes(sample: str, values: Values) -> list[SampleScene]:
    """Return the scenes of a kind of sample that the options describe. Raise ConfigError if options conflict."""
    if sample == "real":
        return [_real_scene()]
    seed, folder = values["seed"], values.get("from_")
    if folder is not None:
        layouts = Layouts.of(Scene, *PAIRS.rows, *FRAMES.rows) if sample == "transparent" else PAIRS
        lack = {"kinect": "no true disparity", "transparent": "no true depth"}.get(sample, "")
        return [_scene_from(scene, seed, lack) for scene in discover_scenes(folder, layouts)]
    if sample == "kinect":
        if values["width"] < _MIN_WIDTH:
            raise ConfigError(f"--width: at least {_MIN_WIDTH} for Kinect scenes (got {values['width']})")
        names = ("camouflage", "planes", "foreground", "curved", *(_SEQUENCES if values["frames"] else ()))
        settings = {name: {"kind": name, "seed": seed} for name in names}
    elif sample == "transparent":
        settings = {f"glass_{each}": {"seed": each} for each in (seed, seed + 1)}
    elif sample == "registration":  # small, large and tiny errors in turn
        largest = [_LARGEST_ERRORS[k % len(_LARGEST_ERRORS)] for k in range(values["count"])]
        settings = {f"pair_{seed + k}": {"seed": seed + k, "largest": error} for k, error in enumerate(largest)}
    else:  # the kinds in turn, the next seed after each round
        top, chosen = values["width"] // 2, tuple(dict.fromkeys(values["kind"] or KINDS[:4]))
        if values["max_disparity"] > top:
            raise ConfigError(f"--max-disparity: at most width / 2 = {top} (got {values['max_disparity']})")
        if unknown := [kind for kind in chosen if kind not in KINDS]:
            raise ConfigError(f"--kind: no kind called {unknown[0]!r}; one of: {', '.join(KINDS)}")
        turns = [(chosen[i % len(chosen)], seed + i // len(chosen)) for i in range(values["count"])]
        settings = {f"{kind}_{each}": {"kind": kind, "seed": each} for kind, each in turns}
    return [SampleScene(name=name, folder=Path(), settings=own) for name, own in settings.items()]


def _real_scene() -> SampleScene:
    """Return the real pair in the wheel of scikit-image. Raise ConfigError if this version lacks it."""
    package = importlib.util.find_spec("skimage")
    assert package is not None and package.origin is not None
    files = {role: Path(package.origin).parent / "data" / name for role, name in _REAL_FILES.items()}
    if missing := [file for file in files.values() if not file.is_file()]:
        raise ConfigError(f"--real: {missing[0]} is missing: this build of scikit-image has no stereo pair")
    return SampleScene(name="Motorcycle", folder=files["left"].parent, files=files)


def _scene_from(scene: Scene, seed: int, lack: str) -> SampleScene:
    """Return a scene to generate from another one; ``lack`` names the truth that it needs and may lack, or is empty."""
    truth = {role: getattr(scene, role, None) for role in ("depth_true", "disparity_left", "disparity_right")}
    files = scene.input_files | {role: file for role, file in truth.items() if file is not None}
    files |= {f"mask_{name}": file for name, file in getattr(scene, "masks", {}).items()}
    missing = f"{scene.folder}: {lack} to start from" if lack and not scene.has_truth else ""
    values: dict[str, Any] = {"problem": scene.problem or missing, "settings": {"seed": seed}}
    return SampleScene(name=scene.name, folder=scene.folder, files=files, origin=scene, **values)


def _write(folder: Path, images: Values, maps: Values, masks: Values, end: str = "") -> None:
    """Write images as PNG, maps that are not None as PFM, masks as PNG, by name; all names end with ``end``."""
    for name, image in (*images.items(), *((f"mask_{name}", mask) for name, mask in masks.items())):
        write_png(folder / f"{name}{end}.png", image)
    for name, values in maps.items():
        if values is not None:
            write_pfm(folder / f"{name}{end}.pfm", values)


def _write_meta(folder: Path, **meta: Any) -> None:
    known = {key: value for key, value in meta.items() if value is not None}
    write_text(folder / "meta.json", json.dumps(known, indent=1) + "\n")


class _Pair(NamedTuple):
    left: Image
    right: Image
    maps: dict[str, Any]  # by name
    masks: dict[str, Mask]  # by name
    protocol: str
    meta: dict[str, Any]  # further fields of meta.json


def _pair_of(origin: StereoScene) -> _Pair:
    """Return the images of a scene, and its truth if it has one."""
    pair, maps, masks = load_pair(origin), {}, {}
    if origin.has_truth:
        truth = true_disparity(origin)
        maps, masks = {"disp_left": truth.disparity, "disp_right": truth.right}, truth.masks
    meta = {
        "max_disparity": origin.max_disparity,
        "masks": "as in the source",
        "source": f"generated by depthcli sample: cross-modal, from {origin.name}",
        "notes": "left: grey of the scene's left image; right: infrared-like picture of its right image.",
    }
    return _Pair(pair.left, pair.right, maps, masks, origin.protocol or "middlebury_v2", meta)


def _generated_pair(values: Values, kind: Kind, seed: int) -> _Pair:
    """Return a generated pair with exact truth."""
    size = values["width"], values["height"], values["max_disparity"]
    radiometry = Radiometry.of_strength(values["radiometric"])
    chosen = {name: values[name] for name in ("noise", "wall_contrast", "brightness")}
    made = make_scene(kind, seed, *size, radiometry=radiometry, **chosen)
    notes = "Disparity at pixel centers and masks are exact; no pixel is unknown."
    if kind == "repetitive":
        shortest, longest = np.nanmin(made.repetition), np.nanmax(made.repetition)
        notes += f" The wall's pattern repeats after {shortest:.2f} to {longest:.2f} pixels."
    maps = {"disp_left": made.disparity_left, "disp_right": made.disparity_right}
    masks = {"nonocc": made.nonocc, "all": np.ones_like(made.nonocc), "disc": made.disc}
    meta = {
        "max_disparity": made.max_disparity,
        "masks": "exact",
        "notes": notes,
        "source": f"generated by depthcli sample: kind {kind}, seed {seed}",
    }
    return _Pair(made.left, made.right, maps, masks, "middlebury_v2", meta)


def _make_stereo(values: Values, scene: SampleScene, folder: Path) -> dict[str, Any]:
    """Write a pair, both true disparities, masks and meta.json; with ``speckles``, as of two kinds of camera."""
    seed = scene.settings["seed"]
    if isinstance(scene.origin, StereoScene):
        pair = _pair_of(scene.origin)
    else:
        pair = _generated_pair(values, scene.settings["kind"], seed)
    left, right, masks = pair.left, pair.right, pair.masks
    if "speckles" in values:
        left, right = cross_modal_pair(left, right, seed, values["speckles"])
    _write(folder, {"left": left, "right": right}, pair.maps, masks)
    facts = size_of(left)
    _write_meta(folder, protocol=pair.protocol, disp_scale=1, **facts, **pair.meta)
    return facts | ({"nonocc": round(float(masks["nonocc"].mean()), 6)} if "nonocc" in masks else {})


def _make_kinect(values: Values, scene: SampleScene, folder: Path) -> dict[str, Any]:
    """Write color, measured and true depth, masks and meta.json."""
    seed, fattening, size = scene.settings["seed"], values["fattening"], (values["width"], values["height"])
    kind = scene.settings.get("kind", "")
    if kind in _SEQUENCES:
        samples = make_kinect_sequence(kind, values["frames"], seed, *size, fattening=fattening)
    else:
        if isinstance(scene.origin, StereoScene):
            color, truth = read_color8(scene.origin.left), true_disparity(scene.origin).disparity
        else:
            color, truth = make_kinect_scene(kind, seed, *size)
        samples = [simulate_kinect(color, truth, seed, fattening=fattening)]
    for number, sample in enumerate(samples):
        maps = {"depth": sample.frame().depth, "depth_true": sample.depth_true()}
        masks = {name: getattr(sample, name) for name in ("gap", "occluded", "specular", "mismatch", "measured")}
        _write(folder, {"color": sample.color}, maps, masks, f"_{number:05d}" if kind in _SEQUENCES else "")
    source = f"generated by depthcli sample --kinect, seed {seed}"
    fb = RgbdFrame.fb  # of ``frame`` and ``depth_true`` above
    _write_meta(folder, protocol="depth", fb=fb, source=source, notes="meters; depth_true and masks are exact")
    return size_of(samples[0].truth) | {"frames": len(samples)}


def _make_transparent(values: Values, scene: SampleScene, folder: Path) -> dict[str, Any]:
    """Write color, depth of the sensor, sparse and true depth, mask and meta.json; of a pair also its infrared.

    Sparse depth is simulated from the ground truth. The right view of a pair becomes infrared, and one surface glass.
    """
    seed, origin = scene.settings["seed"], scene.origin
    meta: dict[str, Any] = {"notes": "sparse: emulated from depth_true; the rest is the source's"}
    if isinstance(origin, RgbdScene):
        frame, true = load_frame(origin), true_depth(origin)
        color, sensor, truth, masks = frame.color, frame.depth, true.depth, true.masks
    else:
        made, top = _glass(values, origin, seed)
        meta = {"fb": _FB, "notes": "meters; sparse: emulated from depth_true", "max_disparity": top}
        write_png(folder / "ir.png", made.infrared)
        write_text(folder / "calib.json", json.dumps({"rectified": True, "fb": _FB}) + "\n")
        sensor, truth = (depth_of_disparity(part, _FB) for part in (made.sensor, made.disparity))
        color, masks = made.color, {"transparent": made.mask}
    chosen = {"outliers": values["outliers"], "clustered": values["at_edges"], "seed": seed}
    sparse = sparse_samples(truth, color, values["share"], **chosen)
    _write(folder, {"color": color}, {"depth": sensor, "depth_true": truth, "sparse": sparse}, masks)
    source = f"generated by depthcli sample --transparent, seed {seed}"
    _write_meta(folder, protocol="depth", source=source, sparse_source="the truth", **meta)
    return size_of(color)


def _glass(values: Values, origin: Scene | None, seed: int) -> tuple[TransparentScene, int | None]:
    """Return a scene with a transparent surface, generated or made of a pair, and its largest disparity."""
    if isinstance(origin, StereoScene):
        pair = load_pair(origin)
        made = glass_of_pair(pair.left, pair.right, true_disparity(origin).disparity, seed, values["speckles"])
        return made, origin.max_disparity
    top = values["width"] // 8
    return make_transparent_scene(seed, values["width"], values["height"], top, values["speckles"]), top


def _make_registration(values: Values, scene: SampleScene, folder: Path) -> dict[str, Any]:
    """Write both volumes, the body's mask, the dense true error and meta.json."""
    largest, seed = scene.settings["largest"], scene.settings["seed"]
    pair = make_deformed_pair(seed, _SHAPE, largest, values["noise"])
    depth, height, width = _SHAPE
    error = np.linalg.norm(pair.residual * np.array(_SPACING), axis=-1).astype(np.float32)
    volumes = {"fixed": pair.fixed, "moving_warped": pair.warped, "mask": pair.mask.astype(np.float32)}
    for stem, array in (volumes | {"error_true": error}).items():
        write_array(folder / f"{stem}.nii.gz", Grid((width, height, depth), _SPACING), array)
    source = f"generated by depthcli sample --registration, seed {seed}"
    _write_meta(folder, protocol="registration", source=source, notes="error_true: exact, mm")
    mean = round(float(error[pair.mask].mean()), 6)
    return {"width": width, "height": height, "slices": depth, "mean_error": mean}


def _make_real(values: Values, scene: SampleScene, folder: Path) -> dict[str, Any]:
    """Write the real pair of scikit-image, its true disparities, calib.txt and meta.json."""
    from skimage.data import stereo_motorcycle

    left, right, disparity = stereo_motorcycle()
    _write(folder, {"left": left, "right": right}, {"disp_left": disparity}, {})
    write_geometry(folder / "calib.txt", _REAL_GEOMETRY, _REAL_RANGE)
    height, width = disparity.shape
    _write_meta(folder, width=width, height=height, **_REAL_META)
    return {"width": width, "height": height}


class SampleKind(NamedTuple):
    """A kind of generated scenes."""

    make: Callable[[Values, SampleScene, Path], dict[str, Any]]
    """Writes one scene into an empty folder and returns facts for the report."""
    options: tuple[str, ...]
    """The options of ``sample`` that it takes."""


_SIZE = ("width", "height", "max_disparity")
_OF_STEREO = ("count", "kind", "seed", *_SIZE, "noise", "radiometric", "brightness", "wall_contrast")
_OF_KINECT = ("seed", "width", "height", "frames", "fattening", "from_")
_OF_GLASS = ("seed", "width", "height", "share", "outliers", "speckles", "at_edges", "from_")
SAMPLE_KINDS = {
    "stereo": SampleKind(_make_stereo, _OF_STEREO),
    "real": SampleKind(_make_real, ()),
    "cross_modal": SampleKind(_make_stereo, (*_OF_STEREO, "speckles", "from_")),
    "kinect": SampleKind(_make_kinect, _OF_KINECT),
    "registration": SampleKind(_make_registration, ("count", "seed", "noise")),
    "transparent": SampleKind(_make_transparent, _OF_GLASS),
}
"""By the name of their option, with underscores; ``stereo`` without one."""
