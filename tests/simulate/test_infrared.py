"""Infrared-like pictures."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

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
