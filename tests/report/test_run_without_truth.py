"""The page of runs whose scenes have no ground truth, or not all of them."""

import shutil
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.maps import Status
from depthcli.core.volumes import Grid
from depthcli.evaluation.evaluate import ScoredMap
from depthcli.evaluation.protocols import Settings, load
from depthcli.evaluation.protocols._disparity import DisparityTruth
from depthcli.evaluation.protocols.registration import PreparedTruth, RegistrationProtocol
from depthcli.evaluation.scores import MapResult
from depthcli.io.formats.disparity import read_pfm, read_status
from depthcli.io.formats.images import read_grey, read_image
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.io.scenes import StereoScene, VolumePairScene
from depthcli.report.packing import unpack
from depthcli.report.scene_view import view_with_truth
from depthcli.report.without_truth import _doubt
from tests.files import laid
from tests.report.conftest import ODD
from tests.report.test_page import Reader, registration_truth

SIZE = (48, 64)


def pair(folder: Path, shift: int, noise: float) -> None:
    """Write a pair whose right view is shifted, and differs the more the larger the noise."""
    rng = np.random.default_rng(shift)
    left = rng.integers(0, 256, SIZE).astype(np.float64)
    right = np.roll(left, -shift, 1) + rng.normal(0, noise, SIZE)
    views = {"left.png": left, "right.png": right}
    laid(folder, {n: np.repeat(v.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2) for n, v in views.items()})


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three pairs without truth, one of them hard to match and one with a hostile name, and a damaged one."""
    folder = tmp_path_factory.mktemp("pairs") / "set"
    for name, shift, noise in (("easy", 3, 0.0), ("hard", 5, 60.0), (ODD, 4, 15.0)):
        pair(folder / name, shift, noise)
    laid(folder / "damaged", {"left.png": b"x", "right.png": b"x"})
    return folder


def stereo(scenes: Path, output: Path, *more: str) -> int:
    return main(["stereo", "opencv-sgbm", "-i", str(scenes), "-o", str(output), "--max-disparity", "15", *more])


def inconsistent(scene: Path) -> float:
    status = read_status(scene / "status.png")
    return 100 * float(np.mean((status & int(Status.OCCLUDED | Status.MISMATCH)) != 0))


def test_worst_first_with_the_maps_as_they_are(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = tmp_path / "run"
    assert stereo(pairs, run, "--html") == 3  # for the damaged scene, not for the page
    assert capsys.readouterr().err.rstrip().endswith(f": {run / 'evaluation' / 'report.html'}")
    reader = Reader(run / "evaluation")
    header, *rows = reader.tables[0]
    assert header[:4] == ["scene", "status", "left-right inconsistent, %", "no value, %"]
    assert rows[0][0] == "damaged"
    assert "not a PNG" in rows[0][1]
    shares = {name: inconsistent(run / name) for name in ("easy", "hard", ODD)}
    assert [row[0] for row in rows[1:]] == sorted(shares, key=lambda name: -shares[name])
    assert [float(row[2]) for row in rows[1:]] == pytest.approx(sorted(shares.values(), reverse=True), abs=0.01)
    assert shares["hard"] > shares["easy"]
    data = reader.scenes()
    assert [scene["name"] for scene in data] == [row[0] for row in rows[1:]]  # as the viewer steps through them
    for scene in data:
        (view,) = scene["views"]
        assert view["truth"] is None and view["region"] is None
        values, packed = read_pfm(run / scene["name"] / "disp_left.pfm"), view["runs"]["run"]["values"]
        assert np.allclose(unpack(packed), values, atol=packed["step"])
        assert np.array_equal(unpack(view["runs"]["run"]["status"]), read_status(run / scene["name"] / "status.png"))
    assert len(reader.images) == 3 * 3  # image, map, status
    assert "<script>alert" not in (run / "evaluation" / "report.html").read_text("utf-8")


def test_too_many_scenes_have_pictures_of_the_worst():
    for key in ("density", "measured"):
        assert _doubt({key: 0.5}) < _doubt({key: 0.9})
    for key in ("mean_error", "inside_mean"):
        assert _doubt({key: 3.0}) < _doubt({key: 1.0})


def test_scenes_with_and_without_truth_share_a_page(pairs: Path, tmp_path: Path):
    scenes = tmp_path / "set"
    shutil.copytree(pairs / "easy", scenes / "known")
    shutil.copytree(pairs / "hard", scenes / "unknown")
    truth = np.full(SIZE, 3, np.float32)
    laid(scenes / "known", {"disp_left.pfm": truth, "meta.json": {"protocol": "middlebury_v2"}})
    assert stereo(scenes, tmp_path / "run", "--html", "--bound") == 0
    reader = Reader(tmp_path / "run" / "evaluation")
    known, unknown = reader.scenes()
    bound, probability, values = (
        read_pfm(tmp_path / "run" / "unknown" / f"{name}.pfm") for name in ("bound", "probability", "disp_left")
    )
    header, row = reader.tables[-1]
    assert header[2] == "expected incorrect, %"
    assert float(row[2]) == pytest.approx(100 * (1 - probability[np.isfinite(values)].mean()), abs=0.01)
    assert row[header.index("median bound")] == f"{np.nanmedian(bound):.3g} px"
    packed = unknown["views"][0]["runs"]["run"]["bound"]
    np.testing.assert_allclose(unpack(packed), bound, atol=packed["step"])
    assert unknown["bound"] and known["bound"]
    for scene, name in ((known, "known"), (unknown, "unknown")):
        assert scene["name"] == name
        assert (scene["views"][0]["region"] is None) == (name == "unknown")
        assert list(scene["views"][0]["runs"]) == ["run"]
    assert {"scene-0", "scene-1", "section-0", "without"} <= set(reader.ids)
    assert "unknown" not in [row[0] for table in reader.tables[:-1] for row in table]
    assert [row[0] for row in reader.tables[-1]] == ["scene", "unknown"]
    assert "bad 1" in reader.text


def test_control_characters_of_names_are_escaped(pairs: Path, tmp_path: Path):
    shutil.copytree(pairs / "easy", tmp_path / "set" / "a\x1b[31m")
    assert stereo(tmp_path / "set", tmp_path / "run", "--html") == 0
    page = (tmp_path / "run" / "evaluation" / "report.html").read_text("utf-8")
    assert "a\\x1b[31m" in page
    assert not any(unicodedata.category(char) == "Cc" for char in page if char != "\n")


def test_a_page_that_cannot_be_written_fails_no_scene(pairs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    foreign = tmp_path / "run" / "evaluation" / "report.html"
    laid(foreign.parent, {foreign.name: "mine"})
    assert stereo(pairs, tmp_path / "run", "--html", "--scenes", "easy") == 3
    assert foreign.read_text() == "mine"
    error = capsys.readouterr().err
    assert "no report.html: " in error and "to open in a browser" not in error
    assert (tmp_path / "run" / "easy" / "disp_left.pfm").is_file()


def test_frames_of_a_sensor_show_their_bound(tmp_path: Path):
    rng = np.random.default_rng(0)
    for number in range(2):
        color = rng.integers(0, 256, (*SIZE, 3)).astype(np.uint8)
        depth = (1000 + 10 * (number + 1) * rng.normal(0, 1, SIZE)).astype(np.uint16)
        depth[10:14, 20:30] = 0
        laid(tmp_path / "set" / f"frame{number}", {"color.png": color, "depth.png": depth})
    words = ["-i", str(tmp_path / "set"), "-o", str(tmp_path / "run"), "--html", "-q"]
    assert main(["refine-kinect", "dsrm", *words]) == 0
    reader = Reader(tmp_path / "run" / "evaluation")
    header, *rows = reader.tables[0]
    assert header[2] == "expected incorrect, %"
    assert float(rows[0][2]) >= float(rows[1][2])
    for name, figure in ((row[0], row[header.index("median bound")]) for row in rows):
        folder = tmp_path / "run" / name
        assert float(figure.removesuffix(" m")) == pytest.approx(np.nanmedian(read_pfm(folder / "bound.pfm")), rel=0.01)
        picture = read_image(folder / "preview.png")
        assert picture.shape[0] > SIZE[0] and picture.shape[1] > 2 * SIZE[1]  # the bound with its bar beside the map
    for scene in reader.scenes():
        sensor = unpack(scene["views"][0]["sensor"])
        depth = read_grey(tmp_path / "set" / scene["name"] / "depth.png")
        np.testing.assert_array_equal(np.isnan(sensor), depth == 0)
        np.testing.assert_allclose(sensor[depth > 0], depth[depth > 0], atol=1)


def test_a_registration_without_landmarks(volumes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    given = volumes.parent / "set" / "pair_0"
    files = ["--fixed", str(given / "fixed.nii.gz"), "--warped", str(next(given.glob("moving_warped.*")))]
    output = tmp_path / "run"
    assert main(["register-confidence", "axes", *files, "--name", "case", "-o", str(output), "--html"]) == 0
    assert capsys.readouterr().err.rstrip().endswith("report.html")
    reader = Reader(output / "evaluation")
    header, row = reader.tables[0]
    (scene,) = reader.scenes()
    assert {view["plane"] for view in scene["views"]} == {"axial", "coronal", "sagittal"}
    assert (scene["low"], scene["high"]) == (0.0, 10.0)
    assert len(reader.images) == 1  # the three slices of preview.png
    made, judge = output / "case" / "expected_error.nii.gz", RegistrationProtocol()
    volume = read_volume(made)
    case = VolumePairScene(name="case", folder=given, fixed=given / "fixed.nii.gz")
    shown = judge.presentation.show(made, case, judge.files)
    inside = ~np.isnan(shown.values)
    assert 0 < inside.mean() < 1  # air is left out
    mask = np.zeros(volume.grid.shape, np.uint8)
    mask[3:9, 10:20, 30:32] = 1
    write_array(tmp_path / "mask.mha", volume.grid, mask)
    masked = judge.presentation.show(made, replace(case, mask=tmp_path / "mask.mha"), judge.files)
    assert np.array_equal(~np.isnan(masked.values), volume.grid.turned(mask) > 0)
    assert np.array_equal(shown.values[inside], volume.grid.turned(volume.values)[inside])
    figure = row[header.index("expected error in the body, mm")]
    assert float(figure) == pytest.approx(shown.values[inside].mean(), abs=0.01)


def test_landmarks_leave_the_whole_volume_in_sight(volumes: Path):
    given, made = volumes.parent / "set" / "pair_0", volumes.parent / "run" / "pair_0" / "expected_error.nii.gz"
    scene = VolumePairScene(name="pair_0", folder=given, fixed=given / "fixed.nii.gz")
    grid, judge = read_volume(scene.fixed).grid, RegistrationProtocol()
    places = np.array(grid.shape) / 2 + np.array([[0.0, 0, 0], [2, 3, 4]])
    errors = np.array([1, 4], np.float32)
    truth = registration_truth(errors, grid, places, None)
    view = view_with_truth(judge, scene, truth)
    assert view is not None
    assert judge.presentation.at_points(truth)
    dense = judge.presentation.show(made, scene, judge.files)
    result = MapResult("run", scene.name, "set", judge.name)
    view.add(ScoredMap(result, made, judge.read(made, scene, truth), truth, {}), made.parent)
    for cut, shown in zip(view._cuts, view.data["views"], strict=True):
        values, known = unpack(shown["runs"]["run"]["values"]), unpack(shown["region"]) > 0
        assert np.array_equal(np.isnan(values), np.isnan(dense.values[cut.index]))
        assert np.array_equal(np.isnan(unpack(shown["runs"]["run"]["error"])), ~known)
    voxels = PreparedTruth(errors, None, np.ones(grid.shape, bool), truth.stored)
    assert not judge.presentation.at_points(voxels)
    flat = Grid(grid.size, (2.0, 1.0, 3.0), grid.origin)
    write_array(volumes.parent / "flat.mha", flat, np.zeros(flat.shape, np.float32))
    scene = replace(scene, fixed=volumes.parent / "flat.mha")
    view = view_with_truth(judge, scene, registration_truth(errors, flat, places, None))
    assert view is not None and {shown["tall"] for shown in view.data["views"]} == {0.5, 1.5, 3.0}


@pytest.mark.parametrize(("size", "shown"), [((72, 96), (36, 48, 3)), ((36, 48), (36, 48, 3)), ((72, 48), None)])
def test_an_image_is_shown_at_the_size_of_the_map(tmp_path: Path, size: tuple[int, int], shown: tuple | None):
    laid(tmp_path, {"left.png": np.zeros((*size, 3), np.uint8)})
    scene = StereoScene(name="a", folder=tmp_path, left=tmp_path / "left.png")
    values, judge = np.ones((36, 48), np.float32), load("eth3d")(Settings())
    view = view_with_truth(judge, scene, DisparityTruth(values, {"all": values > 0}))
    assert view is not None
    image = view._image_of(view._start)
    assert (None if image is None else image.shape) == shown
