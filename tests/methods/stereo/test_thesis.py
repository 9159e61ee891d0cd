"""Chapter 3 of the thesis: its presets against its equations, and the plain loops that figure 3.2 is timed with."""

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.aggregation.cross import cross_arms
from depthcli.methods.stereo.cost.gradient import image_gradient
from depthcli.methods.stereo.cost.rank import rank_transform
from depthcli.methods.stereo.volume import CostVolume
from depthcli.simulate.stereo_scenes import make_scene
from tests.contracts.inputs import part, preset
from tests.naive import loops
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


H, W, D = 16, 20, 5
INSIDE = np.arange(W)[:, None] >= np.arange(D)
PAIR = StereoPair(*np.random.default_rng(0).integers(0, 256, (2, H, W, 3)).astype(np.uint8))
COSTS = np.random.default_rng(1).integers(0, 60, (H, W, D)).astype(np.uint8)


def means(name, **fields):
    found = part("methods.stereo.aggregation", name, **fields)(CostVolume(COSTS), PAIR)
    return found.costs / found.scale


def two_passes(step, *arguments):
    """Means: the sum of the costs by their number."""
    sums = []
    for costs in (COSTS, np.ones_like(COSTS)):
        half, out = (np.zeros(costs.shape, np.float32) for _ in range(2))
        step(costs.astype(np.float32), half, *arguments[0])
        step(half.transpose(1, 0, 2), out.transpose(1, 0, 2), *arguments[1])
        sums.append(out)
    return sums[0] / sums[1]


def test_means_over_windows_and_crosses_and_with_weights():
    assert np.allclose(means("constant_window", window=5), two_passes(loops.box, (2,), (2,)), atol=0.1)
    own, other = (cross_arms(image, 4, 90, 4, 90).astype(np.int64) for image in PAIR.color8)
    turned = (arms[2:].transpose(0, 2, 1) for arms in (own, other))
    fields = {"length": 4, "threshold": 90, "inner_length": 4, "iterations": 1, "smoothing": False}
    found = means("cross", **fields, support="intersection")
    assert np.allclose(found, two_passes(loops.arms, (own[:2], other[:2], True), (*turned, False)), atol=0.1)
    fields = {"window": 5, "norm": "squared", "color_space": "rgb", "gamma_color": 900, "gamma_space": 300}
    out = np.zeros((6, W, D), np.float32)
    loops.weights(COSTS.astype(np.float32), out, *(image.astype(np.float32) for image in PAIR.color8), 2, 4)
    assert np.allclose(means("adaptive_weight", **fields)[4:10][:, INSIDE], out[:, INSIDE], atol=0.1)


def test_costs():
    grey = [image.astype(np.float32) for image in PAIR.grey]
    ranks = np.zeros((H, W, 1), np.float32)
    loops.ranks(grey[0], ranks)
    assert np.array_equal(ranks[4:-4, 4:-4, 0], rank_transform(PAIR.grey[0], (9, 9))[4:-4, 4:-4])
    signatures = [np.zeros((H, W), np.uint64) for _ in grey]
    for image, signature in zip(grey, signatures, strict=True):
        loops.signatures(image, signature)
    out = np.zeros((H, W, D), np.float32)
    loops.hamming(*signatures, out)
    inner = np.s_[3:-3, 4 + D : -4]
    assert np.array_equal(out[inner], part("methods.stereo.cost", "census", window=(9, 7))(PAIR, D).costs[inner])
    steps = np.arange(-2, 3)
    smooth = np.exp(-(steps**2) / 2)
    taps = np.stack([np.outer(smooth, steps * smooth), np.outer(steps * smooth, smooth)])
    slopes = np.zeros((H, W, 2), np.float32)
    loops.derivatives(grey[0], slopes, taps)
    kernel = np.moveaxis(image_gradient(PAIR.grey[0], 1.0), 0, 2)[2:-2, 2:-2]
    assert np.corrcoef(slopes[2:-2, 2:-2].ravel(), kernel.ravel())[0, 1] > 0.9999
