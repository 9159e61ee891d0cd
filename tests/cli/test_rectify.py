"""Rigs with known cameras and a known room: rectified by every kind of calibration, matched, turned into meters."""

import json
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest
import yaml

import depthcli
from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import RectifiedRig, Rig
from depthcli.core.errors import InputError
from depthcli.io.formats.calibrations import Reading, read_geometry, read_rig
from depthcli.io.formats.disparity import read_pfm, read_status, write_pfm
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import read_image, write_png
from depthcli.methods.stereo.rectification import rectify_uncalibrated, row_error
from depthcli.problems import rectified
from tests.boards import opencv
from tests.command_line import contents, rows, run
from tests.golden import refused, told

SIZE = (240, 180)
# Planes n . X = 1 in the left camera's frame, nearest last: a slanted wall, a board in front of it.
WALL, BOARD = np.array([0.05, 0.02, 0.34]), np.array([0.0, 0.03, 0.55])


def rotation(*degrees: float) -> np.ndarray:
    return cv2.Rodrigues(np.radians(np.array(degrees)))[0]


def rig(fisheye: bool = False, strength: float = 1.0) -> Rig:
    lens = (0.02, -0.01, 0.003, -0.001) if fisheye else (-0.12, 0.03, 0.001, -0.0008, 0.0)
    lenses = [
        Camera(np.array([[f, 0, cx], [0, f + 1.5, cy], [0, 0, 1]]), lens, SIZE, fisheye)
        for f, cx, cy in ((190.0, 121.0, 88.0), (194.0, 117.5, 91.0))
    ]
    turn = rotation(*(strength * np.array([1.6, -2.2, 1.1])))
    return Rig(*lenses, turn, turn @ np.array([-0.14, 0.006 * strength, -0.004 * strength]))


def seen(rays: np.ndarray, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) that rays from ``center`` meet, in the left camera's frame, and whether they are the board's."""
    far, near = (center + rays * ((1 - center @ plane) / (rays @ plane))[:, None] for plane in (WALL, BOARD))
    board = (np.abs(near[:, 0] + 0.05) < 0.35) & (np.abs(near[:, 1]) < 0.28)
    return np.where(board[:, None], near, far), board


def photo(lens: Camera, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: what a camera at x' = turn x + shift sees; the mean of nine rays a pixel."""
    noise = np.random.default_rng(5).random((2, 1024, 1024, 3)).astype(np.float32)
    noise = np.stack([cv2.GaussianBlur(each, (0, 0), 2.2) for each in noise])
    noise = (noise - noise.min()) / (noise.max() - noise.min())
    width, height = lens.size or SIZE
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    total = np.zeros((height, width, 3))
    eye = np.hstack([np.eye(3), np.zeros((3, 1))])
    for dx in (-1 / 3, 0, 1 / 3):
        for dy in (-1 / 3, 0, 1 / 3):
            plane = lens.undistorted(np.stack([x.ravel() + dx, y.ravel() + dy], 1), np.eye(3), eye)
            rays = np.hstack([plane, np.ones((len(plane), 1))]) @ turn  # of x = turn.T (x' - shift)
            points, board = seen(rays, -turn.T @ shift)
            u, v = (((points[:, k] * 160 + 512) % 1023).astype(np.float32).reshape(x.shape) for k in (0, 1))
            pictures = [cv2.remap(each, u, v, cv2.INTER_LINEAR) for each in noise]
            total += np.where(board.reshape(x.shape)[..., None], pictures[1], pictures[0])
    return np.rint(total / 9 * 255).clip(0, 255).astype(np.uint8)


class Shot(NamedTuple):
    rig: Rig
    left: Path
    right: Path

    @property
    def words(self) -> tuple[str | Path, ...]:
        return ("--left", self.left, "--right", self.right, "--name", "room")


def shot(folder: Path, taken: Rig) -> Shot:
    left = photo(taken.left, np.eye(3), np.zeros(3))
    right = photo(taken.right, taken.rotation, taken.translation)
    write_png(folder / "left.png", left)
    write_png(folder / "right.png", right)
    return Shot(taken, folder / "left.png", folder / "right.png")


