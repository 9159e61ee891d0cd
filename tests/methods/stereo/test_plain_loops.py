"""The plain loops that figure 3.2 is timed with compute what the kernels compute."""

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross, cross_arms
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.gradient import image_gradient
from depthcli.methods.stereo.cost.rank import rank_transform
from depthcli.methods.stereo.volume import CostVolume
from tests.naive import loops

H, W, D = 16, 20, 5
INSIDE = np.arange(W)[:, None] >= np.arange(D)


@pytest.fixture
def pair() -> StereoPair:
    rng = np.random.default_rng(0)
    return StereoPair(*rng.integers(0, 256, (2, H, W, 3)).astype(np.uint8))


@pytest.fixture
def costs() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 60, (H, W, D)).astype(np.uint8)


def two_passes(step, costs, *arguments):
    half, out = (np.zeros(costs.shape, np.float32) for _ in range(2))
    step(costs.astype(np.float32), half, *arguments[0])
    step(half.transpose(1, 0, 2), out.transpose(1, 0, 2), *arguments[1])
    return out


def test_sums_over_windows(pair, costs):
    found = ConstantWindow(window=5)(CostVolume(costs), pair)
    total = two_passes(loops.box, costs, (2,), (2,))
    area = two_passes(loops.box, np.ones_like(costs), (2,), (2,))
    assert np.allclose(found.costs / found.scale, total / area, atol=0.1)


def test_sums_over_crosses(pair, costs):
    method = Cross(length=4, threshold=90, inner_length=4, iterations=1, support="intersection", smoothing=False)
    own, other = (cross_arms(image, 4, 90, 4, 90).astype(np.int64) for image in pair.color8)
    turned = (arms[2:].transpose(0, 2, 1) for arms in (own, other))
    passes = (own[:2], other[:2], True), (*turned, False)
    total = two_passes(loops.arms, costs, *passes)
    area = two_passes(loops.arms, np.ones_like(costs), *passes)
    found = method(CostVolume(costs), pair)
    assert np.allclose(found.costs / found.scale, total / area, atol=0.1)


def test_means_with_weights(pair, costs):
    method = AdaptiveWeight(window=5, norm="squared", color_space="rgb", gamma_color=900, gamma_space=300)
    out = np.zeros((6, W, D), np.float32)
    left, right = (image.astype(np.float32) for image in pair.color8)
    loops.weights(costs.astype(np.float32), out, left, right, 2, 4)
    found = method(CostVolume(costs), pair)
    assert np.allclose((found.costs / found.scale)[4:10][:, INSIDE], out[:, INSIDE], atol=0.1)


def test_costs(pair):
    grey = [image.astype(np.float32) for image in pair.grey]
    ranks = np.zeros((H, W, 1), np.float32)
    loops.ranks(grey[0], ranks)
    assert np.array_equal(ranks[4:-4, 4:-4, 0], rank_transform(pair.grey[0], (9, 9))[4:-4, 4:-4])
    signatures = [np.zeros((H, W), np.uint64) for _ in grey]
    for image, signature in zip(grey, signatures, strict=True):
        loops.signatures(image, signature)
    out = np.zeros((H, W, D), np.float32)
    loops.hamming(*signatures, out)
    inner = np.s_[3:-3, 4 + D : -4]
    assert np.array_equal(out[inner], Census(window=(9, 7))(pair, D).costs[inner])
    steps = np.arange(-2, 3)
    smooth = np.exp(-(steps**2) / 2)
    taps = np.stack([np.outer(smooth, steps * smooth), np.outer(steps * smooth, smooth)])
    slopes = np.zeros((H, W, 2), np.float32)
    loops.derivatives(grey[0], slopes, taps)
    kernel = np.moveaxis(image_gradient(pair.grey[0], 1.0), 0, 2)[2:-2, 2:-2]
    assert np.corrcoef(slopes[2:-2, 2:-2].ravel(), kernel.ravel())[0, 1] > 0.9999
