"""What every optimizer promises, and every smoothness term of an energy."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from depthcli.algorithms.regions import region_graph
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.boundary import BoundaryCost
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.optimization import Optimizer
from depthcli.methods.stereo.volume import CostVolume
from depthcli.testing.inputs import TINY, assert_pure, blocky_pair, random_volume, run_checks, shifted_pair, texture


def check_optimizer(optimizer: Optimizer) -> None:
    """Raise AssertionError unless an optimizer keeps all promises to pipelines; takes some seconds."""
    run_checks(optimizer, OPTIMIZER_CHECKS)


def volumes_of_all_types_and_sizes(optimizer: Optimizer) -> None:
    """Volumes of every type and size, also with more disparities than columns, have finite costs of their shape."""
    for height, width, disparities in TINY:
        for dtype in (np.uint8, np.uint16, np.float32):
            result = optimizer(random_volume(height, width, disparities, dtype), blocky_pair(height, width))
            shape = (height, width, disparities)
            assert result.costs.shape == shape, f"expected {shape}, got {result.costs.shape}"
            assert result.scale > 0, f"the scale is {result.scale}"
            assert np.isfinite(result.costs).all(), "a cost is infinite or NaN"


def unanimous_costs_keep_their_winner(optimizer: Optimizer) -> None:
    """A disparity that is the cheapest everywhere remains the cheapest, at any scale of the costs."""
    for scale in (1.0, 85.0, 1360.0):
        costs = np.full((15, 30, 12), 200, np.uint8)
        costs[:, :, 5] = 10
        left, _ = winners(optimizer(CostVolume(costs, scale), blocky_pair(15, 30)).costs)
        assert np.all(left[:, 5:] == 5), f"another disparity wins at a scale of {scale}"


def equal_costs_stay_equal(optimizer: Optimizer) -> None:
    """If all costs are equal, they remain equal."""
    costs = optimizer(CostVolume(np.full((9, 20, 8), 40, np.uint8)), blocky_pair(9, 20)).costs
    np.testing.assert_array_equal(costs.min(axis=2), costs.max(axis=2))


def a_plane_keeps_its_disparity(optimizer: Optimizer) -> None:
    """On random texture, the true disparity wins in nine tenths of the pixels or more."""
    shift = 5
    pair = shifted_pair(30, 60, shift)
    left, _ = winners(optimizer(AbsoluteDifference()(pair, 12), pair).costs)
    share = np.mean(left[:, shift:] == shift)
    assert share > 0.9, f"{share:.0%} of the pixels have the true disparity, expected more than 90 %"


def same_at_any_number_of_threads(optimizer: Optimizer) -> None:
    """The costs do not depend on the number of threads, and the inputs stay as they were."""
    pair, volume = blocky_pair(41, 70), random_volume(41, 70, 37, np.uint16)
    assert_pure(lambda: optimizer(volume, pair).costs, volume.costs, pair.left, pair.right)


OPTIMIZER_CHECKS = (
    volumes_of_all_types_and_sizes,
    unanimous_costs_keep_their_winner,
    equal_costs_stay_equal,
    a_plane_keeps_its_disparity,
    same_at_any_number_of_threads,
)
"""One function a promise."""


Smoothness: TypeAlias = Callable[[NDArray[np.uint8]], tuple[NDArray[Any], NDArray[Any]]]
"""(H, W, 3) uint8 image -> cost of a difference between neighbors in a row, (H, W - 1), and in a column, (H - 1, W)."""


def check_smoothness(term: Smoothness | BoundaryCost) -> None:
    """Raise AssertionError unless a smoothness term keeps all promises to energies.

    ``term`` takes an (H, W, 3) uint8 image and returns the costs of a difference, such as in disparity, between
    neighbors along the rows, (H, W - 1), and along the columns, (H - 1, W). It can also be a boundary cost between
    segments (derived from ``depthcli.methods.stereo.boundary.BoundaryCost``); then every pixel is a segment.
    """
    if isinstance(term, BoundaryCost):
        run_checks(term, BOUNDARY_CHECKS)
    else:
        run_checks(term, SMOOTHNESS_CHECKS)


def images_of_any_size_have_finite_costs(term: Smoothness) -> None:
    """Images of any size have costs of the right shape, none of them infinite or negative."""
    for height, width in ((2, 2), (2, 9), (9, 2), (7, 11)):
        across, down = term(texture((height, width, 3), width))
        assert across.shape == (height, width - 1), f"expected {(height, width - 1)}, got {across.shape}"
        assert down.shape == (height - 1, width), f"expected {(height - 1, width)}, got {down.shape}"
        for costs in (across, down):
            assert np.isfinite(costs).all(), "a cost is infinite or NaN"
            assert costs.min() >= 0, "a cost is negative"


def edges_of_color_cost_less(term: Smoothness) -> None:
    """Neighbors of one color have the same positive cost everywhere; the more the colors differ, the less it costs."""
    grey = np.cumsum(np.arange(20)).astype(np.uint8)  # steps of 1, 2, ...
    image = np.broadcast_to(grey[:, None], (6, 20, 3)).copy()
    (steps, same), (down, _) = term(image), term(np.full_like(image, 90))
    assert same.min() == same.max() == down.min() == down.max() > 0, "pairs of equal colors have different costs"
    assert np.all(steps <= same.min()), "an edge of color costs more than equal colors"
    assert np.all(np.diff(steps, axis=1) <= 0), "a stronger edge costs more"
    assert steps[0, -1] < steps[0, 0], "no edge costs less"


def rows_and_columns_count_alike(term: Smoothness) -> None:
    """Costs move with the image when it is mirrored or its rows become columns."""
    image = texture((9, 14, 3), 1) // 8
    across, down = term(image)
    turned = term(np.ascontiguousarray(image.swapaxes(0, 1)))
    np.testing.assert_allclose(turned[1].T, across, rtol=1e-6)
    np.testing.assert_allclose(turned[0].T, down, rtol=1e-6)
    np.testing.assert_allclose(term(np.ascontiguousarray(image[:, ::-1]))[0][:, ::-1], across, rtol=1e-6)


def same_term_at_any_number_of_threads(term: Smoothness) -> None:
    """The costs do not depend on the number of threads, and the image stays as it was."""
    image = texture((33, 47, 3), 2)
    assert_pure(lambda: np.concatenate([costs.ravel() for costs in term(image)]), image)


SMOOTHNESS_CHECKS = (
    images_of_any_size_have_finite_costs,
    edges_of_color_cost_less,
    rows_and_columns_count_alike,
    same_term_at_any_number_of_threads,
)
"""One function a promise."""


def _of_boundaries(check: Callable[[Smoothness], None]) -> Callable[[BoundaryCost], None]:
    @wraps(check)
    def checked(cost: BoundaryCost) -> None:
        def between_pixels(image: NDArray[np.uint8]) -> tuple[NDArray[Any], NDArray[Any]]:
            height, width = image.shape[:2]
            graph = region_graph(np.arange(height * width, dtype=np.int32).reshape(height, width), image)
            costs = np.asarray(cost(graph))
            assert costs.shape == (len(graph.edges),), f"expected {(len(graph.edges),)}, got {costs.shape}"
            in_row = np.diff(graph.edges, axis=1)[:, 0] == 1
            return costs[in_row].reshape(height, width - 1), costs[~in_row].reshape(height - 1, width)

        check(between_pixels)

    return checked


def no_segment_has_no_boundary(cost: BoundaryCost) -> None:
    """An image of one segment has no boundaries, and no costs."""
    costs = np.asarray(cost(region_graph(np.zeros((4, 5), np.int32), texture((4, 5, 3)))))
    assert costs.shape == (0,), f"expected (0,), got {costs.shape}"


BOUNDARY_CHECKS = (*map(_of_boundaries, SMOOTHNESS_CHECKS), no_segment_has_no_boundary)
"""One function a promise."""