@pytest.fixture(scope="module")
def pinhole(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    return shot(tmp_path_factory.mktemp("pinhole"), rig())


@pytest.fixture(scope="module")
def fish(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    return shot(tmp_path_factory.mktemp("fish"), rig(fisheye=True))


def ros(folder: Path, taken: Rig) -> list[Path]:
    found = taken.rectified(SIZE, SIZE)
    files = []
    for name, lens, turn, projection in (
        ("left", taken.left, found.rotation, found.projection),
        ("right", taken.right, found.rotation_right, found.projection_right),
    ):
        model = "equidistant" if lens.fisheye else "plumb_bob"
        text = f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: {name}\ndistortion_model: {model}\n"
        for key, value in (
            ("camera_matrix", lens.matrix), ("distortion_coefficients", lens.coefficients[None]),
            ("rectification_matrix", turn), ("projection_matrix", projection),
        ):  # fmt: skip
            rows, columns = value.shape
            text += f"{key}:\n  rows: {rows}\n  cols: {columns}\n  data: {value.ravel().tolist()}\n"
        files.append(folder / f"{name}.yaml")
        files[-1].write_text(text)
    return files


def kalibr(file: Path, taken: Rig) -> Path:
    text = ""
    for name, lens in (("cam0", taken.left), ("cam1", taken.right)):
        text += f"{name}:\n  camera_model: pinhole\n  distortion_model: {'equidistant' if lens.fisheye else 'radtan'}\n"
        text += f"  distortion_coeffs: {list(lens.distortion[:4])}\n"
        k = lens.matrix
        text += (
            f"  intrinsics: {[float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])]}\n  resolution: {list(SIZE)}\n"
        )
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = taken.rotation, taken.translation
    file.write_text(text + f"  T_cn_cnm1: {place.tolist()}\n")
    return file


def kitti(file: Path, taken: Rig) -> Path:
    """Cameras 2 and 3, both turned against camera 0."""
    turn, shift = rotation(3, -2, 1), np.array([0.06, 0.01, 0.02])
    lines = []
    for number, lens, r, t in (
        (2, taken.left, turn, shift),
        (3, taken.right, taken.rotation @ turn, taken.rotation @ shift + taken.translation),
    ):
        for key, value in (("S", np.array(SIZE)), ("K", lens.matrix), ("D", lens.coefficients), ("R", r), ("T", t)):
            lines.append(f"{key}_0{number}: " + " ".join(f"{v:.15e}" for v in value.ravel()))
    file.write_text("calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.95e-02\n" + "\n".join(lines) + "\n")
    return file


@pytest.mark.parametrize(
    ("baseline", "unit", "said"),
    [
        (4.3, None, "a baseline of 4.3 m: if the translation has another unit, give the unit"),
        (4.3, "m", ""),
        (4.3, "mm", ""),  # an endoscope
        (4.17, "24mm", ""),
        (0.0043, None, "which unit has the translation?"),
        (0.0043, "m", ""),
        (140, None, "which unit has the translation?"),
        (140, "mm", ""),
    ],
)
def test_an_unusual_baseline_asks_for_its_unit(baseline: float, unit: str | None, said: str, tmp_path: Path):
    """By every reader of rigs and of rectified pairs, in depth and in Python's to_depth, too."""
    taken = rig()
    far = replace(taken, translation=taken.translation / taken.baseline * baseline)
    meters = {None: 1.0, "m": 1.0, "mm": 0.001, "24mm": 0.024}[unit]
    files = [[opencv(tmp_path / "a.yml", far)], ros(tmp_path, far), [kalibr(tmp_path / "b.yaml", far)]]
    files += [[kitti(tmp_path / "c.txt", far)]]
    (tmp_path / "K.txt").write_text(f"200 0 119.5 0 200 89.5 0 0 1\n{baseline}\n")
    write_pfm(tmp_path / "map.pfm", np.full((180, 240), 10, np.float32))
    for one in [*files, [tmp_path / "K.txt"]]:
        with collected_warnings() as lines:
            if "which" in said:
                refused(InputError, read_geometry, one, Reading(unit))
                continue
            geometry = read_geometry(one, Reading(unit))
        assert geometry.baseline == pytest.approx(baseline * meters, rel=1e-3)
        assert bool(said) == any(line.startswith(f"{one[0]}: a baseline") for line in lines)
    words = ["--calibration", tmp_path / "a.yml", *(["--unit", unit] if unit else []), "-q"]
    code = run("depth", tmp_path / "map.pfm", *words, "-o", tmp_path / "out")
    assert code == (3 if "which" in said else 0)
    (row,) = json.loads((tmp_path / "out/report.json").read_text())["scenes"]
    assert said in " ".join([row["error"], *(row["warnings"] or [])])


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_an_image_size_may_be_an_array(suffix: str, tmp_path: Path):
    file = opencv(tmp_path / f"c.{suffix}", rig(), "K1 D1 K2 D2 R T imageSize")
    assert read_rig([file]).left.size == tuple(SIZE)


def test_units_that_are_none(tmp_path: Path, tool):
    opencv(tmp_path / "a.yml", rig())
    write_pfm(tmp_path / "map.pfm", np.full((180, 240), 10, np.float32))
    calibration = ("--calibration", tmp_path / "a.yml")
    pair = ("--left", "l.png", "--right", "r.png")
    for line in (
        ("depth", tmp_path / "map.pfm"),
        ("stereo", "fast", *pair),
        ("fuse", "consensus", *pair),
        ("rectify", *pair),
    ):
        for wrong in ("inch", "0mm", "5", "-2mm"):
            tool.told(2, *line, *calibration, "--unit", wrong, "-o", tmp_path / "out")
        for option in (("--unit", "mm"), ("--fisheye",), ("--cameras", "0,1"), ("--alpha", "1")):
            tool.told(3 if line[0] == "depth" else 2, *line, *option, "-o", tmp_path / "out", "-q")  # no calibration


@pytest.mark.parametrize("command", ["rectify", "stereo", "fuse"])
def test_all_commands_read_a_calibration_as_rectify_does(command: str, fish: Shot, tmp_path: Path):
    """With --fisheye, --alpha, --cameras and --unit."""
    file = opencv(tmp_path / "mm.yml", fish.rig, unit=0.001)
    words = (*fish.words, "--calibration", file, "--unit", "mm", "--fisheye", "--alpha", "0.5", "-q")
    line = {"rectify": ("rectify",), "stereo": ("stereo", "fast"), "fuse": ("fuse", "consensus")}[command]
    assert run(*line, *words, "-o", tmp_path / "out") == 0
    found = read_geometry(tmp_path / "out/room/calib.txt")
    expected = fish.rig.rectified(SIZE, SIZE, 0.5).geometry
    assert (found.left.fx, found.baseline) == pytest.approx((expected.left.fx, expected.baseline))
    if command == "rectify":
        return
    map_file = tmp_path / "out/room/disp_left.pfm"
    (tmp_path / "alone").mkdir()
    shutil.copy(map_file, tmp_path / "alone/map.pfm")
    words = ("--calibration", file, "--unit", "mm", "--fisheye", "--alpha", "0.5", "-q")
    assert run("depth", tmp_path / "alone/map.pfm", *words, "-o", tmp_path / "alone/depth") == 0
    assert run("depth", tmp_path / "out", "-q", "-o", tmp_path / "depth") == 0
    one, other = read_pfm(tmp_path / "alone/depth/map/depth.pfm"), read_pfm(tmp_path / "depth/room/depth.pfm")
    np.testing.assert_allclose(one, other, rtol=1e-5)


def test_a_camera_of_images_of_another_size_is_warned_of(pinhole: Shot, tmp_path: Path):
    """If the file has no size: by rectify, stereo, depth and to_depth; one with its size is refused or scaled."""
    own = pinhole.rig
    write_pfm(tmp_path / "map.pfm", np.full((180, 240), 10, np.float32))
    for name, factor, count in (("own", 1.0, 0), ("double", 2.0, 2), ("half", 0.5, 2)):
        taken = replace(own, left=own.left.scaled(factor), right=own.right.scaled(factor))
        file = opencv(tmp_path / f"{name}.yml", taken)
        for command in (("rectify",), ("stereo", "fast")):
            out = tmp_path / name / command[0]
            run(*command, *pinhole.words, "--calibration", file, "-o", out, "-q")
            (row,) = json.loads((out / "report.json").read_text())["scenes"]
            lines = [line for line in row["warnings"] or [] if "far from the center of images of 240 x 180" in line]
            assert len(lines) == count and (count or row["status"] == "done")
        k = taken.left.matrix
        (tmp_path / f"{name}.txt").write_text(" ".join(map(str, k.ravel())) + "\n0.14\n")
        words = ("--calibration", tmp_path / f"{name}.txt", "-o", tmp_path / name / "depth", "-q")
        assert run("depth", tmp_path / "map.pfm", *words) == 0
        (row,) = json.loads((tmp_path / name / "depth/report.json").read_text())["scenes"]
        assert bool(count) == any("far from the center" in line for line in row["warnings"] or [])


def true_depth(taken: Rig) -> np.ndarray:
    """What the rectified left camera sees: the depth (H, W), meters."""
    width, height = size = taken.left.size or SIZE
    found = taken.rectified(size, size)
    k = found.geometry.left
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = np.stack([(x - k.cx) / k.fx, (y - k.cy) / k.fy, np.ones_like(x)], 2).reshape(-1, 3) @ found.rotation
    points, _ = seen(rays, np.zeros(3))
    return (points @ found.rotation.T)[:, 2].reshape(x.shape)


def check_meters(maps: Path, taken: Rig, tmp_path: Path) -> None:
    """Turn the one map of a run into meters, compare with where the rays meet the room."""
    assert run("depth", maps, "-o", tmp_path / "depth", "--mask", "measured", "-q") == 0
    (file,) = (tmp_path / "depth").glob("*/depth.pfm")
    depth, true = read_pfm(file), true_depth(taken)
    measured = np.isfinite(depth)
    assert measured.mean() > 0.6
    error = (depth - true)[measured] / true[measured]
    # A pixel is 6 to 12 % of the depth here: no bias, and a sixth of a pixel at most half of the time.
    assert abs(np.median(error)) < 0.004
    assert np.median(np.abs(error)) < 0.015
    assert np.mean(np.abs(error) < 0.04) > 0.93


def echo(folder: Path, taken: Rig, upper: bool = False) -> list[Path]:
    """Messages as ROS 2 prints them, two of each topic, or in lists and upper case as ROS 1 does."""
    files = []
    for file in ros(folder, taken):
        fields = yaml.safe_load(file.read_text())
        names = {"d": "distortion_coefficients", "k": "camera_matrix", "r": "rectification_matrix",
                 "p": "projection_matrix"}  # fmt: skip
        texts = []
        for second in (1, 2):
            text = f"header:\n  stamp:\n    sec: {second}\n    nanosec: {second}00\n  frame_id: optical\n"
            text += f"height: {SIZE[1]}\nwidth: {SIZE[0]}\ndistortion_model: {fields['distortion_model']}\n"
            for key, name in names.items():
                values = fields[name]["data"]
                listed = "\n" + "".join(f"- {value}\n" for value in values)
                text += f"{key.upper()}: {values}\n" if upper else f"{key}:{listed}"
            text += "binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n"
            texts.append(text + "  do_rectify: false\n---\n")
        files.append(file.with_suffix(".echo.yaml"))
        files[-1].write_text("".join(texts))
    return files


def zed(file: Path, taken: Rig) -> Path:
    """The file of Stereolabs, with another size before that of the rig; distortions in either place."""
    turn, shift = cv2.Rodrigues(taken.rotation)[0].ravel(), taken.translation * 1000
    text = ""
    for mode, factor in (("FHD", 2.5), ("VGA", 1.0)):
        for side, lens in (("LEFT", taken.left), ("RIGHT", taken.right)):
            values = dict(zip(("fx", "fy", "cx", "cy"), lens.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] * factor, strict=True))
            if not lens.fisheye:
                values |= dict(zip(("k1", "k2", "p1", "p2", "k3"), lens.distortion, strict=True))
            text += f"[{side}_CAM_{mode}]\n" + "".join(f"{key}={value}\n" for key, value in values.items()) + "\n"
    if taken.left.fisheye:
        for side, lens in (("LEFT", taken.left), ("RIGHT", taken.right)):
            text += f"[{side}_DISTO]\n" + "".join(f"k{k} = {v}\n" for k, v in enumerate(lens.distortion, 1)) + "\n"
    text += f"[STEREO]\nBaseline={-shift[0]}\nTY={shift[1]}\nTZ_VGA={shift[2]}\n"
    text += "".join(f"{key}_VGA={value}\n{key}_FHD=0.5\n" for key, value in zip(("RX", "CV", "RZ"), turn, strict=True))
    file.write_text(text)
    return file


RIGS = {  # name -> the files of a calibration in a folder, and the options that they need; "lens": of fisheye lenses
    **{f"opencv {end}": lambda at, taken, end=end: ([opencv(at / f"a.{end}", taken)], ["lens"])
       for end in ("yml", "xml", "json")},
    "opencv, old names, mm": lambda at, taken: (
        [opencv(at / "mm.yml", taken, "M1 D1 M2 D2 R T", 0.001)], ["lens", "--unit", "mm"]),
    "opencv, squares of 24 mm": lambda at, taken: (
        [opencv(at / "squares.yml", taken, unit=0.024)], ["lens", "--unit", "24mm"]),
    "opencv, two files": lambda at, taken: (halves(at, opencv(at / "c.yml", taken)), ["lens"]),
    "ros": lambda at, taken: (ros(at, taken), []),
    "ros2 topic echo": lambda at, taken: (echo(at, taken), []),
    "rostopic echo": lambda at, taken: (echo(at, taken, upper=True), []),
    "kalibr": lambda at, taken: ([kalibr(at / "chain.yaml", taken)], []),
    "kitti": lambda at, taken: ([kitti(at / "calib_cam_to_cam.txt", taken)], []),
    "zed": lambda at, taken: ([zed(at / "SN123.conf", taken)], []),
}  # fmt: skip


def zed_rig(fisheye: bool) -> Rig:
    """The rig with images of ZED's size VGA."""
    lenses = []
    for lens in (rig(fisheye).left, rig(fisheye).right):
        moved = lens.scaled(2.0).matrix
        moved[:2, 2] += (90, 10)
        lenses.append(Camera(moved, lens.distortion, (672, 376), fisheye))
    return Rig(*lenses, rig().rotation, rig().translation)


LENSES = [(kind, lens) for kind in RIGS for lens in ("pinhole", "fish") if (kind, lens) != ("kitti", "fish")]


@pytest.mark.parametrize(("kind", "lens"), LENSES)
def test_every_kind_of_file_gives_the_rig(kind: str, lens: str, tmp_path: Path):
    fisheye = lens == "fish"
    taken = zed_rig(fisheye) if kind == "zed" else rig(fisheye)
    files, options = RIGS[kind](tmp_path, taken)
    unit = options[-1] if "--unit" in options else None
    found = read_rig(files, Reading(unit, fisheye and "lens" in options), taken.left.size)
    for one, other in ((found.left, taken.left), (found.right, taken.right)):
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-9)
        np.testing.assert_allclose(np.resize(one.distortion, 4), np.resize(other.distortion, 4), atol=1e-12)
        assert one.fisheye == other.fisheye
    np.testing.assert_allclose(found.rotation, taken.rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, taken.translation, atol=1e-9)


