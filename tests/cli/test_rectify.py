"""Rigs with known cameras and a known room: rectified by every kind of calibration, matched, turned into meters."""

import itertools
import re
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.errors import InputError
from depthcli.io.formats.calibrations import Reading, read_geometry, read_rig
from depthcli.io.formats.disparity import read_pfm, read_status, write_pfm
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import read_image, write_png
from depthcli.methods.stereo.rectification import rectify_uncalibrated, row_error
from depthcli.problems import rectified
from tests.boards import opencv
from tests.calibrations import RIGS, SIZE, geometries, kalibr, kitti, rig, ros, rotation
from tests.command_line import contents, rows, run
from tests.files import laid
from tests.golden import refused

PIXELS = np.stack(np.meshgrid(*map(np.arange, SIZE)), -1).reshape(-1, 2).astype(float)
# Planes n . X = 1 in the left camera's frame, nearest last: a slanted wall, a board in front of it.
WALL, BOARD = np.array([0.05, 0.02, 0.34]), np.array([0.0, 0.03, 0.55])


def seen(plane: np.ndarray, turn: np.ndarray, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) of the left camera that rays (x, y, 1) @ turn from ``center`` meet; the board's are True."""
    rays = np.column_stack([plane, np.ones(len(plane))]) @ turn
    far, near = (center + rays * ((1 - center @ each) / (rays @ each))[:, None] for each in (WALL, BOARD))
    board = (np.abs(near[:, 0] + 0.05) < 0.35) & (np.abs(near[:, 1]) < 0.28)
    return np.where(board[:, None], near, far), board


def photo(lens: Camera, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: what a camera at x' = turn x + shift sees; the mean of nine rays a pixel."""
    noise = np.random.default_rng(5).random((2, 1024, 1024, 3)).astype(np.float32)
    noise = np.stack([cv2.GaussianBlur(each, (0, 0), 2.2) for each in noise])
    noise = (noise - noise.min()) / (noise.max() - noise.min())
    shape, total = SIZE[::-1], np.zeros((*SIZE[::-1], 3))
    for step in itertools.product((-1 / 3, 0, 1 / 3), repeat=2):
        points, board = seen(lens.rays(PIXELS + step), turn, -turn.T @ shift)
        u, v = (((points[:, k] * 160 + 512) % 1023).astype(np.float32).reshape(shape) for k in (0, 1))
        wall, front = (cv2.remap(each, u, v, cv2.INTER_LINEAR) for each in noise)
        total += np.where(board.reshape(*shape, 1), front, wall)
    return np.rint(total / 9 * 255).clip(0, 255).astype(np.uint8)


class Shot(NamedTuple):
    rig: Rig
    left: Path
    right: Path

    @property
    def words(self) -> tuple[str | Path, ...]:
        return ("--left", self.left, "--right", self.right, "--name", "room")


def shot(folder: Path, taken: Rig) -> Shot:
    right = photo(taken.right, taken.rotation, taken.translation)
    laid(folder, {"left.png": photo(taken.left, np.eye(3), np.zeros(3)), "right.png": right})
    return Shot(taken, folder / "left.png", folder / "right.png")


@pytest.fixture(scope="module")
def pinhole(tmp_path_factory: pytest.TempPathFactory) -> Shot:
    return shot(tmp_path_factory.mktemp("pinhole"), rig())


def true_depth(taken: Rig) -> np.ndarray:
    """What the rectified left camera sees: the depth (H, W), meters."""
    found = taken.rectified(SIZE, SIZE)
    k = found.geometry.left
    points, _ = seen((PIXELS - (k.cx, k.cy)) / (k.fx, k.fy), found.rotation, np.zeros(3))
    return (points @ found.rotation.T)[:, 2].reshape(SIZE[::-1])


def flat_map(folder: Path) -> Path:
    write_pfm(folder / "map.pfm", np.full(SIZE[::-1], 10, np.float32))
    return folder / "map.pfm"


def both(files: list[Path]) -> list[str | Path]:
    return [word for file in files for word in ("--calibration", file)]


@pytest.mark.parametrize(
    ("kind", "fisheye"),
    [(kind, fisheye) for kind in RIGS for fisheye in (False, True) if (kind, fisheye) != ("kitti", True)],
)
def test_every_kind_of_file_gives_the_rig(kind: str, fisheye: bool, tmp_path: Path):
    taken = rig(fisheye)
    if kind == "zed":  # which is known by its size, VGA
        left, right = (replace(lens, size=(672, 376)) for lens in (taken.left, taken.right))
        taken = replace(taken, left=left, right=right)
    files, options = RIGS[kind](tmp_path, taken)
    unit = options[-1] if "--unit" in options else None
    found = read_rig(files, Reading(unit, fisheye and "lens" in options), taken.left.size)
    for one, other in ((found.left, taken.left), (found.right, taken.right)):
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e-9)
        np.testing.assert_allclose(np.resize(one.distortion, 4), np.resize(other.distortion, 4), atol=1e-12)
        assert one.fisheye == other.fisheye and one.size == (None if kind.startswith("opencv,") else other.size)
    np.testing.assert_allclose(found.rotation, taken.rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, taken.translation, atol=1e-9)
    if kind == "zed":  # what its file lacks is 0
        files[0].write_text(re.sub("(?m)^(TY|TZ|RX|CV|RZ).*\n", "", files[0].read_text()))
        found = read_rig(files, Reading(), taken.left.size)
        assert (found.rotation == np.eye(3)).all() and (found.translation[1:] == 0).all()


