"""Data sets of stereo pairs with conventions of their own, on miniatures that follow the sets' documents."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.evaluation import protocols
from depthcli.io.formats.calibrations import Reading, read_geometry
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import StereoScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes, scenes_with_files
from depthcli.io.scenes.pairs import PAIRS
from tests.contracts.layouts import check_layout
from tests.golden import refused
from tests.scenes import load, true

HEIGHT, WIDTH = 6, 8
COLOR = np.dstack([np.arange(48, dtype=np.uint8).reshape(HEIGHT, WIDTH) + k for k in range(3)]).astype(np.uint8)
DISPARITY = np.full((HEIGHT, WIDTH), 2.5, np.float32)
DISPARITY[2:4, 3:] = 4.25


def find(folder: Path, layout: str | None = None, warn=lambda line: None) -> list[StereoScene]:
    scenes = discover_scenes(folder, PAIRS, layout, ["*"], warn)
    return scenes  # type: ignore[return-value]


def images(*paths: Path) -> None:
    for path in paths:
        write_png(path, COLOR)


def codes(path: Path, disparity: np.ndarray, scale: float) -> None:
    write_png(path, np.where(np.isnan(disparity), 0, np.rint(disparity * scale)).astype(np.uint16))


# Scene Flow datasets


def sceneflow(root: Path, where: str, frame: str = "0006") -> Path:
    images(*(root / "frames_cleanpass" / where / side / f"{frame}.png" for side in ("left", "right")))
    for side in ("left", "right"):
        write_pfm(root / "disparity" / where / side / f"{frame}.pfm", DISPARITY)
    return root


@pytest.mark.parametrize("where", ["TRAIN/A/0000", "15mm_focallength/scene_forwards/fast", "a_rain_of_stones_x2"])
def test_the_three_scene_flow_sets(tmp_path: Path, where: str):
    root = sceneflow(tmp_path / "Set", where)
    images(*(root / "frames_finalpass" / where / side / "0006.png" for side in ("left", "right")))
    clean, final = find(root)
    name = "_".join([*where.split("/"), "0006"])  # one table for each pass, not for each sequence
    assert (clean.name, final.name) == (f"frames_cleanpass/{name}", f"frames_finalpass/{name}")
    assert (clean.layout, clean.protocol, clean.max_disparity) == ("sceneflow", "scene_flow", 192)
    assert clean.disparity_left is not None
    assert clean.disparity_left == final.disparity_left
    found = scenes_with_files([clean.disparity_left], ALL_KINDS).get(clean.disparity_left)
    assert found is not None
    assert found.folder == root
    truth = true(clean)
    np.testing.assert_array_equal(truth.disparity, DISPARITY)
    np.testing.assert_array_equal(truth.right, DISPARITY)
    assert [scene.name for scene in find(tmp_path)] == [f"Set/{clean.name}", f"Set/{final.name}"]
    check_layout("sceneflow", root)


def test_negative_disparities_and_occlusions_of_the_subset(tmp_path: Path):
    images(*(tmp_path / "train" / "image_clean" / side / "0000000.png" for side in ("left", "right")))
    write_pfm(tmp_path / "train" / "disparity" / "left" / "0000000.pfm", -DISPARITY)
    occluded = np.zeros((HEIGHT, WIDTH), np.uint8)
    occluded[:, 0] = 255
    write_png(tmp_path / "train" / "disparity_occlusions" / "left" / "0000000.png", occluded)
    (scene,) = find(tmp_path)
    assert scene.name == "train/image_clean/0000000"
    truth = true(scene)
    np.testing.assert_array_equal(truth.disparity, DISPARITY)
    assert truth.right is None
    np.testing.assert_array_equal(truth.masks["nonocc"], occluded == 0)


def test_webp_frames_of_the_scene_flow_sets_are_refused(tmp_path: Path):
    images(*(tmp_path / "frames_cleanpass" / "a" / side / "0006.webp" for side in ("left", "right")))
    refused(InputError, load, find(tmp_path)[0])


# MPI Sintel


def packed(disparity: np.ndarray) -> np.ndarray:
    red = np.floor(disparity / 4)
    green = np.floor((disparity - 4 * red) * 64)
    blue = np.floor((disparity - 4 * red - green / 64) * 16384)
    return np.dstack([red, green, blue]).astype(np.uint8)


def sintel(folder: Path) -> Path:
    for name in ("clean", "final"):
        images(*(folder / f"{name}_{side}" / "alley_1" / "frame_0001.png" for side in ("left", "right")))
    values = DISPARITY.copy()
    values[0, :4] = 0, 1023.9999, 100 + 1 / 64, 7 + 3 / 16384
    write_png(folder / "disparities" / "alley_1" / "frame_0001.png", packed(values))
    hidden, outside = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    hidden[4], outside[:, 0] = 255, 255
    write_png(folder / "occlusions" / "alley_1" / "frame_0001.png", hidden)
    write_png(folder / "outofframe" / "alley_1" / "frame_0001.png", outside)
    return folder


def test_sintel(tmp_path: Path):
    clean, final = find(sintel(tmp_path / "training"))
    assert (clean.name, final.name) == ("clean/alley_1_frame_0001", "final/alley_1_frame_0001")
    truth = true(final)
    assert np.isnan(truth.disparity[0, 0])
    np.testing.assert_allclose(truth.disparity[0, 1:4], [1023.9999, 100 + 1 / 64, 7 + 3 / 16384], rtol=0, atol=1e-4)
    np.testing.assert_array_equal(truth.disparity[1:], DISPARITY[1:])
    inside = np.arange(WIDTH)[None, :] > 0
    visible = np.arange(HEIGHT)[:, None] != 4
    np.testing.assert_array_equal(truth.masks["all"], np.broadcast_to(inside, (HEIGHT, WIDTH)))
    np.testing.assert_array_equal(truth.masks["nonocc"], inside & visible)
    regions = protocols.load(final.protocol)().truth(final).masks
    assert {"all", "nonocc"} <= set(regions)
    assert next(scene.name for scene in find(tmp_path)) == "training/clean/alley_1_frame_0001"
    check_layout("sintel", tmp_path)


def test_what_is_said_of_other_disparities_in_sintel(tmp_path: Path):
    sintel(tmp_path)
    codes(tmp_path / "disparities" / "alley_1" / "frame_0001.png", DISPARITY, 256)
    refused(InputError, true, find(tmp_path)[0])


# DrivingStereo


def driving_calib(root: Path, size: str, sequence: str) -> Path:
    path = root / "calib_train" / f"{size}-image-calib" / f"{sequence}.txt"
    path.parent.mkdir(parents=True)
    rows = "1003.5 0.0 479.5 {} 0.0 1003.5 200.1 0.0 0.0 0.0 1.0 0.0"
    path.write_text(f"P_rect_101: {rows.format(0.0)}\nP_rect_103: {rows.format(-546.9)}\n")
    return path


def test_driving_stereo(tmp_path: Path):
    frame = "2018-07-09-16-11-56_2018-07-09-16-12-26-502"
    name = f"2018-07-09-16-11-56/{frame}"
    images(*(tmp_path / f"train-{side}-image" / f"{name}.jpg" for side in ("left", "right")))
    unknown = DISPARITY.copy()
    unknown[0] = np.nan
    codes(tmp_path / "train-disparity-map" / f"{name}.png", unknown, 256)
    calib = driving_calib(tmp_path, "half", "2018-07-09-16-11-56")
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout, scene.max_disparity) == (f"train-left-image/{frame}", "driving-stereo", 255)
    np.testing.assert_array_equal(true(scene).disparity, unknown)
    assert scene.calibration == calib
    geometry = read_geometry(calib, Reading(cameras=scene.cameras))
    assert (geometry.left.fx, geometry.baseline) == (1003.5, pytest.approx(546.9 / 1003.5))
    check_layout("driving-stereo", tmp_path)


def test_full_size_frames_of_driving_stereo_have_another_scale(tmp_path: Path):
    name = "2018-10-31-06-55-01_2018-10-31-07-35-30-878"
    for size, scale in (("half", 256), ("full", 128)):
        images(*(tmp_path / "cloudy" / f"{side}-image-{size}-size" / f"{name}.png" for side in ("left", "right")))
        codes(tmp_path / "cloudy" / f"disparity-map-{size}-size" / f"{name}.png", DISPARITY, scale)
    calib = driving_calib(tmp_path, "full", "2018-10-31-06-55-01")
    full, half = find(tmp_path / "cloudy")
    assert (full.disparity_scale, half.disparity_scale) == (128, 256)
    assert (full.calibration, half.calibration) == (calib, None)
    for scene in (full, half):
        np.testing.assert_array_equal(true(scene).disparity, DISPARITY)


# Sets with integer codes: CREStereo's and InStereo2K


@pytest.mark.parametrize(("layout", "frame", "files", "scale"), [
    ("crestereo", "hole/0003c2ad-2128", "hole/0003c2ad-2128_{}", 32),
    ("instereo2k", "part1/000003", "part1/000003/{}", 100),
])  # fmt: skip
def test_sets_with_integer_codes(tmp_path: Path, layout: str, frame: str, files: str, scale: float):
    unknown = DISPARITY.copy()
    unknown[1] = np.nan
    for side in ("left", "right"):
        file = files.format(side)
        images(tmp_path / (f"{file}.jpg" if layout == "crestereo" else f"{file}.png"))
        codes(tmp_path / (f"{file}.disp.png" if layout == "crestereo" else f"{file}_disp.png"), unknown, scale)
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout) == (frame, layout)
    for values in (true(scene).disparity, true(scene).right):
        np.testing.assert_array_equal(values, unknown)
    assert set(protocols.load(scene.protocol)().truth(scene).masks) == {"nonocc", "all", "disc"}
    check_layout(layout, tmp_path / frame.partition("/")[0])


# Middlebury 2021 and Booster


def test_middlebury_2021_has_masks_by_both_views(tmp_path: Path):
    folder = tmp_path / "artroom1"
    images(folder / "im0.png", folder / "im1.png", folder / "ambient" / "L0" / "im0e0.png")
    left, right = DISPARITY.copy(), np.full((HEIGHT, WIDTH), 2.5, np.float32)
    left[0, 5] = np.inf
    right[5, 3] = np.inf
    write_pfm(folder / "disp0.pfm", left)
    write_pfm(folder / "disp1.pfm", right)
    camera = "[1734.16 0 333.49; 0 1734.16 958.05; 0 0 1]"
    (folder / "calib.txt").write_text(
        f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=529.50\nwidth=1920\nheight=1080\nndisp=170\nvmin=55\nvmax=142\n"
    )
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.max_disparity, scene.masks) == ("middlebury-v3", 170, {})
    masks = protocols.load(scene.protocol)().truth(scene).masks
    assert list(masks) == ["nonocc", "all"]
    expected = np.isfinite(left) & (left == 2.5) & (np.arange(WIDTH) >= 3)
    expected[5, 6] = False  # its match, 3 px to the left, is unknown
    np.testing.assert_array_equal(masks["nonocc"], expected)
    assert scene.calibration is not None
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


def booster(folder: Path) -> Path:
    images(*(folder / camera / f"im{k}.png" for camera in ("camera_00", "camera_02") for k in (0, 1)))
    values = DISPARITY.copy()
    values[0, 0] = 0
    visible, classes = np.full((HEIGHT, WIDTH), 255, np.uint8), np.zeros((HEIGHT, WIDTH), np.uint8)
    visible[:, 0], classes[2:4, 3:] = 0, 3
    write_png(folder / "mask_00.png", visible)
    write_png(folder / "mask_cat.png", classes)
    np.save(folder / "disp_00.npy", values)
    np.save(folder / "disp_02.npy", values)
    (folder / "calib_00-02.xml").write_text(_BOOSTER)
    return folder


def test_booster(tmp_path: Path):
    booster(tmp_path / "balanced" / "Bathroom")
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
    assert first.calibration is not None
    geometry = read_geometry(first.calibration)
    assert (geometry.left.fx, geometry.baseline, geometry.offset) == (5000, pytest.approx(0.05), 10)
    check_layout("booster", tmp_path / "balanced")


@pytest.mark.parametrize("text", ["<a>", "<a><b>1</b></a>", _BOOSTER.replace("5000. 0. 2000. ", ""),
                                  _BOOSTER.replace("<baselineLR>50.", "<baselineLR>")])  # fmt: skip
def test_a_broken_calibration_of_booster(tmp_path: Path, text: str):
    (tmp_path / "calib.xml").write_text(text)
    refused(InputError, read_geometry, tmp_path / "calib.xml")


def test_unbalanced_pairs_of_booster_are_refused(tmp_path: Path):
    booster(tmp_path / "unbalanced" / "Bathroom")
    (tmp_path / "unbalanced" / "Bathroom" / "camera_02").rename(tmp_path / "unbalanced" / "Bathroom" / "camera_01")
    scene = find(tmp_path)[0]
    refused(InputError, load, scene)


# ETH3D


def eth3d(root: Path, scene: str = "delivery_area_1l") -> Path:
    folder = root / "two_view_training" / scene
    images(folder / "im0.png", folder / "im1.png")
    camera = "[541.8 0 553.4; 0 541.8 232.4; 0 0 1]"
    (folder / "calib.txt").write_text(f"cam0={camera}\ncam1={camera}\ndoffs=0\nbaseline=59.9\nwidth=8\nndisp=8\n")
    for name in ("cameras.txt", "images.txt"):
        (folder / name).write_text("")
    return folder


def test_the_truth_of_eth3d_lies_in_a_folder_beside(tmp_path: Path):
    folder = eth3d(tmp_path)
    assert not find(tmp_path)[0].has_truth
    truth = tmp_path / "two_view_training_gt" / folder.name
    write_pfm(truth / "disp0GT.pfm", DISPARITY)
    write_png(truth / "mask0nocc.png", np.full((HEIGHT, WIDTH), 255, np.uint8))
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout, scene.protocol) == ("two_view_training/delivery_area_1l", "eth3d", "eth3d")
    np.testing.assert_array_equal(true(scene).disparity, DISPARITY)
    assert true(scene).masks["nonocc"].all()
    check_layout("eth3d", tmp_path / "two_view_training")


@pytest.mark.parametrize("camera", ["rig_calibration_undistorted", "dslr_calibration_jpg"])
def test_many_view_scenes_of_eth3d_are_refused(tmp_path: Path, camera: str):
    for name in (camera, "images"):
        (tmp_path / "delivery_area" / name).mkdir(parents=True)
    refused(InputError, find, tmp_path / "delivery_area")
    eth3d(tmp_path)
    useless, usable = discover_scenes(tmp_path, PAIRS)
    assert "many-view" in useless.problem
    assert usable.layout == "eth3d"


# TartanAir, Falling Things, KITTI raw, Argoverse 1


def test_tartanair(tmp_path: Path):
    folder = tmp_path / "P001"
    images(*(folder / f"image_{side}" / f"000007_{side}.png" for side in ("left", "right")))
    (folder / "depth_left").mkdir()
    np.save(folder / "depth_left/000007_left_depth.npy", np.where(DISPARITY > 0, 80 / DISPARITY, 0).astype(np.float32))
    (folder / "pose_left.txt").write_text("0 0 0 0 0 0 1\n")
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.name) == ("tartanair", "P001/000007")
    np.testing.assert_allclose(true(scene).disparity, np.where(DISPARITY > 0, DISPARITY, np.nan), rtol=1e-5)
    assert scene.geometry is not None and scene.geometry.fb == 80
    check_layout("tartanair", tmp_path)


def test_falling_things(tmp_path: Path):
    folder = tmp_path / "kitchen_0"
    images(folder / "000003.left.jpg", folder / "000003.right.jpg")
    codes(folder / "000003.left.depth.png", 768 * 0.06 * 10_000 / (DISPARITY + 20), 1)
    camera = {"fx": 768.0, "fy": 768.0, "cx": 480, "cy": 270, "s": 0}
    settings = {"camera_settings": [{"name": "left", "intrinsic_settings": camera}]}
    (folder / "_camera_settings.json").write_text(json.dumps(settings))
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.name) == ("falling-things", "kitchen_0/000003")
    np.testing.assert_allclose(true(scene).disparity, DISPARITY + 20, rtol=1e-3)
    assert scene.geometry is not None and scene.geometry.fb == pytest.approx(768 * 0.06)
    assert pickle.loads(pickle.dumps(scene)).name == scene.name
    check_layout("falling-things", tmp_path)


@pytest.mark.parametrize(("sides", "cameras"), [(("image_02", "image_03"), (2, 3)), (("image_00", "image_01"), (0, 1))])
def test_kitti_raw(tmp_path: Path, sides: tuple[str, str], cameras: tuple[int, int]):
    tmp_path = tmp_path / "image_00"  # which says nothing of the cameras
    drive = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    images(*(drive / side / "data" / f"000000000{k}.png" for side in sides for k in range(2)))
    rows = "721.5 0 609.6 {} 0 721.5 172.9 0 0 0 1 0"
    text = "".join(f"P_rect_0{n}: {rows.format(0 if n % 2 == 0 else -387.6)}\n" for n in range(4))
    (tmp_path / "2011_09_26" / "calib_cam_to_cam.txt").write_text(text)
    first, _ = find(tmp_path / "2011_09_26")
    assert (first.layout, first.cameras) == ("kitti-raw", cameras)
    assert first.calibration is not None
    assert read_geometry(first.calibration, Reading(cameras=first.cameras)).fb == pytest.approx(387.6)
    check_layout("kitti-raw", tmp_path / "2011_09_26")


def test_argoverse_stereo(tmp_path: Path):
    log = "train/273c1883-673a-36bf-b124-88311b1a80be"
    for side in ("left", "right"):
        name = f"stereo_front_{side}_rect"
        images(tmp_path / "rectified_stereo_images_v1.1" / log / name / f"{name}_315975340198711248.jpg")
    name = "stereo_front_left_rect_disparity"
    codes(tmp_path / "disparity_maps_v1.1" / log / name / f"{name}_315975340198711248.png", DISPARITY, 256)
    (scene,) = find(tmp_path)
    assert scene.layout == "argoverse-stereo" and scene.name.endswith("315975340198711248")
    np.testing.assert_array_equal(true(scene).disparity, np.where(DISPARITY > 0, DISPARITY, np.nan))
    check_layout("argoverse-stereo", tmp_path)
