"""The protocols against closed forms, naive references, and what the benchmarks' own programs print."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from depthcli.core.errors import ConfigError, InputError
from depthcli.evaluation import protocols
from depthcli.evaluation.protocols import Settings, missing_scores, picture
from depthcli.evaluation.protocols._disparity import DisparityProtocol, DisparityTruth
from depthcli.evaluation.protocols.depth import DepthTruth
from depthcli.evaluation.protocols.kitti_2012 import INTERPOLATED, interpolate_background
from depthcli.evaluation.scores import ESTIMATED_ONLY, MapResult, Metric, Score, find_score, in_order
from depthcli.io.formats.disparity import read_disparity, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import RgbdScene, StereoScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.io.stereo_pairs import StereoTruth
from tests.files import laid
from tests.golden import refused, saying, warned
from tests.naive import metrics as naive
from tests.scenes import DATA, needs_data

STEREO = [name for name in protocols.names() if issubclass(protocols.load(name), DisparityProtocol)]


def make(name: str, **what: Any) -> Any:
    return protocols.load(name)(Settings(**what))


def everywhere(truth: np.ndarray, mask: str = "all") -> DisparityTruth:
    return DisparityTruth(truth, {mask: np.ones(truth.shape, bool)})


def by(name: str, estimate: Any, truth: Any, mask: str = "all") -> list[Score]:
    """The scores of a map by a protocol, of every pixel."""
    return make(name).scores(np.array(estimate, np.float32), everywhere(np.array(truth, np.float32), mask))


def mean_of(judge: Any, found: Iterable[list[Score]]) -> list[Score]:
    return judge.mean([MapResult("r", str(k), "d", judge.name, scores=tuple(each)) for k, each in enumerate(found)])


def pick(scores: list[Score], metric: str, t: float | None = None, convention: str | None = None) -> Score:
    (mask,) = {score.region for score in scores}
    return find_score(scores, metric, mask, t, convention)


def random_maps(seed: int, shape: tuple[int, int] = (13, 17)):
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0, 80, shape).astype(np.float32)
    estimate = (truth + rng.normal(0, 3, shape)).astype(np.float32)
    truth[rng.random(shape) < 0.2] = np.nan
    estimate[rng.random(shape) < rng.choice([0.05, 0.5, 0.95])] = np.nan
    if rng.random() < 0.3:
        estimate[rng.integers(shape[0])] = np.nan
    estimate[rng.random(shape) < 0.05] = rng.choice([-4, 200, 1e6])
    return estimate, truth, rng.random(shape) < 0.7


def test_names_and_unknown_names():
    assert {"middlebury-v2", "middlebury-v3", "eth3d", "kitti-2012", "kitti-2015"} <= set(protocols.names())
    assert protocols.load("KITTI-2015") is protocols.load("kitti_2015")
    refused(InputError, protocols.load, "kitti")
    refused(ConfigError, Settings, resolution="X")


@pytest.mark.parametrize("name", STEREO)
def test_truth_scores_best_nothing_worst_and_no_truth_gives_no_number(name, tmp_path):
    mask, judge = "nonocc", make(name)
    truth = everywhere((2 + np.arange(60, dtype=np.float32) / 16).reshape(6, 10), mask)
    for scores, best in ((judge.scores(truth.values, truth), True), (missing_scores(judge, truth), False)):
        headline = next(s for s in scores if (s.metric, s.region) == (judge.headline, mask))
        worst = math.nan if judge.headline.worst is None else judge.headline.worst
        assert headline.value == pytest.approx(0 if best else worst, nan_ok=True)
        for s in scores:
            worst = math.nan if s.metric.worst is None else s.metric.worst
            expected = (100 if s.metric.larger_is_better else 0) if best else worst
            assert s.value == expected or (math.isnan(s.value) and math.isnan(expected)), s
            assert s.density == (100 if best else 0)
            assert s.pixels == 60 or (best and s.metric.unit == "px")
    assert not judge.wrong(truth.values, truth).any()
    assert picture(judge, truth.values, truth).shape == (6, 10, 3)
    for metric, region in (("nonsense", mask), (judge.headline.name, "elsewhere")):
        with pytest.raises(KeyError):
            find_score(scores, metric, region)
    without = everywhere(np.full((3, 3), np.nan, np.float32))
    for scores in (judge.scores(np.ones((3, 3), np.float32), without), missing_scores(judge, without)):
        assert scores and all(math.isnan(score.value) for score in scores if score.metric.name != "coverage")
        assert all(math.isnan(score.value) for score in mean_of(judge, [scores]))
    write_pfm(tmp_path / "m.pfm", np.ones((6, 8), np.float32))
    with pytest.raises(InputError, match=r"m\.pfm: the map is 8 x 6, the truth 10 x 6"):
        judge.read(tmp_path / "m.pfm", None, truth)


@pytest.mark.parametrize("name", STEREO)
@pytest.mark.parametrize("threshold", [1.0, 2.5])
def test_a_users_threshold_is_the_headlines(name, threshold):
    truth, judge = everywhere(np.full((1, 4), 1, np.float32)), make(name, threshold=threshold)
    scores = judge.scores(truth.values + np.array([[0, 1.25, 2, 3]], np.float32), truth)
    headline = pick(scores, judge.headline.name, threshold, judge.headline.convention)
    assert headline.wrong == {1.0: 3, 2.5: 1}[threshold]
    assert judge.wrong(truth.values + np.float32(2), truth).all() == (threshold == 1)


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_v2_agrees_with_the_naive_one(seed):
    estimate, truth, mask = random_maps(seed)
    scores = make("middlebury-v2").scores(estimate, DisparityTruth(truth, {"all": mask}))
    for t in (0.5, 0.75, 1.0, 1.5, 2.0):
        score = pick(scores, "bad", t)
        wrong, pixels = naive.bad_v2(estimate, truth, mask, t)
        assert (score.wrong, score.pixels) == (wrong, pixels)
        assert score.value == pytest.approx(100 * wrong / pixels)


def test_an_error_of_exactly_the_threshold_is_right():
    truth = np.tile(np.arange(20), (5, 1))
    assert [pick(by("middlebury-v2", truth + k, truth), "bad", 1.0).value for k in (1, 2)] == [0, 100]


def test_masks_that_are_not_given_follow_from_both_views():
    left, right = np.full((2, 20, 30), 2, np.float32)
    left[:, 15:20], right[:, 8:13] = 7, 7
    judge = make("middlebury-v2")
    derived = judge.masks(StereoTruth(left, right))
    assert not derived["nonocc"][:, :2].any()  # outside the right image
    assert not derived["nonocc"][:, 10:15].any()  # hidden
    assert derived["nonocc"][:, 15:20].all() and derived["disc"][:, 16].all()
    given = np.zeros((20, 30), bool)
    assert not judge.masks(StereoTruth(left, right, masks={"nonocc": given}))["disc"].any()
    assert set(judge.masks(StereoTruth(left))) == {"all"}


@given(st.integers(0, 10**6), st.sampled_from([1, 2, 4]), st.booleans(), st.sampled_from("FHQ"))
@settings(max_examples=40, deadline=None)
def test_v3_agrees_with_the_naive_one(seed, factor, rounded, size):
    _, truth, mask = random_maps(seed, (12, 16))
    estimate, _, _ = random_maps(seed + 1, (12 // factor, 16 // factor))
    estimate[1, 1:3] = -np.inf
    full = {"F": 1, "H": 2, "Q": 4}[size]
    reference = DisparityTruth(truth, {"all": mask}, max_disparity=59, round_disparity=rounded, factor=full)
    judge = make("middlebury-v3")
    scores = judge.scores(estimate, reference)
    for t in (0.5, 1.0, 2.0, 4.0):
        bad, invalid, total, average = naive.evaldisp(estimate, truth, mask, t / full, 59, rounded)
        assert pick(scores, "bad", t).value == pytest.approx(bad)
        assert pick(scores, "totbad", t).value == pytest.approx(total)
    assert pick(scores, "invalid").value == pytest.approx(invalid)
    assert pick(scores, "avgerr").value == pytest.approx(average, nan_ok=True, rel=1e-5)
    assert judge.wrong(estimate, reference)[mask].sum() == pick(scores, "bad", 2.0).wrong


def test_v3_clips_minus_infinity_and_ignores_bytes_behind_the_values_as_the_sdk(tmp_path):
    truth = everywhere(np.full((2, 3), 2, np.float32))
    values = np.array([[-np.inf, np.inf, np.nan], [2, 2, 2]], np.float32)
    data = b"Pf\n3 2\n-1\n" + values[::-1].astype("<f4").tobytes()
    (tmp_path / "map.pfm").write_bytes(data + b"more")
    judge, scene = make("middlebury-v3"), StereoScene(name="s", folder=tmp_path, left=tmp_path / "left.png")
    values, lines = warned(judge.read, tmp_path / "map.pfm", scene, truth)
    scores = judge.scores(values, truth)
    assert ["4 bytes more" in line for line in lines] == [True]
    assert (pick(scores, "invalid").wrong, pick(scores, "bad", 1.0).wrong) == (2, 1)
    assert pick(scores, "avgerr").value == 0.5


def test_quantiles_are_errors_that_occur():
    for name, expected in (("middlebury-v3", [5, 9, 10, 10]), ("eth3d", [6, 10, 10, 10])):
        scores = by(name, [range(1, 11)], np.zeros((1, 10)))
        assert [pick(scores, f"A{q}").value for q in (50, 90, 95, 99)] == expected


def test_v3_refuses_what_is_no_exact_half_or_quarter():
    for shape in ((5, 7), (6, 7), (3, 4), (2, 2), (11, 13)):
        with saying(ValueError):
            make("middlebury-v3").resized(np.ones(shape, np.float32), everywhere(np.ones((10, 13), np.float32)))


@pytest.mark.parametrize(("name", "width", "resolution", "factor"), [
    ("Motorcycle", 741, None, 4), ("Motorcycle", 1482, None, 2), ("Motorcycle", 2964, None, 1),
    ("Jadeplant", 658, None, 4), ("Teddy", 450, None, 4), ("Teddy", 900, None, 2), ("ArtL", 347, None, 4),
    ("set/Teddy", 1800, None, 1), ("MyDesk", 700, None, 1), ("MyDesk", 700, "H", 2), ("Motorcycle", 741, "F", 1),
])  # fmt: skip
def test_v3_thresholds_are_those_of_the_full_size(tmp_path, name, width, resolution, factor):
    write_pfm(tmp_path / "disp0GT.pfm", np.full((1, width), 20, np.float32))
    scene = StereoScene(name=name, folder=tmp_path, left=tmp_path, disparity_left=tmp_path / "disp0GT.pfm")
    judge = make("middlebury-v3", resolution=resolution)
    truth = judge.truth(scene)
    assert truth.factor == factor
    found = [pick(judge.scores(truth.values + np.float32(off / factor), truth), "totbad", 2.0) for off in (2.0, 2.25)]
    assert [score.value for score in found] == [0, 100]
    assert found[0].metric.heading == {1: "totbad 2", 2: "totbad 2 (1)", 4: "totbad 2 (0.5)"}[factor]


def test_v3_means_weigh_the_hard_scenes_half():
    judge, metric = make("middlebury-v3"), Metric("totbad", "%", 2.0, worst=100.0)
    results = [MapResult("r", f"set/{n}", "set", "middlebury-v3", scores=(Score(metric, "nonocc", v, 1, 100.0),))
               for n, v in (("Teddy", 10.0), ("PianoL", 40.0))]  # fmt: skip
    assert judge.mean(results)[0].value == pytest.approx((10 + 20) / 1.5)


@given(st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_eth3d_agrees_with_the_naive_one(seed):
    estimate, truth, mask = random_maps(seed, (13, 90))
    scores = make("eth3d").scores(estimate, DisparityTruth(truth, {"all": mask}))
    for t in (0.5, 1.0, 2.0, 4.0):
        bad, coverage, average, median = naive.eth3d(estimate, truth, mask, t)
        assert pick(scores, "bad", t).value == pytest.approx(bad)
    assert pick(scores, "coverage").value == pytest.approx(coverage)
    assert pick(scores, "avgerr").value == pytest.approx(average, rel=1e-5, nan_ok=True)
    assert pick(scores, "A50").value == pytest.approx(median, rel=1e-5, nan_ok=True)


@given(st.integers(0, 10**6), st.lists(st.sampled_from(["map", "empty", "empty row"]), min_size=1, max_size=4))
@settings(max_examples=60, deadline=None)
def test_kitti_agrees_with_the_kits_formulas(seed, kinds):
    """Frames of several sizes, some without any estimate or with an empty row: counts, figures and densities."""
    frames = []
    for k, kind in enumerate(kinds):
        estimate, truth, mask = random_maps(seed + k, (5 + 3 * k, 11 - 2 * k))
        estimate[{"map": slice(0), "empty": slice(None), "empty row": slice(2, 3)}[kind]] = np.nan
        mask[0, 0], truth[0, 0] = True, 9  # a frame without truth is an error of the kits
        frames.append((naive.submitted(estimate), truth, mask))
        given = frames[-1][0]
        np.testing.assert_array_equal(interpolate_background(given), naive.interpolate_background(given))
    for name, formulas, rules in (
        ("kitti-2012", naive.kitti_2012, [("out", t) for t in (2.0, 3.0, 4.0, 5.0)]),
        ("kitti-2015", naive.kitti_2015, [("D1", 3.0), ("out", 3.0)]),
    ):
        judge = make(name)
        found = [judge.scores(estimate, DisparityTruth(truth, {"occ": mask})) for estimate, truth, mask in frames]
        mean = mean_of(judge, found)
        for metric, t in rules:
            rule = naive.d1 if metric == "D1" else lambda error, _, t=t: error > t
            expected = formulas(frames, rule)
            for frame, scores in zip(frames, found, strict=True):
                wrong, _, pixels = naive.kitti_frame(*frame, rule)
                both = [pick(scores, metric, t, c) for c in (INTERPOLATED, ESTIMATED_ONLY)]
                assert [(s.wrong, s.pixels) for s in both] == list(zip(wrong, pixels, strict=True))
            for k, convention in enumerate((INTERPOLATED, ESTIMATED_ONLY)):
                both = (pick(mean, metric, t, convention), pick(mean, "avgerr", None, convention))
                assert [s.value for s in both] == pytest.approx(expected[2 * k : 2 * k + 2], rel=1e-5)
                assert [s.density for s in both] == pytest.approx([expected[4]] * 2, rel=1e-6)


def test_d1_needs_both_conditions_and_exactly_five_percent_is_wrong():
    truth = everywhere(np.array([[100, 100, 20, 80]], np.float32), "occ")
    estimate = np.array([[104, 106, 23.5, 84]], np.float32)  # 4 %; 6 %; 3.5 px and 17.5 %; 5 %
    judge = make("kitti-2015")
    assert pick(judge.scores(estimate, truth), "D1", 3.0, ESTIMATED_ONLY).wrong == 3
    np.testing.assert_array_equal(judge.wrong(estimate, truth), [[False, True, True, True]])


def test_kitti_scores_the_png_that_would_be_submitted(tmp_path):
    truth, judge = everywhere(np.array([[10, 10, 10, 300]], np.float32), "occ"), make("kitti-2012")
    estimate = np.array([[-10, 13 + 1 / 600, 13 + 1 / 400, 300]], np.float32)  # missing; 13; 13 + 1/256; 255.996
    write_pfm(tmp_path / "m.pfm", estimate)
    out = pick(judge.scores(judge.read(tmp_path / "m.pfm", None, truth), truth), "out", 3.0, ESTIMATED_ONLY)
    assert (out.wrong, out.pixels, out.density) == (2, 3, 75)


@pytest.mark.parametrize(("name", "metric", "value", "density", "wrong"), [
    ("kitti-2012", "out", 62.5, 50, None), ("kitti-2015", "D1", 40, 80, 2),  # frames averaged; their pixels pooled
])  # fmt: skip
def test_a_frame_that_a_run_lacks_is_wholly_wrong(name, metric, value, density, wrong):
    judge = make(name)
    found = by(name, [[10, 10, 10, 19]], np.full((1, 4), 10), "occ")
    absent = missing_scores(judge, everywhere(np.full((1, 1), 10, np.float32), "occ"))
    mean = mean_of(judge, (found, absent))
    score = pick(mean, metric, 3.0, ESTIMATED_ONLY)
    assert (score.value, score.wrong) == (value, wrong)
    assert pick(mean, metric, 3.0, INTERPOLATED).density == density
    assert math.isnan(pick(mean, "avgerr", None, INTERPOLATED).value)


def test_kitti_regions():
    occ = np.array([[10, 10, 10, -1, np.nan]], np.float32)
    noc = np.array([[12, np.nan, 10, np.nan, np.nan]], np.float32)
    stored = StereoTruth(occ, None, noc, np.array([[True, False, False, False, True]]))
    judge = make("kitti-2015")
    masks = judge.masks(stored)
    sizes = {"occ": 3, "occ_bg": 2, "occ_fg": 1, "noc": 2, "noc_bg": 1, "noc_fg": 1}
    assert {name: int(masks[name].sum()) for name in in_order(masks, judge.region_order)} == sizes
    # noc has its own values: an estimate of 10 is off by 2 there.
    scores = make("kitti-2012").scores(np.full((1, 5), 10, np.float32), DisparityTruth(occ, masks, noc))
    assert [find_score(scores, "avgerr", region, None, INTERPOLATED).value for region in ("noc", "occ")] == [1, 0]


@pytest.mark.parametrize("name", STEREO)
@pytest.mark.parametrize("factor", [16, 4, 256, 0.5, 1 / 16, -1])
def test_wrong_scale_is_noticed(name, factor, tmp_path):
    truth = random_maps(3, (40, 50))[1]
    estimate = truth + np.float32(0.3)
    judge, reference = make(name), replace(everywhere(truth), max_disparity=80)
    for values, is_said in ((estimate, False), (estimate * np.float32(factor), True)):
        write_pfm(tmp_path / "m.pfm", values)
        lines = warned(judge.read, tmp_path / "m.pfm", None, reference)[1]
        assert any("times the truth" in line for line in lines) == is_said


@pytest.mark.parametrize("name", STEREO)
@pytest.mark.parametrize("mark", [-1.0, -16.0, 0.0])
@pytest.mark.parametrize("share", [0.002, 0.05])
def test_what_is_no_value_in_a_map(name, mark, share, tmp_path):
    """A constant of a share of the pixels, as in all commands; else 0 is a value, and less where the program has it."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(5, 60, (50, 80)).astype(np.float32)
    estimate = truth + np.float32(0.3)
    estimate[rng.random(truth.shape) < share] = mark
    write_pfm(tmp_path / "map.pfm", estimate)
    judge, of_scene = make(name), everywhere(truth)
    values, lines = warned(judge.read, tmp_path / "map.pfm", None, of_scene)
    values = judge.values(values, of_scene)
    counts = mark == 0 or name in ("eth3d", "middlebury-v3")
    assert np.isnan(values[estimate == mark]).all() == (share > 0.005 or not counts)
    assert not np.isnan(values[estimate != mark]).any()
    assert any(f"{mark:g}: taken as no value" in line for line in lines) == (share > 0.005)
    stays = make(name, invalid=np.nan)
    values = stays.values(stays.read(tmp_path / "map.pfm", None, of_scene), of_scene)
    assert np.isnan(values[estimate == mark]).all() != counts
    given = make(name, invalid=mark).read(tmp_path / "map.pfm", None, of_scene)
    assert np.isnan(given).mean() == np.mean(estimate == mark)
    truth[0, 0] = -3
    kept = not np.isnan(judge.values(estimate, everywhere(truth))[estimate == mark]).any()
    assert kept == (not name.startswith("kitti") or mark == 0)


