"""What the features promise beyond those of ``tests.contracts``."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.method import Family
from tests.contracts.inputs import soft_volume

FAMILY = Family.of("depthcli.methods.registration.feature")


@pytest.mark.parametrize("name", ["mind", "mind_ssc", "local_ncc"])
def test_channels_are_the_same_at_any_contrast(name):
    volume = soft_volume(4)
    feature = FAMILY.load(name)()
    one, other = feature(volume, 3 * volume + np.float32(50))
    assert np.abs(one.astype(int) - other.astype(int)).max() <= 1