def geometries(found: RectifiedRig) -> dict[str, tuple[str, str, list[str]]]:
    """Name of a format -> file name, its content for a rectified pair, and the options that it needs."""
    left, right = found.projection, found.projection_right.copy()
    right[0, 2] += 3  # of the right principal point
    numbers = [" ".join(f"{value:.12e}" for value in each.ravel()) for each in (left, right)]
    k, zero = left[:, :3], np.zeros((3, 4))
    cams = [f"cam{n}=[{k[0, 0]} 0 {k[0, 2] + 3 * n}; 0 {k[1, 1]} {k[1, 2]}; 0 0 1]" for n in (0, 1)]
    baseline = -right[0, 3] / right[0, 0]
    others = " ".join(map(str, zero.ravel()))
    data = "<proj_mat{0} type_id='opencv-matrix'><rows>3</rows><cols>4</cols><dt>d</dt><data>{1}</data></proj_mat{0}>"
    booster = "".join(data.format(side, text) for side, text in zip("LR", numbers, strict=True))
    middlebury = "\n".join(cams) + "\n{}baseline={}\n{}"
    size = f"width={SIZE[0]}\nheight={SIZE[1]}\nndisp=64\n"
    return {
        "middlebury": ("calib.txt", middlebury.format("doffs=3\n", baseline * 1000, size), []),
        "eth3d, without doffs and size": ("calib.txt", middlebury.format("", baseline * 1000, ""), []),
        "middlebury in meters": ("calib.txt", middlebury.format("doffs=3\n", baseline, size), ["--unit", "m"]),
        "kitti, color": ("a.txt", f"P0: {others}\nP1: {others}\nP2: {numbers[0]}\nP3: {numbers[1]}\n", []),
        "kitti, grey": (
            "a.txt", f"P0: {numbers[0]}\nP1: {numbers[1]}\nP2: {others}\nP3: {others}\n", ["--cameras", "0,1"]),
        "kitti, raw": ("a.txt", f"P_rect_02: {numbers[0]}\nP_rect_03: {numbers[1]}\n", []),
        "booster": ("a.xml", f"<a>{booster}<baselineLR>{baseline * 1000}</baselineLR></a>", []),
        "foundation stereo": ("K.txt", f"{' '.join(map(str, k.ravel()))}\n{baseline}\n", ["no offset"]),
    }  # fmt: skip


