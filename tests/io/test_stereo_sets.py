"""Data sets of stereo pairs with conventions of their own, on miniatures that follow the sets' documents."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.evaluation import protocols
from depthcli.io.formats.calibrations import Reading, read_geometry
from depthcli.io.formats.images import write_png
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, scenes_with_files
from depthcli.io.scenes.pairs import PAIRS
from tests.contracts.layouts import check_layout
from tests.files import laid
from tests.golden import refused
from tests.scenes import load, true

HEIGHT, WIDTH = 6, 8
COLOR = np.dstack([np.arange(48, dtype=np.uint8).reshape(HEIGHT, WIDTH) + k for k in range(3)]).astype(np.uint8)
DISPARITY = np.full((HEIGHT, WIDTH), 2.5, np.float32)
DISPARITY[2:4, 3:] = 4.25


def find(folder: Path) -> list:
    return discover_scenes(folder, PAIRS)


def pair(folder: Path, pattern: str, sides: tuple[str, str] = ("left", "right")) -> Path:
    """Write both views, whose names have the side at every {}; return the folder."""
    return laid(folder, {pattern.replace("{}", side): COLOR for side in sides})


def codes(disparity: np.ndarray, scale: float) -> np.ndarray:
    return np.where(np.isnan(disparity), 0, np.rint(disparity * scale)).astype(np.uint16)


@pytest.mark.parametrize("where", ["TRAIN/A/0000", "15mm_focallength/scene_forwards/fast", "a_rain_of_stones_x2"])
def test_the_three_scene_flow_sets(tmp_path: Path, where: str):
    root = tmp_path / "Set"
    for name in ("cleanpass", "finalpass"):
        pair(root / f"frames_{name}" / where, "{}/0006.png")
    laid(root / "disparity" / where, {"left/0006.pfm": DISPARITY, "right/0006.pfm": DISPARITY})
    clean, final = find(root)
    name = "_".join([*where.split("/"), "0006"])  # one table for each pass, not for each sequence
    assert (clean.name, final.name) == (f"frames_cleanpass/{name}", f"frames_finalpass/{name}")
    assert (clean.layout, clean.protocol, clean.max_disparity) == ("sceneflow", "scene_flow", 192)
    assert clean.disparity_left is not None and clean.disparity_left == final.disparity_left
    assert scenes_with_files([clean.disparity_left], ALL_KINDS)[clean.disparity_left].folder == root
    truth = true(clean)
    np.testing.assert_array_equal(truth.disparity, DISPARITY)
    np.testing.assert_array_equal(truth.right, DISPARITY)
    assert [scene.name for scene in find(tmp_path)] == [f"Set/{clean.name}", f"Set/{final.name}"]
    check_layout("sceneflow", root)


def test_negative_disparities_and_occlusions_of_the_subset_and_webp(tmp_path: Path):
    occluded = np.zeros((HEIGHT, WIDTH), np.uint8)
    occluded[:, 0] = 255
    pair(tmp_path / "train/image_clean", "{}/0000000.png")
    laid(
        tmp_path / "train",
        {"disparity/left/0000000.pfm": -DISPARITY, "disparity_occlusions/left/0000000.png": occluded},
    )
    (scene,) = find(tmp_path)
    assert scene.name == "train/image_clean/0000000"
    truth = true(scene)
    np.testing.assert_array_equal(truth.disparity, DISPARITY)
    assert truth.right is None
    np.testing.assert_array_equal(truth.masks["nonocc"], occluded == 0)
    pair(tmp_path / "webp/frames_cleanpass", "a/{}/0006.webp")
    refused(InputError, load, find(tmp_path / "webp")[0])


def packed(disparity: np.ndarray) -> np.ndarray:
    red = np.floor(disparity / 4)
    green = np.floor((disparity - 4 * red) * 64)
    blue = np.floor((disparity - 4 * red - green / 64) * 16384)
    return np.dstack([red, green, blue]).astype(np.uint8)


def test_sintel(tmp_path: Path):
    values = DISPARITY.copy()
    values[0, :4] = 0, 1023.9999, 100 + 1 / 64, 7 + 3 / 16384
    hidden, outside = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    hidden[4], outside[:, 0] = 255, 255
    for name in ("clean", "final"):
        pair(tmp_path / "training", f"{name}_{{}}/alley_1/frame_0001.png")
    for kind, image in (("disparities", packed(values)), ("occlusions", hidden), ("outofframe", outside)):
        write_png(tmp_path / "training" / kind / "alley_1/frame_0001.png", image)
    clean, final = find(tmp_path / "training")
    assert (clean.name, final.name) == ("clean/alley_1_frame_0001", "final/alley_1_frame_0001")
    truth = true(final)
    assert np.isnan(truth.disparity[0, 0])
    np.testing.assert_allclose(truth.disparity[0, 1:4], [1023.9999, 100 + 1 / 64, 7 + 3 / 16384], rtol=0, atol=1e-4)
    np.testing.assert_array_equal(truth.disparity[1:], DISPARITY[1:])
    np.testing.assert_array_equal(truth.masks["all"], outside == 0)
    np.testing.assert_array_equal(truth.masks["nonocc"], (outside == 0) & (hidden == 0))
    assert {"all", "nonocc"} <= set(protocols.load(final.protocol)().truth(final).masks)
    assert next(scene.name for scene in find(tmp_path)) == "training/clean/alley_1_frame_0001"
    check_layout("sintel", tmp_path)
    write_png(tmp_path / "training/disparities/alley_1/frame_0001.png", codes(DISPARITY, 256))
    refused(InputError, true, final)


def driving_calib(root: Path, size: str, sequence: str) -> Path:
    row = "1003.5 0.0 479.5 {} 0.0 1003.5 200.1 0.0 0.0 0.0 1.0 0.0\n"
    file = f"calib_train/{size}-image-calib/{sequence}.txt"
    return laid(root, {file: f"P_rect_101: {row.format(0.0)}P_rect_103: {row.format(-546.9)}"}) / file


def test_driving_stereo(tmp_path: Path):
    frame = "2018-07-09-16-11-56_2018-07-09-16-12-26-502"
    name = f"2018-07-09-16-11-56/{frame}"
    pair(tmp_path, f"train-{{}}-image/{name}.jpg")
    unknown = DISPARITY.copy()
    unknown[0] = np.nan
    write_png(tmp_path / f"train-disparity-map/{name}.png", codes(unknown, 256))
    calib = driving_calib(tmp_path, "half", "2018-07-09-16-11-56")
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout, scene.max_disparity) == (f"train-left-image/{frame}", "driving-stereo", 255)
    np.testing.assert_array_equal(true(scene).disparity, unknown)
    assert scene.calibration == calib
    geometry = read_geometry(calib, Reading(cameras=scene.cameras))
    assert (geometry.left.fx, geometry.baseline) == (1003.5, pytest.approx(546.9 / 1003.5))
    check_layout("driving-stereo", tmp_path)
    # Frames of the full size have another scale.
    name = "2018-10-31-06-55-01_2018-10-31-07-35-30-878.png"
    for size, scale in (("half", 256), ("full", 128)):
        pair(tmp_path / "cloudy", f"{{}}-image-{size}-size/{name}")
        write_png(tmp_path / f"cloudy/disparity-map-{size}-size/{name}", codes(DISPARITY, scale))
    calib = driving_calib(tmp_path, "full", "2018-10-31-06-55-01")
    full, half = find(tmp_path / "cloudy")
    assert [(s.disparity_scale, s.calibration) for s in (full, half)] == [(128, calib), (256, None)]
    for scene in (full, half):
        np.testing.assert_array_equal(true(scene).disparity, DISPARITY)


@pytest.mark.parametrize(("layout", "frame", "image", "truth", "scale"), [
    ("crestereo", "hole/0003c2ad-2128", "hole/0003c2ad-2128_{}.jpg", "hole/0003c2ad-2128_{}.disp.png", 32),
    ("instereo2k", "part1/000003", "part1/000003/{}.png", "part1/000003/{}_disp.png", 100),
])  # fmt: skip
def test_sets_with_integer_codes(tmp_path: Path, layout: str, frame: str, image: str, truth: str, scale: float):
    unknown = DISPARITY.copy()
    unknown[1] = np.nan
    pair(tmp_path, image)
    laid(tmp_path, {truth.format(side): codes(unknown, scale) for side in ("left", "right")})
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout) == (frame, layout)
    for values in (true(scene).disparity, true(scene).right):
        np.testing.assert_array_equal(values, unknown)
    assert set(protocols.load(scene.protocol)().truth(scene).masks) == {"nonocc", "all", "disc"}
    check_layout(layout, tmp_path / frame.partition("/")[0])


def test_middlebury_2021_has_masks_by_both_views(tmp_path: Path):
    left, right = DISPARITY.copy(), np.full((HEIGHT, WIDTH), 2.5, np.float32)
    left[0, 5] = right[5, 3] = np.inf
    camera = "[1734.16 0 333.49; 0 1734.16 958.05; 0 0 1]"
    numbers = "doffs=0 baseline=529.50 width=1920 height=1080 ndisp=170 vmin=55 vmax=142\n".replace(" ", "\n")
    images = dict.fromkeys(("im0.png", "im1.png", "ambient/L0/im0e0.png"), COLOR)
    laid(tmp_path / "artroom1", images | {"disp0.pfm": left, "disp1.pfm": right})
    (tmp_path / "artroom1/calib.txt").write_text(f"cam0={camera}\ncam1={camera}\n{numbers}")
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.max_disparity, scene.masks) == ("middlebury-v3", 170, {})
    masks = protocols.load(scene.protocol)().truth(scene).masks
    assert list(masks) == ["nonocc", "all"]
    expected = np.isfinite(left) & (left == 2.5) & (np.arange(WIDTH) >= 3)
    expected[5, 6] = False  # its match, 3 px to the left, is unknown
    np.testing.assert_array_equal(masks["nonocc"], expected)
    assert read_geometry(scene.calibration).fb == pytest.approx(1734.16 * 0.5295)


_BOOSTER = """<?xml version="1.0"?>
<opencv_storage>
<proj_matL type_id="opencv-matrix"><rows>3</rows><cols>4</cols><dt>d</dt>
<data>5000. 0. 2000. 0. 0. 5000. 1500. 0. 0. 0. 1. 0.</data></proj_matL>
<proj_matR type_id="opencv-matrix"><rows>3</rows><cols>4</cols><dt>d</dt>
<data>5000. 0. 2010. -250000. 0. 5000. 1500. 0. 0. 0. 1. 0.</data></proj_matR>
<baselineLR>50.</baselineLR>
</opencv_storage>
"""


def test_booster(tmp_path: Path):
    folder = tmp_path / "balanced/Bathroom"
    values, visible = DISPARITY.copy(), np.full((HEIGHT, WIDTH), 255, np.uint8)
    classes = np.zeros((HEIGHT, WIDTH), np.uint8)
    values[0, 0], visible[:, 0], classes[2:4, 3:] = 0, 0, 3
    laid(folder, {f"camera_0{camera}/im{k}.png": COLOR for camera in (0, 2) for k in (0, 1)})
    laid(folder, {"mask_00.png": visible, "mask_cat.png": classes, "disp_00.npy": values, "disp_02.npy": values,
                  "calib_00-02.xml": _BOOSTER})  # fmt: skip
    first, second = find(tmp_path)
    assert (first.name, second.name) == ("balanced/Bathroom_im0", "balanced/Bathroom_im1")
    assert (first.layout, first.protocol) == ("booster", "booster")
    truth = true(second)
    assert np.isnan(truth.disparity[0, 0])
    np.testing.assert_array_equal(truth.disparity.ravel()[1:], DISPARITY.ravel()[1:])
    counts = {name: int(mask.sum()) for name, mask in truth.masks.items()}
    assert counts == {"nonocc": 42, "class_0": 38, "class_1": 0, "class_2": 0, "class_3": 10}
    judge = protocols.load(first.protocol)()
    assert list(judge.truth(first).masks) == ["all", "nonocc", "class_0", "class_1", "class_2", "class_3"]
    geometry = read_geometry(first.calibration)
    assert (geometry.left.fx, geometry.baseline, geometry.offset) == (5000, pytest.approx(0.05), 10)
    check_layout("booster", tmp_path / "balanced")
    (folder / "camera_02").rename(folder / "camera_01")  # an unbalanced pair
    refused(InputError, load, find(tmp_path)[0])
    broken = _BOOSTER.replace("5000. 0. 2000. ", ""), _BOOSTER.replace("<baselineLR>50.", "<baselineLR>")
    for text in ("<a>", "<a><b>1</b></a>", *broken):
        first.calibration.write_text(text)
        refused(InputError, read_geometry, first.calibration)


def test_eth3d(tmp_path: Path):
    """The truth lies in a folder beside; many-view scenes are refused."""
    camera = "[541.8 0 553.4; 0 541.8 232.4; 0 0 1]"
    calib = f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=59.9\nwidth=8\nndisp=8\n"
    laid(tmp_path / "two_view_training/delivery_area_1l", {
        "im0.png": COLOR, "im1.png": COLOR, "calib.txt": calib, "cameras.txt": "", "images.txt": ""})  # fmt: skip
    assert not find(tmp_path)[0].has_truth
    truth = tmp_path / "two_view_training_gt/delivery_area_1l"
    laid(truth, {"disp0GT.pfm": DISPARITY, "mask0nocc.png": np.full((HEIGHT, WIDTH), 255, np.uint8)})
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout, scene.protocol) == ("two_view_training/delivery_area_1l", "eth3d", "eth3d")
    np.testing.assert_array_equal(true(scene).disparity, DISPARITY)
    assert true(scene).masks["nonocc"].all()
    check_layout("eth3d", tmp_path / "two_view_training")
    for number, camera in enumerate(("rig_calibration_undistorted", "dslr_calibration_jpg")):
        folder = laid(tmp_path / f"area_{number}", {f"{camera}/x": "", "images/x": ""})
        refused(InputError, find, folder)
    *useless, usable = find(tmp_path)
    assert ["many-view" in scene.problem for scene in useless] == [True, True] and usable.layout == "eth3d"


def test_tartanair(tmp_path: Path):
    depth = 80 / DISPARITY
    pair(tmp_path / "P001", "image_{}/000007_{}.png")
    laid(tmp_path / "P001", {"depth_left/000007_left_depth.npy": depth, "pose_left.txt": "0 0 0 0 0 0 1\n"})
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.name, scene.geometry.fb) == ("tartanair", "P001/000007", 80)
    np.testing.assert_allclose(true(scene).disparity, DISPARITY, rtol=1e-5)
    check_layout("tartanair", tmp_path)


def test_falling_things(tmp_path: Path):
    camera = {"fx": 768.0, "fy": 768.0, "cx": 480, "cy": 270, "s": 0}
    settings = {"camera_settings": [{"name": "left", "intrinsic_settings": camera}]}
    depth = codes(768 * 0.06 * 10_000 / (DISPARITY + 20), 1)
    pair(tmp_path / "kitchen_0", "000003.{}.jpg")
    laid(tmp_path / "kitchen_0", {"000003.left.depth.png": depth, "_camera_settings.json": settings})
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.name) == ("falling-things", "kitchen_0/000003")
    np.testing.assert_allclose(true(scene).disparity, DISPARITY + 20, rtol=1e-3)
    assert scene.geometry.fb == pytest.approx(768 * 0.06)
    assert pickle.loads(pickle.dumps(scene)).name == scene.name
    check_layout("falling-things", tmp_path)


@pytest.mark.parametrize("cameras", [(2, 3), (0, 1)])
def test_kitti_raw(tmp_path: Path, cameras: tuple[int, int]):
    day = tmp_path / "image_00/2011_09_26"  # whose first name says nothing of the cameras
    for k in range(2):
        pair(day / "2011_09_26_drive_0001_sync", f"{{}}/data/000000000{k}.png", tuple(f"image_0{n}" for n in cameras))
    row = "721.5 0 609.6 {} 0 721.5 172.9 0 0 0 1 0\n"
    text = "".join(f"P_rect_0{n}: {row.format(0 if n % 2 == 0 else -387.6)}" for n in range(4))
    first, _ = find(laid(day, {"calib_cam_to_cam.txt": text}))
    assert (first.layout, first.cameras) == ("kitti-raw", cameras)
    assert read_geometry(first.calibration, Reading(cameras=first.cameras)).fb == pytest.approx(387.6)
    check_layout("kitti-raw", day)


def test_argoverse_stereo(tmp_path: Path):
    log, frame = "train/273c1883-673a-36bf-b124-88311b1a80be", "315975340198711248"
    name = "stereo_front_{}_rect"
    pair(tmp_path / "rectified_stereo_images_v1.1" / log, f"{name}/{name}_{frame}.jpg")
    name = "stereo_front_left_rect_disparity"
    write_png(tmp_path / "disparity_maps_v1.1" / log / f"{name}/{name}_{frame}.png", codes(DISPARITY, 256))
    (scene,) = find(tmp_path)
    assert scene.layout == "argoverse-stereo" and scene.name.endswith(frame)
    np.testing.assert_array_equal(true(scene).disparity, DISPARITY)
    check_layout("argoverse-stereo", tmp_path)
