"""Bounds of completed depth: what widens them, and what is known of the surroundings of a pixel."""

from __future__ import annotations

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
    rng = np.random.default_rng(0)
    sensor = (1 + 0.002 * rng.standard_normal(SHAPE)).astype(np.float32)
    status = np.zeros(SHAPE, np.uint8)
    sparse = np.where(rng.random(SHAPE) < 0.1, np.float32(1), np.float32(np.nan)) + 0.008 * rng.standard_normal(SHAPE)
    sparse = sparse.astype(np.float32)
    sparse[20:70, 70:] = np.nan
    status[30:60, 10:40] = DepthStatus.GAP_FILLED
    values = np.where(status > 0, np.float32(1), sensor)
    sensor[status > 0] = np.nan
    values[0, 0], status[0, 0] = np.nan, DepthStatus.EMPTY
    return SparseFrame(np.full((*SHAPE, 3), 90, np.uint8), sensor, sparse=sparse), DepthMap(values, status)


def median(frame: SparseFrame, found: DepthMap, rows: slice, columns: slice) -> float:
    bound, _ = glass_bounds(glass_errors(), frame, found, 0.9, 0.03)
    return float(np.median(bound[rows, columns]))


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
    around, unsampled = (slice(72, 90), slice(0, 60)), (slice(35, 55), slice(90, 120))
    filled = slice(35, 55), slice(15, 35)
    assert median(frame, found, *around) < 0.03
    assert median(frame, found, *unsampled) > 5 * median(frame, found, *around)
    wrong = np.where(np.isnan(frame.depth) & np.isfinite(frame.sparse), np.float32(0.8), frame.sparse)
    assert median(replace(frame, sparse=wrong), found, *filled) > 2 * median(frame, found, *filled)
    objects = np.isnan(frame.depth)
    assert median(replace(frame, objects=objects), found, *filled) > 2 * median(frame, found, *filled)
    bound, probability = glass_bounds(glass_errors(), frame, found, 0.9, 0.03)
    assert np.isnan(bound[0, 0]) and probability[0, 0] == 0 and np.isfinite(bound[found.valid]).all()
