"""Adjusting a pair: rows and light of the right image, noise of both; what is recovered, and what stays as it is."""

import itertools
import re
from dataclasses import replace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.kernels.jit import n_threads, run_bands
from depthcli.methods.fusion.pipeline import Fusion
from depthcli.methods.stereo import adjustment
from depthcli.methods.stereo.adjustment import adjusted, noise, right_view
from depthcli.methods.stereo.adjustment.right_view import BLOCK, CELL, resample
from depthcli.methods.stereo.matching import Limits, match
from depthcli.methods.stereo.tiling.plan import PROCESS_BYTES
from depthcli.simulate.stereo_scenes import make_scene
from depthcli.testing.inputs import assert_pure, changed, texture
from tests.contracts.inputs import COMBINED, part, preset, views, wrong
from tests.golden import saying
from tests.naive import adjustment as naive
from tests.scenes import real_pair, real_scenes

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


def test_shifted_rows_are_aligned_and_a_correct_pair_hardly_changes(scene):
    """Offsets of up to three rows; also before fusion."""
    accurate = preset("stereo", "accurate").pipeline
    askew = shifted(scene.right, TILTED)
    straight = error(accurate, scene, scene.right)
    assert abs(straight - error(without(accurate), scene, scene.right)) < 0.01
    assert error(without(accurate), scene, askew) > straight + 0.1
    assert error(accurate, scene, askew) < straight + 0.02
    assert np.abs(adjusted(views(scene), 40, BOTH).right.astype(int) - scene.right).mean() < 2
    fusion = Fusion.model_validate({"measures": ["absolute_difference", "census"], "adjust": ["rows"]})
    assert error(fusion, scene, askew) < error(without(fusion), scene, askew) - 0.1
    aligned = adjusted(StereoPair(scene.left, askew), scene.max_disparity, BOTH).right.astype(int)
    inside = (slice(8, -8), slice(8, -60))  # what lies in both views
    before, after = (np.abs(one.astype(int) - scene.right)[inside].mean() for one in (askew, aligned))
    assert after < before / 2.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_uneven_light_is_corrected(seed):
    accurate = preset("stereo", "accurate").pipeline
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


def smooth():
    """Soft blobs from 60 to 190, (200, 300)."""
    blobs = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(200, 300)), (0, 0), 12)
    return 125 + 65 * blobs / np.abs(blobs).max()


@pytest.mark.parametrize("sigma", [0.6, 1.0, 3.0, 8.0])
def test_the_noise_is_measured(sigma):
    noisy = smooth() + np.random.default_rng(1).normal(0, sigma, (200, 300))
    found = [noise.noise_level(np.rint(noisy * scale).astype(np.float32)) for scale in (1, 257)]
    np.testing.assert_allclose([each[0] for each in found], (sigma, 257 * sigma), rtol=0.25)
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=0.15)


def dark(seed, kind="planes"):
    return make_scene(kind, seed, 300, 220, 40, wall_contrast=0.6, brightness=0.08, noise=1.5)


def grainy(pair, size, sigma=0.8, brightness=0.04):
    """A pair at 4 % of its brightness, in noise that neighbors share."""
    rng = np.random.default_rng(1)

    def view(image):
        grain = cv2.GaussianBlur(rng.normal(size=image.shape), (0, 0), size)
        return np.rint(brightness * image + sigma * grain / grain.std()).clip(0, 255).astype(np.uint8)

    return changed(pair, view)


@pytest.mark.parametrize(("size", "radii"), [(0.7, (3, 5)), (1.0, (5, 8)), (1.6, (9, 10))])
def test_noise_that_neighbors_share_is_seen_in_the_dark(size, radii):
    clean = smooth() / 25
    grain = cv2.GaussianBlur(np.random.default_rng(1).normal(size=clean.shape), (0, 0), size)
    level = np.rint(clean + 0.8 * grain / grain.std()).astype(np.float32)
    deviation, _, radius = noise.noise_level(level, differing=1.0)
    assert deviation == pytest.approx(0.8, rel=0.35) and radii[0] <= radius <= radii[1]
    assert noise.noise_level(level)[2] == 3
    white = np.rint(clean + np.random.default_rng(1).normal(0, 0.8, clean.shape)).astype(np.float32)
    assert noise.noise_level(white, differing=1.0) == noise.noise_level(white)


