"""Search ranges that do not begin at 0, and what the key points of a pair say: its range, and how its rows meet."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.io.formats.disparity import read_disparity, read_pfm, read_status, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.methods.stereo import rectification, search_range
from depthcli.methods.stereo.rectification import match_views, rectify_uncalibrated
from depthcli.methods.stereo.search_range import MatchedRange, SearchRange, matched_range
from depthcli.methods.stereo.volume import StereoResult
from depthcli.problems.stereo import Stereo
from depthcli.simulate.stereo_scenes import make_scene
from tests.command_line import rows, run
from tests.contracts.inputs import preset, views
from tests.golden import refused


def blobs(width: int, height: int = 60, seed: int = 3) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


NOISE = StereoPair(blobs(300, 200, 1), blobs(300, 200, 2))


def moved_pair(shift: int) -> StereoPair:
    """A textured plane: left (y, x) shows right (y, x - shift)."""
    canvas, start = blobs(120 + abs(shift)), max(shift, 0)
    return StereoPair(*(canvas[:, x : x + 120].copy() for x in (start - shift, start)))


def images_of(pair: StereoPair, folder: Path) -> tuple[str | Path, ...]:
    """Write a pair, and return the words that name it."""
    left, right = folder / "left.png", folder / "right.png"
    write_png(left, pair.left)
    write_png(right, pair.right)
    return "--left", left, "--right", right, "--name", "s"


def test_a_range_beyond_the_images_and_that_of_noise_are_refused():
    pair = StereoPair(blobs(40, 9, 1), blobs(40, 9, 2))
    assert SearchRange(39, 50).shift(pair).shape == (9, 1)
    refused(InputError, SearchRange(40, 50).shift, pair)
    refused(InputError, search_range.complete_range, 5, 5, pair)
    refused(InputError, matched_range, NOISE)


@pytest.mark.parametrize("shift", [-12, 0, 9])
@pytest.mark.parametrize("name", ["fast", "opencv-sgbm"])
def test_a_converging_or_cropped_pair(shift: int, name: str, tmp_path: Path, tool):
    pair = moved_pair(shift)
    ends = ("--min-disparity", str(shift - 5), "--max-disparity", str(shift + 6))
    words = ("stereo", name, *images_of(pair, tmp_path), *ends, "-o", tmp_path / "run", "-q")
    assert tool.err(0, *words) == ""
    values, status = read_pfm(tmp_path / "run/s/disp_left.pfm"), read_status(tmp_path / "run/s/status.png")
    assert values.shape == pair.shape == status.shape
    seen = np.zeros(pair.shape, bool)
    seen[:, max(shift, 0) : 120 + min(shift, 0)] = True
    measured = np.isfinite(values) & ((status & Status.FILLED) == 0)
    assert np.mean(np.abs(values - shift)[seen & measured] <= 0.5) > 0.98 and measured[seen].mean() > 0.85
    # What has no partner was not measured.
    x = np.arange(120)[None] - np.where(measured, values, 0)
    assert not (measured & (x > 119.51)).any() and not measured[:, : max(shift - 5, 0)].any()
    codes = read_disparity(tmp_path / "run/s/disp_left.png")
    np.testing.assert_array_equal(np.isfinite(codes), np.isfinite(values) & (values >= (0 if shift < 5 else -1)))
    positive = np.isfinite(codes) & (values > 0)
    np.testing.assert_allclose(codes[positive], values[positive], atol=1 / 256)
    row = rows(tmp_path / "run")["s"]
    assert (row["min_disparity"], row["max_disparity"]) == (shift - 5, shift + 6)


@pytest.mark.parametrize(("given", "low"), [(None, -10), (0, 0), (-3, -3), ("auto", -10)])
def test_a_lower_end_is_only_estimated_if_it_is_not_given(tmp_path: Path, given: int | str | None, low: int):
    """If a calibration rectifies the pairs and there is no upper end."""
    config = preset("stereo", "fast", f"min_disparity={'null' if given is None else given}")
    config = config.model_copy(update={"calibration": (tmp_path / "rig.yaml",)})
    search, _ = search_range.complete_range(*Stereo(config).ends(), moved_pair(4), MatchedRange(-10, 50, 99))
    assert search == SearchRange(low, 50)


def test_what_the_report_and_the_warnings_say(tmp_path: Path, tool):
    words = ("stereo", "fast", *images_of(moved_pair(-12), tmp_path), "-o")
    tool.told(0, *words, tmp_path / "a", "--min-disparity", "-12", "--max-disparity", "8")
    auto = ("--min-disparity", "auto", "--max-disparity", "auto")
    assert "end of the search range" not in tool.err(0, *words, tmp_path / "b", *auto)
    row = rows(tmp_path / "b")["s"]
    assert -25 < row["min_disparity"] == row["range_low"] < -12 < row["max_disparity"] == row["range_top"] < 0
    assert row["range_matches"] > 16 and row["seconds"]["range"] > 0
    tool.told(3, *words, tmp_path / "c", "--max-disparity", "auto", "-q")
    assert "above 119" in tool.err(0, *words, tmp_path / "e", "--max-disparity", "5000")
    assert "119" in (tmp_path / "e/report.csv").read_text()
    for top, *low in (("9", "--min-disparity", "9"), ("many",), ("0",)):
        tool.told(2, *words, tmp_path / "d", "--max-disparity", top, *low)


@pytest.mark.parametrize("kind", ["planes", "curved"])
def test_the_pair_says_its_range(kind):
    scene = make_scene(kind, 1, 240, 180, 40)
    found = matched_range(views(scene))
    true = np.quantile(scene.disparity_left, (0.01, 0.99))
    assert found.n_matches > 16 and found.low <= true[0]
    assert true[1] <= found.top <= 1.6 * true[1] + 5
    # Converging cameras: the same, moved.
    moved = matched_range(StereoPair(scene.left, np.roll(scene.right, 20, axis=1)))
    assert abs(moved.low - found.low + 20) <= 3 and abs(moved.top - found.top + 20) <= 6


def test_the_range_holds_a_near_thing_without_corners_and_no_false_matches():
    far, near, canvas = 10, 84, blobs(370, 240)
    left, right = canvas[:, :360].copy(), canvas[:, far:].copy()
    shade = np.linspace(60, 190, 60, dtype=np.uint8)[:, None] + np.linspace(0, 50, 50, dtype=np.uint8)
    left[90:150, 200:250], right[90:150, 200 - near : 250 - near] = shade, shade
    found = matched_range(StereoPair(left, right))
    assert 0 <= found.low < far and near <= found.top < 1.4 * near
    left[20:26, 320:326] = right[20:26, 60:66]  # 0.04 % of the pixels say 260
    again = matched_range(StereoPair(left, right))
    assert (again.low, again.top) == (found.low, found.top)


def test_ranges_that_end_before_near_things_are_warned_of(tmp_path: Path, tool):
    """20 % of the truth lie beyond three quarters of the largest disparity, 3 % of the measured pixels at that end."""
    scene = make_scene("planes", 0, 240, 180, 40)
    pair, top = views(scene), int(np.ceil(scene.disparity_left.max()))
    near = search_range.matched_beyond(pair, SearchRange(0, round(0.75 * top)))
    assert near is not None and abs(near - top) <= 3
    assert search_range.matched_beyond(pair, SearchRange(0, top)) is None
    assert search_range.matched_beyond(NOISE, SearchRange(0, 5)) is None
    words = ("stereo", "fast", *images_of(pair, tmp_path), "-o")
    for searched in (round(0.75 * top), top):
        said = tool.err(0, *words, tmp_path / f"{searched}", "--max-disparity", str(searched))
        assert ("see max_disparity" in said) == (searched < top)


@pytest.mark.parametrize("low", [-3, 4])
def test_restoring_keeps_holes_and_fills_no_hole(low: int):
    x, search = np.arange(12), SearchRange(low, low + 8)
    shape = search.shift(StereoPair(blobs(12, 5), blobs(12, 5))).shape
    partner = (x - (2 + low) < 12) & (x >= max(low, 0))
    for dense, reason in ((False, Status.OCCLUDED), (True, Status.OCCLUDED | Status.FILLED)):
        values = np.full(shape, 2.0, np.float32)
        values[0, 5] = 2.0 if dense else np.nan
        made = StereoResult(DisparityMap(values, np.zeros(shape, np.uint8)), confidence={"a": values})
        made.pictures = {"first": values, "segments": np.full(shape, 2, np.uint16)}
        back = search.restore(made, 12)
        assert set(back.pictures["first"][1]) == {2 + low} and (back.pictures["segments"] == 2).all()
        assert back.disparity.values.shape == back.confidence["a"].shape == (5, 12)
        np.testing.assert_array_equal(back.disparity.values[1], np.where(partner | dense, 2 + low, np.nan))
        np.testing.assert_array_equal(back.disparity.status[1], np.where(partner, 0, reason))


def test_shares_at_the_ends_and_suggested_ranges():
    values = np.array([[0.9, 1.1, 6.9, 7.1, 8, np.nan]], np.float32)
    assert SearchRange(0, 8).share_at_ends(DisparityMap(values, np.zeros((1, 6), np.uint8))) == (0.2, 0.4)
    assert MatchedRange(5, 30, 20).suggested == SearchRange(0, 30)


def test_evaluation_and_depth_with_negative_disparities(tmp_path: Path):
    """A scene whose truth is negative: matched, scored by every protocol's rule that has one, turned into depth."""
    pair, scene = moved_pair(-12), tmp_path / "data" / "s"
    images_of(pair, scene)
    truth = np.full(pair.shape, -12, np.float32)
    truth[:, -12:] = np.nan
    write_pfm(scene / "disp_left.pfm", truth)
    (scene / "calib.txt").write_text("cam0=[50 0 20; 0 50 20; 0 0 1]\ndoffs=20\nbaseline=100\n")
    for protocol in ("middlebury_v2", "middlebury_v3", "eth3d"):
        meta = {"max_disparity": -4, "min_disparity": -20, "protocol": protocol}
        (scene / "meta.json").write_text(json.dumps(meta))
        out = tmp_path / protocol
        assert run("stereo", "fast", "-i", tmp_path / "data", "-o", out, "--evaluate", "-q") == 0
        assert json.loads((out / "evaluation/scores.json").read_text())["headlines"][0]["value"] < 3
    (scene / "meta.json").write_text(json.dumps(meta | {"min_disparity": -24}))
    assert run("stereo", "fast", "-i", tmp_path / "data", "-o", out, "-q") == 0
    assert rows(out)["s"]["min_disparity"] == -24  # another range is another result
    assert run("depth", tmp_path / "eth3d", "-o", tmp_path / "depth", "-q") == 0
    assert abs(np.median(read_pfm(tmp_path / "depth/s/depth.pfm")) - 5 / 8) < 0.01


def test_key_points_of_large_views_are_places_in_the_whole_views(monkeypatch):
    small = blobs(160, 120)
    large = cv2.resize(small, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    monkeypatch.setattr(rectification, "_MAX_PIXELS", small.size)
    left, right = match_views(large, small)
    assert len(left) > 40
    np.testing.assert_allclose(np.median(left + 0.5 - 4 * (right + 0.5), axis=0), 0, atol=0.2)


def test_points_that_no_geometry_explains_are_refused():
    left, right = np.random.default_rng(0).uniform(0, 200, (2, 24, 2))
    refused(InputError, rectify_uncalibrated, left, right, (200, 200))
