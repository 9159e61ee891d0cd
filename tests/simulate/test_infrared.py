"""Infrared-like pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depthcli.simulate.stereo_scenes import make_scene
from depthcli.simulate.transparent_scenes import cross_modal_pair, infrared_like


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


def test_deterministic_and_inputs_untouched():
    image = make_scene("planes", 0, 96, 72, 12).right
    before = image.copy()
    np.testing.assert_array_equal(infrared_like(image, 1), infrared_like(image, 1))
    assert np.mean(infrared_like(image, 1) != infrared_like(image, 2)) > 0.5
    np.testing.assert_array_equal(image, before)


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
    with pytest.raises(ValueError, match="speckles"):
        infrared_like(image, 0, 2.0)


def test_brightness_no_longer_matches_but_order_does():
    scene = make_scene("foreground", 1, 200, 150, 24)
    left, right = cross_modal_pair(scene.left, scene.right, 1)

    def bad(cost_of_shift: np.ndarray) -> float:
        chosen = np.argmin([cv2.blur(c, (9, 9)) for c in cost_of_shift], axis=0)
        return float(np.mean(np.abs(chosen - scene.disparity_left)[scene.nonocc] > 1))

    def absolute(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.abs(a.astype(np.float32) - b)

    def order(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        offsets = [(y, x) for y in range(-2, 3) for x in range(-3, 4) if (y, x) != (0, 0)]
        bits = [(np.roll(a, o, (0, 1)) > a) != (np.roll(b, o, (0, 1)) > b) for o in offsets]
        return np.sum(bits, axis=0).astype(np.float32)

    shifted = [np.roll(right, d, axis=1) for d in range(25)]
    assert bad([order(left, s) for s in shifted]) < 0.5 * bad([absolute(left, s) for s in shifted])