@pytest.mark.parametrize("kind", geometries(rig().rectified(SIZE, SIZE)))
def test_every_calibration_of_a_rectified_pair_gives_meters(kind: str, tmp_path: Path):
    found = rig().rectified(SIZE, SIZE)
    name, text, options = geometries(found)[kind]
    offset = 0 if options == ["no offset"] else 3
    (tmp_path / name).write_text(text)
    true = true_depth(rig())
    write_pfm(tmp_path / "map.pfm", (found.fb / true - offset).astype(np.float32))
    words = ["--calibration", tmp_path / name, *(word for word in options if word != "no offset")]
    assert run("depth", tmp_path / "map.pfm", *words, "-o", tmp_path / "out", "-q") == 0
    np.testing.assert_allclose(read_pfm(tmp_path / "out/map/depth.pfm"), true, rtol=1e-4)
    (row,) = json.loads((tmp_path / "out/report.json").read_text())["scenes"]
    assert row["baseline"] == pytest.approx(found.rig.baseline) and not row["warnings"]
    reading = Reading(cameras=(0, 1) if "--cameras" in options else (2, 3))
    refused(InputError, read_rig, [tmp_path / name], reading)


def test_a_rectified_pair_has_rows_that_correspond_and_the_right_depth(pinhole: Shot, tmp_path: Path):
    taken = pinhole.rig
    calibration = opencv(tmp_path / "c.yml", taken)
    assert run("rectify", *pinhole.words, "--calibration", calibration, "-o", tmp_path / "scenes", "-q") == 0
    row = rows(tmp_path / "scenes")["room"]
    assert row["matches"] > 100 and row["overlap"] == 1 and row["row_error"] < 0.25 < 1.5 < row["row_error_before"]
    assert row["baseline"] == pytest.approx(np.linalg.norm(taken.translation))
    assert sorted(p.name for p in (tmp_path / "scenes/room").iterdir()) == [
        "calib.txt", "left.png", "meta.json", "record.json", "right.png",
    ]  # fmt: skip
    geometry = read_geometry(tmp_path / "scenes/room/calib.txt")
    assert geometry.fb == pytest.approx(taken.rectified(SIZE, SIZE).geometry.fb)
    assert run("stereo", "fast", "-i", tmp_path / "scenes", "-o", tmp_path / "run", "-q") == 0
    check_meters(tmp_path / "run", taken, tmp_path)


