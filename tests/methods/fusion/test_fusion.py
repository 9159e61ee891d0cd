"""Fusion of costs, and choice among finished maps and their mixing: against slow references, and whole."""

import itertools
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import rankdata

from depthcli.algorithms.pixel_network import TrainedNetwork
from depthcli.algorithms.plane_fitting.window_slopes import slopes
from depthcli.core.context import Clock
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.io.formats.networks import read_network, write_network
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.fusion.blend import add_weighted, blend, measure_weights, normalize_confidences, normalize_costs
from depthcli.methods.fusion.choice import network
from depthcli.methods.fusion.choice.energy import ScoredMap, best_mix, energy, neighbor_weights
from depthcli.methods.fusion.map_costs import VIEW_PLANES, agreement, disagreements, hidden_jumps
from depthcli.methods.fusion.maps import MapFusion, _status
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import Ballot, ColorSupport, WindowSupport
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.volume import CostVolume
from depthcli.problems.fusion import Fuse, FuseConfig
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import assert_pure, blocky_pair, random_volume, texture
from tests.contracts.checks import CHECKS
from tests.contracts.inputs import KINDS, part, random_proposals, views
from tests.golden import refused
from tests.naive import fusion as naive
from tests.naive.stereo import constant_window

MEASURES = ["absolute_difference", "gradient", "rank", "census"]


def fusion(**fields):
    return Fusion.model_validate({"measures": MEASURES, **fields})


def soft_pair(height=40, width=70):
    """A soft texture at disparity 7."""
    wide = cv2.GaussianBlur(texture((height, width + 7, 3)), (0, 0), 1.0)
    return StereoPair(np.ascontiguousarray(wide[:, :width]), np.ascontiguousarray(wide[:, 7:]))


def test_a_measure_chosen_alone_counts_where_no_light_is_trusted(monkeypatch: pytest.MonkeyPatch):
    chosen = np.tile(np.array([1, 0, 0, 0], np.float32)[:, None, None], (1, 40, 70))
    monkeypatch.setattr("depthcli.methods.fusion.pipeline.measure_weights", lambda *_: chosen.copy())
    pair = replace(soft_pair(), light_trust=np.zeros((40, 70), np.uint8))
    np.testing.assert_array_equal(fusion(weights="select").fuse(pair, 12).weights, chosen)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(9, 20, 7), (1, 1, 1), (6, 5, 18), (5, 30, 33)])
@pytest.mark.parametrize(("scale", "outside"), [(None, None), (40.0, 0.25)])
def test_squash_agrees_with_the_reference(dtype, shape, scale, outside):
    costs = (np.random.default_rng(0).random(shape) * 200).astype(dtype)
    got = normalize_costs(CostVolume(costs), scale, outside).costs
    assert got.dtype == np.uint8 and np.abs(got - naive.squash(costs, scale, outside)).max() <= 0.51


@pytest.mark.parametrize("count", [1, 2, 5])
def test_blend_agrees_with_the_reference(count):
    rng = np.random.default_rng(count)
    volumes = [CostVolume(rng.integers(0, 256, (6, 7, 11)).astype(np.uint8), 255.0) for _ in range(count)]
    weights = rng.random((count, 6, 7)).astype(np.float32)
    weights /= weights.sum(axis=0)
    got = blend(volumes, weights).costs
    np.testing.assert_array_equal(got, naive.blend(np.stack([v.costs for v in volumes]), weights))
    total = np.zeros(got.shape, np.float32)
    for volume, weight in zip(volumes, weights, strict=True):
        add_weighted(total, volume, weight)
    assert np.abs(total * 255 - got).max() < 2


@pytest.mark.parametrize("shape", [(12, 17), (1, 9), (9, 1), (8, 16), (20, 40)])
@pytest.mark.parametrize("n_disparities", [1, 15, 16, 17, 35])
@pytest.mark.parametrize("tolerance", [0, 1])
def test_votes_agree_with_the_reference(shape, n_disparities, tolerance):
    rng = np.random.default_rng(n_disparities)
    disparities = rng.integers(0, n_disparities, (3, *shape)).astype(np.int32)
    weights = rng.random((3, *shape)).astype(np.float32)
    image = cv2.medianBlur(rng.integers(0, 256, (*shape, 3)).astype(np.uint8), 3)
    votes, fading = (naive.cast_votes(disparities, weights, n_disparities, tolerance, each) for each in (False, True))
    smooth = cv2.medianBlur(image, 3)
    for support, spread in (
        (WindowSupport(shape, 5), lambda v: constant_window(v, 5)),
        (ColorSupport(image, 6.0, 20.0), lambda v: naive.color_shares(v, smooth, 6.0, 20.0)),
    ):
        ballot = Ballot(disparities, weights, n_disparities, tolerance, support)
        shares = ballot.shares(disparities)
        want = spread(votes)
        expected = np.take_along_axis(want[None], disparities[..., None], 3)[..., 0]
        np.testing.assert_allclose(shares, expected, atol=1e-5)
        base = CostVolume(rng.integers(0, 4081, (*shape, n_disparities)).astype(np.uint16), 4080.0)
        added = ballot.costs(base, 0.5, 4080)
        expected = (base.costs / 4080 + 0.5 * (1 - want)) / 1.5 * 4080
        assert added.scale == pytest.approx(4080 / 1.5)
        assert np.abs(added.costs - expected).max() < 0.6
        assert np.abs(ballot.costs(None, 1.0, 4080).costs - 4080 * (1 - spread(fading))).max() < 0.6