@pytest.mark.parametrize("kind", geometries(rig().rectified(SIZE, SIZE)))
def test_every_calibration_of_a_rectified_pair_gives_meters(kind: str, tmp_path: Path):
    found, true = rig().rectified(SIZE, SIZE), true_depth(rig())
    name, text, options = geometries(found)[kind]
    (tmp_path / name).write_text(text)
    offset = 0 if kind == "foundation stereo" else 3
    write_pfm(tmp_path / "map.pfm", (found.fb / true - offset).astype(np.float32))
    words = ("--calibration", tmp_path / name, *options, "-o", tmp_path / "out", "-q")
    assert run("depth", tmp_path / "map.pfm", *words) == 0
    np.testing.assert_allclose(read_pfm(tmp_path / "out/map/depth.pfm"), true, rtol=1e-4)
    row = rows(tmp_path / "out")["map"]
    assert row["baseline"] == pytest.approx(found.rig.baseline) and not row["warnings"]
    refused(InputError, read_rig, [tmp_path / name], Reading(cameras=(0, 1) if options[-1:] == ["0,1"] else (2, 3)))


@pytest.mark.parametrize(("baseline", "unit", "said"), [
    (4.3, None, "a baseline of 4.3 m: if the translation has another unit, give the unit"),
    (4.3, "m", ""),
    (4.3, "mm", ""),  # an endoscope
    (4.17, "24mm", ""),
    (0.0043, None, "which unit has the translation?"),
    (0.0043, "m", ""),
    (140, None, "which unit has the translation?"),
    (140, "mm", ""),
])  # fmt: skip
def test_an_unusual_baseline_asks_for_its_unit(baseline: float, unit: str | None, said: str, tmp_path: Path):
    """By every reader of rigs and of rectified pairs, in depth and in Python's to_depth, too."""
    taken = rig()
    far = replace(taken, translation=taken.translation / taken.baseline * baseline)
    meters = {None: 1.0, "m": 1.0, "mm": 0.001, "24mm": 0.024}[unit]
    (tmp_path / "K.txt").write_text(f"200 0 119.5 0 200 89.5 0 0 1\n{baseline}\n")
    whole = opencv(tmp_path / "a.yml", far), kalibr(tmp_path / "b.yaml", far), kitti(tmp_path / "c.txt", far)
    for one in ([whole[0]], ros(tmp_path, far), [whole[1]], [whole[2]], [tmp_path / "K.txt"]):
        with collected_warnings() as lines:
            if "which" in said:
                refused(InputError, read_geometry, one, Reading(unit))
                continue
            geometry = read_geometry(one, Reading(unit))
        assert geometry.baseline == pytest.approx(baseline * meters, rel=1e-3)
        assert bool(said) == any(line.startswith(f"{one[0]}: a baseline") for line in lines)
    words = ("--calibration", whole[0], *(["--unit", unit] if unit else []), "-o", tmp_path / "out", "-q")
    assert run("depth", flat_map(tmp_path), *words) == (3 if "which" in said else 0)
    row = rows(tmp_path / "out")["map"]
    assert said in " ".join([row["error"], *(row["warnings"] or [])])