@pytest.mark.parametrize("brightness", [0.05, 0.12])
def test_texture_in_the_dark_is_no_noise_since_both_views_have_it(brightness):
    pair = views(make_scene("planes", 3, 240, 180, 30, brightness=brightness))
    noisy = grainy(pair, 1, 1.5, 0.5)
    assert noise._differing(*map(noise._level, (pair.left, pair.right))) == 0
    assert noise._differing(*map(noise._level, (noisy.left, noisy.right))) > 0.3


@pytest.mark.parametrize(("name", "ratio"), [("fast", 0.8), ("accurate", 0.75)])
def test_dark_scenes_in_coarse_noise_have_fewer_errors_than_averaged_and_than_sgbm(name, ratio, monkeypatch):
    pipeline, peer = (preset("stereo", one).pipeline for one in (name, "opencv-sgbm"))
    errors = np.zeros(3)
    for seed, kind, size in ((10, "planes", 2.0), (11, "foreground", 2.5), (12, "curved", 3.5)):
        scene = make_scene(kind, seed, 300, 220, 40)
        for k, (method, limit) in enumerate(((pipeline, noise._DIFFERING), (pipeline, 2), (peer, 2))):
            with monkeypatch.context() as patch:
                patch.setattr(noise, "_DIFFERING", limit)
                errors[k] += wrong(method(grainy(views(scene), size), scene.max_disparity), scene)
    assert errors[0] < ratio * errors[1:].min()


def test_clean_pairs_and_those_in_daylight_stay_as_they_are():
    for pair in (*(views(make_scene(kind, 3, 240, 180, 30)) for kind in ("planes", "foreground")), real_pair().pair):
        assert noise.denoised(pair) is pair and adjusted(pair, 30, ("noise",)) is pair
    for folder in ("middlebury_v2", "middlebury_2001", "middlebury_2005"):
        for pair, _, _ in real_scenes(folder).values():
            assert noise.denoised(pair) is pair


def test_a_dark_pair_is_averaged_and_brightened():
    pair = views(dark(0))
    found = noise.denoised(pair)
    assert found.left.dtype == np.uint16 and found.bits is None and found.light_trust is None
    clean = make_scene("planes", 0, 300, 220, 40, wall_contrast=0.6)
    assert np.percentile(found.left.mean(2), 90) / 65535 == pytest.approx(0.55, abs=0.03)

    def unlikeness(image):  # to the scene in daylight, up to a curve of the levels
        given, true = (np.argsort(np.argsort(one.mean(2).ravel(), kind="stable")) for one in (image, clean.left))
        return 1 - np.corrcoef(given, true)[0, 1]

    assert unlikeness(found.left) < unlikeness(pair.left) / 2


@pytest.mark.parametrize("pair", [views(dark(2)), grainy(views(make_scene("planes", 2)), 2.5)], ids=["white", "coarse"])
def test_strips_and_threads_do_not_show(pair, monkeypatch):
    found = []

    def run():
        cv2.setNumThreads(n_threads())
        found.append(noise.denoised(pair))
        return np.stack([found[-1].left, found[-1].right])

    assert_pure(run, pair.left, pair.right)
    monkeypatch.setattr(noise, "_STRIP", 50)
    difference = np.abs(noise.denoised(pair).left.astype(int) - found[0].left.astype(int))
    assert difference.max() <= 1  # sums that run down a column begin elsewhere


def test_tiny_and_flat_images():
    for shape, value in itertools.product([(1, 1, 3), (2, 40), (9, 3), (40, 5, 3)], (0, 7, 255)):
        image = np.full(shape, value, np.uint8)
        found = noise.denoised(StereoPair(image, image)).left
        assert np.ptp(found) == 0 and found.shape == shape


@pytest.mark.parametrize(("name", "ratio"), [("fast", 0.85), ("accurate", 0.7)])
def test_scenes_in_the_dark_have_fewer_errors(name, ratio):
    """Of the errors without the step."""
    pipeline = preset("stereo", name).pipeline
    without = pipeline.model_copy(update={"adjust": tuple(a for a in pipeline.adjust if a != "noise")})
    errors = np.zeros(2)
    for seed, kind in enumerate(("planes", "foreground", "curved")):
        scene = dark(10 + seed, kind)
        errors += [wrong(one(views(scene), scene.max_disparity), scene) for one in (pipeline, without)]
    assert errors[0] < ratio * errors[1]
