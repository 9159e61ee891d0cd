"""``depthcli calibrate``: photos of boards by cameras that are known, and what ``rectify`` makes of the result."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.algorithms.calibration import CameraFit, Chessboard, Corners, _projected, fit_camera, fit_rig
from depthcli.core.cameras.rig import RectifiedRig, Rig
from depthcli.core.errors import InputError
from depthcli.io.calibration_photos import find_photos
from depthcli.io.formats.calibrations import read_rig
from depthcli.io.formats.images import read_image, write_png
from depthcli.problems.boards import CameraPhotos, _doubts, _with_rig, board_of
from tests import boards
from tests.boards import SIZE, SQUARE
from tests.command_line import run
from tests.files import laid
from tests.golden import refused, told

pytestmark = pytest.mark.slow

CHESS = ("--board", "9x6", "--square", "25mm")
EXTENT = (8 * SQUARE, 5 * SQUARE)


def shoot(folder: Path, rig: Rig, texture: np.ndarray, places, names: str = "{side}{k:02}.png") -> None:
    for k, (turn, shift) in enumerate(places):
        for side, image in zip(("left", "right"), boards.pair(rig, texture, turn, shift, k), strict=True):
            write_png(folder / names.format(side=side, k=k), image)


@pytest.fixture(scope="module")
def chess(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve pairs of photos; the right one of pair 05 shows the board of pair 07."""
    folder = tmp_path_factory.mktemp("chess") / "photos"
    shoot(folder, boards.rig(), boards.chessboard(9, 6), boards.poses(12, EXTENT))
    shutil.copy(folder / "right07.png", folder / "right05.png")
    return folder


def check(found: Rig, true: Rig) -> None:
    """Compare the cameras, and how far the rows of true points are apart after the rectification."""
    assert found.left.fisheye == true.left.fisheye
    for one, other in ((found.left, true.left), (found.right, true.right)):
        np.testing.assert_allclose(np.diag(one.matrix), np.diag(other.matrix), rtol=0.003)
        np.testing.assert_allclose(one.matrix[:2, 2], other.matrix[:2, 2], atol=2.0)
    assert abs(found.baseline / true.baseline - 1) < 0.003
    if true.left.fisheye:  # whose photos below do not fill the images
        return
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.4, 0.4, 4000), rng.uniform(-0.3, 0.3, 4000), rng.uniform(0.4, 4, 4000)])
    points[:, :2] *= points[:, 2:]
    pixels = [true.left.project(points), true.right.project(points @ true.rotation.T + true.translation)]
    inside = np.all([((p >= 0) & (p < SIZE)).all(axis=1) for p in pixels], axis=0)
    left, right = found.rectified(SIZE, SIZE).points(pixels[0][inside], pixels[1][inside])
    errors = np.abs(left[:, 1] - right[:, 1])
    assert inside.sum() > 1000 and np.sqrt(np.mean(errors**2)) < 0.05 and np.quantile(errors, 0.95) < 0.1


def test_a_chessboard_gives_the_rig_without_the_pair_that_does_not_fit(chess: Path, tmp_path: Path, tool) -> None:
    target = tmp_path / "stereo.yml"
    out, err = tool.both(0, "calibrate", chess, *CHESS, "-o", target)
    check(read_rig([target]), boards.rig())
    report = json.loads((tmp_path / "stereo_report.json").read_text())
    photos = {photo["name"]: photo for photo in report["photos"]}
    assert photos["05"]["left_out"] == {"pair": "outlier"} and photos["05"]["pair_error"] > 5
    assert [name for name, photo in photos.items() if "outlier" in photo["left_out"].values()] == ["05"]
    assert "do not fit the others: 05" in err and "no: outlier" in out
    assert report["rig"]["row_error"] < 0.1 and report["warnings"] == []
    assert all(camera["reprojection_error"] < 0.1 for camera in report["cameras"])
    assert read_image(tmp_path / "stereo_coverage.png").shape == (504, 1288, 3)
    tool.told(2, "calibrate", chess, *CHESS, "-o", target)
    # The rig rectifies photos of the same cameras.
    sides = [word for side in ("left", "right") for word in (f"--{side}", chess / f"{side}07.png")]
    assert run("rectify", *sides, "--name", "a", "--calibration", target, "-o", tmp_path / "out", "-q") == 0
    views = (read_image(tmp_path / "out" / "a" / f"{side}.png") for side in ("left", "right"))
    left, right = (Chessboard(9, 6, SQUARE).find(view) for view in views)
    assert left is not None and right is not None
    assert np.sqrt(np.mean((left.pixels[:, 1] - right.pixels[:, 1]) ** 2)) < 0.1


