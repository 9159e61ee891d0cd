"""Pipelines of refine-kinect as wholes: depth-guided segments, filters of libraries, the preset fast, sequences."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.cameras.camera import Intrinsics
from depthcli.core.context import Clock
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import DepthStatus
from depthcli.methods.kinect.camera_motion import displacement, estimated_motion, view_after
from depthcli.methods.kinect.disparity import Measurement, nearest_fill, refined_depth
from depthcli.methods.kinect.layers import Layer, RefinedDisparity
from depthcli.methods.kinect.pipeline.dsrm import Dsrm
from depthcli.methods.kinect.pipeline.sequence import carried_labels, still_pixels
from depthcli.simulate.depth_sensor import KinectSample
from depthcli.simulate.kinect_scenes import make_kinect_sequence
from tests.contracts.checks import assert_depth
from tests.contracts.inputs import preset
from tests.golden import refused
from tests.methods.kinect._made import blocks, labels_of, noisy, off, pipeline, random_planes, same_points, sample_of
from tests.naive import kinect as naive


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


def few_pixels(disparity):
    """A black frame of a disparity in pixels."""
    color = np.zeros((*disparity.shape, 3), np.uint8)
    return RgbdFrame(color, (43.5 / disparity).astype(np.float32))


FILLS = ("inpaint", {}), ("inpaint", {"algorithm": "navier-stokes"}), ("joint_bilateral", {}), ("nearest", {})


@pytest.mark.parametrize(("name", "fields"), FILLS)
def test_fills_keep_what_is_known(name, fields):
    frame = sample_of(seed=2, discs=4).frame()
    refined, known = pipeline(name, **fields)(frame).depth, ~np.isnan(frame.depth)
    np.testing.assert_array_equal(refined.values[known], frame.depth[known])
    assert (refined.status[known] == DepthStatus.KEPT).all()
    assert (refined.status[~known] == DepthStatus.GAP_FILLED).all()


def test_nearest_fill_takes_the_nearest_known_value():
    values = np.full((20, 20), np.nan, np.float32)
    values[3, 4], values[15, 12] = 1, 2
    filled = nearest_fill(values)
    rows, columns = np.mgrid[:20, :20]
    first, second = np.hypot(rows - 3, columns - 4), np.hypot(rows - 15, columns - 12)
    clear = np.abs(first - second) > 1  # the transform's distances are approximate
    np.testing.assert_array_equal(filled[clear], np.where(first < second, 1, 2)[clear])
    assert np.isnan(nearest_fill(np.full((3, 3), np.nan, np.float32))).all()


def test_the_status_of_refined_depth():
    """Measured 10 px, moved by less and by more than 3 deviations; gaps; a thousandth and less of what was measured."""
    depth = np.array([[1, 1, 1, 1, np.nan, np.nan, np.nan, np.nan]], np.float32)
    disparity = np.array([[10, 10.29, 10.31, np.nan, 5, 5, 0.05, 0.005]], np.float32)
    fallback = np.arange(8)[None] != 4
    frame = RgbdFrame(np.zeros((1, 8, 3), np.uint8), depth, 10.0)
    found = refined_depth(frame, disparity, 0.1, Clock(), fallback)
    names = ("KEPT", "SMOOTHED", "CORRECTED", "EMPTY", "GAP_FILLED", "FALLBACK", "FALLBACK", "EMPTY")
    assert [DepthStatus(bits).name for bits in found.depth.status[0]] == list(names)


def spatial(line, alpha, delta):
    """One pass over a line, there and back, with edges at steps of the unfiltered values."""
    for order in (range(len(line)), range(len(line) - 1, -1, -1)):
        source, state, before = line.copy(), np.nan, np.nan
        for i in order:
            if abs(before - source[i]) < delta:
                state = alpha * source[i] + (1 - alpha) * state
                line[i] = state
            else:
                state = source[i]
            before = source[i]
    return line


def test_realsense_spatial_filter():
    rng = np.random.default_rng(3)
    disparity = (20 + np.cumsum(rng.normal(0, 0.4, (13, 17)), axis=1)).astype(np.float32)
    disparity[rng.random((13, 17)) < 0.2] = np.nan
    method, frame = pipeline("realsense", temporal_alpha=1, persistency=0, hole_filling="off"), few_pixels(disparity)
    expected = frame.disparity.astype(float)
    for _ in range(2):
        expected = np.array([spatial(row, 0.5, 20 / 32) for row in expected])
        expected = np.array([spatial(column, 0.5, 20 / 32) for column in expected.T]).T
    np.testing.assert_allclose(43.5 / method(frame).depth.values, expected, rtol=1e-4)


def test_realsense_temporal_filter_smooths_carries_over_and_follows():
    method = pipeline("realsense", magnitude=0, hole_filling="off")
    # steady; seen twice, then gone for long; moves by more than the threshold
    columns = [[10, 10.4, 10, 10, 10, 10, 10], [10, 10] + [np.nan] * 5, [10, 12, 12, 12, 12, 12, 12]]
    state, seen, carried = None, [], []
    for disparity in np.array(columns).T:
        refined, state = method.step(few_pixels(disparity[None]), state)
        seen.append(43.5 / refined.depth.values[0])
        carried.append(bool(refined.depth.status[0, 1] & DepthStatus.CARRIED))
        assert refined.depth.filled[0, 1] == carried[-1]
    seen = np.array(seen)
    assert seen[1, 0] == pytest.approx(0.4 * 10.4 + 0.6 * 10, rel=1e-5)
    np.testing.assert_allclose(seen[:, 2], columns[2], rtol=1e-5)
    # valid in 2 of the last 4 frames: for three frames after the value is gone
    np.testing.assert_array_equal(np.isnan(seen[:, 1]), [False] * 5 + [True] * 2)
    assert carried == [False, False, True, True, True, False, False]
    refused(ValueError, method.step, few_pixels(np.ones((2, 3))), state)


@pytest.mark.parametrize(("mode", "value"), [("left", 10), ("farthest", 8), ("nearest", 14)])
def test_realsense_hole_filling(mode, value):
    disparity = np.full((3, 4), 10.0)
    disparity[0, 2], disparity[2, 1], disparity[1, 2] = 14, 8, np.nan
    refined = pipeline("realsense", magnitude=0, hole_filling=mode)(few_pixels(disparity))
    assert 43.5 / refined.depth.values[1, 2] == pytest.approx(value, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["planes", "foreground", "curved", "camouflage"])
def test_shadow_smoother_has_smaller_errors_than_the_smoother_it_uses(kind):
    sample = sample_of(kind, size=(320, 240), discs=4)
    methods = pipeline("shadow_smoother"), pipeline("fast_global_smoother")
    ours, peer = (off(method(sample.frame()), sample) for method in methods)
    for part in (sample.gap, sample.mismatch):
        assert np.nanmean(ours[part]) < 0.8 * np.nanmean(peer[part])
    assert np.nanmean(ours[sample.measured]) < 0.24


def test_without_colors_the_edges_of_the_depth_stop_the_smoothing():
    truth = np.where(np.arange(60) < 30, 22, 12) + np.zeros((40, 1))
    disparity = truth + 0.2 * np.random.default_rng(0).standard_normal(truth.shape)
    disparity[10:30, 20:40] = np.nan
    frame = RgbdFrame.without_color((43.5 / disparity).astype(np.float32), 43.5, None)
    error = np.abs(43.5 / pipeline("shadow_smoother")(frame).depth.values - truth)
    assert error.mean() < 0.06 and error[:, 25:35].mean() < 0.12


def sequence(*settings):
    return preset("refine-kinect", "sequence", *settings).pipeline


@functools.cache
def frames(kind: str) -> list[KinectSample]:
    return make_kinect_sequence(kind, 8, 1, 240, 180, 32)


def run(pipeline, samples):
    results, state = [], None
    for sample in samples:
        result, state = pipeline.step(sample.frame(), state)
        results.append(result)
    return results, state


def mean_error(results, samples):
    """After the first frame."""
    return np.mean([off(result, sample).mean() for result, sample in zip(results, samples, strict=True)][1:])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["static", "moving"])
def test_as_good_as_frame_by_frame(kind):
    errors, pipeline = np.zeros(2), sequence()
    for seed in (0, 1):
        samples = make_kinect_sequence(kind, 8, seed, 320, 240, 40)
        along, state = run(pipeline, samples)
        assert state.age == 7  # segments were computed once
        errors += [mean_error(way, samples) for way in (along, [pipeline(sample.frame()) for sample in samples])]
    assert errors[0] <= 1.05 * errors[1]


def test_the_estimated_motion_is_that_of_the_poses():
    first, _, third = frames("camera")[:3]
    assert first.intrinsics is not None and first.pose is not None and third.pose is not None
    found = estimated_motion(first.color, third.color, first.disparity, first.intrinsics, RgbdFrame.fb)
    true = np.linalg.inv(third.pose) @ first.pose
    assert found is not None and np.linalg.norm(true[:3, 3]) > 0.06  # meters
    np.testing.assert_allclose(found[:3, 3], true[:3, 3], atol=0.005)
    np.testing.assert_allclose(found[:3, :3], true[:3, :3], atol=0.002)


@pytest.mark.slow
@pytest.mark.parametrize(("known", "motion"), [(True, "pose"), (False, "estimated")])
def test_a_moving_camera_is_followed_with_less_error_and_less_noise_than_frame_by_frame(known, motion):
    errors, noise, pipeline = np.zeros(2), np.zeros(2), sequence()
    for seed in (0, 1):
        samples = make_kinect_sequence("camera", 6, seed, 320, 240, 40)
        given = [replace(sample, pose=sample.pose if known else None) for sample in samples]
        along, state = run(pipeline, given)
        assert [result.words["motion"] for result in along] == ["new"] + [motion] * 5
        assert not state.layers[0].own.all()
        ways = along, [pipeline(sample.frame()) for sample in given]
        errors += [mean_error(way, samples) for way in ways]
        places = [same_points(samples[0], sample) for sample in samples]
        seen = np.all([there for _, there in places], axis=0)
        for k, way in enumerate(ways):
            maps = [
                (RgbdFrame.fb / result.depth.values - sample.truth).ravel()[at]
                for result, sample, (at, _) in zip(way, samples, places, strict=True)
            ]
            noise[k] += np.std(maps, axis=0)[seen].mean()
    assert errors[0] < 0.95 * errors[1] and noise[0] < 0.8 * noise[1]


def test_pixels_that_changed_while_the_camera_moved_are_not_followed():
    first, *_, last = frames("camera")
    _, state = run(sequence(), [first])
    color = last.color.copy()
    color[60:90] += 128  # modulo 256
    changed = replace(last.frame(), color=color)
    _, measurement, *_ = sequence().refine(changed)
    way, view, followed = sequence()._followed(changed, measurement, state)
    assert way == "pose" and view is not None and followed[view.reached].mean() > 0.4
    assert not followed[60:90].any() and not followed[~view.reached].any()


@pytest.mark.parametrize("kind", ["static", "moving"])
def test_a_still_camera_has_the_same_bytes_with_and_without_poses(kind):
    samples = frames(kind)[:4]
    posed = [replace(sample, pose=np.eye(4)) for sample in samples]
    ways = [run(sequence(), given)[0] for given in (samples, posed)]
    for way in ways:
        assert [result.words["motion"] for result in way] == ["new", "still", "still", "still"]
    for one, other in zip(*ways, strict=True):
        np.testing.assert_array_equal(one.depth.values, other.depth.values)


@pytest.mark.parametrize("turn", [0.0, 0.05])
def test_the_view_after_a_motion_shows_a_slanted_plane_where_it_is(turn):
    rows, columns = np.mgrid[:60, :80].astype(np.float32)
    camera, fb = Intrinsics(100.0, 100.0, 39.5, 29.5), 40.0
    disparity = 20 + 0.05 * columns - 0.03 * rows
    color = np.stack([columns * 3, rows * 4, rows + columns], axis=2).astype(np.uint8)
    rotation, shift = cv2.Rodrigues(np.array([0, 0, turn]))[0], np.array([[0.02], [0.01], [-0.05]])
    motion = np.block([[rotation, shift], [np.zeros(3), 1]])
    view = view_after(motion, color, disparity, camera, fb, 0.5)
    assert view.reached[12:-12, 12:-12].all()
    y, x = np.nonzero(view.reached)
    old_y, old_x = np.divmod(view.source[y, x], 80)
    z = fb / disparity[old_y, old_x]
    points = rotation @ np.stack([(old_x - 39.5) / 100 * z, (old_y - 29.5) / 100 * z, z]) + shift
    assert np.abs(100 * points[0] / points[2] + 39.5 - x).max() <= 1.51
    assert np.abs(fb / points[2] - view.disparity[y, x]).max() < 0.2
    inside = (old_x > 1) & (old_x < 78) & (old_y > 1) & (old_y < 58)
    assert np.abs(view.color[y, x].astype(int) - color[old_y, old_x])[inside].max() <= 6  # two pixels of the ramps
    assert displacement(motion, disparity, camera, fb) > 1 > 1e-9 > displacement(np.eye(4), disparity, camera, fb)
    assert displacement(motion, disparity * np.float32(np.nan), camera, fb) == 0


def test_segments_are_new_after_max_age_and_much_change():
    samples, state, ages = frames("static"), None, []
    for sample in samples:
        _, state = sequence("max_age=3").step(sample.frame(), state)
        ages.append(state.age)
    assert ages == [0, 1, 2, 0, 1, 2, 0, 1]
    first, pipeline = samples[0].frame(), sequence()
    other = RgbdFrame(255 - first.color, first.depth)
    result, state = pipeline.step(other, pipeline.step(first, None)[1])
    assert state.age == 0
    np.testing.assert_array_equal(result.depth.values, pipeline(other).depth.values)


shapes = pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1), (14, 23)])


@shapes
def test_still_pixels(shape):
    rng = np.random.default_rng(0)
    color = blocks(*shape)
    before = np.clip(color + rng.integers(-6, 7, color.shape), 0, 255).astype(np.uint8)
    reliable, disparity = noisy(*shape), noisy(*shape, seed=1)
    found = still_pixels(color, reliable, before, disparity, 5, 2.0)
    same = np.abs(color.astype(int) - before).max(axis=2) <= 5
    np.testing.assert_array_equal(found, same & ~(np.abs(reliable - disparity) > 2))


@shapes
@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 1.0])
def test_carried_labels(shape, share):
    rng = np.random.default_rng(2)
    labels = labels_of(*shape)
    count = labels.max() + 1
    labels[rng.random(shape) < 0.1] = -1
    scale = rng.uniform(0.2, 0.6, count).astype(np.float32)
    surfaces, value_at = random_planes(rng.integers(18, 28, (count, 3)), scale)
    limit = np.where(rng.random(shape) < 0.3, rng.uniform(10, 40, shape), np.inf).astype(np.float32)
    reliable, still, own = noisy(*shape), rng.random(shape) < share, rng.random(shape) < 0.5
    color = blocks(*shape)
    frame = RgbdFrame(color, np.full(shape, 2, np.float32))
    measurement = replace(Measurement.of(frame, 5.0, 0.0, False, 0.3), reliable=reliable, limit=limit)
    found = carried_labels(Layer(labels, surfaces, own), still, color, measurement)
    expected = naive.carried_labels(labels, own, still, color, reliable, limit, value_at, scale, 1.5, 0.3)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
