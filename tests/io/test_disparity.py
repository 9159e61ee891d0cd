"""Disparity files: exact round trips, the formats of the benchmarks byte by byte."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from depthcli.core.errors import InputError
from depthcli.io.disparity import read_disparity, read_pfm, write_disparity_png, write_pfm
from depthcli.io.images import read_image, write_png

maps = hnp.arrays(np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.floats(width=32))


@given(maps)
@settings(max_examples=100, deadline=None)
def test_pfm_round_trip(values):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pfm"
        write_pfm(path, values)
        np.testing.assert_array_equal(read_pfm(path), np.where(np.isnan(values), np.float32(np.inf), values))
        np.testing.assert_array_equal(read_disparity(path), np.where(np.isfinite(values), values, np.float32(np.nan)))


@given(maps)
@settings(max_examples=50, deadline=None)
def test_kitti_png_round_trip(values):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.png"
        write_disparity_png(path, values)
        read = read_disparity(path)
    np.testing.assert_array_equal(np.isnan(read), ~np.isfinite(values))
    known = np.isfinite(values)
    kept = np.clip(values[known].astype(float), 1 / 256, 65535 / 256)
    assert np.all(np.abs(read[known] - kept) <= 0.5 / 256 + 1e-9)


def test_pfm_bytes_and_both_byte_orders(tmp_path: Path):
    values = np.array([[1, 2, np.nan], [4, 5, 6]], np.float32)
    path = tmp_path / "a.pfm"
    write_pfm(path, values)
    stored = np.array([[4, 5, 6], [1, 2, np.inf]])
    assert path.read_bytes() == b"Pf\n3 2\n-1\n" + stored.astype("<f4").tobytes()
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), stored[::-1])
    for header in (b"Pf\n3 2\n1.0\n", b"Pf 3 2 1\n", b"Pf\r\n3 2\r\n0.25\r\n"):
        path.write_bytes(header + stored.astype(">f4").tobytes())
        np.testing.assert_array_equal(read_disparity(path), values)
    path.write_bytes(b"PF\n3 2\n-1\n" + np.repeat(stored[..., None], 3, axis=2).astype("<f4").tobytes())
    np.testing.assert_array_equal(read_disparity(path), values)


@pytest.mark.parametrize("data", [
    b"", b"Pf", b"Pf\n3 2\n", b"Pf\n3 2\n0\n" + bytes(24), b"Pf\n3 2\nx\n" + bytes(24), b"Pf\n0 2\n-1\n",
    b"Pf\n3 2\n-1\n" + bytes(23), b"Pf\n3 2\n-1\n" + bytes(25), b"P5\n3 2\n-1\n" + bytes(24),
    b"Pf\n-3 2\n-1\n" + bytes(24), b"PF\n1 1\n-1\n" + bytes(range(12)), b"Pf\n3 2\n-\n" + bytes(24),
    b"Pf\n99999999 99999999\n-1\n" + bytes(24),
])  # fmt: skip
def test_bad_pfm(tmp_path: Path, data):
    (tmp_path / "bad.pfm").write_bytes(data)
    with pytest.raises(InputError, match=r"bad\.pfm"):
        read_disparity(tmp_path / "bad.pfm")


def test_codes_are_divided_by_their_scale(tmp_path: Path):
    path = tmp_path / "a.png"
    write_png(path, np.array([[0, 40, 255]], np.uint8))
    np.testing.assert_array_equal(read_disparity(path, 4), np.array([[np.nan, 10, 63.75]], np.float32))
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), np.array([[np.nan, 5, 31.875]], np.float32))
    with pytest.raises(InputError, match="disp_scale"):
        read_disparity(path)
    write_png(path, np.array([[0, 256, 640]], np.uint16))
    np.testing.assert_array_equal(read_disparity(path, scale_8bit=8), np.array([[np.nan, 1, 2.5]], np.float32))
    assert read_image(path).dtype == np.uint16


def test_npy(tmp_path: Path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([[1.5, np.inf, np.nan]]))
    np.testing.assert_array_equal(read_disparity(path), np.array([[1.5, np.nan, np.nan]], np.float32))
    np.save(path, np.array([[-16, 0, 24]], np.int16))  # OpenCV's fixed point, -16 = none
    np.testing.assert_array_equal(read_disparity(path, 16), np.array([[np.nan, np.nan, 1.5]], np.float32))
    for bad in (np.zeros(3), np.array([["a"]]), np.zeros((0, 3)), np.array([[{}]], object)):
        np.save(path, bad, allow_pickle=True)
        with pytest.raises(InputError, match=r"a\.npy"):
            read_disparity(path)