def test_a_charuco_board_may_be_seen_in_part_and_fisheye_lenses(tmp_path: Path) -> None:
    chess, part = boards.chessboard(9, 6), boards.charuco(11, 8, 0.018)
    places = boards.poses(9, (9 * SQUARE, 6 * SQUARE), seed=2)
    shoot(tmp_path / "part", boards.rig(), part, places, "{side}/{k}.png")
    shoot(tmp_path / "fish", boards.rig(fisheye=True), chess, boards.poses(8, EXTENT))
    for photos, *words in (
        ("part", "--board", "charuco:11x8", "--square", "2.5cm", "--marker", "18mm"),
        ("fish", *CHESS, "--fisheye"),
    ):
        assert run("calibrate", tmp_path / photos, *words, "-o", tmp_path / f"{photos}.yml", "-q") == 0
        check(read_rig([tmp_path / f"{photos}.yml"]), boards.rig(fisheye=photos == "fish"))


@pytest.mark.parametrize("kind", ["parallel", "copies", "nearly copies"])
@pytest.mark.parametrize("lens", [(), ("--fisheye",)])
def test_photos_that_do_not_determine_the_camera_are_refused(kind: str, lens: tuple[str, ...], tmp_path: Path, tool):
    camera, texture = boards.rig(bool(lens)).left, boards.chessboard(9, 6)
    for k, (_, shift) in enumerate(boards.poses(8, EXTENT, tilt=0.0)):
        if kind == "parallel":
            image = boards.photo(camera, texture, np.eye(3), shift, k)
        elif k == 0:
            turn = cv2.Rodrigues(np.radians([10.0, -12.0, 2.0]))[0]
            place = np.array([0, 0, 0.5]) - turn @ np.array([*EXTENT, 0]) / 2
            first = image = boards.photo(camera, texture, turn, place, 0)
        else:
            image = np.roll(first, k % 3, 1) if kind == "nearly copies" else first
        write_png(tmp_path / "photos" / f"{k}.png", image)
    err = tool.err(2, "calibrate", tmp_path / "photos", *CHESS, *lens, "-o", tmp_path / "c.yml")
    assert ("do not determine the camera" if kind == "parallel" else "8 photos show the board at 1 diff") in err
    assert [each.name for each in tmp_path.iterdir()] == ["photos"]


@pytest.mark.parametrize("fisheye", [False, True])
@pytest.mark.parametrize("tilt", [2.0, 8.0, 15.0, 30.0])
def test_the_uncertainty_of_a_focal_length_is_that_of_its_errors(tilt: float, fisheye: bool) -> None:
    """Refused where the error may exceed 15 %; else the errors of 8 fits are within three of its deviations."""
    board, camera, errors = Chessboard(9, 6, SQUARE), boards.rig(fisheye).left, []
    for seed in range(4):
        photos, rng = {}, np.random.default_rng(seed)
        for k, (turn, shift) in enumerate(boards.poses(8, EXTENT, tilt=tilt)):
            pixels = _projected(camera, board.points, cv2.Rodrigues(turn)[0].ravel(), np.ravel(shift))
            photos[str(k)] = Corners(np.arange(54), pixels + rng.normal(0, 0.1, pixels.shape))
        try:
            fit = fit_camera(board, photos, SIZE, fisheye)
        except InputError:
            assert tilt < 15
            continue
        errors.append(abs(fit.camera.matrix[0, 0] / camera.matrix[0, 0] - 1) / fit.focal_uncertainty)
    assert len(errors) == 0 if tilt < 5 else len(errors) == 4 if tilt > 10 else True
    assert max(errors, default=0.0) < 4


@pytest.fixture
def few(chess: Path, tmp_path: Path) -> Path:
    """Four of the pairs."""
    return Path(shutil.copytree(chess, tmp_path / "photos", ignore=shutil.ignore_patterns("*[056789].png", "*1?.png")))


