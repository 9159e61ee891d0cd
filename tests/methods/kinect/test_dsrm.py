"""Depth-guided segments as a whole: contract, status, accuracy on simulated frames."""

from dataclasses import replace

import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.methods.kinect.disparity import Measurement
from depthcli.methods.kinect.layers import Layer, RefinedDisparity
from depthcli.methods.kinect.pipeline.dsrm import Dsrm
from tests.contracts.checks import assert_depth
from tests.contracts.inputs import preset
from tests.methods.kinect._made import off, sample_of


def with_values(disparity, reliable, **changes) -> Measurement:
    """A measurement of these values, black everywhere."""
    given = {"disparity": disparity, "reliable": reliable, "lab": np.zeros((*disparity.shape, 3), np.uint8), **changes}
    unlimited = np.full(disparity.shape, np.inf, np.float32)
    return replace(Measurement.of(sample_of().frame(), 5.0, 0, False), limit=unlimited, **given)


def test_depth_guidance_separates_near_and_far_of_one_color():
    kinect = sample_of("camouflage", 0)
    rule = {"complexity": 8192, "coarser": [2048, 512], "depth_guidance": 0, "smoothing": 0}
    blind = Dsrm.model_validate({"segmentation": {"method": "statistical_region_merging", **rule}})
    guided, other = (off(method(kinect.frame()), kinect)[kinect.measured].mean() for method in (Dsrm(), blind))
    assert guided < 0.7 * other


def test_segments_with_a_model_of_their_own():
    """By 3 reliable pixels that are half of them; by core pixels that are half of the measured ones."""
    measurement = Measurement.of(sample_of().frame(), 5.0, 0.8, True)
    doubtful = (measurement.probability > 0.6) & (measurement.probability < 0.8)
    np.testing.assert_array_equal(measurement.core, doubtful & ~np.isnan(measurement.disparity))
    sizes, n_reliable, n_core = (8, 4, 4, 10, 13), (3, 2, 4, 0, 0), (0, 0, 0, 6, 5)
    labels = np.repeat(np.arange(5, dtype=np.int32), sizes)[None]
    place = np.concatenate([np.arange(size) for size in sizes])[None]
    reliable, core = (place < np.array(counts)[labels] for counts in (n_reliable, n_core))
    values = np.full(labels.shape, 20, np.float32)
    given = with_values(values, np.where(reliable, values, np.float32(np.nan)), core=core)
    layer = Dsrm(min_known=3, min_share=0.5, join=False)._fit(given, labels)
    assert [bool(layer.own[labels == k].all()) for k in range(5)] == [False, False, True, True, False]


@pytest.mark.parametrize("smooth", [False, True])
def test_measurements_are_compared_with_the_median_of_the_layers_that_have_a_surface(smooth):
    rng, shape, tolerance, noise = np.random.default_rng(4), (9, 14), 2.0, 0.5
    values, scales = rng.uniform(18, 22, 12), rng.uniform(0.1, 1, 12)
    bounds = np.repeat(values[:, None], 2, axis=1).astype(np.float32)
    surfaces = Surfaces(np.zeros((12, 6)), np.zeros((12, 2)), bounds, scales.astype(np.float32), 14.0)
    labels = rng.integers(-1, 12, (4, *shape)).astype(np.int32)
    labels[:, 0, :5] = -1  # no surface at all
    measured = rng.uniform(16, 24, shape).astype(np.float32)
    reliable = np.where(rng.random(shape) < 0.5, measured, np.float32(np.nan))
    layers = [Layer(layer, surfaces, layer >= 0) for layer in labels]
    found = RefinedDisparity.of(layers, with_values(measured, reliable, noise=noise), 0, tolerance, smooth)
    for y, x in np.ndindex(*shape):
        chosen = labels[:, y, x][labels[:, y, x] >= 0]
        middle, scale = measured[y, x], noise
        if chosen.size:
            middle, scale = np.median(bounds[chosen, 0]), max(np.median(surfaces.scale[chosen]), noise)
        agrees = abs(measured[y, x] - middle) <= tolerance * scale
        status = DepthStatus.CORRECTED if np.isnan(reliable[y, x]) and not agrees else DepthStatus.KEPT
        if agrees and smooth and chosen.size:
            status = DepthStatus.SMOOTHED
        expected = measured[y, x] if status == DepthStatus.KEPT else middle
        assert (found.status[y, x], found.disparity[y, x]) == (status, pytest.approx(expected, rel=1e-6))
        assert found.scale[y, x] == pytest.approx(scale, rel=1e-6)


def test_pixels_without_a_surface_are_filled_from_pixels_of_similar_color():
    """In turn, and with no segment that joins another."""
    frame = sample_of().frame()
    depth = Dsrm(combination="in_turn", join=False, min_share=0.6)(frame).depth
    status, gap = depth.status, np.isnan(frame.depth)
    fallback = status == DepthStatus.FALLBACK
    assert fallback.any() and gap[fallback].mean() > 0.5 and np.isfinite(depth.values[fallback]).all()
    assert not (status[gap] & DepthStatus.CORRECTED).any()


def test_corrections_in_turn_lie_beside_the_outlines_of_segments():
    labels = np.tile(np.arange(20, dtype=np.int32) // 10, (12, 1))
    values = np.full(labels.shape, 20, np.float32)
    measurement = with_values(values, values.copy())
    measurement.reliable[5, [2, 9]] = 25
    method = Dsrm(combination="in_turn", correction_band=3, detail_reach=0)
    found = method._in_turn(RgbdFrame(measurement.lab, RgbdFrame.fb / values), measurement, [labels])
    assert found.status[5, [2, 9]].tolist() == [DepthStatus.KEPT, DepthStatus.CORRECTED]


@pytest.mark.parametrize("name", ["dsrm", "thesis/ch4"])
def test_status_says_what_was_done(name):
    frame = sample_of().frame()
    result = preset("refine-kinect", name).pipeline(frame)
    depth, status, known = result.depth.values, result.depth.status, ~np.isnan(frame.depth)
    assert_depth(result, frame)
    kept = status == DepthStatus.KEPT
    np.testing.assert_array_equal(depth[kept], frame.depth[kept])
    assert (status[known] & ~(DepthStatus.CORRECTED | DepthStatus.SMOOTHED) == 0).all()
    assert (status & DepthStatus.CORRECTED).any() and np.isfinite(depth).all() and (depth > 0).all()
    assert (depth != frame.depth)[known & ~kept].mean() > 0.99
    assert {"segmentation", "refinement"} <= set(result.seconds)


def test_the_preset_is_the_default_and_details_are_the_segments_of_every_layer():
    assert preset("refine-kinect", "dsrm").pipeline == Dsrm()
    pictures = Dsrm(details=True)(sample_of().frame()).pictures
    assert sorted(pictures) == ["segments_0", "segments_1", "segments_2"]
    assert all(picture.shape == (180, 240, 3) and picture.dtype == np.uint8 for picture in pictures.values())
    colors = [len(np.unique(picture.reshape(-1, 3), axis=0)) for picture in pictures.values()]
    assert colors[0] > colors[2] > 1