def test_confidences_become_comparable_by_their_ranks_and_lrc_by_its_pixels():
    values = np.random.default_rng(0).integers(0, 9, (2, 5, 6)).astype(np.float32)
    expected = (rankdata(values).reshape(values.shape) - 0.5) / 60
    np.testing.assert_allclose(normalize_confidences(values, "pkr"), expected, rtol=1e-6)
    np.testing.assert_allclose(normalize_confidences(-values, "lrc"), 1 / (1 + values), rtol=1e-6)


def test_voters_count_alike_or_by_a_confidence_of_their_costs():
    pair, plain = soft_pair(), {"vote_aggregation": None, "measures": ["census", "rank"]}
    parts = [measure.cost(pair, 12) for measure in fusion(**plain).measures]
    alike, ranked = (
        fusion(**plain, vote_confidence=name)._ballot(parts, pair, None, Clock()) for name in (None, "pkr")
    )
    assert (alike.vote_weights == 1).all()
    np.testing.assert_array_equal(alike.disparities, ranked.disparities)
    optimize = fusion().vote_optimization
    ratios = np.stack([confidence_maps(optimize(part, pair).costs, ["pkr"])["pkr"] for part in parts])
    expected = (rankdata(ratios).reshape(ratios.shape) - 0.5) / ratios.size
    np.testing.assert_allclose(ranked.vote_weights, expected, rtol=1e-5)


modes = pytest.mark.parametrize("weights", ["consensus", "confidence", "equal", "select", "vote"])


@modes
def test_weights_sum_to_one(weights):
    rng = np.random.default_rng(0)
    disparities = rng.integers(0, 20, (3, 10, 12)).astype(np.int32)
    given = rng.random((3, 10, 12)).astype(np.float32)
    ballot = Ballot(disparities, given, 20, 1, WindowSupport((10, 12), 5))
    got = measure_weights(weights, ballot, 2.0, given.shape)
    np.testing.assert_allclose(got.sum(axis=0), 1, atol=1e-6)
    if weights == "consensus":
        squares = np.maximum(ballot.shares(disparities), 1e-4) ** 2
        np.testing.assert_allclose(got, squares / squares.sum(axis=0), rtol=1e-4)
    if weights == "select":
        np.testing.assert_array_equal(got.argmax(axis=0), given.argmax(axis=0))


@modes
@pytest.mark.parametrize("support", ["color", "window"])
@pytest.mark.parametrize("blend_when", ["before", "after"])
def test_the_true_shift_is_found_in_every_mode(weights, support, blend_when):
    pair = soft_pair()
    consensus = {"support": support, "window": 9}
    result = fusion(weights=weights, consensus=consensus, blend=blend_when, confidence=["pkr", "consensus"])(pair, 15)
    assert np.mean(result.disparity.values[:, 14:] == 7) > 0.99
    share = result.confidence["consensus"]
    assert 0 <= share.min() <= share.max() <= 1 and share[10:30, 25:60].mean() > 0.9
    assert list(result.confidence) == ["pkr", "consensus"]
    assert sum(result.figures[f"weight_{k}"] for k in range(4)) == pytest.approx(1, abs=1e-5)


def test_equal_weights_without_votes_are_the_plain_mean_and_votes_are_counted_for_a_confidence_only():
    pair = soft_pair()
    plain = fusion(weights="equal", consensus={"vote_cost": 0}, aggregation=None)
    fused = plain.fuse(pair, 11, vote=False)
    parts = [normalize_costs(m.cost(pair, 12), None).costs.astype(int) for m in fusion().measures]
    np.testing.assert_array_equal(fused.volume.costs, (64 * sum(parts) + 128) >> 8)
    assert fused.volume.costs.dtype == np.uint8 and fused.ballot is None
    asked = plain.model_copy(update={"confidence": ("consensus",)})(pair, 11)
    np.testing.assert_array_equal(asked.disparity.values, plain(pair, 11).disparity.values)
    assert asked.confidence["consensus"].max() > 0.5


