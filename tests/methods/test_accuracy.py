"""Golden accuracy of stereo and fusion on real scenes: what was measured once must not get worse unnoticed.

Middlebury, bad > 1 px, missing counts as bad. A figure that improves is welcome: lower the golden one.
"""

import numpy as np
import pytest

from depthcli.evaluation.curves import sparsification
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.cost.census import Census
from depthcli.problems.fusion import Fuse
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.inputs import part, preset, views, wrong
from tests.scenes import V2, errors, rates, real_pair, real_scenes

pytestmark = pytest.mark.slow


def pipeline(name, *settings):
    return preset("stereo", name, *settings).pipeline


def mean_error(method, folder):
    """Mean of nonocc, all and disc over the scenes of a data set; on the real pair, of which all is known, of that."""
    scenes = [real_pair()] if folder == REAL else real_scenes(folder).values()
    return np.mean([[*errors(method, scene).values()] for scene in scenes])


REAL = "the real pair of scikit-image"
PEERS = [
    part("methods.stereo.pipeline", name, **fields)
    for name, fields in (("opencv_sgbm", {}), ("opencv_sgbm", {"mode": "3way", "wls": {}}), ("opencv_bm", {}))
]


@pytest.mark.parametrize(("folder", "golden"), [(REAL, (11.84, 17.53, 12.74)), (V2, (11.2, 9.2, 15.0))])
def test_peers_have_their_known_error(folder, golden):
    """Both ways: a peer that we run worse than it is would make our own figures look good."""
    found = [mean_error(peer, folder) for peer in PEERS]
    assert found == pytest.approx(golden, abs=0.3 if folder == REAL else 0.4)


@pytest.mark.parametrize(("folder", "max_errors"), [
    # No setting was chosen on it; chapter 3's cross and ad-census flatten its slanted surfaces.
    (REAL, {"fast": 7.9, "accurate": 6.2, "ad-census": 15.6, "adaptive-weight": 9.8, "cross": 14.8}),
    (V2, {"fast": 7.5, "cross": 5.2, "ad-census": 4.8, "adaptive-weight": 6.0, "accurate": 4.2, "segments": 4.15}),
    ("middlebury_2001", {"accurate": 0.66, "segments": 0.8}),
    ("middlebury_2005", {"accurate": 8.0, "segments": 7.8}),
    ("middlebury_2006", {"accurate": 4.9}),
])  # fmt: skip
def test_presets_keep_their_accuracy(folder, max_errors):
    for name, max_error in max_errors.items():
        assert mean_error(pipeline(name), folder) <= max_error, name


# Mean over the four scenes of bad > 1 px in all regions, %, which figure 3.3 of the thesis draws.
CHAPTER_3 = {
    "cw": {"ad": 17.7, "ad-gradient": 11.4, "ad-rank": 12.2, "ad-census": 11.6},
    "cross": {"ad": 14.5, "ad-gradient": 9.6, "ad-rank": 10.4, "ad-census": 9.6},
    "aw": {"ad": 12.5, "ad-gradient": 9.2, "ad-rank": 9.6, "ad-census": 9.1},
}


def error_everywhere(name, *settings):
    """Errors of a preset of chapter 3 in all regions, scene by scene."""
    method = pipeline(f"thesis/ch3-{name}", *settings)
    return np.array([errors(method, scene)["all"] for scene in real_scenes().values()])


def test_chapter_3_keeps_its_errors_and_what_section_3_3_3_concludes():
    """Both ways: these presets are the thesis's methods, which are to be neither improved nor spoilt.

    AD is the worst on every scene; AD + census is the best or nearly so, with AD + rank close behind. CROSS and AW are
    alike, AW slightly better, and both are much better than CW.
    """
    chapter_3 = {way: {cost: error_everywhere(f"{cost}-{way}") for cost in costs} for way, costs in CHAPTER_3.items()}
    for way, found in chapter_3.items():
        means = {cost: errors.mean() for cost, errors in found.items()}
        assert means == pytest.approx(CHAPTER_3[way], abs=0.4), way
        others = [found[cost] for cost in ("ad-gradient", "ad-rank", "ad-census")]
        assert all((found["ad"] > other).all() for other in others), way
        assert means["ad-census"] < min(means.values()) + 0.4
        assert means["ad-census"] - 0.1 < means["ad-rank"] < means["ad-census"] + 1.2
    # Where it does not hold: on Tsukuba AD + gradient is the best with every aggregation.
    tsukuba = list(real_scenes()).index("Tsukuba")
    assert all(min(found, key=lambda cost: found[cost][tsukuba]) == "ad-gradient" for found in chapter_3.values())
    for cost in CHAPTER_3["cw"]:
        window, cross, weights = (chapter_3[way][cost].mean() for way in ("cw", "cross", "aw"))
        assert weights < cross < window - 1.5
    assert chapter_3["cross"]["ad-census"].mean() < chapter_3["aw"]["ad-census"].mean() + 1


