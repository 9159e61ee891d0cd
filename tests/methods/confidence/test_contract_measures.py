"""What every confidence measure promises: the folder says which there are."""

from __future__ import annotations

import pytest

from depthcli.core.method import Family
from depthcli.methods.confidence import measures
from depthcli.testing import confidence


@pytest.mark.parametrize("name", measures())
@pytest.mark.parametrize("check", confidence.CHECKS, ids=lambda check: check.__name__)
def test_contract(name, check):
    check(Family.of("depthcli.methods.confidence").load(name)())
