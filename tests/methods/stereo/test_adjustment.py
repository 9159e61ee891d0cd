"""Adjusting the right image: kernels against naive references, what is recovered, and what stays as it is."""

import re
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import run_bands
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo import adjustment
from depthcli.methods.stereo.adjustment import adjusted, right_view
from depthcli.methods.stereo.adjustment.right_view import BLOCK, CELL, resample
from depthcli.methods.stereo.matching import Limits, match
from depthcli.methods.stereo.tiling.plan import PROCESS_BYTES
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import texture
from tests.contracts.inputs import COMBINED, part, preset, views, wrong
from tests.golden import saying
from tests.naive import adjustment as naive

BOTH = ("rows", "light")
TILTED = np.array([0.8, -0.5, 0.4, 0.3, 0.6, -0.5])


def shifted(image, row_shift):
    """Return ``image`` with its rows shifted."""
    out = np.empty_like(image)
    resample(image, row_shift, np.ones((1, 1, 3), np.float32), 8, np.float32(255), out)
    return out


def lit(image, seed=0):
    """Return ``image`` under light that changes from corner to corner, at another exposure."""
    y, x = (np.linspace(0, 1, side) for side in image.shape[:2])
    field = 0.6 + 0.3 * x + 0.2 * y[:, None] * (seed + 1)
    return np.clip(image * field[:, :, None] * (0.95, 1.0, 1.05), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def scene():
    return make_scene("planes", seed=3, height=260, width=360, max_disparity=40)


def error(pipeline, scene, right):
    return wrong(pipeline(StereoPair(scene.left, right), scene.max_disparity), scene)


def local(**fields):
    return part("methods.stereo.pipeline", "local", **fields)


def without(pipeline):
    return pipeline.model_copy(update={"adjust": ()})


@pytest.fixture(scope="module")
def accurate():
    return preset("stereo", "accurate").pipeline


def test_a_pair_whose_rows_were_far_off_is_matched_again(scene, monkeypatch):
    matched = Mock(wraps=adjustment._matched)
    monkeypatch.setattr(adjustment, "_matched", matched)
    adjusted(views(scene), 40, ("rows",))
    assert matched.call_count == 1
    adjusted(StereoPair(scene.left, shifted(scene.right, 2 * TILTED)), 40, ("rows",))
    assert matched.call_count > 2


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 9, 3), (11, 1, 3), (17, 23, 1), (20, 31, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_resampling_agrees_with_the_naive_reference(shape, dtype):
    image, top = texture(shape, dtype=dtype), np.iinfo(dtype).max
    gains = np.random.default_rng(1).uniform(0.5, 2, (3, 4, 3)).astype(np.float32)
    out = np.empty_like(image)
    resample(image, TILTED, gains, 8, np.float32(top), out)
    expected = np.clip(naive.resampled(image, TILTED, gains, 8, top), 0, top)
    np.testing.assert_allclose(out.astype(float), expected, atol=0.5 + 1e-3 * (top / 255) + 1e-2)


@pytest.mark.parametrize("shape", [(8, 8), (9, 30), (21, 17)])
def test_sums_agree_with_the_naive_references(shape):
    rng = np.random.default_rng(2)
    disparity = rng.uniform(-0.4, 12, shape).astype(np.float32)
    disparity[rng.random(shape) < 0.2] = np.nan
    disparity = np.maximum(disparity, 0)
    left, right = texture((*shape, 3), 1), texture((*shape, 3), 2)
    cells, blocks = (tuple(-(-side // size) for side in shape) for size in (CELL, BLOCK))
    gains = rng.uniform(0.5, 2, (*cells, 3)).astype(np.float32)
    details = [right_view.Details.of(image // 8) for image in (left, right)]

    def check(kernel, sums, given, expected, rtol=1e-4, atol=1e-3):
        run_bands(kernel, sums.shape[1], disparity, *given, sums)
        np.testing.assert_allclose(sums, expected, rtol=rtol, atol=atol)

    light = naive.light_sums(disparity, left, right, gains, 1.4, CELL, 8)
    check(right_view.sum_light, np.zeros((3, *cells, 3), np.float32), (left, right, gains, np.float32(1.4)), light)
    differences = naive.difference_sums(disparity, left, right, CELL)
    check(right_view.sum_differences, np.zeros((2, *cells), np.float32), (left, right), differences)
    expected = naive.block_sums(disparity, *details, TILTED, BLOCK, 4, 20)
    check(right_view.sum_blocks, np.zeros((8, *blocks)), (*details, TILTED), expected, 1e-3, 0.1)


def test_shifted_rows_are_aligned_and_a_correct_pair_hardly_changes(scene, accurate):
    """Offsets of up to three rows."""
    askew = shifted(scene.right, TILTED)
    straight = error(accurate, scene, scene.right)
    assert abs(straight - error(without(accurate), scene, scene.right)) < 0.01
    assert error(without(accurate), scene, askew) > straight + 0.1
    assert error(accurate, scene, askew) < straight + 0.02
    assert np.abs(adjusted(views(scene), 40, BOTH).right.astype(int) - scene.right).mean() < 2
    aligned = adjusted(StereoPair(scene.left, askew), scene.max_disparity, BOTH).right.astype(int)
    inside = (slice(8, -8), slice(8, -60))  # what lies in both views
    before, after = (np.abs(one.astype(int) - scene.right)[inside].mean() for one in (askew, aligned))
    assert after < before / 2.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_uneven_light_is_corrected(seed, accurate):
    scene = make_scene("foreground", seed=5, height=260, width=360, max_disparity=40, wall_contrast=0.2)
    optimization = {"method": "scanline", "p1": 10, "p2": 40}
    pipeline = local(adjust=["light"], cost="absolute_difference", optimization=optimization)
    other = lit(scene.right, seed)
    assert error(pipeline, scene, other) < error(without(pipeline), scene, other) / 4
    assert error(accurate, scene, other) < error(accurate, scene, scene.right) + 0.01
    corrected = adjusted(StereoPair(scene.left, other), scene.max_disparity, ("light",)).right
    ratio = np.median(corrected / np.maximum(scene.right, 1.0), axis=(0, 1))
    np.testing.assert_allclose(ratio, 1, atol=0.06)


def test_light_trust_is_low_where_no_smooth_gain_corrects_the_light(scene):
    """The left half of the right image is lit in a checkered pattern."""
    y, x = np.indices(scene.nonocc.shape)
    spots = np.where(x < 180, 1 - 0.4 * ((x // 6 + y // 6) % 2), 1)
    spotted = (scene.right * spots[:, :, None]).astype(np.uint8)
    alike, other = (adjusted(StereoPair(scene.left, one), 40, ("light",)) for one in (scene.right, spotted))
    assert alike.light_trust.shape == other.light_trust.shape == scene.left.shape[:2]
    assert np.median(alike.light_trust) > 150
    assert np.median(other.light_trust[:, 60:180]) < 0.5 * np.median(other.light_trust[:, 240:])
    assert adjusted(StereoPair(scene.left, spotted), 40, ("rows",)).light_trust is None
    pipeline = local(cost=COMBINED, optimization={"method": "scanline", "p1": 1.5, "p2": 5})
    results = [pipeline(replace(other, light_trust=trust), 40) for trust in (None, other.light_trust)]
    errors = [np.abs(result.disparity.values - scene.disparity_left)[:, 60:180] > 1 for result in results]
    assert errors[1].mean() < 0.9 * errors[0].mean()


def test_grey_and_deep_images_are_adjusted_alike(scene):
    left, right = scene.left[:, :, 1].copy(), lit(shifted(scene.right, TILTED))[:, :, 1].copy()
    shallow = adjusted(StereoPair(left, right), 40, BOTH).right
    assert shallow.ndim == 2
    deep = adjusted(StereoPair(left.astype(np.uint16) * 257, right.astype(np.uint16) * 257), 40, BOTH).right
    assert deep.dtype == np.uint16 and np.abs(deep / 257.0 - shallow).max() <= 1
    twelve = adjusted(StereoPair(left.astype(np.uint16) * 16, right.astype(np.uint16) * 16, 12), 40, BOTH)
    assert twelve.right.max() <= 4095 and np.abs(twelve.right / 16.0 - shallow).mean() < 1


def test_the_memory_error_names_a_sufficient_amount(scene):
    pipeline, pair = local(adjust=BOTH, cost="census"), StereoPair(scene.left, lit(scene.right))
    with saying(InputError) as raised:
        match(pipeline, pair, 40, Limits(5 << 20, tiles="always"))
    needed, given = (int(word) for word in re.findall(r"(-?\d+) MiB", str(raised.value)))
    assert given == 5
    match(pipeline, pair, 40, Limits((needed + 1) << 20, tiles="always"))


def test_pairs_with_too_few_matches_are_returned_unchanged():
    for *shape, top in ((1, 1, 8), (1, 2000, 8), (2000, 1, 8), (15, 15, 8), (40, 60, 8), (260, 360, 1)):
        pair = StereoPair(texture((*shape, 3), 1), texture((*shape, 3), 2))
        assert adjusted(pair, top, BOTH) is pair, shape


def test_large_pairs_and_ranges_are_reduced_by_powers_of_two(monkeypatch):
    pair = StereoPair(*np.zeros((2, 41, 60, 3), np.uint8))
    for name, limit, factor in (("_MAX_PIXELS", 153, 8), ("_MAX_PIXELS", 154, 4), ("_MAX_COSTS", 400, 4)):
        with monkeypatch.context() as patched:
            patched.setattr(adjustment, name, limit)
            reduced, found = adjustment._reduced(pair, 10)
        assert (found, reduced.shape) == (factor, (-(-41 // factor), -(-60 // factor)))


def test_tiles_are_adjusted_as_the_whole(scene):
    """A pipeline without the whole image's sums gives the same map in tiles."""
    fields = {"aggregation": "constant_window", "refinement": ["left_right_check", "background_fill"]}
    pipeline = local(adjust=BOTH, cost=COMBINED, **fields)
    pair = StereoPair(scene.left, lit(shifted(scene.right, TILTED)))
    tiled = match(pipeline, pair, 40, Limits(PROCESS_BYTES + (24 << 20), tiles="always"))
    assert tiled.figures["tiles"] > 1
    np.testing.assert_array_equal(tiled.disparity.values, pipeline(pair, 40).disparity.values)


def test_fusion_adjusts_too(scene):
    fusion = Fusion.model_validate({"measures": ["absolute_difference", "census"], "adjust": ["rows"]})
    askew = shifted(scene.right, TILTED)
    assert error(fusion, scene, askew) < error(without(fusion), scene, askew) - 0.1
    assert "adjustment" in fusion(StereoPair(scene.left, askew), 40).seconds