def test_windows_of_figure_3_3():
    """CW is best near 11 x 11; AW gets better up to 33 x 33."""

    def means(name, windows):
        return [error_everywhere(name, f"aggregation.window={window}").mean() for window in windows]

    for cost in ("ad-census", "ad-gradient"):
        small, near, large = means(f"{cost}-cw", (5, 11, 21))
        assert near < small - 0.5 and near < large - 0.5
    found = means("ad-census-aw", (3, 11, 33))
    assert found == sorted(found, reverse=True)


TABLE_2_1 = {
    "ch2-baseline": ((2.64, 3.26, 11.8), (2.63, 3.36, 9.91)),
    "ch2-kp": ((1.56, 2.23, 7.42), (2.08, 2.67, 7.28)),
    "ch2-dedc": ((1.25, 1.75, 6.28), (1.31, 1.65, 6.75)),
    "ch2-kp-dedc": ((1.08, 1.59, 5.82), (1.28, 1.61, 6.59)),
}
"""Rows of table 2.1, as printed and as the presets reach them: bad > 1 px on Tsukuba, nonocc, all, disc, %."""


def test_table_2_1_is_in_its_order_and_keeps_its_errors():
    rows = [[*errors(pipeline(name), real_scenes()["Tsukuba"]).values()] for name in TABLE_2_1]
    for found, (printed, reached) in zip(rows, TABLE_2_1.values(), strict=True):
        assert found == pytest.approx(reached, abs=0.02)
        assert found[0] == pytest.approx(printed[0], abs=0.6)
    assert np.all(np.diff(rows, axis=0) <= 0)
    assert np.all(np.array(rows[-1]) <= (1.30, 1.75, 6.6))


def test_table_2_2_keeps_its_errors():
    rows = {name: [*errors(pipeline("ch2-kp-dedc"), scene).values()] for name, scene in real_scenes().items()}
    assert np.mean([*rows.values()]) <= 5.6  # the thesis: 4.88
    assert rows["Venus"][0] <= 0.25


def beats(name, other, part, scenes):
    """Whether the error of a preset, summed over generated scenes, is less than a part of that of another one.

    Settings may follow a name.
    """
    ours, others = (
        sum(wrong(method(views(made), made.max_disparity), made) for made in scenes)
        for method in (pipeline(*words.split()) for words in (name, other))
    )
    return ours < part * others


@pytest.mark.parametrize(
    ("name", "without", "part"), [("ch2-kp-dedc", "ch2-dedc", 0.6), ("segments", "segments keypoints=none", 0.75)]
)
def test_key_points_help_where_patterns_repeat(name, without, part):
    assert beats(name, without, part, [make_scene("repetitive", seed) for seed in (0, 2)])


def test_accurate_beats_sgbm_on_generated_scenes():
    """Patterns that repeat within the range; levels up to 20 with noise."""
    dark = {"brightness": 0.08, "noise": 1.5, "wall_contrast": 0.6}
    assert beats("accurate", "opencv-sgbm", 1, [make_scene("repetitive", seed) for seed in range(500, 504)])
    scenes = [make_scene(("planes", "foreground")[seed % 2], seed, **dark) for seed in range(500, 504)]
    assert beats("accurate", "opencv-sgbm", 0.6, scenes)