@pytest.mark.slow
def test_a_config_rectifies_on_the_fly(pinhole: Shot, tmp_path: Path, tool):
    file = opencv(tmp_path / "c.yml", pinhole.rig)
    assert run("rectify", *pinhole.words, "--calibration", file, "-o", tmp_path / "scenes", "-q") == 0
    assert run("stereo", "fast", "-i", tmp_path / "scenes", "-o", tmp_path / "two", "-q") == 0
    config = tmp_path / "rig.yaml"
    config.write_text(f"base: fast\ncalibration: {file}\n")
    once = ("stereo", config, *pinhole.words, "-o", tmp_path / "one")
    assert run(*once, "-q") == 0
    one, two = tmp_path / "one/room", tmp_path / "two/room"
    for name in ("disp_left.pfm", "disp_left.png", "status.png", "preview.png"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    assert (one / "left.png").read_bytes() == (tmp_path / "scenes/room/left.png").read_bytes()
    assert not (one / "right.png").exists()
    row = rows(tmp_path / "one")["room"]
    assert row["row_error"] < 0.25 < 1.5 < row["row_error_before"]
    assert row["min_depth"] < row["median_depth"] == pytest.approx(np.median(true_depth(pinhole.rig)), rel=0.02)
    # Meters without another word: the rectified pair and its calibration lie beside the map.
    for name in ("one", "two"):
        assert run("depth", tmp_path / name, "-o", tmp_path / f"depth-{name}", "--ply", "-q") == 0
    for name in ("depth.pfm", "points.ply"):
        assert (tmp_path / "depth-one/room" / name).read_bytes() == (tmp_path / "depth-two/room" / name).read_bytes()
    # The option says the same; what was made is kept until the calibration changes.
    tool.told(0, "stereo", "fast", *pinhole.words, "--calibration", file, "-o", tmp_path / "one")
    opencv(file, rig(strength=0.75))
    tool.told(0, *once)
    assert (one / "disp_left.pfm").read_bytes() != (two / "disp_left.pfm").read_bytes()


def test_python_rectifies_as_the_command_does(pinhole: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The same files, and metric depth without further numbers; both ask for the unit of millimeters."""
    file, other = opencv(tmp_path / "c.yml", pinhole.rig), opencv(tmp_path / "mm.yml", pinhole.rig, unit=0.001)
    images = (*pinhole.words, "--max-disparity", "30", "-q")
    assert run("stereo", "fast", *images, "--calibration", file, "-o", tmp_path / "run") == 0
    assert run("depth", tmp_path / "run", "-o", tmp_path / "depth", "-q") == 0
    views = [read_image(side) for side in (pinhole.left, pinhole.right)]
    found = depthcli.stereo(*views, 30, "fast", calibration=str(file))
    found.save(tmp_path / "python")
    found.to_depth().save(tmp_path / "metric")
    for name in ("disp_left.pfm", "status.png", "left.png", "calib.txt"):
        assert (tmp_path / "python" / name).read_bytes() == (tmp_path / "run/room" / name).read_bytes()
    assert (tmp_path / "metric/depth.pfm").read_bytes() == (tmp_path / "depth/room/depth.pfm").read_bytes()
    refused(depthcli.InputError, depthcli.stereo, *views, 30, "fast", calibration=str(other))
    for unit, code in (((), 2), (("--unit", "inch"), 2), (("--unit", "mm"), 0)):
        assert run("stereo", "fast", *images, "--calibration", other, *unit, "-o", tmp_path / "mm") == code
    told(capsys.readouterr().err)
    assert (tmp_path / "mm/room/disp_left.pfm").read_bytes() == (tmp_path / "run/room/disp_left.pfm").read_bytes()


@pytest.fixture
def video(pinhole: Shot, tmp_path: Path) -> list[str | Path]:
    """Four frames, the later ones of other content, and the command that matches them; two images in one folder."""
    for k in range(4):
        for side in ("left", "right"):
            image = read_image(getattr(pinhole, side))
            write_png(tmp_path / "in" / f"{side}_{k}.png", image if k == 0 else 255 - np.roll(image, 9 * k, 0))
    file = opencv(tmp_path / "c.yml", pinhole.rig)
    return ["stereo", "fast", "-i", tmp_path / "in", "--calibration", file]


def test_a_calibration_costs_a_video_once(video: list[str | Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Rows are those of the first frame, the range that of three; the maps of the rectification are made once."""
    calls: Counter[str] = Counter()

    def counted(place: object, name: str) -> None:
        whole = getattr(place, name)

        def call(*arguments: object, **options: object) -> object:
            calls[name] += 1
            return whole(*arguments, **options)

        monkeypatch.setattr(place, name, call)

    counted(rectified, "match_views")
    counted(rectified, "matched_range")
    counted(Camera, "undistortion_maps")
    assert run(*video, "-o", tmp_path / "run", "-q") == 0
    assert calls == {"match_views": 1, "matched_range": 3, "undistortion_maps": 2}
    rows = json.loads((tmp_path / "run/report.json").read_text())["scenes"]
    assert len({row["max_disparity"] for row in rows}) == 1
    assert ["row_error" in row for row in rows] == [True, False, False, False]
    # Another calibration in the same file is another rectification.
    opencv(tmp_path / "c.yml", rig(strength=0.75))
    assert run(*video, "-o", tmp_path / "other", "-q") == 0
    assert calls == {"match_views": 2, "matched_range": 6, "undistortion_maps": 4}


@pytest.mark.slow
def test_frames_of_a_video_are_the_same_in_every_process(video: list[str | Path], tmp_path: Path):
    assert run(*video, "-o", tmp_path / "one", "-q") == 0
    assert run(*video, "-o", tmp_path / "jobs", "-q", "--jobs", "2") == 0
    assert run(*video, "-o", tmp_path / "resumed", "-q", "--scenes", "3") == 0
    assert run(*video, "-o", tmp_path / "resumed", "-q") == 0
    for other in ("jobs", "resumed"):
        assert contents(tmp_path / other) == contents(tmp_path / "one")
    # First, middle and last frame are inputs of all: of another one, all are matched again.
    before = (tmp_path / "one/1/record.json").read_text()
    write_png(tmp_path / "in/left_3.png", np.full((SIZE[1], SIZE[0], 3), 70, np.uint8))
    assert run(*video, "-o", tmp_path / "one", "-q") == 0
    assert (tmp_path / "one/1/record.json").read_text() != before


@pytest.fixture
def clip(pinhole: Shot, tmp_path: Path) -> list[str | Path]:
    """Two videos of five frames, of which the middle one alone has depths that are as far apart."""
    views = {side: read_image(getattr(pinhole, side))[..., ::-1] for side in ("left", "right")}
    found = pinhole.rig.rectified(SIZE, SIZE).images(*(np.ascontiguousarray(view) for view in views.values()))
    for side, view in zip(views, found, strict=False):
        writer = cv2.VideoWriter(str(tmp_path / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
        writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
        for k in range(5):
            writer.write(np.roll(view, -20, 1) if (side, k) == ("right", 2) else view)
        writer.release()
    return ["--left", tmp_path / "left.avi", "--right", tmp_path / "right.avi"]


@pytest.mark.slow
def test_a_video_has_one_range_by_its_first_middle_and_last_frame(clip: list[str | Path], tmp_path: Path, capsys):
    def rows(folder: str, *more: str | Path) -> list[dict[str, Any]]:
        assert run("stereo", "fast", *clip, *more, "-o", tmp_path / folder) == 0
        return json.loads((tmp_path / folder / "report.json").read_text())["scenes"]  # type: ignore[no-any-return]

    one = rows("one")
    said = capsys.readouterr().err
    assert "--max-disparity auto was taken, which gives " in said
    each = rows("each", "--max-disparity", "auto")
    tops = [row["max_disparity"] for row in each]
    assert tops[2] > tops[0] + 10
    assert {row["max_disparity"] for row in one} == {max(tops[0], tops[2], tops[4])}
    assert {row["range_matches"] for row in one} == {sum(each[k]["range_matches"] for k in (0, 2, 4))}
    alone = rows("alone", "--scenes", "000001", "--jobs", "2")
    assert alone[0]["max_disparity"] == one[1]["max_disparity"]
    assert contents(tmp_path / "alone/000001") == contents(tmp_path / "one/000001")


@pytest.mark.slow
def test_a_turned_camera_is_no_second_one(pinhole: Shot, tmp_path: Path, tool):
    left = read_image(pinhole.left)
    matrix = np.array([[200.0, 0, 119.5], [0, 200, 89.5], [0, 0, 1]])
    turned = cv2.warpPerspective(left, matrix @ rotation(2, 3, 1) @ np.linalg.inv(matrix), SIZE, flags=cv2.INTER_CUBIC)
    write_png(tmp_path / "turned.png", turned)
    images = ("--left", pinhole.left, "--right", tmp_path / "turned.png", "--name", "room")
    tool.told(0, "rectify", *images, "--uncalibrated", "-o", tmp_path / "scenes")
    assert "no depth" not in tool.err(0, "rectify", *pinhole.words, "--uncalibrated", "-o", tmp_path / "other")


@pytest.mark.slow
def test_without_calibration(pinhole: Shot, tmp_path: Path, capsys: pytest.CaptureFixture[str], tool):
    straight = rig()
    straight = Rig(*(Camera(lens.matrix, size=SIZE) for lens in (straight.left, straight.right)),
                         straight.rotation, straight.translation)  # fmt: skip
    taken = shot(tmp_path / "photos", straight)
    assert run("rectify", *taken.words, "--uncalibrated", "-o", tmp_path / "scenes", "-q") == 0
    row = json.loads((tmp_path / "scenes/report.json").read_text())["scenes"][0]
    assert row["row_error"] < 0.3 < 1.5 < row["row_error_before"]
    assert row["overlap"] > 0.75
    assert not (tmp_path / "scenes/room/calib.txt").exists()
    assert run("stereo", "fast", "-i", tmp_path / "scenes", "-o", tmp_path / "run", "-q") == 0
    status = read_status(tmp_path / "run/room/status.png")
    assert np.mean((status & 0b11111) == 0) > 0.7
    given = ("--focal", "200", "--baseline", "0.1")
    assert run("depth", tmp_path / "run", *given, "-o", tmp_path / "depth", "-q") == 3
    assert "without a calibration" in capsys.readouterr().err and not (tmp_path / "depth/room/depth.pfm").exists()
    # Two photos of different things, and photos without anything on them.
    noise = np.random.default_rng(0).integers(0, 255, (180, 240), np.uint8)
    write_png(tmp_path / "other.png", cv2.GaussianBlur(noise, (0, 0), 2) * np.uint8(3))
    write_png(tmp_path / "flat.png", np.full((180, 240), 70, np.uint8))
    for other in ("other.png", "flat.png"):
        pair = ("--left", taken.left, "--right", tmp_path / other, "--name", other)
        tool.told(3, "rectify", *pair, "--uncalibrated", "-o", tmp_path / "scenes", "-q")
        assert not (tmp_path / "scenes" / other / "left.png").exists()


def test_rows_of_turned_cameras_meet_without_their_calibration():
    taken, rng = rig(), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.ones(300)]) * rng.uniform(1, 5, (300, 1))
    seen = points, points @ taken.rotation.T + taken.translation
    cameras = (Camera(lens.matrix, size=SIZE) for lens in (taken.left, taken.right))
    left, right = (camera.project(each) for camera, each in zip(cameras, seen, strict=True))
    found = rectify_uncalibrated(left, right, SIZE)
    assert row_error(left, right) > 1.5 > 0.25 > row_error(*found.points(left, right))


def test_points_that_no_two_cameras_explain_are_refused():
    """Half of the rows off by two pixels: no pair is made of them."""
    rng = np.random.default_rng(1)
    left = rng.uniform(0, 200, (300, 2))
    right = left - np.stack([rng.uniform(5, 40, 300), np.zeros(300)], 1)
    one, other = rectify_uncalibrated(left, right, (200, 200)).points(left, right)
    assert row_error(one, other) < 0.01
    assert np.quantile(one[:, 0] - other[:, 0], 0.01) == pytest.approx(0.02 * 200, abs=0.1)
    right[:180, 1] += rng.choice([-1, 1], 180) * rng.uniform(1.5, 2.5, 180)
    refused(InputError, rectify_uncalibrated, left, right, (200, 200))


@pytest.mark.slow
def test_wrong_calibrations(pinhole: Shot, tmp_path: Path, tool):
    images = (*pinhole.words, "-o", tmp_path / "out", "-q")
    taken = pinhole.rig
    swapped = Rig(taken.left, taken.right, taken.rotation, -taken.translation)
    above = Rig(taken.left, taken.right, np.eye(3), np.array([0.0, 0.1, 0.0]))
    (tmp_path / "text.yml").write_text("nothing: here\n")
    (tmp_path / "part.yml").write_text("%YAML:1.0\n---\nalpha: 5\n")
    for file in (
        opencv(tmp_path / "swapped.yml", swapped),
        opencv(tmp_path / "above.yml", above),
        tmp_path / "text.yml",
        tmp_path / "part.yml",
        ros(tmp_path, taken)[0],
        tmp_path / "absent.yml",
    ):
        tool.told(3, "rectify", *images, "--calibration", file)
    # The rows of another rig's calibration do not fit: said, not refused.
    bent = Rig(taken.left, taken.right, rotation(5, 0, 0) @ taken.rotation, taken.translation)
    images = (*images[:-1], "--overwrite")
    tool.told(0, "rectify", *images, "--calibration", opencv(tmp_path / "bent.yml", bent))


def test_alpha_shows_everything(pinhole: Shot, tmp_path: Path):
    calibration = ("--calibration", opencv(tmp_path / "c.yml", pinhole.rig), "--alpha", "1")
    assert run("rectify", *pinhole.words, *calibration, "-o", tmp_path / "scenes", "-q") == 0
    row = json.loads((tmp_path / "scenes/report.json").read_text())["scenes"][0]
    assert 0.6 < row["overlap"] < 0.99
    assert row["row_error"] < 0.25
    assert (read_image(tmp_path / "scenes/room/left.png") == 0).all(axis=2).mean() > 0.01


def halves(folder: Path, file: Path) -> list[Path]:
    """Two files of OpenCV, as its sample writes them: the cameras, and how they stand."""
    text = file.read_text()
    at = text.index("R: !!")
    parts = [folder / "intrinsics.yml", folder / "extrinsics.yml"]
    parts[0].write_text(text[:at])
    parts[1].write_text("%YAML:1.0\n---\n" + text[at:])
    return parts


def both(files: list[Path]) -> list[str | Path]:
    return [word for file in files for word in ("--calibration", file)]


def test_a_calibration_of_two_files_is_taken_everywhere(pinhole: Shot, tmp_path: Path, capsys):
    """By stereo and depth, as by rectify; two whole ones are refused."""
    whole = opencv(tmp_path / "c.yml", pinhole.rig)
    lines = [["--calibration", whole], both(halves(tmp_path, whole)), both(ros(tmp_path, pinhole.rig))]
    maps = []
    for k, calibration in enumerate(lines):
        out = tmp_path / f"run{k}"
        assert run("stereo", "fast", *pinhole.words, *calibration, "-o", out, "-q") == 0
        maps.append((out / "room/disp_left.pfm").read_bytes())
        # A map that stereo rectified for keeps its own geometry, whatever the file's projections say.
        assert run("depth", out, "-o", tmp_path / f"own{k}", "-q") == 0
        assert run("depth", out, *calibration, "-o", tmp_path / f"depth{k}", "-q") == 0
        depths = [(tmp_path / name / "room/depth.pfm").read_bytes() for name in (f"own{k}", f"depth{k}")]
        assert depths[0] == depths[1]
    assert maps[0] == maps[1]
    for command in (("stereo", "fast"), ("rectify",)):
        twice = both([whole, opencv(tmp_path / "d.yml", pinhole.rig)])
        assert run(*command, *pinhole.words, *twice, "-o", tmp_path / "none", "-q") != 0
        told(capsys.readouterr().err)


@pytest.mark.parametrize("kind", ["opencv", "projections", "ros", "echo", "kalibr", "kitti"])
def test_depth_takes_what_rectify_takes(kind: str, pinhole: Shot, tmp_path: Path, tool):
    """A map of another program, of a pair that was rectified as depthcli does, or by projections of the file."""
    taken = pinhole.rig
    found = taken.rectified(SIZE, SIZE)
    write_pfm(tmp_path / "map.pfm", np.tile(np.linspace(8, 20, SIZE[0]), (SIZE[1], 1)))
    files = {"kalibr": kalibr, "kitti": kitti, "opencv": opencv, "projections": opencv}
    of_both = {"ros": ros, "echo": echo}
    calibration = of_both[kind](tmp_path, taken) if kind in of_both else [files[kind](tmp_path / "c.yml", taken)]
    factor = 2.0 if kind == "projections" else 1.0  # which other flags of OpenCV give
    if kind == "projections":
        storage = cv2.FileStorage(str(tmp_path / "p.yml"), cv2.FILE_STORAGE_WRITE)
        storage.write("P1", found.projection * [[factor], [factor], [1]])
        storage.write("P2", found.projection_right * [[factor], [factor], [1]])
        storage.release()
        calibration.append(tmp_path / "p.yml")
    said = tool.err(0, "depth", tmp_path / "map.pfm", *both(calibration), "-o", tmp_path / "out")
    by_projections = kind in ("ros", "echo", "projections")
    assert ("rectified by its projections" in said, "depthcli rectify has rectified" in said) == (
        by_projections,
        not by_projections,
    )
    depth = read_pfm(tmp_path / "out/map/depth.pfm")
    np.testing.assert_allclose(depth, factor * found.geometry.depth(read_pfm(tmp_path / "map.pfm")), rtol=1e-5)
