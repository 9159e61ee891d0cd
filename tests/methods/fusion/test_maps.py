"""Mixing of finished maps: kernels against references, moves against all possible mixes, and whole mixes."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.methods.fusion.choice.energy import ScoredMap, best_mix, energy, neighbor_weights
from depthcli.methods.fusion.map_costs import VIEW_PLANES, agreement, disagreements, hidden_jumps
from depthcli.methods.fusion.maps import MapFusion, _status
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import WindowSupport
from depthcli.methods.stereo.volume import CostVolume
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import assert_pure, blocky_pair, random_volume, texture
from tests.contracts.inputs import random_proposals, views
from tests.naive import maps as naive


@pytest.mark.parametrize(("count", "height", "width", "n_disparities"), [(1, 1, 1, 1), (3, 4, 7, 20), (16, 5, 33, 9)])
def test_costs_of_maps_agree_with_the_reference(count, height, width, n_disparities):
    volume = CostVolume(random_volume(height, width, n_disparities).costs, 100.0)
    given = replace(random_proposals(height, width, n_disparities, count), volume=volume)
    maps = given.values
    plane = {name: np.empty(maps.shape, np.float32) for name in VIEW_PLANES}
    lowest = given.compare(maps, plane, (1.4, 2.5))
    np.testing.assert_allclose(lowest, volume.costs.min(axis=2) / 100, rtol=1e-5)
    for name, most in (("cost", 1.4), ("uncut_cost", 2.5)):
        np.testing.assert_allclose(plane[name], naive.matching_costs(maps, volume.costs, 0.01, most), atol=1e-4)
    found = np.where(plane["hidden"] > 0, 0.4, plane["contradiction"])
    np.testing.assert_allclose(found, naive.contradictions(maps, given.right, 0.4), atol=1e-4)
    weights = np.arange(count).astype(np.float32)
    if count > 1:
        np.testing.assert_allclose(disagreements(maps, weights), naive.disagreements(maps, weights), atol=1e-4)
        assert not disagreements(maps[:1], weights[:1]).any()
    image = given.pair.color8[0]
    np.testing.assert_allclose(hidden_jumps(maps, image), naive.hidden_jumps(maps, image), atol=1e-5)


def test_means_over_a_support_are_those_of_its_sums():
    planes = np.random.default_rng(2).uniform(0, 3, (19, 9, 13)).astype(np.float32)  # more than are summed at a time
    support = WindowSupport((9, 13), 3)
    expected = cv2.blur(planes.transpose(1, 2, 0), (3, 3)).transpose(2, 0, 1)
    np.testing.assert_allclose(support.mean(planes)[:, 1:-1, 1:-1], expected[:, 1:-1, 1:-1], rtol=1e-5)


def random_scored_map(height, width, seed):
    rng = np.random.default_rng(seed)
    values = rng.uniform(0, 4, (height, width)).astype(np.float32)
    gradient = rng.uniform(-0.5, 0.5, (2, height, width)).astype(np.float32)
    return ScoredMap(values, gradient, rng.uniform(0, 1, (height, width)).astype(np.float32))


def test_energy_agrees_with_the_reference():
    scored = random_scored_map(7, 9, 3)
    weights = neighbor_weights(texture((7, 9, 3), 2), 2.0, 10.0, 0.1)
    expected = naive.energy(scored.values, scored.slopes, scored.cost, weights, 1.5)
    assert energy(scored, weights, 1.5) == pytest.approx(expected, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_the_best_mix_has_the_least_energy(seed):
    """Of all 2^9 mixes; with pairs that a cut cannot represent the energy still never rises."""
    a, b = random_scored_map(3, 3, seed), random_scored_map(3, 3, seed + 100)
    weights = neighbor_weights(texture((3, 3, 3), seed), 1.0, 20.0, 0.2)
    assert energy(best_mix(a, b, weights, 2.0, 0.0), weights, 2.0) <= energy(a, weights, 2.0)
    weak = tuple(each * np.float32(0.02) for each in weights)
    chosen = (np.array(bits, bool).reshape(3, 3) for bits in itertools.product((False, True), repeat=9))
    mixes = (ScoredMap(*(np.where(mix, new, old) for old, new in zip(a, b, strict=True))) for mix in chosen)
    best = min(energy(mix, weak, 2.0) for mix in mixes)
    found = best_mix(a, b, weak, 2.0, 0.0)
    assert found is not a and energy(found, weak, 2.0) <= best + 0.02


def test_agreement_is_the_weighted_share():
    maps = np.array([[[5.0]], [[5.3]], [[7.0]], [[6.0]]], np.float32)
    weights = np.array([1, 2, 4, 1], np.float32)
    np.testing.assert_allclose(agreement(np.float32([[5.0]]), maps, weights), (1 + 2 + 0.5) / 8)


def test_the_status_of_a_mix_and_the_lower_one_of_two_maps():
    values, right = np.array([[1, 1, 1, 1, 3, 5]], np.float32), np.array([[1, 3, 0, 2, 0, 0]], np.uint16)
    hidden, wrong = Status.OCCLUDED | Status.FILLED, Status.MISMATCH | Status.FILLED
    assert _status(values, right).tolist() == [[hidden, 0, hidden, 0, 0, wrong]]
    fusion = MapFusion.model_validate({"optimizations": [{"optimization": "scanline"}]})
    maps = [DisparityMap(np.full((8, 9), d, np.float32), np.zeros((8, 9), np.uint8)) for d in (2, 5)]
    volume, grey = CostVolume(np.zeros((8, 9, 8), np.uint8)), np.zeros((8, 9), np.uint8)
    median = fusion._proposals(StereoPair(grey, grey), volume, np.zeros((8, 9), np.uint16), maps).values[0]
    assert (median == 2).all()  # a mean would be a value that nobody proposed


MATCHERS = [
    {"weight": 2, "matcher": {"pipeline": "local", "cost": "census", "optimization": "scanline"}},
    {"matcher": {"pipeline": "local", "cost": "gradient", "aggregation": "cross"}},
]
SMALL = {
    "measures": ["absolute_difference", "census"], "optimization": "scanline", "confidence": ["agreement", "da"],
    "refinement": ["left_right_check", "subpixel", "background_fill"],
    "maps": {
        "matchers": MATCHERS,
        "optimizations": [{"weight": 0.5, "optimization": {"method": "scanline", "p2": 4.0}}],
    },
}  # fmt: skip


@pytest.mark.slow
def test_the_mix_is_better_than_its_parts_and_agreement_sorts_out_errors():
    fusion = Fusion.model_validate(SMALL)
    first = Fusion.model_validate({**SMALL, "maps": None, "confidence": []})
    errors = np.zeros(4)
    for seed in (5, 6):
        scene = make_scene("planes", seed, 160, 120, 24, wall_contrast=0.3)
        results = [one(views(scene), 24) for one in (fusion, first, *(m.matcher for m in fusion.maps.matchers))]
        wrong, *others = (~(np.abs(one.disparity.values - scene.disparity_left) <= 1) for one in results)
        errors += [each.mean() for each in (wrong, *others)]
        assert wrong[results[0].confidence["agreement"] > 0.9].mean() < 0.5 * wrong.mean()
        filled = results[0].disparity.filled
        assert results[0].disparity.valid.all() and wrong[filled].mean() > wrong[~filled].mean()
    assert errors[0] < errors[1:].min()


@pytest.mark.parametrize("color", [False, True])
def test_same_bytes_at_any_thread_count_and_on_small_images(color):
    fusion, pair = Fusion.model_validate(SMALL), blocky_pair(31, 70, color, 4)

    def run():
        result = fusion(pair, 20)
        return np.concatenate([result.disparity.values, result.disparity.status, result.confidence["agreement"]])

    assert_pure(run, pair.left, pair.right)
    for height, width in ((1, 1), (2, 3), (9, 1)):
        assert fusion(blocky_pair(height, width, color), 5).disparity.values.shape == (height, width)