def test_tiny_images_ranges_wider_than_the_image_and_threads():
    make = fusion(confidence=["lrc", "dap", "consensus"])
    for shape in ((1, 1), (3, 5), (40, 6)):
        values = make(StereoPair(texture(shape, 1), texture(shape, 2)), 20).disparity.values
        assert values.shape == shape and (values <= np.arange(shape[1])).all()
    pair = soft_pair(45, 61)

    def run():
        result = make(pair, 20)
        return np.stack([result.disparity.values, result.confidence["consensus"]])

    assert_pure(run, pair.left, pair.right)


def test_a_volume_made_elsewhere_counts_as_a_measure_if_it_fits():
    pair = soft_pair()
    census = Census()(pair, 16).costs
    ours = fusion(measures=["census", "census"])(pair, 11).disparity.values

    def mixed(**volumes):
        given = {f"{name}.npy": volume for name, volume in volumes.items()}
        return fusion(measures=["census", {"volume": "learned.npy"}]).with_volumes(lambda: given)(pair, 11)

    for volume in (census, census.astype(np.float64)):
        np.testing.assert_array_equal(mixed(learned=volume).disparity.values, ours)
    refused(InputError, mixed)
    for volume in (np.zeros((40, 70, 11)), np.full((40, 70, 12), np.nan)):
        refused(InputError, mixed, learned=volume)


def test_the_segment_pipeline_works_on_fused_costs():
    pair = soft_pair()
    make = fusion(aggregation=None, segments={"window_radius": 2, "planes": {"min_size": 20}})
    result = make(pair, 15)
    assert np.nanmean(np.abs(result.disparity.values[:, 14:] - 7) < 0.6) > 0.9
    assert list(result.seconds)[:4] == ["cost", "voters", "weights", "aggregation"]
    assert "expansion" in result.seconds and "weight_0" in result.figures and "planes" in result.figures
    dumped = make.model_dump(mode="json", by_alias=True)
    assert dumped["segments"]["planes"]["min_size"] == 20 and dumped["segments"]["energy"]["data_term"] == "dedc"
    assert Fusion.model_validate(dumped) == make


@pytest.mark.parametrize(("place", "fields"), [
    ("segments.planes.mots", {"segments": {"planes": {"mots": 3}}}),
    ("refinement", {"segments": {}, "refinement": ["subpixel"]}), ("maps", {"segments": {}, "maps": {}}),
    ("confidence", {"confidence": ["agreement"]}), ("confidence", {"maps": {}, "confidence": ["probability"]}),
    ("optimization", {"segments": {}, "optimization": "scanline"}),
])  # fmt: skip
def test_fields_that_do_not_fit_together_are_refused(place, fields):
    with pytest.raises(ValidationError) as caught:
        fusion(**fields)
    assert [".".join(error["loc"]) for error in caught.value.errors()] == [place]


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
    choice = 120 * 160 * (5 * (9 + 12) + 1000)  # bytes for five proposals
    assert fusion.maps.peak_bytes((120, 160), 24, 1 << 40) == (1 << 40) + choice
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


def random_network(kinds, units=(8, 4)):
    rng, names = np.random.default_rng(0), network.input_names(kinds)

    def some(*shape):
        return rng.normal(size=shape).astype(np.float32)

    (one, two), size = units, len(names)
    layers = (some(size, one) / 3, some(len(kinds), one)), (some(one, two) / 3, some(two)), (some(two, 1), some(1))
    return TrainedNetwork(kinds, names, some(size), np.abs(some(size)), layers)


@pytest.mark.parametrize("check", CHECKS["methods.fusion.choice"], ids=lambda check: check.__name__)
def test_contract(check):
    check(network.NetworkChoice().with_network(random_network(KINDS), KINDS))


