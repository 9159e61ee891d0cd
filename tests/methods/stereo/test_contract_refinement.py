"""What every refinement step promises: the folder says which there are."""

import pytest

from depthcli.testing import refinement
from tests.methods.stereo._pairs import methods


@pytest.mark.parametrize("step", methods("depthcli.methods.stereo.refinement"))
@pytest.mark.parametrize("check", refinement.CHECKS, ids=lambda check: check.__name__)
def test_contract(step, check):
    check(step)
