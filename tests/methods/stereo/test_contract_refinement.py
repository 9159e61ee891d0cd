"""What every refinement step promises: the folder says which there are."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.volume import RefinementContext
from tests.methods.stereo._pairs import TINY, assert_pure, blocky_pair, methods, random_volume, shifted_pair

STEPS = methods("depthcli.methods.stereo.refinement")


def noisy_case(height: int, width: int, disparities: int, seed: int = 0, color: bool = True):
    """Winners of random costs with holes of every kind, and what belongs to them."""
    rng = np.random.default_rng(seed)
    volume = random_volume(height, width, disparities, np.uint16, seed)
    left, right = winners(volume.costs)
    values = left.astype(np.float32)
    reason = rng.choice([0, Status.OCCLUDED, Status.MISMATCH, Status.NO_DATA], (height, width), p=[0.7, 0.1, 0.1, 0.1])
    values[reason != 0] = np.nan
    return DisparityMap(values, reason.astype(np.uint8)), RefinementContext(
        blocky_pair(height, width, color), volume, right
    )


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize(("height", "width", "disparities"), TINY)
def test_tiny_images_and_wide_ranges(step, height, width, disparities):
    for color in (False, True):
        disparity, evidence = noisy_case(height, width, disparities, width, color)
        result = step(disparity, evidence)
        assert result.values.shape == (height, width)
        assert not np.isinf(result.values).any()
        known = result.values[result.valid]
        assert np.all((known >= 0) & (known <= disparities - 1))


@pytest.mark.parametrize("step", STEPS)
def test_the_map_depends_on_the_rows_within_the_halo_alone(step):
    """A band of rows with this margin has the values of the whole map."""
    halo = step.halo()
    if halo is None:
        pytest.skip("depends on the whole map, as it says")
    height = 2 * halo + 40
    disparity, context = noisy_case(height, 60, 20, 4)
    rows = slice(9, height - 7)
    pair, volume = context.pair, context.volume
    band = RefinementContext(
        type(pair)(pair.left[rows], pair.right[rows]),
        type(volume)(np.ascontiguousarray(volume.costs[rows]), volume.scale),
        context.right[rows],
    )
    part = step(DisparityMap(disparity.values[rows].copy(), disparity.status[rows].copy()), band)
    whole = step(disparity, context)
    inner = slice(halo, part.values.shape[0] - halo)
    np.testing.assert_array_equal(part.values[inner], whole.values[rows][inner])
    np.testing.assert_array_equal(part.status[inner], whole.status[rows][inner])


@pytest.mark.parametrize("step", STEPS)
def test_every_pixel_without_value_has_a_reason(step):
    disparity, evidence = noisy_case(30, 50, 20, 1)
    result = step(disparity, evidence)
    reasons = Status.OCCLUDED | Status.MISMATCH | Status.OUT_OF_RANGE | Status.NO_DATA
    assert np.all(result.status[~result.valid] & reasons)
    # A value that appeared is marked as filled, and keeps the reason for its absence.
    appeared = result.valid & ~disparity.valid
    assert np.all(result.status[appeared] & Status.FILLED)
    assert np.all(result.status[appeared] & disparity.status[appeared])


@pytest.mark.parametrize("step", STEPS)
def test_same_bytes_at_any_thread_count_and_inputs_untouched(step):
    disparity, evidence = noisy_case(41, 70, 20, 2)

    def run():
        result = step(disparity, evidence)
        return np.stack([np.nan_to_num(result.values, nan=-1), result.status])

    assert_pure(run, disparity.values, disparity.status, evidence.volume.costs, evidence.right, evidence.pair.left)


@pytest.mark.parametrize("step", STEPS)
def test_a_perfect_map_stays(step):
    shift = 6
    pair = shifted_pair(30, 60, shift)
    volume = AbsoluteDifference()(pair, 14)
    left, right = winners(volume.costs)
    interior = np.s_[4:-4, shift + 6 : -4]
    values = np.full(left.shape, shift, np.float32)
    assert np.mean(left[interior] == shift) > 0.9
    result = step(DisparityMap(values, np.zeros(left.shape, np.uint8)), RefinementContext(pair, volume, np.where(
        np.arange(60) < 60 - shift, np.uint16(shift), right).astype(np.uint16)))  # fmt: skip
    assert np.all(np.abs(result.values[interior] - shift) <= 0.5)
    assert not np.any(result.status[interior] & ~np.uint8(Status.SMOOTHED))


@pytest.mark.parametrize("step", STEPS)
def test_a_map_without_any_value_does_not_crash(step):
    _, evidence = noisy_case(12, 20, 8, 3)
    empty = DisparityMap(np.full((12, 20), np.nan, np.float32), np.full((12, 20), Status.MISMATCH, np.uint8))
    result = step(empty, evidence)
    assert not np.isinf(result.values).any()
