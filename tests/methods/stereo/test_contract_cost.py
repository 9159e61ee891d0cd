"""What every cost measure promises: the folder says which there are."""

import numpy as np
import pytest

from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing import check_cost_measure, cost
from tests.methods.stereo._pairs import methods


@pytest.mark.parametrize("measure", methods("depthcli.methods.stereo.cost"))
@pytest.mark.parametrize("check", cost.CHECKS, ids=lambda check: check.__name__)
def test_contract(measure, check):
    if check is cost.compares_levels_is_true and measure.method_name() == "combined":
        pytest.skip("compares what its parts compare")
    check(measure)


class Wrong(Census):
    """A census that looks farther than it says."""

    def halo(self) -> int:
        return 0


class Random(Census):
    """Costs that nothing decides."""

    def __call__(self, pair, n_disparities):
        volume = super().__call__(pair, n_disparities)
        shuffled = np.random.default_rng().permuted(volume.costs, axis=2)
        return type(volume)(np.ascontiguousarray(shuffled), volume.scale)


class OneInfinite(Census):
    """Costs one of which is infinite, inside larger images alone."""

    def __call__(self, pair, n_disparities):
        costs = super().__call__(pair, n_disparities).costs.astype(np.float32)
        costs[10:11, 10:11, 1] = np.inf
        return CostVolume(costs)


class Wide(Census):
    """Costs of four bytes, which its memory is not estimated for."""

    def __call__(self, pair, n_disparities):
        volume = super().__call__(pair, n_disparities)
        return CostVolume(volume.costs.astype(np.float32), volume.scale)


class Raises(Census):
    """Costs that cannot be computed."""

    def __call__(self, pair, n_disparities):
        raise KeyError("no such thing")


@pytest.mark.parametrize(("kind", "said"), [
    (OneInfinite, "OneInfinite fails .* infinite"),
    (Wide, "Wide fails .* bytes_per_cost"),
    (Raises, "Raises fails .* KeyError"),
    (Wrong, r"Wrong fails costs_depend_on_the_halo_alone \(A tile with the margin"),
    (Random, "Random fails true_shift_is_cheapest"),
])  # fmt: skip
def test_what_breaks_it_is_named(kind, said):
    with pytest.raises(AssertionError, match=said):
        check_cost_measure(kind())