def test_units_that_are_none_and_options_without_a_calibration(tmp_path: Path, tool):
    pair = ("--left", "l.png", "--right", "r.png")
    depth = ("depth", flat_map(tmp_path))
    for line in (depth, ("stereo", "fast", *pair), ("fuse", "consensus", *pair), ("rectify", *pair)):
        for wrong in ("inch", "0mm", "5", "-2mm"):
            words = ("--calibration", opencv(tmp_path / "a.yml", rig()), "--unit", wrong)
            tool.told(2, *line, *words, "-o", tmp_path / "out")
        for option in (("--unit", "mm"), ("--fisheye",), ("--cameras", "0,1"), ("--alpha", "1")):
            tool.told(3 if line == depth else 2, *line, *option, "-o", tmp_path / "out", "-q")


@pytest.mark.parametrize("kind", ["opencv yml", "projections", "ros", "rostopic echo", "kalibr", "kitti"])
def test_depth_takes_what_rectify_takes(kind: str, pinhole: Shot, tmp_path: Path, tool):
    """A map of another program, of a pair that was rectified as depthcli does, or by projections of the file."""
    found, factor = pinhole.rig.rectified(SIZE, SIZE), 1.0
    write_pfm(tmp_path / "map.pfm", np.tile(np.linspace(8, 20, SIZE[0]), (SIZE[1], 1)))
    if kind == "projections":
        files, factor = [opencv(tmp_path / "c.yml", pinhole.rig), tmp_path / "p.yml"], 2.0  # by other flags of OpenCV
        storage = cv2.FileStorage(str(files[1]), cv2.FILE_STORAGE_WRITE)
        for name, projection in (("P1", found.projection), ("P2", found.projection_right)):
            storage.write(name, projection * [[factor], [factor], [1]])
        storage.release()
    else:
        files, _ = RIGS[kind](tmp_path, pinhole.rig)
    said = tool.err(0, "depth", tmp_path / "map.pfm", *both(files), "-o", tmp_path / "out")
    by_projections = kind not in ("opencv yml", "kalibr", "kitti")
    assert ("rectified by its projections" in said) == by_projections
    assert ("depthcli rectify has rectified" in said) != by_projections
    depth = read_pfm(tmp_path / "out/map/depth.pfm")
    np.testing.assert_allclose(depth, factor * found.geometry.depth(read_pfm(tmp_path / "map.pfm")), rtol=1e-5)


# Pairs that are rectified by them.


