"""``refine_depth``, ``complete_transparent`` and ``registration_confidence`` from Python."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import depthcli
from depthcli.core.context import Context
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_image
from depthcli.io.formats.volumes import read_volume
from depthcli.io.scenes import RgbdScene, SequenceScene
from depthcli.problems.inputs import load_config
from depthcli.problems.kinect import RefineKinect, RefineKinectConfig
from depthcli.run.job import Outcome
from depthcli.simulate.deformed_volumes import make_deformed_pair
from tests.command_line import contents, run
from tests.golden import refused, saying


def frame(folder: Path) -> tuple[Any, Any]:
    return read_image(folder / "color.png"), read_pfm(folder / "depth.pfm")


def test_a_cloud_is_that_of_the_command(tmp_path: Path, made_kinect: Path):
    found = depthcli.refine_depth(*frame(made_kinect / "planes"), "dsrm", fb=43.5, ply=True, mask="measured", far=50)
    found.save(tmp_path / "python")
    words = ["--scenes", "planes", "--ply", "--mask", "measured", "--far", "50", "-o", tmp_path / "run", "-q"]
    assert run("refine-kinect", "dsrm", "-i", made_kinect, *words) == 0
    assert contents(tmp_path / "python") == contents(tmp_path / "run" / "planes")
    found.to_points("measured", far=50).save(tmp_path / "own.ply")
    assert (tmp_path / "own.ply").read_bytes() == (tmp_path / "python" / "points.ply").read_bytes()


def test_the_numbers_of_a_sequence_are_means_of_the_frames_that_have_them(tmp_path: Path, monkeypatch):
    rows = iter([{"density": 0.5, "median_bound": None}, {"density": 1.0, "median_bound": 0.25}])
    monkeypatch.setattr("depthcli.problems.frames.DepthProblem.compute", lambda *_: Outcome(dict(next(rows))))
    frames = tuple(RgbdScene(name=f"s/{k}", folder=tmp_path, color=None, depth=tmp_path) for k in range(2))
    job = RefineKinect(load_config(RefineKinectConfig, "sequence"))
    scene = SequenceScene(name="s", folder=tmp_path, frames=frames)
    found = job.compute(scene, tmp_path, Context(1 << 30, "s"))
    assert found.facts == {"frames": 2, "frames_failed": 0, "density": 0.75, "median_bound": 0.25}
    # Where the cameras stood is an input, too.
    moved = [replace(frames[1], pose=(k * 0.5,) * 16) for k in (0, 1, 1)]
    given = [job.settings(replace(scene, frames=(frames[0], frame))).get("poses") for frame in (frames[1], *moved)]
    assert given[0] is None and given[1] != given[2] == given[3]


def test_a_result_describes_itself_and_codes_are_depths_by_their_scale(made_kinect: Path):
    color, depth = frame(made_kinect / "planes")
    codes = np.where(np.isfinite(depth), np.rint(depth * 5000), 0).clip(0, 65535).astype(np.uint16)
    by_codes = depthcli.refine_depth(color, codes, "nearest", depth_scale=5000)
    by_meters = depthcli.refine_depth(color, np.where(codes > 0, codes / 5000, np.nan), "nearest")
    assert np.array_equal(by_codes.values, by_meters.values, equal_nan=True)
    found = depthcli.refine_depth(color, depth, "fast", intrinsics=(80, 80, 47.5, 35.5))
    assert np.array_equal(found.filled | found.kept | found.corrected, found.valid)
    assert not (found.filled & found.kept).any() and not np.isfinite(depth[found.filled]).any()
    assert found.bound.shape == found.probability.shape == found.values.shape == (72, 96)
    assert "other" in found.seconds and repr(found).startswith("RefinedDepth(96 x 72, ")
    assert found._repr_png_().startswith(b"\x89PNG")
    limit = float(np.median(found.bound))
    assert len(found.to_points("all", max_bound=limit)) == np.count_nonzero(found.bound <= limit)
    assert len(found.to_points()) == found.measured.sum() == found.kept.sum() < found.valid.sum()
    points = found.to_points("all")
    again = found.to_points("all", intrinsics=(80, 80, 47.5, 35.5))
    assert len(points) == found.valid.sum() and np.array_equal(points.points, again.points)
    assert points.points[:, 2] == pytest.approx(found.values[found.valid])


COLOR, DEPTH = np.full((8, 9, 3), 100, np.uint8), np.ones((8, 9), np.float32)


@pytest.mark.parametrize(("depth", "words"), [
    (1200 * DEPTH, ("1000", "millimeters")), (120 * DEPTH, ("100", "centimeters")), (DEPTH, ()),
    (np.full((8, 9), 7500, np.uint16), ("7.5 m", "5000", "depth_scale")),
])  # fmt: skip
def test_a_wrong_unit_is_said(depth: Any, words: tuple[str, ...]):
    lines = depthcli.refine_depth(COLOR, depth, "nearest").warnings
    assert bool(lines) == bool(words) and all(word in lines[0] for word in words)
    if depth.dtype == np.float32:
        assert depthcli.complete_transparent(COLOR, depth, depth).warnings[:1] == lines[:1]
        assert bool(depthcli.evaluate(depth, DEPTH, "depth").warnings) == bool(words)


def test_what_is_a_measured_depth():
    truth, estimate = np.ones((4, 6), np.float32), np.ones((4, 6), np.float32)
    estimate[0], estimate[1], truth[3] = 0, -1, 0
    scores = depthcli.evaluate(estimate, truth, "depth")
    assert scores.value("coverage", "all") == pytest.approx(100 / 3)


def test_what_cannot_be_used_is_refused():
    for color, depth, cameras in (
        (COLOR, np.zeros((8, 9), np.uint16), {}), ([COLOR], DEPTH, {}), ([COLOR, COLOR[:5]], [DEPTH, DEPTH[:5]], {}),
        (COLOR, DEPTH, {"depth_intrinsics": (1, 2, 3)}), (COLOR, DEPTH, {"depth_to_color": np.eye(4)}),
    ):  # fmt: skip
        refused(depthcli.InputError, depthcli.refine_depth, color, depth, "nearest", **cameras)
    for given in (
        {"preset": "sparse"}, {}, {"infrared": COLOR[:4, :, 0], "fb": 50.0}, {"preset": "sensor"},
        {"preset": "sensor", "objects": DEPTH > 0}, {"preset": "sensor", "objects": DEPTH > 1},
    ):  # fmt: skip
        refused(depthcli.InputError, depthcli.complete_transparent, COLOR, DEPTH, **given)
    for depth in (DEPTH[:, 1:], np.stack([DEPTH, DEPTH])):
        refused(depthcli.InputError, depthcli.complete_transparent, COLOR, depth, depth)
    refused(depthcli.ConfigError, depthcli.complete_transparent, COLOR, DEPTH, infrared=COLOR[..., 0])
    refused(depthcli.ConfigError, depthcli.refine_depth, COLOR, DEPTH, depth_scale=-1)
    refused(depthcli.InputError, depthcli.refine_depth(COLOR, DEPTH, "nearest").to_points, mask=np.ones((8, 9)))


def test_depth_without_color_has_the_camera_of_the_sensor():
    depth = np.full((8, 9), 2.0, np.float32)
    depth[3, 4] = np.nan
    first, second = depthcli.refine_depth(None, [depth, depth / 2], "nearest", depth_intrinsics=(40, 50, 4, 3))
    assert (first.values == 2).all() and (second.values == 1).all() and first.filled.sum() == 1
    points = second.to_points("all").points.reshape(8, 9, 3)
    np.testing.assert_allclose(points[5, 8], [(8 - 4) / 40, (5 - 3) / 50, 1], rtol=1e-6)


def test_depth_of_its_own_camera_is_registered():
    color, depth = np.zeros((60, 80, 3), np.uint8), np.full((15, 24), 2.0, np.float32)
    cameras = {"intrinsics": (80, 80, 39.5, 29.5), "depth_intrinsics": [20, 20, 11.5, 7]}
    found = depthcli.refine_depth(color, depth, "nearest", **cameras)
    assert found.values.shape == (60, 80) and (found.values == 2).all() and found.kept.all()
    assert (found.status == depthcli.DepthStatus.KEPT).all()
    moved = depthcli.refine_depth(color, depth, "nearest", **cameras, depth_to_color=(np.eye(3), [0.5, 0, 0]))
    # Half of the 24 - 20 columns that the depth camera sees more on either side, and 80 x 0.5 / 2 pixels.
    assert moved.filled.sum() == (20 - 8) * 60


def test_volumes_are_arrays_or_images_and_files_have_the_values_of_the_result(tmp_path: Path, made_volumes: Path):
    sitk = pytest.importorskip("SimpleITK")
    files = [made_volumes / "pair_0" / f"{name}.nii.gz" for name in ("fixed", "moving_warped", "mask")]
    fixed, warped, mask = map(read_volume, files)
    grid = {"origin": (-10.0, 20.0, 5.0), "direction": np.reshape(fixed.grid.direction, (3, 3))}
    volumes = fixed.values, warped.values, fixed.grid.spacing[::-1]
    found = depthcli.registration_confidence(*volumes, mask=mask.values, **grid, max_voxels=30000)
    images = [sitk.ReadImage(str(file)) for file in files]
    for image in images:  # which know where they are
        image.SetOrigin(grid["origin"])
    again = depthcli.registration_confidence(*images[:2], mask=images[2], max_voxels=30000)
    assert np.array_equal(found.values, again.values) and found.grid == again.grid
    images[1].SetSpacing((1.0, 1.0, 9.0))
    refused(depthcli.InputError, depthcli.registration_confidence, *images[:2], preset="axes")
    found.save(tmp_path)
    for name in ("expected_error", "confidence", "bound", "probability"):
        written = read_volume(tmp_path / f"{name}.nii.gz").values
        assert np.array_equal(written, getattr(found, "values" if name == "expected_error" else name)), name
    assert found.shift.shape == (*found.values.shape, 3)
    (row,) = found.at(found.grid.to_point(np.array([[20.0, 28, 28]])))
    assert row["expected_error"] == pytest.approx(found.values[20, 28, 28], abs=0.1)
    assert {"search", "other"} <= set(found.seconds)
    assert found._repr_png_().startswith(b"\x89PNG") and "mm expected" in repr(found)


SHAPE = (6, 8, 9)
FIXED = np.random.default_rng(0).random(SHAPE, np.float32)


def test_wrong_volumes_are_refused_and_one_given_twice_is_said():
    given = {"fixed": FIXED, "warped": FIXED, "spacing": (1, 1, 1), "preset": "axes"}
    for wrong in (
        {"spacing": None}, {"warped": FIXED[:5]}, {"warped": np.where(FIXED > 0.9, np.nan, FIXED)},
        {"fixed": np.zeros(SHAPE)}, {"mask": np.zeros(SHAPE)}, {"fixed": FIXED[0, 0]}, {"spacing": (1, 0, 1)},
    ):  # fmt: skip
        with saying(depthcli.InputError):
            depthcli.registration_confidence(**given | wrong)
    for warped, is_said in ((FIXED.copy(), True), (np.roll(FIXED, 1, axis=2), False)):
        found = depthcli.registration_confidence(**given | {"warped": warped})
        assert any("the same" in line for line in found.warnings) == is_said
    refused(depthcli.InputError, found.at, [1.0, 2.0, 3.0])
    refused(depthcli.InputError, found.save, "nowhere", suffix=".dcm")
    plain = replace(found, details=replace(found.details, shift=None), bounds={})  # of another program's pipeline
    for name in ("shift", "bound"):
        refused(depthcli.InputError, getattr, plain, name)


def test_images_of_two_dimensions_are_volumes_of_one_slice():
    sitk = pytest.importorskip("SimpleITK")
    fixed, warped = (sitk.GetImageFromArray(np.roll(FIXED[0], k, axis=1)) for k in (0, 1))
    for image in (fixed, warped):
        image.SetSpacing((2.0, 3.0))
        image.SetOrigin((-5.0, 7.0))
        image.SetDirection((0.0, -1.0, 1.0, 0.0))
    grid = depthcli.registration_confidence(fixed, warped, preset="axes").grid
    assert (grid.size, grid.spacing, grid.origin) == ((9, 8, 1), (2, 3, 1), (-5, 7, 0))
    assert grid.direction == (0, -1, 0, 1, 0, 0, 0, 0, 1)


def of_wide(overrides: dict[str, Any]) -> Any:
    wide = make_deformed_pair(1, (20, 24, 24), 5.0)
    return depthcli.registration_confidence(wide.fixed, wide.warped, (1.0, 1.0, 1.0), "mind", overrides)


def test_bounds_and_probabilities_of_registrations_are_monotone():
    promises = [(0.5, 1.0), (0.9, 3.0), (0.99, 6.0)]
    found = [of_wide({"bound.level": level, "bound.within": within, "levels": 2}) for level, within in promises]
    for less, more in itertools.pairwise(found):
        assert (less.bound <= more.bound).all() and (less.bound < more.bound).any()
        assert (less.probability <= more.probability).all()
        np.testing.assert_array_equal(less.values, more.values)
    assert all(one.probability.min() >= 0 and one.probability.max() <= 1 for one in found)
    assert found[2].details.figures["reach"] == 5
    for one in found:
        assert (one.bound >= one.values).all() and one.bound[np.isfinite(one.bound)].max() < 5
        np.testing.assert_array_equal(one.status, np.isposinf(one.bound))


def test_further_resolutions_leave_the_calibrated_bounds_or_open_them():
    one, three = (of_wide({"levels": levels}) for levels in (1, 3))
    assert not np.array_equal(one.values, three.values)
    finite = np.isfinite(three.bound)
    assert finite.any() and np.isposinf(three.bound[np.isposinf(one.bound)]).all()
    assert three.bound[finite].max() < one.details.figures["reach"] == three.details.figures["reach"]
    np.testing.assert_array_equal(three.bound[finite], np.maximum(one.bound, three.values)[finite])
    np.testing.assert_array_equal(one.probability, three.probability)


def test_a_bound_that_ends_with_the_search_is_open(tmp_path: Path):
    fixed, warped = np.random.default_rng(1).random((2, 16, 18, 18), np.float32)  # nothing matches
    found = depthcli.registration_confidence(fixed, warped, (2, 1, 1), "mind", radius=2)
    reach = found.details.figures["reach"]
    assert reach == pytest.approx(2 * 2 ** (1 / 3), abs=1e-4)
    assert found.details.figures["at_reach"] == 1 and found.details.figures["inside_bound"] == round(reach, 4)
    assert np.isposinf(found.bound).all() and (found.status == depthcli.VolumeStatus.OPEN_BOUND).all()
    # Slices go through a given voxel, or the middle: slice 8 of 16 from above, so slice 7 as stored, at 14 mm.
    pictures = [
        depthcli.registration_confidence(fixed, warped, (2, 1, 1), "mind", radius=2, **fields)._repr_png_()
        for fields in ({"slice_at": (9.0, 9.0, 14.0)}, {"slice_at": (5.0, 6.0, 14.0)}, {"neurological": True})
    ]
    assert found._repr_png_() == pictures[0] and len({*pictures}) == 3
    for suffix in (".nii.gz", ".mha", ".nrrd"):
        found.save(tmp_path, suffix, landmarks=[[5, 5, 5]])
        assert np.isposinf(read_volume(tmp_path / f"bound{suffix}", infinite=True).values).all()
        assert (read_volume(tmp_path / f"status{suffix}").values == 1).all()
    assert read_image(tmp_path / "preview.png").shape[1] >= 1200  # the bound is the fourth column
    assert (tmp_path / "points.csv").read_text().splitlines()[1].split(",")[-2] == "> 2.5198"
