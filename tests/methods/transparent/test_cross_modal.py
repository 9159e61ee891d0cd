"""Stereo of color and infrared: the rig's geometry, channel weights, which matches are kept, and the whole chain."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from depthcli.core.cameras.camera import Camera
from depthcli.core.cameras.rig import Rig
from depthcli.core.cameras.triangulation import depth_of_disparity, disparity_of_depth
from depthcli.core.color_and_infrared import RgbIrFrame
from depthcli.core.context import Clock
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.methods.stereo.volume import CostVolume
from depthcli.methods.transparent.cross_modal import GREY, CrossModal, faded_costs, learned_weights, mix_channels
from depthcli.methods.transparent.match_selection import MatchSelection, cost_at, local_deviation
from depthcli.simulate.transparent_scenes import glass_of_pair, make_transparent_scene
from depthcli.testing.inputs import assert_pure, texture
from tests.contracts.inputs import preset
from tests.golden import refused
from tests.naive import transparent as naive
from tests.scenes import DATA, load, needs_data, true

SIZE, SMALL = (200, 150), (160, 130)


def rig(shift=-0.08, **changes):
    """A color camera and an infrared one of another size and focal length, turned a little."""
    color = Camera(np.array([[190.0, 0, 98], [0, 192, 77], [0, 0, 1]]), (0.05, -0.03, 0.001, -0.001, 0.0), SIZE)
    infrared = Camera(np.array([[150.0, 0, 82], [0, 149, 63], [0, 0, 1]]), size=SMALL)
    turn = cv2.Rodrigues(np.array([0.01, -0.03, 0.015]))[0].astype(np.float64)
    return replace(Rig(color, infrared, turn, np.array([shift, 0.002, 0.003])), **changes)


def photograph(cameras):
    """Both views of a textured wall a meter away, at right angles to the color camera's axis."""
    picture = cv2.GaussianBlur(texture((900, 1200)).astype(np.float32), (0, 0), 3)
    picture = np.clip(128 + 6 * (picture - 128), 0, 255).astype(np.float32)

    def view(camera, size, turn, shift):
        pixels = np.mgrid[: size[1], : size[0]][::-1].reshape(2, -1).T.astype(np.float64)
        rays = np.column_stack([camera.rays(pixels), np.ones(len(pixels))]) @ turn  # in the color camera's frame
        origin = -turn.T @ shift
        points = origin + ((1 - origin[2]) / rays[:, 2])[:, None] * rays
        u, v = ((500 * points[:, k] + half).reshape(size[::-1]) for k, half in ((0, 600), (1, 450)))
        return cv2.remap(picture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR)

    left = view(cameras.left, SIZE, np.eye(3), np.zeros(3))
    right = view(cameras.right, SMALL, cameras.rotation, cameras.translation)
    color = np.repeat(np.rint(left).astype(np.uint8)[:, :, None], 3, axis=2)
    return color, np.rint(255 * (right / 255) ** 0.7).astype(np.uint8)


@pytest.mark.parametrize("shift", [-0.08, 0.08])
def test_a_wall_is_measured_through_two_different_cameras(shift):
    cameras = rig(shift)
    depth = np.ones(SIZE[::-1], np.float32)
    depth[40:90, 60:130] = np.nan  # the sensor is blind here
    frame, figures = CrossModal()(RgbIrFrame(*photograph(cameras), depth, cameras), Clock())
    found = frame.sparse[40:90, 60:130]
    assert np.isfinite(found).mean() > 0.5 and np.nanmedian(np.abs(found - 1.0)) < 0.02
    assert figures["matched"] == pytest.approx(np.isfinite(frame.sparse).mean())
    assert (frame.sparse_confidence[np.isfinite(frame.sparse)] >= 0.3).all()


def test_cameras_that_cannot_be_matched_are_refused():
    views = np.zeros((*SIZE[::-1], 3), np.uint8), np.zeros(SMALL[::-1], np.uint8), np.ones(SIZE[::-1], np.float32)
    turned = cv2.Rodrigues(np.array([0.0, 2.5, 0]))[0]
    for cameras in (rig(translation=np.array([0.0, 0.08, 0])), rig(rotation=turned)):
        refused(InputError, CrossModal(), RgbIrFrame(*views, cameras), Clock())


def test_weights_of_the_channels_are_learned_from_the_sensor():
    color = cv2.GaussianBlur(texture((80, 120, 3), 1), (0, 0), 1.2)
    infrared = np.roll(mix_channels(color, (0.7, 0.3, 0.0)), -7, axis=1)
    disparity = np.full((80, 120), 7, np.float32)
    disparity[:, :20] = np.nan
    np.testing.assert_allclose(learned_weights(color, infrared, disparity), (0.7, 0.3, 0.0), atol=0.03)
    assert learned_weights(color, infrared, np.full_like(disparity, np.nan)) == GREY
    grey = np.repeat(color[..., :1], 3, axis=2)  # of which the infrared image is the negative
    assert learned_weights(grey, 255 - np.roll(grey[..., 0], -7, axis=1), disparity) == GREY


