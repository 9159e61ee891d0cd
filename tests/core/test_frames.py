"""Samples of a pair: 16-bit files that cameras fill partly are as bright as they were meant to be."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.frames import StereoPair


@pytest.mark.parametrize("bits", [10, 12, 14, 16, None])
def test_largest_sample_is_white_whatever_its_bits(bits):
    top = (1 << (bits or 16)) - 1
    ramp = np.arange(0, top + 1, dtype=np.uint16)[None]
    pair = StereoPair(ramp, ramp.copy(), bits)
    np.testing.assert_array_equal(pair.grey[0], np.rint(ramp * (65535 / top)))
    wanted = np.rint(ramp * (255 / top))
    assert np.abs(pair.grey8[0] - wanted).max() <= (0 if bits in (16, None) else 1)
    assert pair.grey8[0].min() == 0 and pair.grey8[0].max() == 255
    assert np.all(np.diff(pair.grey8[0].astype(int)) >= 0)
    np.testing.assert_array_equal(pair.color8[0], np.repeat(pair.grey8[0][..., None], 3, axis=2))


def test_both_images_share_one_scale_and_larger_samples_are_white():
    left, right = np.full((1, 1, 3), 4095, np.uint16), np.full((1, 1, 3), 1000, np.uint16)
    pair = StereoPair(left, right, 12)
    assert [int(image[0, 0, 0]) for image in pair.color8] == [255, 62]
    assert int(StereoPair(left, right, 10).grey8[0][0, 0]) == 255


def test_bits_must_fit_the_type():
    image = np.zeros((2, 2), np.uint8)
    assert StereoPair(image, image, 8).grey[0] is image
    for bits in (0, 9):
        with pytest.raises(ValueError, match="bits"):
            StereoPair(image, image, bits)
