"""Volumes: what is written reads back with SimpleITK, what is broken is one line."""

from __future__ import annotations

import gzip
import json
import warnings

import numpy as np
import pytest

from depthcli.algorithms.resampling import block_means, trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.io.volume_pairs import LoadedPair, label_masks

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    SimpleITK = pytest.importorskip("SimpleITK")

TURNED = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
TILTED = tuple(np.round(np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]), 12).ravel())
FLIPPED = (-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
HALF_TURN = (-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0)


def volume(vector=False):
    rng = np.random.default_rng(0)
    return rng.standard_normal((4, 5, 6, 3) if vector else (4, 5, 6)).astype(np.float32)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha", ".nrrd"])
@pytest.mark.parametrize("direction", [Grid.direction, TURNED, TILTED, FLIPPED, HALF_TURN])
@pytest.mark.parametrize("vector", [False, True])
def test_simpleitk_reads_what_is_written(tmp_path, suffix, direction, vector):
    values = volume(vector)
    grid = Grid((6, 5, 4), (0.7, 1.5, 2.5), (-12.5, 30.0, 7.0), direction)
    write_array(tmp_path / f"a{suffix}", grid, values)
    image = SimpleITK.ReadImage(str(tmp_path / f"a{suffix}"))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(image), values)
    np.testing.assert_allclose(image.GetSpacing(), grid.spacing, rtol=1e-6)
    np.testing.assert_allclose(image.GetOrigin(), grid.origin, rtol=1e-5)
    np.testing.assert_allclose(image.GetDirection(), direction, atol=1e-5)
    back = read_volume(tmp_path / f"a{suffix}", vector)
    np.testing.assert_array_equal(back.values, values)
    assert back.grid.same_as(grid)


def test_points_and_places():
    grid = Grid((6, 5, 4), (0.7, 1.5, 2.5), (-12.5, 30.0, 7.0), TILTED)
    image = SimpleITK.Image([6, 5, 4], SimpleITK.sitkFloat32)
    image.SetSpacing(grid.spacing)
    image.SetOrigin(grid.origin)
    image.SetDirection(grid.direction)
    point = np.array([[-10.0, 33.0, 12.0]])
    place = image.TransformPhysicalPointToContinuousIndex(point[0].tolist())
    np.testing.assert_allclose(grid.to_index(point)[0], place[::-1])
    np.testing.assert_allclose(grid.to_point(grid.to_index(point)), point)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (Grid((6, 6, 5), (1.0, 1.0, 1.0)), "size 6 x 6 x 6, expected 6 x 6 x 5"),
        (Grid((6, 6, 6), (1.0, 1.0, 1.5)), "spacing 1 1 1, expected 1 1 1.5"),
        (Grid((6, 6, 6), (1.0, 1.0, 1.0), (0.0, 9.0, 0.0)), "origin 0 0 0, expected 0 9 0"),
        # The corners on the diagonal stay where they are.
        (Grid((6, 6, 6), (1.0, 1.0, 1.0), direction=(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)), "direction 1 0 0"),
    ],
)
def test_grids_that_differ(other, said):
    grid = Grid((6, 6, 6), (1.0, 1.0, 1.0))
    assert grid.same_as(grid) and not grid.same_as(other)
    assert grid.describe_difference(other).startswith(said)


def test_linear_at_voxels_between_and_outside():
    values = volume()
    places = np.array([[1, 2, 3], [1.5, 2, 3], [-4, 2, 3], [9, 9, 9]], float)
    expected = [values[1, 2, 3], (values[1, 2, 3] + values[2, 2, 3]) / 2, values[0, 2, 3], values[3, 4, 5]]
    np.testing.assert_allclose(trilinear(values, places), expected, rtol=1e-6)


def test_block_means():
    values = np.random.default_rng(3).standard_normal((5, 6, 7)).astype(np.float32)
    found = block_means(values, (2, 1, 3))
    assert found.shape == (3, 6, 3) and found.dtype == np.float32
    for z, y, x in np.ndindex(3, 6, 3):
        assert found[z, y, x] == pytest.approx(values[2 * z : 2 * z + 2, y, 3 * x : 3 * x + 3].mean(), abs=1e-6)
    assert block_means(values, (1, 1, 1)) is values


def test_maps_of_blocks_lie_where_the_blocks_are():
    """The mean of a block of a ramp is the ramp at the block's center."""
    shape, blocks = (4, 6, 9), (2, 1, 3)
    ramps = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij")).astype(np.float32)
    means = [block_means(ramp, blocks) for ramp in ramps]
    pair = RegisteredPair(means[0], means[1], (2.0, 1.0, 3.0))
    start, step = LoadedPair(pair, Grid(shape[::-1], (1.0, 1.0, 1.0)), blocks).on_grid((0.5, 0, 1), (0.5, 2, 1))
    for axis, (first, by) in enumerate(((0.5, 0.5), (0, 2), (1, 1))):
        line = means[axis][tuple(slice(None) if a == axis else 0 for a in range(3))]
        places = first + by * np.arange(2)
        np.testing.assert_allclose(
            np.interp(places, np.arange(len(line)), line), start[axis] + step[axis] * np.arange(2)
        )