def test_rectified_pairs_and_a_config_that_rectifies_on_the_fly(pinhole: Shot, tmp_path: Path, tool):
    file = opencv(tmp_path / "c.yml", pinhole.rig)
    assert run("rectify", *pinhole.words, "--calibration", file, "-o", tmp_path / "scenes", "-q") == 0
    row, scene = rows(tmp_path / "scenes")["room"], tmp_path / "scenes/room"
    assert row["matches"] > 100 and row["overlap"] == 1 and row["row_error"] < 0.25 < 1.5 < row["row_error_before"]
    assert row["baseline"] == pytest.approx(np.linalg.norm(pinhole.rig.translation))
    assert {p.name for p in scene.iterdir()} == {"calib.txt", "left.png", "meta.json", "record.json", "right.png"}
    assert read_geometry(scene / "calib.txt").fb == pytest.approx(pinhole.rig.rectified(SIZE, SIZE).geometry.fb)
    assert run("stereo", "fast", "-i", tmp_path / "scenes", "-o", tmp_path / "two", "-q") == 0
    config = tmp_path / "rig.yaml"
    config.write_text(f"base: fast\ncalibration: {file}\n")
    once = ("stereo", config, *pinhole.words, "-o", tmp_path / "one")
    assert run(*once, "-q") == 0
    one, two = tmp_path / "one/room", tmp_path / "two/room"
    for name in ("disp_left.pfm", "disp_left.png", "status.png", "preview.png"):
        assert (one / name).read_bytes() == (two / name).read_bytes()
    assert (one / "left.png").read_bytes() == (scene / "left.png").read_bytes()
    assert not (one / "right.png").exists()
    row, true = rows(tmp_path / "one")["room"], true_depth(pinhole.rig)
    assert row["row_error"] < 0.25 < 1.5 < row["row_error_before"]
    assert row["min_depth"] < row["median_depth"] == pytest.approx(np.median(true), rel=0.02)
    # Meters without another word: the rectified pair and its calibration lie beside the map.
    for made in (one, two):
        words = ("-o", tmp_path / "depth" / made.parent.name, "--ply", "--mask", "measured", "-q")
        assert run("depth", made.parent, *words) == 0
    assert contents(tmp_path / "depth/one/room") == contents(tmp_path / "depth/two/room")
    # From Python, too; both ask for the unit of millimeters.
    pair, other = [*map(read_image, pinhole[1:])], opencv(tmp_path / "mm.yml", pinhole.rig, unit=0.001)
    found = depthcli.stereo(*pair, preset="fast", calibration=str(file))
    found.save(tmp_path / "python")
    found.to_depth(mask="measured").save(tmp_path / "metric")
    for name in ("disp_left.pfm", "status.png", "left.png", "calib.txt"):
        assert (tmp_path / "python" / name).read_bytes() == (one / name).read_bytes()
    assert (tmp_path / "metric/depth.pfm").read_bytes() == (tmp_path / "depth/one/room/depth.pfm").read_bytes()
    refused(depthcli.InputError, depthcli.stereo, *pair, 30, "fast", calibration=str(other))
    tool.told(2, "stereo", "fast", *pinhole.words, "-q", "--calibration", other, "-o", tmp_path / "mm")
    depth = read_pfm(tmp_path / "depth/two/room/depth.pfm")
    error = ((depth - true) / true)[np.isfinite(depth)]
    assert np.isfinite(depth).mean() > 0.6
    # A pixel is 6 to 12 % of the depth here: no bias, and a sixth of a pixel at most half of the time.
    assert abs(np.median(error)) < 0.004 and np.median(np.abs(error)) < 0.015 and np.mean(np.abs(error) < 0.04) > 0.93
    # The truth beside the photos is of no rectified map.
    truth = shutil.copytree(pinhole.left.parent, tmp_path / "true" / "room")
    laid(truth, {"disp_left.pfm": np.ones(SIZE[::-1], np.float32)})
    tool.told(0, "stereo", config, "-i", truth.parent, "-o", tmp_path / "false", "--max-disparity", "30")
    # The option says the same; what was made is kept until the calibration changes.
    tool.told(0, "stereo", "fast", *pinhole.words, "--calibration", file, "-o", tmp_path / "one")
    opencv(file, rig(strength=0.75))
    tool.told(0, *once)
    assert (one / "disp_left.pfm").read_bytes() != (two / "disp_left.pfm").read_bytes()


