"""Generated glass, infrared-like pictures, and emulated sparse stereo."""

import cv2
import numpy as np
import pytest

from depthcli.io.rgbd_frames import load_sparse_frame, true_depth
from depthcli.io.scenes import RgbdScene
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.simulate.transparent_scenes import (
    cross_modal_pair,
    glass_of_pair,
    infrared_like,
    make_transparent_scene,
    sparse_samples,
)
from depthcli.testing.inputs import texture
from tests.command_line import run
from tests.scenes import load, true


def test_the_sensor_is_right_outside_and_sees_farther_or_nothing_inside():
    scene = make_transparent_scene(1, 160, 120, 20)
    error = scene.sensor - scene.disparity
    inside, outside = error[scene.mask], np.abs(error[~scene.mask])
    assert outside.max() < 0.6 and outside.mean() == pytest.approx(0.08, abs=0.01)
    assert np.isnan(inside).mean() == pytest.approx(0.5, abs=0.02)
    assert np.nanmedian(inside) < -1 and np.nanmax(inside) < 0.6
    assert 0.03 < scene.mask.mean() < 0.4


def test_glass_is_a_surface_in_front_of_its_surroundings():
    images, disparity = np.full((2, 60, 80), 90, np.uint8), np.full((60, 80), np.nan, np.float32)
    inside = np.zeros(disparity.shape, bool)
    inside[20:36, 50:66] = True
    disparity[inside] = 20
    assert not np.array_equal(glass_of_pair(*images, disparity).mask, inside)  # nothing is known around it
    disparity[~inside] = 5
    assert np.array_equal(glass_of_pair(*images, disparity).mask, inside)


@pytest.mark.parametrize("clustered", [False, True])
def test_samples_are_as_many_as_noisy_and_as_wrong_as_asked_for(clustered):
    color = texture((120, 160, 3))
    color[:, :80] = 90
    depth = np.tile(np.linspace(0.5, 1.5, 120, dtype=np.float32)[:, None], (1, 160))
    depth[:10] = np.nan
    sparse = sparse_samples(depth, color, 0.1, noise=0.005, outliers=0.2, clustered=clustered, seed=3)
    chosen = np.isfinite(sparse)
    assert chosen.sum() == round(0.1 * depth.size) and not chosen[:10].any()
    error = np.abs(sparse - depth)[chosen]
    assert np.mean(error > 0.03) == pytest.approx(0.2 * 0.94, abs=0.03)
    assert error[error < 0.02].std() < 0.006
    flat = chosen[:, :78].mean() / chosen.mean()
    assert flat < 0.01 if clustered else 0.9 < flat < 1.1
    np.testing.assert_array_equal(sparse, sparse_samples(depth, color, 0.1, 0.005, 0.2, clustered, 3))


def test_the_command_makes_frames_and_makes_them_from_others_with_truth(two_scenes, tmp_path, tool):
    made, more = tmp_path / "made", tmp_path / "more"
    assert run("sample", "--transparent", "--width", "96", "--height", "72", "-o", made, "-q") == 0
    assert run("sample", "--transparent", "--from", made, "--share", "0.3", "-o", more, "-q") == 0
    for folder, share in ((made, 0.02), (more, 0.3)):
        scenes = discover_scenes(folder, FRAMES)
        assert [scene.name for scene in scenes] == ["glass_0", "glass_1"]
        for scene in scenes:
            assert isinstance(scene, RgbdScene)
            frame, truth = load_sparse_frame(scene), true_depth(scene)
            assert np.isfinite(frame.sparse).mean() == pytest.approx(share, abs=0.001)
            assert truth.masks["transparent"].any() and truth.fb == (24.0 if folder == made else None)
    assert run("sample", "--transparent", "--from", two_scenes, "-o", tmp_path / "pairs", "-q") == 0
    for scene in discover_scenes(tmp_path / "pairs", FRAMES):  # one surface of the pair is glass, the left view color
        origin, truth = discover_scenes(two_scenes / scene.name, PAIRS)[0], true(scene)
        glass, disparity = truth.masks["transparent"], true(origin).disparity
        np.testing.assert_allclose(24.0 / truth.depth, disparity, rtol=1e-5)
        np.testing.assert_allclose(24.0 / load(scene).depth[~glass], disparity[~glass], atol=0.6)
        np.testing.assert_array_equal(load(scene).color, load(origin).left)
        assert 0.01 < glass.mean() < 0.7
    (made / "glass_0" / "depth_true.pfm").unlink()
    assert "no true depth" in "".join(tool.both(3, "sample", "--transparent", "--from", made, "-o", tmp_path / "none"))


@pytest.mark.parametrize("paint", [(200, 40, 90), (30, 120, 60)])
def test_a_flat_picture_shows_weights_power_gain_and_noise(paint):
    result = infrared_like(np.full((200, 260, 3), paint, np.uint8), 4).astype(float)
    smooth = cv2.GaussianBlur(result, (0, 0), 4)
    gain = smooth / (255 * (np.dot((0.6, 0.3, 0.1), paint) / 255) ** 0.7)
    assert (gain.min(), gain.max()) == pytest.approx((0.7, 1.3), abs=0.03)
    assert np.abs(np.diff(gain, axis=1)).max() < 0.03
    assert (result - smooth).std() == pytest.approx(4.0, abs=0.3)


def test_sixteen_bits_and_grey_are_the_same_picture():
    grey = np.tile(np.arange(256, dtype=np.uint8), (64, 1))
    color = np.repeat(grey[:, :, None], 3, axis=2)
    for other in (color, grey.astype(np.uint16) * 257):
        assert np.abs(infrared_like(grey, 3).astype(int) - infrared_like(other, 3)).max() <= 1
    left, right = cross_modal_pair(*[color.astype(np.uint16) * 257] * 2, 3)
    np.testing.assert_array_equal(left, grey)
    assert right.dtype == np.uint8


def test_speckles_are_bright_and_as_many_as_asked_for():
    bright = infrared_like(np.full((200, 200), 60, np.uint8), 0, 0.01) > 200
    assert 250 < cv2.connectedComponents(bright.astype(np.uint8))[0] - 1 < 420