def refused(path, match):
    with pytest.raises(InputError, match=match) as caught:
        read_volume(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_damaged_files_are_one_line(tmp_path):
    grid = Grid((6, 5, 4), (1.0, 1.0, 1.0))
    for suffix in (".nii", ".nii.gz", ".mha", ".nrrd"):
        write_array(tmp_path / f"a{suffix}", grid, volume())
        data = (tmp_path / f"a{suffix}").read_bytes()
        (tmp_path / f"cut{suffix}").write_bytes(data[: len(data) * 2 // 3])
        refused(tmp_path / f"cut{suffix}", "cut off|cannot be read")
        (tmp_path / f"empty{suffix}").write_bytes(b"")
        refused(tmp_path / f"empty{suffix}", "cut off|cannot be read|gzip")
        refused(tmp_path / f"none{suffix}", "no such file|cannot be read")


def test_a_short_payload_in_a_whole_gzip_file(tmp_path):
    write_array(tmp_path / "a.nii", Grid((6, 5, 4), (1.0, 1.0, 1.0)), volume())
    data = (tmp_path / "a.nii").read_bytes()
    (tmp_path / "b.nii.gz").write_bytes(gzip.compress(data[:600]))
    refused(tmp_path / "b.nii.gz", "cut off: 600 bytes")


def test_spacing_of_zero_and_long_text(tmp_path):
    write_array(tmp_path / "a.mha", Grid((6, 5, 4), (1.0, 1.0, 1.0)), volume())
    whole = (tmp_path / "a.mha").read_bytes()
    (tmp_path / "a.mha").write_bytes(whole.replace(b"ElementSpacing = 1 1 1", b"ElementSpacing = 1 0 1"))
    refused(tmp_path / "a.mha", "spacing")
    (tmp_path / "a.mha").write_bytes(whole.replace(b"NDims = 3", b"NDims = 3\nName = " + b"x" * 300))
    refused(tmp_path / "a.mha", "characters")  # which ends the process in MetaIO


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha"])
@pytest.mark.parametrize("vector", [False, True])
def test_what_is_no_number_stays_none(tmp_path, suffix, vector):
    values = volume(vector)  # ITK reads them as 0 from NIfTI
    values[2, 3, 4], values[0, 0, 1] = np.nan, np.inf
    write_array(tmp_path / f"a{suffix}", Grid((6, 5, 4), (1.0, 1.0, 1.0)), values)
    read = read_volume(tmp_path / f"a{suffix}", vector).values
    assert np.array_equal(np.isfinite(read), np.isfinite(values))
    np.testing.assert_array_equal(read[np.isfinite(read)], values[np.isfinite(values)])


def test_four_dimensions_and_vectors(tmp_path):
    series = SimpleITK.JoinSeries([SimpleITK.GetImageFromArray(volume())] * 2)
    SimpleITK.WriteImage(series, str(tmp_path / "four.nii.gz"))
    refused(tmp_path / "four.nii.gz", "4-D")
    write_array(tmp_path / "field.mha", Grid((6, 5, 4), (1.0, 1.0, 1.0)), volume(True))
    refused(tmp_path / "field.mha", "3 values a voxel, want 1")


def test_dirlab_raw(tmp_path):
    values = np.arange(24, dtype="<i2").reshape(2, 3, 4)
    (tmp_path / "case.img").write_bytes(values.tobytes())
    refused(tmp_path / "case.img", '"size" and "spacing"')
    (tmp_path / "meta.json").write_text(json.dumps({"size": [4, 3, 2], "spacing": [0.97, 0.97, 2.5]}))
    read = read_volume(tmp_path / "case.img")
    np.testing.assert_array_equal(read.values, values)
    assert read.grid.spacing == (0.97, 0.97, 2.5)
    (tmp_path / "case.img").write_bytes(values.tobytes()[:-2])
    refused(tmp_path / "case.img", "46 bytes, want 48")


def labels_of(values, regions=()):
    return {name: np.flatnonzero(mask).tolist() for name, mask in label_masks(np.float32([values]), "m", regions)}


def test_labels_of_a_mask():
    assert labels_of([0, 1, 1]) == {"m": [1, 2]} and labels_of([0, 255]) == {"m": [1]}
    assert labels_of([0, 2, 2]) == {"m_2": [1, 2]} and labels_of([3, 0, 1]) == {"m_1": [2], "m_3": [0]}
    assert labels_of([0, 1.0000001, 2]) == {"m_1": [1], "m_2": [2]}  # what is left of rounding
    assert labels_of([0, 0.3, 0.5, np.nan]) == {"m": [2]}
    assert labels_of([0, 1, 7], [("liver", 1), ("spleen", 2)]) == {"liver": [1], "spleen": [], "m_7": [2]}
    assert labels_of([0, 0]) == {"m": []}
    with pytest.raises(InputError, match="2001 values up to 2001: no label map"):
        labels_of(range(2002))  # a scan
    assert len(labels_of(range(2001))) == 2000
    with pytest.raises(InputError, match=r"values up to 1.67772e\+07: no label map"):
        labels_of([1, 2**24 + 2])
    with pytest.raises(InputError, match="nearest neighbor"):
        labels_of([0, 1, 14172.01])  # blurred, though but little in proportion
    for values, regions in (([0, 1.4, 2], ()), ([0, 0.4, 1], [("liver", 1)])):
        with pytest.raises(InputError, match="resample labels by the nearest neighbor"):
            labels_of(values, regions)
