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
from tests.scenes import rates, real_scenes

MEASURES = ["absolute_difference", "gradient", "rank", "census"]


def bad(name, **fields):
    pair, truth, top = real_scenes()[name]
    values = Fusion.model_validate({"measures": MEASURES, **fields})(pair, top).disparity.values
    return rates(values, truth)["nonocc"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "equal", "weighted", "fused"),
    [("Teddy", 10.3, 9.6, 8.5), ("Cones", 5.6, 4.8, 4.4), ("Venus", 2.4, 1.75, 1.4)],
)
def test_consensus_beats_equal_weights_and_votes_beat_weights(name, equal, weighted, fused):
    assert bad(name, weights="equal", consensus={"vote_cost": 0}) == pytest.approx(equal, abs=0.15)
    assert bad(name, consensus={"vote_cost": 0}, blend="after") < weighted + 0.1
    assert bad(name) < fused + 0.1


@pytest.mark.parametrize(("name", "max_area"), [("Teddy", 0.045), ("Cones", 0.022)])
def test_disparity_agreement_and_peak_sorts_out_errors_best(name, max_area):
    pair, truth, top = real_scenes()[name]
    costs = ConstantWindow(window=11)(Census()(pair, top + 1), pair).costs
    known = ~np.isnan(truth.values)
    wrong = ~(np.abs(winners(costs)[0] - truth.values) <= 1)[known]
    areas = {n: sparsification(m[known], wrong).auc for n, m in confidence_maps(costs, ["dap", "da", "pkr"]).items()}
    assert areas["dap"] <= max_area
    assert areas["dap"] < areas["pkr"] < np.mean(wrong) / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "protocol", "name", "region", "max_rate"),
    [
        ("middlebury_v3", "middlebury_v3", "PianoL", "nonocc", 32.0),
        ("kitti", "kitti_2015", "2015_first_scene_intGT", "occ", 6.8),
    ],
)
def test_mixed_maps_are_right_with_a_lamp_in_one_view_and_in_a_sunny_street(folder, protocol, name, region, max_rate):
    """The network was not trained on the street."""
    pair, truth, top = real_scenes(folder, protocol)[name]
    result = Fuse.ready(preset("fuse", "accurate")).config(pair, top)
    assert rates(result.disparity.values, truth, protocol)[region] <= max_rate


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "name", "max_rate"),
    [("middlebury_v2", "Teddy", 2.6), ("middlebury_v2", "Venus", 0.2), ("middlebury_2005", "Dolls", 3.9)],
)
def test_mixed_maps_keep_their_accuracy_and_their_probability_sorts_out_errors(folder, name, max_rate):
    """The network was trained on Teddy and Venus, not on Dolls."""
    pair, truth, top = real_scenes(folder)[name]
    result = Fuse.ready(preset("fuse", "accurate")).config(pair, top)
    assert rates(result.disparity.values, truth)["nonocc"] <= max_rate
    visible = truth.masks["nonocc"]
    wrong = ~(np.abs(result.disparity.values - truth.values) <= 1)[visible]
    area = sparsification(result.confidence["probability"][visible], wrong).auc
    assert area <= 0.25 * np.mean(wrong)
