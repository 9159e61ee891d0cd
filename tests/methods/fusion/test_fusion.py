from dataclasses import replace

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import rankdata

from depthcli.core.context import Clock
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.methods.confidence import confidence_maps
from depthcli.methods.fusion.blend import add_weighted, blend, measure_weights, normalize_confidences, normalize_costs
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.fusion.votes import Ballot, ColorSupport, WindowSupport
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing.inputs import assert_pure, texture
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
        np.testing.assert_allclose(got, naive.consensus_weights(ballot.shares(disparities), 2.0), rtol=1e-4)
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
