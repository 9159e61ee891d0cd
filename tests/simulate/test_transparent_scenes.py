"""Generated glass, infrared-like pictures, and emulated sparse stereo."""

import cv2
import numpy as np
import pytest

from depthcli.cli import main
from depthcli.io.rgbd_frames import load_sparse_frame, true_depth
from depthcli.io.scenes import RgbdScene
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.simulate.transparent_scenes import (
    cross_modal_pair,
    infrared_like,
    make_transparent_scene,
    sparse_samples,
)


@pytest.fixture(scope="module")
def scene():
    return make_transparent_scene(1, 160, 120, 20)


def test_the_sensor_is_right_outside_and_sees_farther_or_nothing_inside(scene):
    outside = np.abs(scene.sensor - scene.disparity)[~scene.mask]
    assert outside.max() < 0.6
    assert outside.mean() == pytest.approx(0.08, abs=0.01)
    inside = (scene.sensor - scene.disparity)[scene.mask]
    assert np.isnan(inside).mean() == pytest.approx(0.5, abs=0.02)
    assert np.nanmedian(inside) < -1
    assert np.nanmax(inside) < 0.6
    assert 0.03 < scene.mask.mean() < 0.4


@pytest.mark.parametrize("clustered", [False, True])
def test_samples_are_as_many_as_noisy_and_as_wrong_as_asked_for(clustered):
    rng = np.random.default_rng(0)
    color = rng.integers(0, 256, (120, 160, 3)).astype(np.uint8)
    color[:, :80] = 90
    depth = np.tile(np.linspace(0.5, 1.5, 120, dtype=np.float32)[:, None], (1, 160))
    depth[:10] = np.nan
    sparse = sparse_samples(depth, color, 0.1, noise=0.005, outliers=0.2, clustered=clustered, seed=3)
    chosen = np.isfinite(sparse)
    assert chosen.sum() == round(0.1 * depth.size)
    assert not chosen[:10].any()
    error = np.abs(sparse - depth)[chosen]
    assert np.mean(error > 0.03) == pytest.approx(0.2 * 0.94, abs=0.03)
    assert error[error < 0.02].std() < 0.006
    flat = chosen[:, :78].mean() / chosen.mean()
    assert flat < 0.01 if clustered else 0.9 < flat < 1.1
    np.testing.assert_array_equal(sparse, sparse_samples(depth, color, 0.1, 0.005, 0.2, clustered, 3))


def test_the_command_makes_frames_and_makes_them_from_others(tmp_path):
    made, more = tmp_path / "made", tmp_path / "more"
    assert main(["sample", "--transparent", "--width", "96", "--height", "72", "-o", str(made), "-q"]) == 0
    assert main(["sample", "--transparent", "--from", str(made), "--share", "0.3", "-o", str(more), "-q"]) == 0
    for folder, share in ((made, 0.02), (more, 0.3)):
        scenes = discover_scenes(folder, FRAMES)
        assert [scene.name for scene in scenes] == ["glass_0", "glass_1"]
        for scene in scenes:
            assert isinstance(scene, RgbdScene)
            frame, truth = load_sparse_frame(scene), true_depth(scene)
            assert np.isfinite(frame.sparse).mean() == pytest.approx(share, abs=0.001)
            assert truth.masks["transparent"].any()
            assert truth.fb == (24.0 if folder == made else None)


def test_a_frame_without_truth_is_a_failed_row(tmp_path, tool):
    made = tmp_path / "made"
    assert main(["sample", "--transparent", "--width", "64", "--height", "48", "-o", str(made), "-q"]) == 0
    (made / "glass_0" / "depth_true.pfm").unlink()
    said = tool.both(3, "sample", "--transparent", "--from", made, "-o", tmp_path / "more")
    assert "no true depth" in said.out + said.err


@pytest.mark.parametrize("paint", [(200, 40, 90), (30, 120, 60)])
def test_a_flat_picture_shows_weights_power_gain_and_noise(paint):
    image = np.empty((200, 260, 3), np.uint8)
    image[:] = paint
    result = infrared_like(image, 4).astype(float)
    light = 255 * ((0.6 * paint[0] + 0.3 * paint[1] + 0.1 * paint[2]) / 255) ** 0.7
    gain = cv2.GaussianBlur(result, (0, 0), 4) / light
    assert gain.min() == pytest.approx(0.7, abs=0.03)
    assert gain.max() == pytest.approx(1.3, abs=0.03)
    assert np.abs(np.diff(gain, axis=1)).max() < 0.03
    grain = result - cv2.GaussianBlur(result, (0, 0), 4)
    assert grain.std() == pytest.approx(4.0, abs=0.3)


def test_sixteen_bits_and_grey_are_the_same_picture():
    grey = np.tile(np.arange(256, dtype=np.uint8), (64, 1))
    color = np.repeat(grey[:, :, None], 3, axis=2)
    eight = infrared_like(grey, 3).astype(int)
    assert np.abs(eight - infrared_like(color, 3)).max() <= 1
    assert np.abs(eight - infrared_like(grey.astype(np.uint16) * 257, 3)).max() <= 1
    left, right = cross_modal_pair(color.astype(np.uint16) * 257, color.astype(np.uint16) * 257, 3)
    np.testing.assert_array_equal(left, grey)
    assert right.dtype == np.uint8


def test_speckles_are_bright_and_as_many_as_asked_for():
    image = np.full((200, 200), 60, np.uint8)
    difference = infrared_like(image, 0, 0.01).astype(int) > 200
    count = cv2.connectedComponents(difference.astype(np.uint8))[0] - 1
    assert 250 < count < 420