def test_all_commands_read_a_calibration_as_rectify_does(tmp_path: Path):
    """With --fisheye, --alpha and --unit."""
    fish = shot(tmp_path, rig(fisheye=True))
    file = opencv(tmp_path / "mm.yml", fish.rig, unit=0.001)
    calibration = ("--calibration", file, "--unit", "mm", "--fisheye", "--alpha", "0.5", "-q")
    expected = fish.rig.rectified(SIZE, SIZE, 0.5).geometry
    for line in (("rectify",), ("stereo", "fast"), ("fuse", "consensus")):
        out = tmp_path / line[0]
        assert run(*line, *fish.words, *calibration, "-o", out) == 0
        found = read_geometry(out / "room/calib.txt")
        assert (found.left.fx, found.baseline) == pytest.approx((expected.left.fx, expected.baseline))
        if line[0] != "rectify":
            (tmp_path / "alone").mkdir(exist_ok=True)
            alone = shutil.copy(out / "room/disp_left.pfm", tmp_path / f"alone/{line[0]}.pfm")
            assert run("depth", alone, *calibration, "-o", tmp_path / "depth") == 0
            assert run("depth", out, "-q", "-o", tmp_path / "depth_of_run", "--overwrite") == 0
            one, two = (read_pfm(tmp_path / name / "depth.pfm") for name in (f"depth/{line[0]}", "depth_of_run/room"))
            np.testing.assert_allclose(one, two, rtol=1e-5)


@pytest.mark.slow
def test_a_camera_of_images_of_another_size_is_warned_of(pinhole: Shot, tmp_path: Path):
    """If the file has no size: by rectify, stereo, depth and to_depth; one with its size is refused or scaled."""
    own, numbers = pinhole.rig, tmp_path / "numbers.txt"
    for factor, count in ((1.0, 0), (2.0, 2), (0.5, 2)):
        taken = replace(own, left=own.left.scaled(factor), right=own.right.scaled(factor))
        calibration = ("--calibration", opencv(tmp_path / "c.yml", taken), "--overwrite", "-q")
        numbers.write_text(" ".join(map(str, taken.left.matrix.ravel())) + "\n0.14\n")
        for command, *words in (
            ("rectify", *pinhole.words, *calibration),
            ("stereo", "fast", *pinhole.words, *calibration),
            ("depth", flat_map(tmp_path), "--calibration", numbers, "--overwrite", "-q"),
        ):
            run(command, *words, "-o", tmp_path / command)
            (row,) = rows(tmp_path / command).values()
            far = [line for line in row["warnings"] or [] if "far from the center of images of 240 x 180" in line]
            assert len(far) == (min(count, 1) if command == "depth" else count)
            assert row["status"] == "done" or (count and command != "depth")


@pytest.fixture
def video(pinhole: Shot, tmp_path: Path) -> list[str | Path]:
    """Four frames, the later ones of other content, and the command that matches them; two images in one folder."""
    for k in range(4):
        for side in ("left", "right"):
            image = read_image(getattr(pinhole, side))
            write_png(tmp_path / "in" / f"{side}_{k}.png", image if k == 0 else 255 - np.roll(image, 9 * k, 0))
    return ["stereo", "fast", "-i", tmp_path / "in", "-q", "--calibration", opencv(tmp_path / "c.yml", pinhole.rig)]


