"""Filled values that are replaced by those of other directions."""

import cv2
import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.kernels.winners import winners
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.directional_fill import DirectionalFill
from depthcli.methods.stereo.volume import CostVolume, RefinementContext
from depthcli.testing.inputs import TINY, blocky_pair, random_volume
from tests.naive import stereo as naive


def filled_case(height, width, disparities, seed=0):
    """A map of blocks with gaps that were filled, and what belongs to it."""
    rng = np.random.default_rng(seed)
    volume = random_volume(height, width, disparities, np.uint16, seed)
    blocks = rng.uniform(0, disparities - 1, (height // 6 + 1, width // 6 + 1)).repeat(6, 0).repeat(6, 1)
    gaps = (rng.random((height // 4 + 1, width // 4 + 1)) < 0.4).repeat(4, 0).repeat(4, 1)[:height, :width]
    values = np.where(gaps, np.float32(np.nan), blocks[:height, :width].astype(np.float32))
    context = RefinementContext(blocky_pair(height, width), volume, winners(volume.costs)[1])
    return BackgroundFill()(DisparityMap(values, gaps * np.uint8(Status.OCCLUDED)), context), context


@pytest.mark.parametrize(("height", "width", "disparities"), [*TINY, (11, 23, 19), (26, 61, 40)])
@pytest.mark.parametrize("scales", [(3.0, 40.0), (40.0, 5.0)])
def test_against_the_reference(height, width, disparities, scales):
    disparity, context = filled_case(height, width, disparities)
    step = DirectionalFill(color_scale=scales[0], distance_scale=scales[1])
    measured = ~np.isnan(disparity.values) & (disparity.status & Status.FILLED == 0)
    image = cv2.GaussianBlur(context.pair.color8[0], (7, 7), 1.0)
    expected, decided = naive.directional_fill(disparity.values, measured, image, context.right, *scales)
    result = step(disparity, context)
    np.testing.assert_array_equal(result.values[decided], expected[decided])
    np.testing.assert_array_equal(result.status, disparity.status)
    np.testing.assert_array_equal(result.values[measured], disparity.values[measured])
    if height == 26:
        assert np.count_nonzero(result.values != disparity.values) > 10


def between_two_boards():
    """A wall seen between two boards, where the fill took the farther board."""
    values, gap = np.full((60, 90), np.float32(5)), np.zeros((60, 90), np.bool_)
    values[20:, :40], values[20:, 40:60], values[20:, 60:] = 20, np.nan, 30
    colors = np.full((60, 90, 3), (90, 140, 90), np.uint8)
    colors[20:, :40], colors[20:, 60:] = (200, 60, 60), (60, 60, 200)
    gap[20:, 40:60] = True
    right = np.full((60, 90), 40, np.uint16)  # contradicts nothing
    context = RefinementContext(StereoPair(colors, colors), CostVolume(np.zeros((60, 90, 41), np.uint8)), right)
    disparity = BackgroundFill()(DisparityMap(values, gap * np.uint8(Status.OCCLUDED)), context)
    assert np.all(disparity.values[gap] == 20)
    return disparity, context, gap


def test_a_gap_takes_the_surface_that_no_edge_separates_from_it_and_the_right_view_does_not_contradict():
    disparity, context, gap = between_two_boards()
    result = DirectionalFill()(disparity, context)
    assert np.all(result.values[20:, 43:57] == 5)  # nearer to the boards the smoothed image mixes the colors
    np.testing.assert_array_equal(result.values[~gap], disparity.values[~gap])
    seen = RefinementContext(context.pair, context.volume, np.zeros_like(context.right))
    before = DirectionalFill(distance_scale=16)(disparity, context).values[gap]
    contradicted = DirectionalFill(distance_scale=16)(disparity, seen).values[gap]
    assert 0 < np.count_nonzero(contradicted == 5) < np.count_nonzero(before == 5)