def test_damaged_photos_are_left_out_and_said(few: Path, tmp_path: Path, tool) -> None:
    laid(few, {f"{side}08.png": (few / f"{side}03.png").read_bytes()[:5000] for side in ("left", "right")})
    laid(few, dict.fromkeys(("left09.png", "other.png"), np.zeros((50, 60), np.uint8)))
    out, err = tool.both(3, "calibrate", few, *CHESS, "-o", tmp_path / "c.yml")
    assert "left08.png" in err and "other.png: left out" in err
    assert "left cannot be read" in out and "60 x 50 pixels, not 640 x 480" in out
    printed = tool.out(3, "calibrate", few, *CHESS, "-o", tmp_path / "c.yml", "--overwrite", "--json")
    assert json.loads(printed) == json.loads((tmp_path / "c_report.json").read_text())


def test_pairs_of_no_rig_are_refused(few: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool) -> None:
    line, whole = ("calibrate", few, "-o", tmp_path / "c.yml", *CHESS[2:], "--board"), RectifiedRig.points
    tool.told(2, *line, "10x7")
    tool.told(2, "calibrate", tmp_path / "nothing", *line[2:], "9x6")
    with monkeypatch.context() as patch:
        patch.setattr(RectifiedRig, "points", lambda *a: (whole(*a)[0], whole(*a)[1] + 2))
        assert "rows are 2" in tool.err(2, *line, "9x6")
    files = sorted(few.glob("right*"))
    images = [read_image(file) for file in files]
    for file, image in zip(files, (*images[1:], images[0]), strict=True):
        write_png(file, image)
    err = tool.err(2, *line, "9x6")
    assert "the pairs do not fit" in err and err.count("\n") == 1
    for file, image in zip(files, images, strict=True):  # images of two sizes
        write_png(file, np.pad(image, ((0, 20), (0, 0)), constant_values=120))
    assert "bring" in tool.err(2, *line, "9x6")
    assert [each.name for each in tmp_path.iterdir()] == ["photos"]


@pytest.mark.parametrize(("folders", "names"), [
    (".", "left/K right/K"), (".", "leftK rightK"), (".", "cam0/K cam1/K"), (".", "K/left K/right"), (".", "imgK"),
    ("a b", "a/leftK b/rightK"), ("a b", "a/cam0_K b/cam1_K"), ("a b", "a/K b/K"),
])  # fmt: skip
def test_pairs_are_found_by_name(tmp_path: Path, folders: str, names: str) -> None:
    """Of one folder, or of one of each camera; numbers of photos are no cameras."""
    pairs = [[tmp_path / f"{name}.png" for name in names.replace("K", number).split()] for number in "01234"]
    laid(tmp_path, {str(file): np.zeros((4, 4), np.uint8) for pair in pairs for file in pair})
    photos, unnamed = find_photos([tmp_path / folder for folder in folders.split()])
    assert [[file for file in (each.left, each.right) if file] for each in photos] == pairs and unnamed == []


@pytest.mark.parametrize(("columns", "rows"), [(9, 6), (8, 6), (7, 7)])
@pytest.mark.parametrize("turned", [0, 180])
def test_both_views_of_a_board_number_its_corners_alike(columns: int, rows: int, turned: int) -> None:
    rig, board = boards.rig(), Chessboard(columns, rows, SQUARE)
    turn = cv2.Rodrigues(np.radians([10.0, -15.0, 5.0]))[0] @ cv2.Rodrigues(np.radians([0.0, 0.0, turned]))[0]
    shift = np.array([0.06, 0, 0.5]) - turn @ np.array([columns - 1, rows - 1, 0]) * SQUARE / 2
    left, right = map(board.find, boards.pair(rig, boards.chessboard(columns, rows), turn, shift))
    assert left is not None and right is not None
    for flipped in (right, Corners(right.ids, right.pixels[::-1])) if (columns + rows) % 2 == 0 else (right,):
        assert (np.ptp(left.pixels - board.alike(left, flipped).pixels, axis=0) < 40).all()