def test_accurate_beats_sgbm_on_a_street():
    """Wrong by more than 3 px, visible pixels of a KITTI frame; both maps are dense."""
    scene = real_scenes("kitti", "kitti_2012")["2012_000070_10"]
    ours, sgbm = (errors(method, scene, "kitti_2012")["noc"] for method in (pipeline("accurate"), PEERS[0]))
    assert ours <= 4.2 and ours < sgbm - 1


def test_pairs_that_are_not_quite_rectified_or_lit_alike_hardly_matter():
    """Playtable and PlaytableP are one scene, rectified imperfectly and perfectly; MotorcycleE is exposed otherwise,
    PianoL has a lamp in one view only: there grey levels cannot be put right, but not be trusted.
    """
    found = real_scenes("middlebury_v3", "middlebury_v3")
    names = ("Playtable", "PlaytableP", "Motorcycle", "MotorcycleE", "PianoL")
    ours, plain = (
        {name: errors(method, found[name], "middlebury_v3")["nonocc"] for name in names}
        for method in (pipeline("accurate"), pipeline("accurate", "adjust=[]"))
    )
    assert ours["Playtable"] <= 1.25 * ours["PlaytableP"]
    assert ours["MotorcycleE"] <= 1.2 * ours["Motorcycle"]
    assert ours["PianoL"] <= 34
    assert all(ours[name] < plain[name] for name in ("Playtable", "Motorcycle", "MotorcycleE", "PianoL"))


def test_consensus_beats_equal_weights_and_votes_beat_weights():
    def bad(name, **fields):
        measures = ["absolute_difference", "gradient", "rank", "census"]
        return errors(Fusion.model_validate({"measures": measures, **fields}), real_scenes()[name])["nonocc"]

    reached = {"Teddy": (10.3, 9.6, 8.5), "Cones": (5.6, 4.8, 4.4), "Venus": (2.4, 1.75, 1.4)}
    for name, (equal, weighted, fused) in reached.items():
        assert bad(name, weights="equal", consensus={"vote_cost": 0}) == pytest.approx(equal, abs=0.15), name
        assert bad(name, consensus={"vote_cost": 0}, blend="after") < weighted + 0.1, name
        assert bad(name) < fused + 0.1, name


def test_disparity_agreement_and_peak_sorts_out_errors_best():
    pair, truth, top = real_pair()
    costs = ConstantWindow(window=11)(Census()(pair, top + 1), pair).costs
    known = ~np.isnan(truth.values)
    wrong = ~(np.abs(winners(costs)[0] - truth.values) <= 1)[known]
    areas = {n: sparsification(m[known], wrong).auc for n, m in confidence_maps(costs, ["dap", "da", "pkr"]).items()}
    assert areas["dap"] <= 0.027
    assert areas["dap"] < areas["pkr"] < np.mean(wrong) / 2


def test_mixed_maps_are_right_with_a_lamp_in_one_view_and_in_a_sunny_street():
    """The network was not trained on the street."""
    for folder, protocol, name, region, max_rate in (
        ("middlebury_v3", "middlebury_v3", "PianoL", "nonocc", 32.0),
        ("kitti", "kitti_2015", "2015_first_scene_intGT", "occ", 6.8),
    ):
        fusion = Fuse.ready(preset("fuse", "accurate")).config
        assert errors(fusion, real_scenes(folder, protocol)[name], protocol)[region] <= max_rate, name


def test_mixed_maps_keep_their_accuracy_and_their_probability_sorts_out_errors():
    """The network was trained on these scenes, on the real pair at another crop."""
    rates_of = (V2, "Teddy", 2.6), (V2, "Venus", 0.2), ("middlebury_2005", "Dolls", 3.9)
    scenes = [(real_scenes(folder)[name], "nonocc", max_rate) for folder, name, max_rate in rates_of]
    for (pair, truth, top), region, max_rate in [(real_pair(), "all", 4.7), *scenes]:
        result = Fuse.ready(preset("fuse", "accurate")).config(pair, top)
        assert rates(result.disparity.values, truth)[region] <= max_rate
        pixels = truth.regions[region]
        wrong = ~(np.abs(result.disparity.values - truth.values) <= 1)[pixels]
        area = sparsification(result.confidence["probability"][pixels], wrong).auc
        assert area <= 0.25 * np.mean(wrong)