def test_inputs_agree_with_the_reference():
    given = random_proposals()
    count, height, width = given.values.shape
    inputs = network.NetworkInputs.of(given)
    own = dict(zip(network.PROPOSAL_PLANES, inputs.own.reshape(-1, count, height, width), strict=True))
    (left, right), volume = given.pair.color8, given.volume
    expected = naive.pointwise(given.values, volume.costs, volume.scale, given.right, left.astype(float), right)
    for name, plane in expected.items():
        np.testing.assert_allclose(own[name], plane, atol=2e-3, err_msg=name)
    for k, values in enumerate(given.values):
        np.testing.assert_allclose(own["roughness"][k], naive.roughness(values, slopes(values, left)), atol=1e-4)
    plane = {name: np.empty(given.values.shape, np.float32) for name in VIEW_PLANES}
    given.compare(given.values, plane, (0.7, 1.5))
    jumps = hidden_jumps(given.values, left)
    for name, reach, softness in (("wide", 8.0, 15.0), ("region", 40.0, 8.0)):
        support = ColorSupport(left, reach, softness)
        np.testing.assert_array_equal(own[f"cost_{name}"], support.mean(plane["cost"]))
        np.testing.assert_array_equal(own[f"jump_{name}"], support.mean(jumps))
    np.testing.assert_array_equal(own["filled"], given.filled)
    shared = dict(zip(network.PIXEL_PLANES, inputs.shared.reshape(-1, height, width), strict=True))
    np.testing.assert_allclose(shared["min_cost"], volume.costs.min(axis=2) / volume.scale, rtol=1e-5)
    np.testing.assert_allclose(shared["filled_share"], (given.filled > 0).mean(axis=0))
    assert (shared["light_trust"] == 1).all()
    trust = texture((height, width), 5)
    dim = network.NetworkInputs.of(replace(given, pair=replace(given.pair, light_trust=trust)))
    np.testing.assert_allclose(dim.shared[network.PIXEL_PLANES.index("light_trust")], trust.ravel() / 255, rtol=1e-6)


@pytest.mark.parametrize(("height", "width", "count"), [(9, 21, 4), (1, 1, 2), (3, 5, 16), (40, 33, 3)])
def test_log_odds_agree_with_the_reference(height, width, count):
    given = random_proposals(height, width, 12, count)
    weights, inputs = random_network(given.kinds), network.NetworkInputs.of(given)
    rows = inputs.rows(np.arange(height * width, dtype=np.int64))
    expected = naive.log_odds(rows.astype(float), weights.mean, weights.scale, weights.layers)
    np.testing.assert_allclose(network.log_odds_of(weights, inputs), expected.T, atol=1e-3)


def test_the_likeliest_proposal_is_taken_with_its_probability():
    given = random_proposals()
    inputs = network.NetworkInputs.of(given)
    odds = network.log_odds_of(random_network(given.kinds), inputs).reshape(given.values.shape)
    values, probability = network.likeliest(given.values, odds, given.narrow)
    picked = values[None] == given.values
    assert picked.any(axis=0).all()
    at = picked.argmax(axis=0)[None]
    expected = 1 / (1 + np.exp(-np.take_along_axis(odds, at, axis=0)[0]))
    single = picked.sum(axis=0) == 1
    assert single.mean() > 0.8
    np.testing.assert_allclose(probability[single], expected[single], atol=1e-5)
    assert (odds.argmax(axis=0) == at[0]).mean() > 0.5  # the others were outvoted by pixels around them


def test_proposals_that_agree_count_and_are_averaged():
    maps = np.array([5, 5.6, 9], np.float32).reshape(3, 1, 1)
    odds = np.log(np.array([0.35, 0.25, 0.4], np.float32)).reshape(3, 1, 1)
    # 0.6 pixels of 1.5: the second counts 0.6 of its share, half of it for the choice (0.425), all of it in the mean
    for fields, expected in (({}, (9, 0.4 / 1.4)), ({"agreeing": 1.5}, (5 + 0.15 * 0.6 / 0.5, 0.35 / 1.35))):
        values, probability = network.likeliest(maps, odds, WindowSupport((1, 1), 1), **fields)
        np.testing.assert_allclose([values[0, 0], probability[0, 0]], expected, rtol=1e-5)


def test_files_of_networks_keep_four_digits_and_others_are_refused(tmp_path):
    trained, file = random_network(KINDS), tmp_path / "net.json"
    write_network(file, trained)
    stored, written = read_network(file), json.loads(file.read_text())
    assert stored.maps == KINDS and stored.inputs == trained.inputs
    for layer, other in zip(trained.layers, stored.layers, strict=True):
        for one, kept in zip(layer, other, strict=True):
            np.testing.assert_allclose(kept, one, rtol=1e-3)
    for change in ({"format": "other"}, {"layers": [1]}, {"mean": [float("nan")]}):
        file.write_text(json.dumps({**written, **change}))
        refused(InputError, read_network, file)


def test_a_network_takes_only_the_inputs_and_maps_it_was_trained_for():
    trained = random_network(KINDS)
    for other in (replace(trained, inputs=("cost", *trained.inputs[1:])), random_network(KINDS, units=(6, 4))):
        refused(InputError, network.NetworkChoice().with_network, other, KINDS)
    refused(ValueError, network.NetworkChoice(), random_proposals())
    refused(NotImplementedError, part("methods.fusion.choice", "energy").with_network, trained, KINDS)
    maps = {"choice": {"method": "network"}, "optimizations": [{"optimization": "scanline"}]}
    refused(ConfigError, Fuse.ready, FuseConfig.model_validate({"measures": ["census"], "maps": maps}))
