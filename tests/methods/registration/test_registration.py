"""The search against a naive reference; the whole method on volumes whose error is known; how measures are combined."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from depthcli.algorithms.resampling import trilinear
from depthcli.core.context import Clock
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.evaluation.statistics import correlation, ranks
from depthcli.methods.registration._search_kernels import MAX_SMALL_VALUE
from depthcli.methods.registration.pipeline.search import RegistrationSearch, monotone
from depthcli.methods.registration.search import displacements, search
from depthcli.problems.registration import RegisterConfidenceConfig
from depthcli.simulate.deformed_volumes import make_deformed_pair, smooth_noise
from depthcli.testing.inputs import threads
from tests.contracts.inputs import part, soft_volume
from tests.naive import registration as naive
from tests.scenes import DATA


def channels(seed, shape, count=2, top=MAX_SMALL_VALUE):
    return np.random.default_rng(seed).integers(0, top + 1, (count, *shape), dtype=np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(("span", "power"), [("cube", 10), ("planes", 5), ("axes", 2), ("cube", 1)])
@pytest.mark.parametrize(
    ("shape", "count", "half", "top"), [((4, 5, 6), 2, 1, 85), ((1, 6, 5), 4, 2, 255), ((3, 3, 3), 1, 0, 255)]
)
def test_measures_agree_with_the_naive_reference(span, power, shape, count, half, top):
    fixed, warped = channels(0, shape, count, top), channels(1, shape, count, top)
    fixed[0, 0, 0, 0] = top
    found = search(fixed, warped, 1.5, 2, half, power, span, costly=True)
    offsets = naive.displacements(shape, 2, span)
    assert [tuple(d) for d in displacements(shape, 2, span)] == offsets
    costs = naive.curves(fixed, warped, 2, half, span)
    expected = naive.measures(costs, offsets, 1.5, power)
    maps = {**found.maps, "variance": found.variance, "border": found.border}
    for name, values in expected.items():
        units = top if name in ("cur0", "cost0", "msm") else 1
        slack = 2e-3 * max(units / 20, 1)
        np.testing.assert_allclose(maps[name] * units, values, rtol=2e-3, atol=slack, err_msg=name)


@pytest.mark.parametrize("stride", [1, 2, 3, 5])
@pytest.mark.parametrize("shape", [(9, 13, 17), (1, 8, 7)])
def test_same_bytes_at_any_stride_tile_and_thread_count(stride, shape):
    views = channels(2, shape, 6), channels(3, shape, 6)
    every = search(*views, 1.0, 2, 2, costly=True)
    for count, tile in itertools.product((1, 2), ({}, {"tile": (4, 5, 7)}, {"tile": (1, 2, 1)})):
        with threads(count):
            found = search(*views, 1.0, 2, 2, costly=True, stride=stride, **tile)
        maps, expected = ({**s.maps, "displacement": s.displacement, "border": s.border} for s in (found, every))
        for name, values in maps.items():
            np.testing.assert_array_equal(values, expected[name][..., ::stride, ::stride, ::stride], err_msg=name)


def texture(shape, seed=0, sigma=1.2):
    return (100 * smooth_noise(np.random.default_rng(seed), shape, sigma)).astype(np.float32)


def config(**fields):
    return RegisterConfidenceConfig(**{"radius": 4, "half_window": 2, "stride": 1, **fields}).pipeline


def shifted(volume, before, after, spacing=(1.0, 1.0, 1.0)):
    """Two windows of a volume along x."""
    return RegisteredPair(volume[:, :, before].copy(), volume[:, :, after].copy(), spacing)


@pytest.fixture(scope="module")
def deformed():
    pair = make_deformed_pair(0, (36, 48, 48), 3.0, noise=0)
    true = np.linalg.norm(pair.residual, axis=-1)
    return RegisteredPair(pair.fixed, pair.warped, (1.0, 1.0, 1.0), pair.mask), true


def test_certainty_of_identical_volumes_without_texture_is_high():
    volume = texture((24, 28, 28)) * (np.arange(28) < 14) + np.float32(1e-3) * texture((24, 28, 28), 1)
    result = config()(RegisteredPair(volume, volume.copy(), (1.5, 1.5, 1.5)))
    assert result.measures["eshift"].max() > 1.5  # flat curves: by themselves they say nothing
    assert result.certainty.min() > 0.95


def test_expected_error_of_a_uniform_shift_is_its_length():
    wide = texture((24, 24, 32))
    means, inner = [], np.s_[6:-6, 6:-6, 6:-6]
    for shift in range(4):
        result = config()(shifted(wide, slice(4, 28), slice(4 - shift, 28 - shift)))
        means.append(float(result.certainty[inner].mean()))
        if shift:
            assert result.expected_error[inner].mean() == pytest.approx(shift, rel=0.25)
    assert all(a > b for a, b in itertools.pairwise(means))


@pytest.mark.slow
def test_expected_error_ranks_voxels_as_the_true_error_does(deformed):
    pair, true = deformed
    result = config(levels=2, stride=2)(pair)
    mask, known = (each[::2, ::2, ::2] for each in (pair.mask, true))
    found, known = result.expected_error[mask], known[mask]
    assert result.step == (2, 2, 2)
    assert correlation(ranks(found), ranks(known)) > 0.75
    assert np.abs(found - known).mean() < 0.6 * known.mean()


@pytest.mark.slow
def test_expected_error_is_a_mean_weighted_by_inverse_variance(deformed):
    """Gaussian mean of eshift, weights 1 / (variance + iso^2 / 2), over features and places; and what grids hide."""
    pair = replace(deformed[0], spacing=(2.0, 2.0, 2.0))
    features = ("mind", "local_ncc")
    result = config(features=features, smoothing=1.5)(pair)
    sums = np.zeros((3, *pair.shape))
    for feature in features:
        curves = config(features=[feature])._searches(pair.fixed, pair.warped, 2.0, Clock())[0][0]
        weight = 1 / (curves.variance.astype(float) + 2)
        doubt = np.minimum(510 * curves.maps["cost0"], 1)
        for k, values in enumerate((weight * doubt * curves.maps["eshift"], weight * doubt, weight)):
            sums[k] += ndimage.gaussian_filter(values, 1.5, mode="nearest", truncate=3.4)
    length, hidden = sums[:2] / sums[2]
    expected = np.sqrt(length**2 + 2 * hidden**2)  # half of the square of a voxel's side
    np.testing.assert_allclose(result.expected_error, expected, rtol=2e-3, atol=2e-3)


@pytest.mark.slow
def test_coarse_level_finds_errors_beyond_the_radius():
    wide = texture((28, 40, 52), sigma=2.5)
    near, far = (config(levels=levels)(shifted(wide, slice(6, 46), slice(40))) for levels in (1, 2))
    assert near.figures["border"] > 0.2 > 0.1 > far.figures["border"]  # of the coarser search
    close, distant = (each.expected_error[10:-10, 10:-10, 10:-10].mean() for each in (near, far))
    assert distant == pytest.approx(6, rel=0.25) and abs(distant - 6) < abs(close - 6)


def test_shift_of_a_single_slice_lies_in_its_plane():
    pair = shifted(texture((9, 40, 48))[4:5], slice(2, 46), slice(44), (1.0, 0.8, 0.8))
    result = config()(pair)  # fixed(x) = wide(x + 2) = warped(x + 2): the match lies 2 voxels of 0.8 mm up x
    assert result.step[0] == 1 and result.expected_error.shape[0] == 1
    assert not result.shift[0].any()
    assert np.median(result.shift[2][:, 8:-8, 8:-8]) == pytest.approx(1.6, abs=0.3)


def test_working_grid_has_cubic_voxels():
    method = config()
    shape, step, start = method.grid((10, 40, 60), (4.0, 1.0, 1.0))
    side = 4 ** (1 / 3)
    assert np.allclose(np.array(step) * [4, 1, 1], side)
    assert shape == tuple(int(np.ceil(n * s / side - 1e-6)) for n, s in zip((10, 40, 60), (4, 1, 1), strict=True))
    assert start == tuple((s - 1) / 2 for s in step)
    assert np.prod(config(max_voxels=1000).grid((100, 100, 100), (1.0, 1.0, 1.0))[0]) <= 1000


def test_fitted_error_rises_with_the_score():
    rng = np.random.default_rng(0)
    score = rng.standard_normal((10, 10, 10)).astype(np.float32)
    error = np.maximum(score + rng.standard_normal(score.shape) + 3, 0).astype(np.float32)
    found = monotone(score, error, rng.random(score.shape) < 0.5)
    order = np.argsort(score.ravel())
    assert (np.diff(found.ravel()[order]) >= 0).all() and (found >= 0).all()
    assert found.mean() == pytest.approx(error.mean(), rel=0.05)


def test_local_values_are_over_their_deviation_or_its_floor():
    volume = np.random.default_rng(2).normal(5, 3, (12, 14, 16)).astype(np.float32)
    volume[:, :, 8:] = 5  # flat
    centered = volume.astype(np.float64) - volume.mean(dtype=np.float64)
    mean, square = (ndimage.gaussian_filter(values, 2.0, mode="nearest", truncate=3.4) for values in
                    (centered, centered**2))  # fmt: skip
    expected = (centered - mean) / np.sqrt(np.maximum(square - mean**2, (0.4 * centered.std()) ** 2))
    found = part("methods.registration.feature", "local_ncc", floor=0.4)._normalized(volume)
    np.testing.assert_allclose(found, expected, rtol=5e-3, atol=5e-3)


@pytest.mark.parametrize("name", ["mind", "mind_ssc", "local_ncc"])
def test_channels_are_the_same_at_any_contrast(name):
    volume = soft_volume(4)
    one, other = part("methods.registration.feature", name)(volume, 3 * volume + np.float32(50))
    assert np.abs(one.astype(int) - other.astype(int)).max() <= 1


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of SimpleITK, as it is imported
def test_expected_error_after_a_registration_stopped_early():
    """Liver MR at exhale and inhale, landmarks of an expert. Spearman of eshift is .78 to .86, and above cost0's."""
    sitk = pytest.importorskip("SimpleITK")
    from _thesis_registration import EARLY, THREADS, pairs, register

    if not (DATA / "medical" / "liver_4dmri" / "dataset19").is_dir():
        pytest.skip("medical/liver_4dmri/dataset19 is not in ../shared/data")
    liver = next(pair for pair in pairs(DATA) if pair.name == "dataset19_cyc_1_6")
    before = sitk.ProcessObject.GetGlobalDefaultNumberOfThreads()
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(THREADS)
    try:
        transform = register(liver, **EARLY)
    finally:
        sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(before)
    low = float(sitk.GetArrayViewFromImage(liver.moving).min())
    warped = sitk.Resample(liver.moving, liver.fixed, transform, sitk.sitkLinear, low)
    fixed, warped = (sitk.GetArrayFromImage(image) for image in (liver.fixed, warped))
    place = liver.fixed.GetOrigin(), tuple(liver.fixed.GetDirection())
    grid = Grid(liver.fixed.GetSize(), liver.fixed.GetSpacing(), *place)
    result = RegistrationSearch()(RegisteredPair(fixed, warped, grid.spacing[::-1]))
    places = (grid.to_index(liver.points) - np.array(result.start)) / np.array(result.step)
    moved = np.array([transform.TransformPoint(point) for point in liver.points.tolist()])
    true = np.linalg.norm(moved - liver.matches, axis=1)
    found, cost = (trilinear(v, places).astype(float) for v in (result.expected_error, result.measures["cost0"]))
    spearman, cost0 = (correlation(ranks(score), ranks(true)) for score in (found, cost))
    assert true.mean() == pytest.approx(2.2, abs=0.2)
    assert spearman >= 0.80 and spearman >= cost0 + 0.04
    assert np.abs(found - true).mean() <= 0.9  # mm
