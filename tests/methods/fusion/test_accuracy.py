"""Fusion and confidences on real scenes: the figures must not get worse."""

import numpy as np
import pytest

from depthcli.evaluation.curves import sparsification
from depthcli.kernels.winners import winners
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.cost.census import Census
from depthcli.problems.fusion import Fuse
from tests.contracts.inputs import preset
from tests.scenes import V2, errors, rates, real_pair, real_scenes

MEASURES = ["absolute_difference", "gradient", "rank", "census"]
REACHED = {"Teddy": (10.3, 9.6, 8.5), "Cones": (5.6, 4.8, 4.4), "Venus": (2.4, 1.75, 1.4)}
"""Bad pixels, %, with equal weights, with those of the consensus, with its votes."""


def bad(name, **fields):
    return errors(Fusion.model_validate({"measures": MEASURES, **fields}), real_scenes()[name])["nonocc"]


@pytest.mark.slow
def test_consensus_beats_equal_weights_and_votes_beat_weights():
    for name, (equal, weighted, fused) in REACHED.items():
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


@pytest.mark.slow
def test_mixed_maps_are_right_with_a_lamp_in_one_view_and_in_a_sunny_street():
    """The network was not trained on the street."""
    for folder, protocol, name, region, max_rate in (
        ("middlebury_v3", "middlebury_v3", "PianoL", "nonocc", 32.0),
        ("kitti", "kitti_2015", "2015_first_scene_intGT", "occ", 6.8),
    ):
        fusion = Fuse.ready(preset("fuse", "accurate")).config
        assert errors(fusion, real_scenes(folder, protocol)[name], protocol)[region] <= max_rate, name


def check_mixed_map(scene, region, max_rate):
    """The map of ``fuse accurate`` keeps its accuracy, and its probability sorts out errors."""
    pair, truth, top = scene
    result = Fuse.ready(preset("fuse", "accurate")).config(pair, top)
    assert rates(result.disparity.values, truth)[region] <= max_rate
    pixels = truth.regions[region]
    wrong = ~(np.abs(result.disparity.values - truth.values) <= 1)[pixels]
    area = sparsification(result.confidence["probability"][pixels], wrong).auc
    assert area <= 0.25 * np.mean(wrong)


@pytest.mark.slow
def test_mixed_maps_keep_their_accuracy():
    """The network was trained on these scenes, on the real pair at another crop."""
    check_mixed_map(real_pair(), "all", 4.7)
    for folder, name, max_rate in ((V2, "Teddy", 2.6), (V2, "Venus", 0.2), ("middlebury_2005", "Dolls", 3.9)):
        check_mixed_map(real_scenes(folder)[name], "nonocc", max_rate)
