"""Presets of chapter 3 of the thesis, each as a whole, against its equations written out one after the other."""

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.inputs import preset
from tests.naive import stereo as naive

N_DISPARITIES = 8


def naive_costs(name, pair):
    colors, grey = pair.color8, pair.grey  # grey is uint16
    costs = naive.absolute_difference(*colors, N_DISPARITIES, 180, 60) / 3
    other = {
        "ad": None,
        "ad-gradient": lambda: (naive.gradient(*(view / 257 for view in grey), N_DISPARITIES, 63, 4), 2),
        "ad-rank": lambda: (naive.rank(*grey, N_DISPARITIES, (9, 9), 16), 30),
        "ad-census": lambda: (naive.census(*grey, N_DISPARITIES, (9, 7), 16), 30),
    }[name]
    return costs if other is None else naive.combined([(costs, 10), other()], 1)


def naive_means(name, costs, pair):
    if name == "cw":
        return naive.constant_window(costs, 11)
    if name == "aw":
        return naive.adaptive_weight(costs, *(view.astype(float) for view in pair.color8), 16, 900, 300, squared=True)
    left, right = (naive.thesis_arms(view, 17, 20) for view in pair.color8)
    return naive.cross(costs, left, True, right)


# By how much a cost may exceed the smallest one: stored costs are rounded, in AD to 1/48, in sums of exponentials to
# 1/127, before which gradients are rounded to 1/4, an eighth of their lambda.
ROUNDING = {"ad": 0.03, "ad-gradient": 0.06, "ad-rank": 0.015, "ad-census": 0.015}


@pytest.mark.slow
@pytest.mark.parametrize("cost", ROUNDING)
@pytest.mark.parametrize("aggregation", ["cw", "cross", "aw"])
def test_the_map_has_the_smallest_costs_by_the_equations(cost, aggregation):
    scene = make_scene("planes", 3, width=32, height=20, max_disparity=N_DISPARITIES - 1)
    pair = StereoPair(scene.left, scene.right)
    found = preset("stereo", f"thesis/ch3-{cost}-{aggregation}").pipeline(pair, N_DISPARITIES - 1).disparity.values
    assert (found == np.rint(found)).all()
    costs = naive_means(aggregation, naive_costs(cost, pair), pair)
    outside = np.arange(N_DISPARITIES) > np.arange(costs.shape[1])[:, None]
    costs[:, outside] = np.inf  # such matches are never chosen
    excess = np.take_along_axis(costs, found.astype(int)[..., None], 2)[..., 0] - costs.min(axis=2)
    assert excess.max() <= ROUNDING[cost]
    assert np.mean(found == costs.argmin(axis=2)) > 0.97
