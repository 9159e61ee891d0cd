"""The table of errors against a loop over single values, and its order."""

import math

import numpy as np
import pytest

from depthcli.algorithms.error_table import ErrorTable
from depthcli.problems.frames import kinect_errors
from depthcli.problems.map_checks import networks

LEVELS = np.linspace(0.5, 0.99, 15)
WITHIN = np.geomspace(0.25, 8, 25)
ODDS = np.linspace(-12, 12, 300).astype(np.float32)


@pytest.fixture(params=["disparity", "disparity, unbiased", "depth"])
def table(request: pytest.FixtureRequest) -> ErrorTable:
    found = (kinect_errors() if request.param == "depth" else networks()).errors
    return found.unbiased if "unbiased" in request.param else found


def naive_bound(table: ErrorTable, odds: float, level: float) -> float:
    """One value between its four entries."""
    place = np.log(table.levels / (1 - table.levels))
    j = next(k for k in range(len(place) - 1) if level <= table.levels[k + 1])
    right = (math.log(level / (1 - level)) - place[j]) / (place[j + 1] - place[j])
    rows = [(1 - right) * row[j] + right * row[j + 1] for row in table.log2_errors]
    if odds <= table.log_odds[0] or odds >= table.log_odds[-1]:
        return float(2 ** rows[0 if odds <= table.log_odds[0] else -1])
    i = next(k for k in range(len(rows) - 1) if odds <= table.log_odds[k + 1])
    down = (odds - table.log_odds[i]) / (table.log_odds[i + 1] - table.log_odds[i])
    return float(2 ** ((1 - down) * rows[i] + down * rows[i + 1]))


def test_a_bound_is_interpolated_between_four_entries(table: ErrorTable):
    for level in (0.5, 0.77, 0.9, 0.97, 0.99):
        want = [naive_bound(table, float(odds), level) for odds in ODDS]
        np.testing.assert_allclose(table.bound(ODDS, level), want, rtol=0.01)
        for odds in (-4.0, -1.0, 0.0, 2.0, 5.0):  # the probability of the bound is its level
            one = np.array([odds], np.float32)
            within = float(table.bound(one, level)[0])
            assert table.probability(one, within)[0] == pytest.approx(level, abs=0.02)


def test_bounds_and_probabilities_are_monotone(table: ErrorTable):
    bounds = np.stack([table.bound(ODDS, level) for level in LEVELS])
    assert (np.diff(bounds, axis=0) >= 0).all() and (np.diff(bounds, axis=1) <= 0).all()
    limits = np.repeat(WITHIN[:, None], ODDS.size, axis=1).astype(np.float32)
    single = table.probability(np.tile(ODDS, (len(WITHIN), 1)), limits)  # a limit for each value
    together = np.stack([table.probability(ODDS, float(within)) for within in WITHIN])
    np.testing.assert_allclose(single, together, atol=0.03)
    for chances in (single, together):
        assert (np.diff(chances, axis=0) >= 0).all() and (np.diff(chances, axis=1) >= 0).all()
        assert chances.min() >= 0 and chances.max() <= 1


def test_the_unbiased_table_gives_the_probability_that_its_log_odds_say():
    found = networks().errors
    for odds in np.linspace(-5, 4.5, 20, dtype=np.float32):
        likely = found.unbiased.probability(np.array([odds]), 1.0)[0]
        assert likely == pytest.approx(1 / (1 + math.exp(-odds)), abs=0.01)
        assert likely > found.probability(np.array([odds]), 1.0)[0] - 0.005, "the table has a margin for new data"
    assert (np.diff(found.unbiased.probability(np.linspace(-12, 12, 100, dtype=np.float32), 1.0)) > 0).all()