def test_the_smallest_boards_are_found() -> None:
    for (words, marker), texture in (
        (("3x3", None), boards.chessboard(3, 3)),
        (("charuco:4x3", "18mm"), boards.charuco(4, 3, 0.018)),
    ):
        photo = boards.photo(boards.rig().left, texture, np.eye(3), np.array([-SQUARE, -SQUARE, 0.25]))
        found = board_of(words, "25mm", marker, "4X4_50").find(photo)
        assert found is not None and len(found) == (6 if marker else 9)


def seen_pairs(true: Rig, n_pairs: int, n_places: int, noise: float) -> dict[str, tuple[Corners, Corners]]:
    """The corners of a board in both views, at one place after the other."""
    board, rng, places = Chessboard(9, 6, SQUARE), np.random.default_rng(0), list(boards.poses(6, EXTENT))
    pairs = {}
    for k in range(n_pairs):
        turn, shift = places[k % n_places]
        points = board.points @ turn.T + shift
        seen = true.left.project(points), true.right.project(points @ true.rotation.T + true.translation)
        one, other = (Corners(np.arange(54), each + rng.normal(0, noise, each.shape)) for each in seen)
        pairs[str(k)] = one, other
    return pairs


@pytest.mark.parametrize(("n_pairs", "n_places", "noise", "longer", "is_refused"), [
    (6, 6, 0.01, 1.3, False),
    (3, 3, 0.01, 1.0, False),
    (2, 2, 0.01, 1.0, True),
    (6, 6, 0.2, 1.3, True),  # a rig that fits worse than its cameras has to resemble them
    (3, 1, 0.0, 1.0, True),  # copies, though the photos of each camera alone determine it
])  # fmt: skip
def test_pairs_and_cameras_that_determine_a_rig(n_pairs, n_places, noise: float, longer: float, is_refused: bool):
    board, true = Chessboard(9, 6, SQUARE), boards.rig()
    pairs = seen_pairs(true, n_pairs, n_places, noise)
    cameras = [replace(each, matrix=np.diag([longer, longer, 1]) @ each.matrix) for each in (true.left, true.right)]
    residuals = {"0": np.full((54, 2), 0.02)}
    alone = tuple(CameraFit(each, None, {}, residuals, 30.0, {}) for each in cameras)
    if is_refused:
        refused(InputError, fit_rig, board, pairs, alone)
    else:
        assert fit_rig(board, pairs, alone).rig.baseline == pytest.approx(0.12, rel=0.01)


def test_rigs_and_cameras_that_are_doubtful() -> None:
    """Views exchanged, one above the other, a board that moved, few photos of both; then cameras alone."""
    board, rig = Chessboard(9, 6, SQUARE), boards.rig()
    exchanged = Rig(rig.right, rig.left, rig.rotation.T, -rig.rotation.T @ rig.translation)
    above = replace(rig, rotation=np.eye(3), translation=np.array([0.0, 0.12, 0.0]))
    for taken, n_pairs, noise in ((exchanged, 6, 0.01), (above, 6, 0.01), (rig, 6, 0.1), (rig, 2, 0.01)):
        pairs = seen_pairs(taken, n_pairs, n_pairs, noise)
        views = []
        for k, (side, camera) in enumerate((("left", taken.left), ("right", taken.right))):
            views.append(CameraPhotos(side, side, SIZE, {name: pair[k] for name, pair in pairs.items()}))
            views[-1].fit = CameraFit(camera, None, dict.fromkeys(pairs, 0.02), {"0": np.full((54, 2), 0.02)}, 30.0, {})
        if n_pairs == 2:
            refused(InputError, _with_rig, board, *views)
        else:
            found = _with_rig(board, *views)
            told("\n".join(found.warnings))
            assert len(found.row_errors) == (0 if taken is above else 6)
    corner = Corners(np.arange(4), np.array([[1.0, 1], [70, 1], [1, 70], [70, 70]]))  # in 1 of 48 cells
    for tilt, error, uncertainty in ((10.0, 0.5, 0.0), (30.0, 3.0, 0.01)):
        view = CameraPhotos("left", "left", SIZE, {"0": corner})
        residuals = {"0": np.full((4, 2), error)}
        view.fit = CameraFit(rig.left, None, {"0": error}, residuals, tilt, {}, focal_uncertainty=uncertainty)
        told("\n".join(_doubts(view)))
