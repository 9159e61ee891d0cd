"""What every refinement step promises."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.refinement import Refinement
from depthcli.methods.stereo.volume import CostVolume, RefinementContext
from depthcli.testing.inputs import TINY, assert_pure, blocky_pair, changed, random_volume, run_checks, shifted_pair


def check_refinement(step: Refinement) -> None:
    """Raise AssertionError unless a refinement step keeps all promises to pipelines; takes some seconds."""
    run_checks(step, CHECKS)


def noisy_case(
    height: int, width: int, disparities: int, seed: int = 0, color: bool = True
) -> tuple[DisparityMap, RefinementContext]:
    """Return winners of random costs with holes of every kind, and their context."""
    rng = np.random.default_rng(seed)
    volume = random_volume(height, width, disparities, np.uint16, seed)
    left, right = winners(volume.costs)
    values = left.astype(np.float32)
    reason = rng.choice([0, Status.OCCLUDED, Status.MISMATCH, Status.NO_DATA], (height, width), p=[0.7, 0.1, 0.1, 0.1])
    values[reason != 0] = np.nan
    return DisparityMap(values, reason.astype(np.uint8)), RefinementContext(
        blocky_pair(height, width, color), volume, right
    )


def tiny_maps_and_wide_ranges(step: Refinement) -> None:
    """Maps of any size stay within the range; no value is infinite."""
    for height, width, disparities in TINY:
        for color in (False, True):
            disparity, evidence = noisy_case(height, width, disparities, width, color)
            result = step(disparity, evidence)
            assert result.values.shape == (height, width), f"expected {(height, width)}, got {result.values.shape}"
            assert not np.isinf(result.values).any(), "a value is infinite"
            known = result.values[result.valid]
            assert np.all((known >= 0) & (known <= disparities - 1)), f"a value is outside 0 .. {disparities - 1}"


def the_map_depends_on_the_halo_alone(step: Refinement) -> None:
    """A band of rows with the margin of ``halo()`` has the values of the whole map; None promises nothing."""
    halo = step.halo()
    if halo is None:
        return
    height = 2 * halo + 40
    disparity, context = noisy_case(height, 60, 20, 4)
    rows = slice(9, height - 7)
    pair, volume = context.pair, context.volume
    assert isinstance(volume, CostVolume)
    band = RefinementContext(
        changed(pair, lambda image: image[rows]),
        CostVolume(np.ascontiguousarray(volume.costs[rows]), volume.scale),
        context.right[rows],
    )
    part = step(DisparityMap(disparity.values[rows].copy(), disparity.status[rows].copy()), band)
    whole = step(disparity, context)
    inner = slice(halo, part.values.shape[0] - halo)
    np.testing.assert_array_equal(part.values[inner], whole.values[rows][inner])
    np.testing.assert_array_equal(part.status[inner], whole.status[rows][inner])


def every_pixel_without_value_has_a_reason(step: Refinement) -> None:
    """Pixels without a value have a reason in the status, new values are marked as filled."""
    disparity, evidence = noisy_case(30, 50, 20, 1)
    result = step(disparity, evidence)
    reasons = Status.OCCLUDED | Status.MISMATCH | Status.OUT_OF_RANGE | Status.NO_DATA
    assert np.all(result.status[~result.valid] & reasons), "a pixel has neither value nor reason"
    # A value that appeared is marked as filled, and keeps the reason for its absence.
    appeared = result.valid & ~disparity.valid
    assert np.all(result.status[appeared] & Status.FILLED), "a new value is not marked as FILLED"
    assert np.all(result.status[appeared] & disparity.status[appeared]), "a filled pixel lost its reason"


def same_map_at_any_number_of_threads(step: Refinement) -> None:
    """The map does not depend on the number of threads, and the inputs stay as they were."""
    disparity, evidence = noisy_case(41, 70, 20, 2)
    volume = evidence.volume
    assert isinstance(volume, CostVolume)

    def run() -> NDArray[np.float32]:
        result = step(disparity, evidence)
        return np.stack([np.nan_to_num(result.values, nan=-1), result.status])

    assert_pure(run, disparity.values, disparity.status, volume.costs, evidence.right, evidence.pair.left)


def a_perfect_map_stays(step: Refinement) -> None:
    """A perfect map of a plane keeps its values, and gets no other status than SMOOTHED."""
    shift = 6
    pair = shifted_pair(30, 60, shift)
    volume = AbsoluteDifference()(pair, 14)
    left, right = winners(volume.costs)
    interior = np.s_[4:-4, shift + 6 : -4]
    values = np.full(left.shape, shift, np.float32)
    assert np.mean(left[interior] == shift) > 0.9
    right = np.where(np.arange(60) < 60 - shift, np.uint16(shift), right).astype(np.uint16)
    context = RefinementContext(pair, volume, right)
    result = step(DisparityMap(values, np.zeros(left.shape, np.uint8)), context)
    assert np.all(np.abs(result.values[interior] - shift) <= 0.5), "a value moved by more than half a pixel"
    assert not np.any(result.status[interior] & ~np.uint8(Status.SMOOTHED)), "a status changed"


def a_map_without_any_value_is_no_error(step: Refinement) -> None:
    """A map without any value gives a map without infinite values."""
    _, evidence = noisy_case(12, 20, 8, 3)
    empty = DisparityMap(np.full((12, 20), np.nan, np.float32), np.full((12, 20), Status.MISMATCH, np.uint8))
    result = step(empty, evidence)
    assert not np.isinf(result.values).any(), "a value is infinite"


CHECKS = (
    tiny_maps_and_wide_ranges,
    the_map_depends_on_the_halo_alone,
    every_pixel_without_value_has_a_reason,
    same_map_at_any_number_of_threads,
    a_perfect_map_stays,
    a_map_without_any_value_is_no_error,
)
"""One function a promise."""
