"""What every aggregation promises: the folder says which there are."""

from __future__ import annotations

import pytest

from depthcli.testing import volume_steps
from tests.methods.stereo._pairs import methods


@pytest.mark.parametrize("aggregate", methods("depthcli.methods.stereo.aggregation"))
@pytest.mark.parametrize("check", volume_steps.AGGREGATION_CHECKS, ids=lambda check: check.__name__)
def test_contract(aggregate, check):
    check(aggregate)
