"""Bounds of completed depth: what widens them, and what is known of the surroundings of a pixel."""

from dataclasses import replace

import numpy as np
import pytest

from depthcli.core.frames import SparseFrame
from depthcli.core.maps import DepthMap, DepthStatus
from depthcli.methods.transparent.bounds import EVIDENCE, evidence, glass_bounds
from depthcli.problems.frames import glass_errors

SHAPE = 90, 120


def frame_and_map() -> tuple[SparseFrame, DepthMap]:
    """Return a wall at 1 m with a gap on the left, and samples but for a region on the right."""
    rng, status = np.random.default_rng(0), np.zeros(SHAPE, np.uint8)
    sensor = (1 + 0.002 * rng.standard_normal(SHAPE)).astype(np.float32)
    sparse = np.where(rng.random(SHAPE) < 0.1, 1 + 0.008 * rng.standard_normal(SHAPE), np.nan).astype(np.float32)
    sparse[20:70, 70:] = np.nan
    status[30:60, 10:40] = DepthStatus.GAP_FILLED
    values = np.where(status > 0, np.float32(1), sensor)
    sensor[status > 0] = np.nan
    values[0, 0], status[0, 0] = np.nan, DepthStatus.EMPTY
    return SparseFrame(np.full((*SHAPE, 3), 90, np.uint8), sensor, sparse=sparse), DepthMap(values, status)


def test_evidence_by_hand():
    frame, found = frame_and_map()
    planes = dict(zip(EVIDENCE, evidence(frame, found), strict=True))
    sampled = np.isfinite(frame.sparse)
    assert np.isfinite(list(planes.values())).all()
    np.testing.assert_allclose(planes["distance"][sampled], np.log2(1 / 120), rtol=1e-6)
    assert planes["noise"][80, 60] == pytest.approx(np.log2(0.002) - 0.92, abs=0.5), "mean of logarithms"
    assert planes["gap"][45, 100] > 2 > 1 > np.median(planes["gap"][75:, :60])
    assert planes["border"][45, 25] == pytest.approx(np.log2(16 / 120), abs=0.1)
    nothing = replace(frame, sparse=np.full(SHAPE, np.nan, np.float32))
    assert np.isfinite(evidence(nothing, found)).all()


def test_bounds_are_wide_where_nothing_was_measured():
    frame, found = frame_and_map()

    def bounds(**changes):
        return glass_bounds(glass_errors(), replace(frame, **changes), found, 0.9, 0.03)

    bound, probability = bounds()
    around, unsampled = np.median(bound[72:90, :60]), np.median(bound[35:55, 90:120])
    assert around < 0.03 and unsampled > 5 * around
    blind, filled = np.isnan(frame.depth), np.s_[35:55, 15:35]
    wrong = np.where(blind & np.isfinite(frame.sparse), np.float32(0.8), frame.sparse)
    for wider, _ in (bounds(sparse=wrong), bounds(objects=blind)):
        assert np.median(wider[filled]) > 2 * np.median(bound[filled])
    assert np.isnan(bound[0, 0]) and probability[0, 0] == 0 and np.isfinite(bound[found.valid]).all()
