"""Contract of every feature, over the folder."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.method import Family
from depthcli.methods.registration.search import search

FAMILY = Family.of("depthcli.methods.registration.feature")


def texture(seed, shape=(20, 20, 20)):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(shape).astype(np.float32)
    for axis in range(3):
        values = (values + np.roll(values, 1, axis) + np.roll(values, -1, axis)) / 3
    return 100 * values.astype(np.float32)


@pytest.mark.parametrize("name", FAMILY.names())
class TestFeature:
    def test_true_shift_is_cheapest(self, name):
        wide = texture(0, (24, 24, 24))
        fixed, warped = wide[2:22, 2:22, 2:22].copy(), wide[2:22, 1:21, 4:24].copy()
        one, other = FAMILY.load(name)()(fixed, warped)
        found = search(one, other, 1.0, 3, 2)
        middle = (slice(7, 13),) * 3
        assert np.median(found.displacement[(1, *middle)]) == pytest.approx(1, abs=0.3)
        assert np.median(found.displacement[(2, *middle)]) == pytest.approx(-2, abs=0.3)

    def test_deterministic_and_inputs_untouched(self, name):
        fixed, warped = texture(1), texture(2)
        before = fixed.copy(), warped.copy()
        feature = FAMILY.load(name)()
        one, two = feature(fixed, warped), feature(fixed, warped)
        assert all(np.array_equal(a, b) and a.dtype == np.uint8 for a, b in zip(one, two, strict=True))
        assert np.array_equal(fixed, before[0]) and np.array_equal(warped, before[1])

    @pytest.mark.parametrize("shape", [(1, 9, 7), (3, 1, 5), (2, 2, 2)])
    def test_equal_volumes_have_equal_channels(self, name, shape):
        for volume in (np.zeros(shape, np.float32), texture(3, shape)):
            one, other = FAMILY.load(name)()(volume, volume)
            assert one.shape[1:] == shape and np.array_equal(one, other)


@pytest.mark.parametrize("name", ["mind", "mind_ssc", "local_ncc"])
def test_channels_are_the_same_at_any_contrast(name):
    volume = texture(4)
    feature = FAMILY.load(name)()
    one, other = feature(volume, 3 * volume + np.float32(50))
    assert np.abs(one.astype(int) - other.astype(int)).max() <= 1