def disturbed(truth: np.ndarray, holes: bool) -> np.ndarray:
    """The truth with a saw of up to 1.4 px, outliers of 9.5 px, and, if requested, holes and empty rows."""
    y, x = np.indices(truth.shape)
    values = np.where(np.isnan(truth), np.float32(20), truth)
    values += ((7 * x + 13 * y) % 23 - 11).astype(np.float32) / 8
    values[(31 * x + 17 * y) % 29 == 0] += 9.5
    if holes:
        values[(5 * x + 3 * y) % 11 < 3] = np.nan
        values[40:60] = np.nan
    return values


def of_motorcycle(judge: Any, holes: bool) -> list[Score]:
    (scene,) = discover_scenes(DATA / "middlebury_v3", ALL_KINDS, patterns=["Motorcycle"])
    truth = judge.truth(scene)
    return judge.scores(disturbed(truth.values, holes), truth)


def of_kitti(judge: Any, holes: bool) -> list[Score]:
    """The mean of two frames."""
    found = []
    for folder, noc in (("kitti/2012_000070_10", "disp_left_noc.png"), ("kitti_eval_pairs/pair_07", "disp_left.png")):
        occ = read_disparity(DATA / folder / "disp_left.png")
        stored = StereoTruth(occ, None, read_disparity(DATA / folder / noc), (np.indices(occ.shape)[1] // 100) % 3 == 1)
        found.append(judge.scores(disturbed(occ, holes), DisparityTruth(occ, judge.masks(stored), stored.noc)))
    return mean_of(judge, found)


@needs_data
@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize(("name", "of_frames", "keys", "form", "printed"), [
    # SDK 1.6: evaldisp with 0.5 px and the mask, with 1.0 px and without it; 70 disparities, not rounded.
    ("middlebury-v3", of_motorcycle, "bad 2, invalid, totbad 2, avgerr", "{:.2f}",
     {"nonocc": ("62.21 0.00 62.21 1.02", "43.33 30.35 73.67 1.02")}),
    ("middlebury-v3", of_motorcycle, "bad 4, invalid, totbad 4, avgerr", "{:.2f}",
     {"all": ("28.63 0.00 28.63 1.02", "19.99 30.16 50.16 1.02")}),
    # The program of ETH3D.
    ("eth3d", of_motorcycle, "coverage, bad .5, bad 1, bad 2, bad 4", "{:g}%",
     {"nonocc": ("1 0.622092 0.286175 0.0344336 0.0344336", "0.696541 0.622044 0.286091 0.0343306 0.0343306"),
      "all": ("1 0.622289 0.286284 0.0344654 0.0344654", "0.698352 0.622259 0.286283 0.0344292 0.0344292")}),
    ("eth3d", of_motorcycle, "avgerr, rms, A50, A90, A95, A99", "{:g}",
     {"nonocc": ("1.01966 1.94796 0.75 1.375 1.375 10.125", "1.01877 1.94548 0.75 1.375 1.375 10.125"),
      "all": ("1.0201 1.94891 0.75 1.375 1.375 10.125", "1.01984 1.94826 0.75 1.375 1.375 10.125")}),
    # The kits of KITTI: stats_disp_*_0.txt; stats_*_out.txt, stats_*_avg.txt (each interpolated and estimated).
    ("kitti-2015", of_kitti, "D1 bg, D1 fg, D1, density 3", "{:.6f}%",
     {"noc": ("0.034131 0.034131 0.034483 0.034483 0.034247 0.034247 1.000000",
              "0.158709 0.034072 0.154431 0.034940 0.157304 0.034358 0.725978"),
      "occ": ("0.034055 0.034055 0.034440 0.034440 0.034180 0.034180 1.000000",
              "0.160477 0.033999 0.154601 0.034900 0.158567 0.034292 0.725918")}),
    ("kitti-2012", of_kitti, "out 2, out 3, out 4, out 5, density 3", "{:.6f}%",
     {"noc": ("0.034248 0.034248 0.034248 0.034248 0.034248 0.034248 0.034248 0.034248 1.000000",
              "0.160359 0.034356 0.157289 0.034356 0.154926 0.034356 0.152741 0.034356 0.726003"),
      "occ": ("0.034187 0.034187 0.034187 0.034187 0.034187 0.034187 0.034187 0.034187 1.000000",
              "0.161482 0.034296 0.158431 0.034296 0.156088 0.034296 0.153919 0.034296 0.725951")}),
    ("kitti-2012", of_kitti, "avgerr", "{:.6f}",
     {"noc": ("1.019000 1.019000", "5.056188 1.020277"), "occ": ("1.018526 1.018526", "5.176367 1.019825")}),
])  # fmt: skip
def test_numbers_of_the_benchmarks_programs(name, of_frames, keys, form, printed, holes):
    judge = make(name)
    scores = of_frames(judge, holes)
    both = (INTERPOLATED, ESTIMATED_ONLY) if of_frames is of_kitti else (None,)
    for mask, lines in printed.items():
        found = []
        for metric, *more in map(str.split, keys.split(", ")):
            threshold = next((float(word) for word in more if word[-1].isdigit()), 3.0 if metric == "D1" else None)
            region = "_".join([mask, *(word for word in more if word[-1].isalpha())])
            if metric == "density":
                found.append(find_score(scores, judge.headline.name, region, threshold, INTERPOLATED).density)
            else:
                found += [find_score(scores, metric, region, threshold, each).value for each in both]
        share = 100 if form.endswith("%") else 1
        assert " ".join(form.rstrip("%").format(value / share) for value in found) == lines[holes], mask


def test_depth_by_hand():
    true, estimate = np.array([[[1, 1, 2, 2, np.nan, 4]], [[1.03, 1.08, 2, np.nan, 1, 3]]], np.float32)
    judge, truth = make("depth"), DepthTruth(true, {"all": np.isfinite(true)}, 43.5, 1000.0)
    found = {score.metric.heading: score.value for score in judge.scores(estimate, truth)}
    assert found == pytest.approx(
        {"MAE": 277.5, "RMSE": 1000 * np.sqrt((0.03**2 + 0.08**2 + 1) / 4), "REL": 0.09, "delta 1.05": 50,
         "delta 1.1": 75, "delta 1.25": 75, "delta 1.562": 100, "delta 1.953": 100, "coverage": 80,
         "MAE px": 43.5 * (2 - 1 / 1.03 - 1 / 1.08 + 1 / 12) / 4,
         "bad 1 px": 75}, rel=1e-5,
    )  # fmt: skip
    assert judge.wrong(estimate, truth)[0].tolist() == [False, True, False, False, False, True]
    assert make("depth", threshold=100.0).wrong(estimate, truth)[0].tolist() == [False] * 5 + [True]


def test_codes_of_depth_have_the_scale_of_the_settings_or_of_the_truth(tmp_path):
    write_png(tmp_path / "d.png", np.full((1, 2), 2000, np.uint16))
    scene = RgbdScene(name="a", folder=tmp_path, color=tmp_path / "c.png", depth=tmp_path / "d.png")
    truth = DepthTruth(np.ones((1, 2), np.float32), {}, None, 4000.0)
    assert make("depth").read(scene.depth, scene, truth).tolist() == [[0.5, 0.5]]
    assert make("depth", scale=500.0).read(scene.depth, scene, truth).tolist() == [[4.0, 4.0]]
    refused(InputError, make("middlebury-v2").truth, scene)
    larger = DepthTruth(np.ones((2, 2), np.float32), {}, None, 4000.0)
    refused(InputError, make("depth").read, scene.depth, scene, larger)
    refused(InputError, make("depth").read_confidence, scene.depth, larger)
    refused(InputError, make("depth").truth, StereoScene(name="b", folder=tmp_path, left=scene.depth))


def test_depth_at_another_size(tmp_path):
    """Every second pixel of maps, masks and confidences, from the first."""
    grid = np.arange(1, 25, dtype=np.float32).reshape(4, 6)
    folder = laid(tmp_path / "a", {
        "color.png": np.zeros((4, 6, 3), np.uint8), "depth.pfm": grid, "depth_true.pfm": grid + 1,
        "mask_object.png": grid > 12, "m.pfm": grid * 2,
    })  # fmt: skip
    (scene,) = discover_scenes(folder, ALL_KINDS)
    judge = make("depth", resize=(3, 2))
    truth = judge.truth(scene)
    assert truth.depth.tolist() == [[2, 4, 6], [14, 16, 18]] and truth.regions["object"].tolist() == [[0] * 3, [1] * 3]
    assert judge.read(folder / "m.pfm", scene, truth).tolist() == [[2, 6, 10], [26, 30, 34]]
    assert judge.read_confidence(folder / "m.pfm", truth).tolist() == [[2, 6, 10], [26, 30, 34]]
    laid(folder, {"depth_true.pfm": grid * np.nan})
    refused(InputError, judge.truth, scene)


def test_scene_flow_evaluates_disparities_below_192():
    disparity, judge = np.array([[0, 0.5, 100, 191.5, 192, 300, 50, np.nan]], np.float32), make("scene-flow")
    truth = DisparityTruth(disparity, judge.masks(StereoTruth(disparity)))
    estimate = disparity + np.array([[9, 0.75, 4, 10, 90, 90, np.nan, 1]], np.float32)
    scores = judge.scores(estimate, truth)
    average = pick(scores, "avgerr")
    assert (average.value, average.metric) == (pytest.approx((0.75 + 4 + 10) / 3), judge.headline)
    assert [pick(scores, "bad", t).value for t in (1.0, 3.0)] == [75, 75]  # the missing one is bad
    assert pick(scores, "D1").value == 50  # 4 px are not 5 % of 100 px
    np.testing.assert_array_equal(judge.wrong(estimate, truth)[0, 1:4], [False, True, True])