@pytest.mark.slow
@pytest.mark.parametrize("channels", ["early", "late", "r", "g", "b", "grey"])
def test_every_way_to_mix_the_channels_matches(channels):
    scene = make_transparent_scene(3, 128, 96, 16)
    inputs, stereo = (scene.color, scene.infrared, scene.sensor), CrossModal(channels=channels, max_disparity=16)
    found = stereo.match(*inputs)
    assert np.nanmedian(np.abs(found.dense - scene.disparity)) < 0.5
    assert sum(found.weights) == pytest.approx(1)
    if channels == "early":
        assert_pure(lambda: stereo.match(*inputs).sparse, *inputs)
        median = stereo.model_copy(update={"median": 3}).match(*inputs).dense
        smooth = stereo.match(scene.color, cv2.medianBlur(scene.infrared, 3), scene.sensor).dense
        np.testing.assert_array_equal(median, smooth)
        assert (median != found.dense).any()


@pytest.mark.slow
def test_selected_matches_are_right_and_none_lie_on_widened_edges():
    scene = make_transparent_scene(4, 240, 180, 30)
    rule = MatchSelection(margin=0, blind_margin=0, widening=0, consensus=0, texture=0, speckle=0)
    without = CrossModal(max_disparity=30, selection=rule)
    kept, all_of = (
        stereo.match(scene.color, scene.infrared, scene.sensor).sparse
        for stereo in (CrossModal(max_disparity=30), without)
    )
    contradicting, others = (np.mean((np.abs(each - scene.sensor) > 1.5)[~scene.mask]) for each in (kept, all_of))
    assert contradicting < 0.5 * others
    known = np.isfinite(kept)
    assert 0.15 < known.mean() < np.isfinite(all_of).mean()
    assert np.mean(np.abs(kept - scene.disparity)[known] > 1) < 0.08


def test_margins_are_those_of_a_sensor_that_knows_and_of_one_that_is_blind():
    """A match cheaper by .12 than the sensor's disparity, or the mean: enough where the sensor is blind."""
    costs = np.full((20, 20, 32), 1000, np.uint16)
    costs[:, :, 10] = 988
    sensor, grey = np.full((20, 20), 20, np.float32), np.zeros((20, 20), np.uint8)
    sensor[:, 10:] = np.nan
    maps = np.full_like(sensor, 10), np.ones_like(sensor), sensor
    rule = MatchSelection(margin=0.15, blind_margin=0.1, speckle=0)
    found, _ = rule(*maps, CostVolume(costs, 100.0), StereoPair(grey, grey))
    np.testing.assert_array_equal(np.isfinite(found), np.isnan(sensor))


def volume(shape, dtype=np.uint16):
    costs = np.random.default_rng(0).integers(0, 200 if dtype == np.uint8 else 4000, shape).astype(dtype)
    return CostVolume(costs, 100.0)


def half_flat(height, width, seed):
    image = texture((height, width), seed)
    image[:, : width // 2] = image[:, : width // 2] // 64 + 100
    return image


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(14, 33, 9), (1, 12, 20), (9, 1, 4), (3, 2, 1)])
def test_faded_costs_agree_with_the_reference(shape, dtype):
    costs, left, right = volume(shape, dtype), half_flat(*shape[:2], 0), half_flat(*shape[:2], 1)
    shares = [np.minimum(local_deviation(image) / 30, 1) for image in (left, right)]
    found = faded_costs(costs, left, right, 30.0).costs
    assert found.dtype == np.uint16
    assert np.abs(found.astype(int) - naive.faded_costs(costs.costs, *shares)).max() <= 1
    assert_pure(lambda: faded_costs(costs, left, right, 30.0).costs, left, right, costs.costs)


def test_costs_beside_a_disparity():
    costs = volume((4, 5, 6))
    disparity = np.full((4, 5), 2.5, np.float32)
    disparity[0], disparity[1, 1], disparity[2] = 3.0, np.nan, 99.0
    found, at = cost_at(costs, disparity), costs.costs / 100
    for row, expected in ((3, at[3, :, 2:4].min(axis=1)), (0, at[0, :, 3:5].min(axis=1)), (2, at[2, :, 5])):
        np.testing.assert_allclose(found[row], expected, rtol=1e-6)
    assert np.isnan(found[1, 1])


@needs_data
@pytest.mark.slow
def test_the_preset_kinect_replaces_the_object_and_little_else():
    """Middlebury pairs whose right view is made infrared and one surface glass."""
    config = preset("transparent", "kinect")
    for files in discover_scenes(DATA / "middlebury_v2", PAIRS, patterns=("Cones", "Teddy", "Venus")):
        pair = load(files)
        scene = glass_of_pair(pair.left, pair.right, true(files).disparity)
        stereo = config.stereo.model_copy(update={"max_disparity": files.max_disparity})
        depth = depth_of_disparity(scene.sensor, 24.0)
        frame, _ = stereo(RgbIrFrame(scene.color, scene.infrared, depth, None, 24.0), Clock())
        values = disparity_of_depth(config.pipeline(frame).depth.values, 24.0)
        error = np.abs(values - scene.disparity)
        assert np.nanmean(error[scene.mask]) < 0.8
        assert np.nanmean(error[np.isfinite(scene.sensor) & ~scene.mask]) < 0.2