def test_a_calibration_costs_a_video_once(video: list[str | Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Rows are those of the first frame, the range that of three; the maps of the rectification are made once."""
    calls: Counter[str] = Counter()

    def count(place: object, name: str) -> None:
        whole = getattr(place, name)
        monkeypatch.setattr(place, name, lambda *words, **named: calls.update([name]) or whole(*words, **named))

    count(rectified, "match_views")
    count(rectified, "matched_range")
    count(Camera, "undistortion_maps")
    assert run(*video, "-o", tmp_path / "run") == 0
    assert calls == {"match_views": 1, "matched_range": 3, "undistortion_maps": 2}
    found = rows(tmp_path / "run").values()
    assert len({row["max_disparity"] for row in found}) == 1
    assert ["row_error" in row for row in found] == [True, False, False, False]
    opencv(tmp_path / "c.yml", rig(strength=0.75))  # another calibration in the same file is another rectification
    assert run(*video, "-o", tmp_path / "other") == 0
    assert calls == {"match_views": 2, "matched_range": 6, "undistortion_maps": 4}


@pytest.mark.slow
def test_frames_of_a_video_are_the_same_in_every_process(video: list[str | Path], tmp_path: Path):
    one = tmp_path / "one"
    for name, *options in (("one",), ("jobs", "--jobs", "2"), ("resumed", "--scenes", "3"), ("resumed",)):
        assert run(*video, "-o", tmp_path / name, *options) == 0
    assert contents(tmp_path / "jobs") == contents(tmp_path / "resumed") == contents(one)
    # First, middle and last frame are inputs of all: of another one, all are matched again.
    before = (one / "1/record.json").read_text()
    write_png(tmp_path / "in/left_3.png", np.full((SIZE[1], SIZE[0], 3), 70, np.uint8))
    assert run(*video, "-o", one) == 0
    assert (one / "1/record.json").read_text() != before


@pytest.mark.slow
def test_a_video_has_one_range_by_its_first_middle_and_last_frame(pinhole: Shot, tmp_path: Path, tool):
    """Two videos of five frames, of which the middle one alone has depths that are as far apart."""
    views = (np.ascontiguousarray(read_image(side)[..., ::-1]) for side in (pinhole.left, pinhole.right))
    for side, view in zip(("left", "right"), pinhole.rig.rectified(SIZE, SIZE).images(*views), strict=False):
        writer = cv2.VideoWriter(str(tmp_path / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
        writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
        for k in range(5):
            writer.write(np.roll(view, -20, 1) if (side, k) == ("right", 2) else view)
        writer.release()
    clip = ("stereo", "fast", "--left", tmp_path / "left.avi", "--right", tmp_path / "right.avi", "-o")
    assert "--max-disparity auto was taken, which gives " in tool.err(0, *clip, tmp_path / "one")
    assert run(*clip, tmp_path / "each", "--max-disparity", "auto") == 0
    assert run(*clip, tmp_path / "alone", "--scenes", "000001", "--jobs", "2") == 0
    one, each, alone = (list(rows(tmp_path / name).values()) for name in ("one", "each", "alone"))
    tops = [row["max_disparity"] for row in each]
    assert tops[2] > tops[0] + 10
    assert {row["max_disparity"] for row in (*one, *alone)} == {max(tops[0], tops[2], tops[4])}
    assert {row["range_matches"] for row in one} == {sum(each[k]["range_matches"] for k in (0, 2, 4))}
    assert contents(tmp_path / "alone/000001") == contents(tmp_path / "one/000001")


@pytest.mark.slow
def test_without_calibration(pinhole: Shot, tmp_path: Path, tool):
    bare = replace(rig(), **{side: Camera(getattr(rig(), side).matrix, size=SIZE) for side in ("left", "right")})
    taken, scenes = shot(tmp_path / "photos", bare), tmp_path / "scenes"
    assert "no depth" not in tool.err(0, "rectify", *taken.words, "--uncalibrated", "-o", scenes)
    row = rows(scenes)["room"]
    assert row["row_error"] < 0.3 < 1.5 < row["row_error_before"] and row["overlap"] > 0.75
    assert not (scenes / "room/calib.txt").exists()
    assert run("stereo", "fast", "-i", scenes, "-o", tmp_path / "run", "-q") == 0
    status = read_status(tmp_path / "run/room/status.png")
    assert np.mean((status & 0b11111) == 0) > 0.7
    given = ("--focal", "200", "--baseline", "0.1")
    err = tool.err(3, "depth", tmp_path / "run", *given, "-o", tmp_path / "depth", "-q")
    assert "without a calibration" in err and not (tmp_path / "depth/room/depth.pfm").exists()
    # Two photos of different things, and photos without anything on them.
    noise = np.random.default_rng(0).integers(0, 255, (180, 240), np.uint8)
    other, flat = cv2.GaussianBlur(noise, (0, 0), 2) * np.uint8(3), np.full((180, 240), 70, np.uint8)
    laid(tmp_path, {"other.png": other, "flat.png": flat, "smaller.png": read_image(taken.right)[:170]})
    for other in ("other.png", "flat.png", "smaller.png"):
        pair = ("--left", taken.left, "--right", tmp_path / other, "--name", other)
        tool.told(3, "rectify", *pair, "--uncalibrated", "-o", scenes, "-q")
        assert not (scenes / other / "left.png").exists()
    # A turned camera is no second one.
    matrix = np.array([[200.0, 0, 119.5], [0, 200, 89.5], [0, 0, 1]])
    move = matrix @ rotation(2, 3, 1) @ np.linalg.inv(matrix)
    turned = cv2.warpPerspective(read_image(pinhole.left), move, SIZE, flags=cv2.INTER_CUBIC)
    write_png(tmp_path / "turned.png", turned)
    pair = ("--left", pinhole.left, "--right", tmp_path / "turned.png", "--name", "turned")
    tool.told(0, "rectify", *pair, "--uncalibrated", "-o", tmp_path / "turned")


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
    taken, line = pinhole.rig, ("rectify", *pinhole.words, "-o", tmp_path / "out", "--calibration")
    laid(tmp_path, {"text.yml": "nothing: here\n", "part.yml": "%YAML:1.0\n---\nalpha: 5\n"})
    above = replace(taken, rotation=np.eye(3), translation=np.array([0.0, 0.1, 0.0]))
    swapped = opencv(tmp_path / "swapped.yml", replace(taken, translation=-taken.translation))
    for file in (
        swapped, opencv(tmp_path / "above.yml", above), tmp_path / "text.yml", tmp_path / "part.yml",
        ros(tmp_path, taken)[0], tmp_path / "absent.yml",
    ):  # fmt: skip
        tool.told(3, *line, file, "-q")
    # The rows of another rig's calibration do not fit: said, not refused.
    bent = replace(taken, rotation=rotation(5, 0, 0) @ taken.rotation)
    tool.told(0, *line, opencv(tmp_path / "bent.yml", bent), "--overwrite")


def test_alpha_shows_everything(pinhole: Shot, tmp_path: Path):
    calibration = ("--calibration", opencv(tmp_path / "c.yml", pinhole.rig), "--alpha", "1")
    assert run("rectify", *pinhole.words, *calibration, "-o", tmp_path / "scenes", "-q") == 0
    row = rows(tmp_path / "scenes")["room"]
    assert 0.6 < row["overlap"] < 0.99 and row["row_error"] < 0.25
    assert (read_image(tmp_path / "scenes/room/left.png") == 0).all(axis=2).mean() > 0.01


def test_a_map_that_was_rectified_for_keeps_its_own_geometry(pinhole: Shot, tmp_path: Path, tool):
    """Whatever the projections of a calibration of two files say; two whole ones are refused."""
    files, depths = both(ros(tmp_path, pinhole.rig)), []
    assert run("stereo", "fast", *pinhole.words, *files, "-o", tmp_path / "run", "-q") == 0
    for name, calibration in (("own", []), ("given", files)):
        assert run("depth", tmp_path / "run", *calibration, "-o", tmp_path / name, "-q") == 0
        depths.append((tmp_path / name / "room/depth.pfm").read_bytes())
    assert depths[0] == depths[1]
    twice = both([opencv(tmp_path / "c.yml", pinhole.rig), opencv(tmp_path / "d.yml", pinhole.rig)])
    for code, *command in ((2, "stereo", "fast"), (3, "rectify")):
        tool.told(code, *command, *pinhole.words, *twice, "-o", tmp_path / "none", "-q")
