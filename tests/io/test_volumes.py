"""Volumes: what is written reads back with SimpleITK, what is broken is one line."""

import gzip
import locale
import os
import re
import shutil
import struct
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from depthcli.algorithms.resampling import block_means, trilinear
from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.io.formats.volumes import read_grid, read_volume, transform_files, volume_files, write_array
from depthcli.io.scenes import VolumePairScene
from depthcli.io.scenes.kinds import distortion_map
from depthcli.io.volume_pairs import LoadedPair, label_masks, load_volumes, true_errors
from tests.files import laid
from tests.golden import refused, warned

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    SimpleITK = pytest.importorskip("SimpleITK")

TURNED = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
TILTED = tuple(np.round(np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]), 12).ravel())
FLIPPED = (-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
HALF_TURN = (-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0)
OBLIQUE = [  # by nearly half a turn about an axis that lies nearest to x, y or z
    tuple(Rotation.from_rotvec(np.radians(angle) * np.array(axis) / 3).as_matrix().ravel())
    for axis, angle in (((2, 1, 2), 175), ((1, 2, 2), -175), ((1, -2, 2), 170), ((2, 2, -1), -170))
]
UNIT = Grid((6, 5, 4), (1.0, 1.0, 1.0))
VALUES = np.random.default_rng(0).standard_normal((4, 5, 6)).astype(np.float32)
VECTORS = np.random.default_rng(0).standard_normal((4, 5, 6, 3)).astype(np.float32)


def by_quaternion(header):
    """Directions in LPS by the quaternion of a NIfTI header, which ITK leaves aside where there is a matrix, too."""
    (third,), (b, c, d) = struct.unpack_from("<f", header, 76), struct.unpack_from("<3f", header, 256)
    turn = Rotation.from_quat([b, c, d, np.sqrt(max(0, 1 - b * b - c * c - d * d))]).as_matrix()
    return (np.diag([-1, -1, 1]) @ turn @ np.diag([1, 1, third])).ravel()


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha", ".nrrd"])
@pytest.mark.parametrize("direction", [Grid.direction, TURNED, TILTED, FLIPPED, HALF_TURN, *OBLIQUE])
@pytest.mark.parametrize("vector", [False, True])
def test_simpleitk_reads_what_is_written(tmp_path, suffix, direction, vector):
    values, path = (VECTORS if vector else VALUES).copy(), tmp_path / f"a{suffix}"
    values[2, 3, 4], values[0, 0, 1] = np.nan, np.inf
    known = np.isfinite(values)
    grid = Grid((6, 5, 4), (0.7, 1.5, 2.5), (-12.5, 30.0, 7.0), direction)
    write_array(path, grid, values)
    image = SimpleITK.ReadImage(str(path))
    np.testing.assert_array_equal(SimpleITK.GetArrayFromImage(image)[known], values[known])
    np.testing.assert_allclose(image.GetSpacing(), grid.spacing, rtol=1e-6)
    np.testing.assert_allclose(image.GetOrigin(), grid.origin, rtol=1e-5)
    np.testing.assert_allclose(image.GetDirection(), direction, atol=1e-5)
    if suffix == ".nii":
        np.testing.assert_allclose(by_quaternion(path.read_bytes()), direction, atol=1e-3)
    stderr = os.fstat(2)
    back = read_volume(path, vector)
    assert os.path.samestat(os.fstat(2), stderr)  # it is silenced while the library reads
    np.testing.assert_array_equal(np.isfinite(back.values), known)  # ITK reads what is no number as 0 from NIfTI
    np.testing.assert_array_equal(back.values[known], values[known])
    assert back.grid.same_as(grid)
    point = np.array([[-10.0, 33.0, 12.0]])
    place = image.TransformPhysicalPointToContinuousIndex(point[0].tolist())
    np.testing.assert_allclose(back.grid.to_index(point)[0], place[::-1])
    np.testing.assert_allclose(back.grid.to_point(back.grid.to_index(point)), point)


def test_grids_that_differ():
    grid = Grid((6, 6, 6), (1.0, 1.0, 1.0))
    assert [grid.same_as(replace(grid, origin=(x, 0.0, 0.0))) for x in (0, 0.009, 0.011)] == [True, True, False]
    turned = (0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)  # the corners on the diagonal stay where they are
    for change, said in (
        ({"size": (6, 6, 5)}, "size 6 x 6 x 6, expected 6 x 6 x 5"),
        ({"spacing": (1.0, 1.0, 1.5)}, "spacing 1 1 1, expected 1 1 1.5"),
        ({"origin": (0.0, 9.0, 0.0)}, "origin 0 0 0, expected 0 9 0"), ({"direction": turned}, "direction 1 0 0"),
    ):  # fmt: skip
        other = replace(grid, **change)
        assert not grid.same_as(other) and grid.describe_difference(other).startswith(said)


def test_linear_at_voxels_between_and_outside():
    places = np.array([[1, 2, 3], [1.5, 2, 3], [-4, 2, 3], [9, 9, 9]], float)
    expected = [VALUES[1, 2, 3], (VALUES[1, 2, 3] + VALUES[2, 2, 3]) / 2, VALUES[0, 2, 3], VALUES[3, 4, 5]]
    np.testing.assert_allclose(trilinear(VALUES, places), expected, rtol=1e-6)


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
        found = np.interp(first + by * np.arange(2), np.arange(len(line)), line)
        np.testing.assert_allclose(found, start[axis] + step[axis] * np.arange(2))


def unreadable(path):
    assert str(path) in refused(InputError, read_volume, path)


def test_damaged_files_and_other_kinds_of_volume_are_one_line(tmp_path, monkeypatch):
    for suffix in (".nii", ".nii.gz", ".mha", ".nrrd"):
        write_array(tmp_path / f"a{suffix}", UNIT, VALUES)
        data = (tmp_path / f"a{suffix}").read_bytes()
        laid(tmp_path, {f"cut{suffix}": data[: len(data) * 2 // 3], f"empty{suffix}": b""})
        for name in ("cut", "empty", "none"):
            unreadable(tmp_path / f"{name}{suffix}")
    whole = (tmp_path / "a.mha").read_bytes()
    others = dict.fromkeys(("a.dcm", "a.vtk", "a"), whole)  # the library knows tens of formats, which are not tried
    laid(tmp_path, others | {
        "short.nii.gz": gzip.compress((tmp_path / "a.nii").read_bytes()[:600]),
        "zero.mha": whole.replace(b"ElementSpacing = 1 1 1", b"ElementSpacing = 1 0 1"),
        "wide.mha": whole.replace(b"ElementSpacing = 1 1 1", b"ElementSpacing = 1 2e12 1"),
        "long.mha": whole.replace(b"NDims = 3", b"NDims = 3\nName = " + b"x" * 300),  # which ends the process in MetaIO
    })  # fmt: skip
    series = SimpleITK.JoinSeries([SimpleITK.GetImageFromArray(VALUES)] * 2)
    SimpleITK.WriteImage(series, str(tmp_path / "four.nii.gz"))
    write_array(tmp_path / "field.mha", UNIT, VECTORS)
    (tmp_path / "frames").mkdir()
    frames = SimpleITK.GetImageFromArray(np.arange(90, dtype=np.uint16).reshape(3, 5, 6))
    SimpleITK.WriteImage(frames, str(tmp_path / "frames" / "a.dcm"))
    shutil.copy(tmp_path / "a.mha", tmp_path / os.fsdecode(b"caf\xe9.mha"))
    refused(InputError, read_volume, tmp_path / os.fsdecode(b"caf\xe9.mha"))
    for name in ("short.nii.gz", "zero.mha", "wide.mha", "long.mha", "four.nii.gz", "field.mha", "frames", *others):
        unreadable(tmp_path / name)
    monkeypatch.setitem(sys.modules, "SimpleITK", None)  # without the library the extra is named
    unreadable(tmp_path / "a.mha")


def slices(folder: Path, places: list[str], series: str = "1") -> Path:
    """A folder of a DICOM slice at every place, (x, y, z) in mm."""
    folder.mkdir(exist_ok=True)
    before = locale.setlocale(locale.LC_ALL)  # writing DICOM, which the program does not, leaves the C locale
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for k, place in enumerate(places):
        image = SimpleITK.GetImageFromArray(np.full((5, 6), k, np.int16))
        tags = {"0008|0060": "CT", "0020|000d": "1.2", "0020|000e": f"1.2.{series}", "0020|0013": str(k),
                "0008|0018": f"1.2.{series}.{k + 1}", "0020|0032": place, "0020|0037": "1\\0\\0\\0\\1\\0"}  # fmt: skip
        for tag, text in tags.items():
            image.SetMetaData(tag, text)
        writer.SetFileName(str(folder / f"{series}_{k}.dcm"))
        writer.Execute(image)
    locale.setlocale(locale.LC_ALL, before)
    return folder


def test_dicom_slices_that_are_no_volume_are_refused(tmp_path):
    assert read_volume(slices(tmp_path / "whole", ["0\\0\\2", "0\\0\\5"])).grid.spacing == (1, 1, 3)
    slices(tmp_path / "twice", ["0\\0\\2", "0\\0\\5", "0\\0\\5.01", "0\\0\\8"])
    slices(tmp_path / "time", ["0\\0\\2"] * 3)
    for file in slices(tmp_path / "nowhere", ["0\\0\\2", "0\\0\\5"]).iterdir():
        file.write_bytes(re.sub(rb"\x20\x00\x32\x00\x06\x00\x00\x00.{6}", b"", file.read_bytes(), flags=re.DOTALL))
    slices(slices(tmp_path / "two", ["0\\0\\2", "0\\0\\5"]), ["0\\0\\2"], "2")
    for name in ("twice", "time", "nowhere", "two"):
        unreadable(tmp_path / name)


def test_images_and_a_single_volume_of_four_dimensions(tmp_path):
    plane = np.arange(30, dtype=np.uint8).reshape(5, 6)
    volume = read_volume(laid(tmp_path, {"a.png": plane}) / "a.png")
    np.testing.assert_array_equal(volume.values, plane[None].astype(np.float32), strict=True)
    assert volume.grid == read_grid(tmp_path / "a.png") == Grid((6, 5, 1), (1.0, 1.0, 1.0))
    image = SimpleITK.GetImageFromArray(VALUES)
    image.SetSpacing((1.0, 2.0, 3.0))
    SimpleITK.WriteImage(SimpleITK.JoinSeries([image]), str(tmp_path / "one.mha"))
    volume = read_volume(tmp_path / "one.mha")
    np.testing.assert_array_equal(volume.values, VALUES)
    assert (volume.grid.size, volume.grid.spacing) == ((6, 5, 4), (1, 2, 3)) and read_grid(
        tmp_path / "one.mha"
    ).size == (6, 5, 4)
    line = b"NRRD0004\ntype: float\ndimension: 1\nsizes: 6\nspacings: 1\nencoding: raw\nendian: little\n\n" + bytes(24)
    refused(InputError, read_grid, laid(tmp_path, {"line.nrrd": line}) / "line.nrrd")
    unreadable(tmp_path / "line.nrrd")


def test_dirlab_raw(tmp_path):
    values, file = np.arange(24, dtype="<i2").reshape(2, 3, 4), tmp_path / "case.img"
    file.write_bytes(values.tobytes())
    unreadable(file)
    read = read_volume(laid(tmp_path, {"meta.json": {"size": [4, 3, 2], "spacing": [0.97, 0.97, 2.5]}}) / "case.img")
    np.testing.assert_array_equal(read.values, values)
    assert read.grid == read_grid(file) == Grid((4, 3, 2), (0.97, 0.97, 2.5))
    laid(tmp_path, {"case.hdr": bytes(348)})  # of Analyze 7.5, beside what says the same
    np.testing.assert_array_equal(read_volume(file).values, values)
    file.write_bytes(values.tobytes()[:-2])
    unreadable(file)
    for size, spacing in (([4, 0, 2], [1, 1, 1]), ([4, 3, 2], [1, -1, 1]), ([4, 3, 1 << 21], [1, 1, 1])):
        unreadable(laid(tmp_path, {"meta.json": {"size": size, "spacing": spacing}}) / "case.img")


def labels_of(values, regions=()):
    return {name: np.flatnonzero(mask).tolist() for name, mask in label_masks(np.float32([values]), "m", regions)}


def test_labels_of_a_mask():
    assert labels_of([0, 1, 1]) == {"m": [1, 2]} and labels_of([0, 255]) == {"m": [1]}
    assert labels_of([0, 2, 2]) == {"m_2": [1, 2]} and labels_of([3, 0, 1]) == {"m_1": [2], "m_3": [0]}
    assert labels_of([0, 1.0000001, 2]) == {"m_1": [1], "m_2": [2]}  # what is left of rounding
    assert labels_of([0, 0.3, 0.5, np.nan]) == {"m": [2]}
    assert labels_of([0, 1, 7], [("liver", 1), ("spleen", 2)]) == {"liver": [1], "spleen": [], "m_7": [2]}
    assert labels_of([0, 0]) == {"m": []}
    assert len(labels_of(range(2001))) == 2000
    for values, regions in (
        (range(2002), ()),  # a scan
        ([1, 2**24 + 2], ()), ([0, 1, 14172.01], ()),  # blurred, though but little in proportion
        ([0, 1.4, 2], ()), ([0, 0.4, 1], [("liver", 1)]),
    ):  # fmt: skip
        refused(InputError, labels_of, values, regions)


META = "ObjectType = Image\nNDims = 3\nDimSize = 6 5 4\nElementType = MET_FLOAT\nElementSpacing = 1 1 1\n"
NRRD = "NRRD0004\ntype: float\ndimension: 3\nsizes: 6 5 4\nendian: little\nspacings: 1 1 1\n"


def test_landmarks_that_are_no_pairs_are_said(tmp_path: Path):
    """Of a registration that moves points by 9 mm along x, in a volume without a moving one beside it."""
    grid = Grid((40, 40, 20), (1.5, 1.5, 2.5), (-20.0, 30.0, 7.0))
    write_array(tmp_path / "fixed.mha", grid, np.random.default_rng(0).random(grid.shape, np.float32))
    SimpleITK.WriteTransform(SimpleITK.TranslationTransform(3, (9.0, 0.0, 0.0)), str(tmp_path / "t.tfm"))
    files = {f"landmarks_{name}": tmp_path / f"{name}.csv" for name in ("fixed", "moving")}
    files |= {"fixed": tmp_path / "fixed.mha", "transform": tmp_path / "t.tfm"}
    scene = VolumePairScene(name="a", folder=tmp_path, **files)
    places = np.random.default_rng(1).uniform(0, 19, (12, 3))
    points, along = grid.to_point(places), np.array([9.0, 0.0, 0.0])
    matches, voxels = points + along + 0.1, np.rint(points)
    for fixed, moving, words in (
        (points, matches, None), (matches - along, points - along, "exchanged"), (points, matches[::-1], "same order"),
        (points, points, "apart"), (voxels, voxels + along, "voxels, not mm"),
    ):  # fmt: skip
        np.savetxt(files["landmarks_fixed"], fixed, delimiter=",")
        np.savetxt(files["landmarks_moving"], moving, delimiter=",")
        _, lines = warned(true_errors, scene)
        assert len(lines) == (words is not None) and all(words in line for line in lines)
    np.savetxt(files["landmarks_fixed"], places[:, ::-1], delimiter=",")
    refused(InputError, true_errors, scene)
    np.savetxt(files["landmarks_fixed"], points[1:], delimiter=",")
    refused(InputError, true_errors, scene)


def test_true_errors_below_zero_are_unknown(tmp_path: Path):
    errors = np.abs(VALUES)
    errors[0, 0, 0], errors[1] = -1, -2
    for name, values in (("fixed", VALUES), ("error_true", errors), ("mask", np.float32(VALUES > 0))):
        write_array(tmp_path / f"{name}.mha", UNIT, values)
    files = {name: tmp_path / f"{name}.mha" for name in ("fixed", "error_true")}
    truth, lines = warned(true_errors, VolumePairScene(name="a", folder=tmp_path, **files))
    np.testing.assert_array_equal(truth.error, np.where(errors < 0, np.nan, errors))
    assert len(lines) == 1 and "error_true.mha: 25.8 % of the voxels are negative" in lines[0]
    truth, _ = warned(true_errors, VolumePairScene(name="a", folder=tmp_path, mask=tmp_path / "mask.mha", **files))
    np.testing.assert_array_equal(truth.error, np.where((errors < 0) | (VALUES <= 0), np.nan, errors))


def test_masks_and_scans_in_each_other_s_place_are_said(tmp_path: Path):
    scan = VALUES * 100
    for name, values in (("scan", scan), ("mask", (scan > 0).astype(np.float32)), ("labels", np.rint(np.abs(scan)))):
        write_array(tmp_path / f"{name}.mha", UNIT, values)
    for warped, mask, said in (("scan", "labels", []), ("scan", "scan", ["scan.mha"]), ("mask", "mask", ["mask.mha"])):
        files = {"fixed": "scan", "moving_warped": warped, "mask": mask}
        paths = {role: tmp_path / f"{name}.mha" for role, name in files.items()}
        _, lines = warned(load_volumes, VolumePairScene(name="a", folder=tmp_path, **paths))
        assert len(lines) == len(said) and all(word in line for word, line in zip(said, lines, strict=True))


SLICES = [f"s{number:02}.raw" for number in range(1, 5)]
LISTED = "\n".join(SLICES)
POINTING = {  # a volume of every kind that keeps its values in other files: header -> its text, and those files
    "a.mhd": (f"{META}ElementDataFile = v.raw\n", ["v.raw"]),
    "b.mhd": (f"{META}ElementDataFile = LIST\n{LISTED}\n", SLICES),
    "c.mhd": (f"{META}ElementDataFile = s%02d.raw 1 4 1\n", SLICES),
    "d.mha": (f"{META}ElementDataFile = v.raw\n", ["v.raw"]),
    "e.nhdr": (f"{NRRD}encoding: raw\ndata file: v.raw\n", ["v.raw"]),
    "f.nhdr": (f"{NRRD}encoding: gzip\ndata file: v.raw.gz\n", ["v.raw.gz"]),
    "g.nhdr": (f"{NRRD}encoding: raw\ndata file: LIST\n{LISTED}\n", SLICES),
    "h.nhdr": (f"{NRRD}encoding: raw\ndata file: s%02d.raw 1 4 1\n", SLICES),
}


def test_files_with_values_are_inputs(tmp_path: Path):
    data = VALUES.astype("<f4").tobytes()
    laid(tmp_path, {"v.raw": data, "v.raw.gz": gzip.compress(data)})
    laid(tmp_path, {name: values.astype("<f4").tobytes() for name, values in zip(SLICES, VALUES, strict=True)})
    for name, (text, files) in POINTING.items():
        header = laid(tmp_path, {name: text}) / name
        np.testing.assert_array_equal(read_volume(header).values, VALUES, err_msg=name)
        behind = volume_files(header)
        assert {file.name for file in behind} == set(files), name
        scene = VolumePairScene(name="a", folder=tmp_path, fixed=header, moving_warped=header)
        assert set(scene.input_files.values()) == {header, *behind}, name
    (tmp_path / "fixed.img").touch()  # what is read beside a file is an input, too
    scene = VolumePairScene(name="a", folder=tmp_path, fixed=tmp_path / "fixed.img")
    assert tmp_path / "meta.json" in scene.input_files.values()
    first = '(Transform "AffineTransform")\n(InitialTransformParametersFileName "/else/where/b.txt")\n'
    b, c = (f'(Transform "A")\n(InitialTransformParameterFileName "{name}")\n' for name in ("./c.txt", "transform.txt"))
    laid(tmp_path, {"transform.txt": first, "b.txt": b, "c.txt": c})
    chain = transform_files(tmp_path / "transform.txt")
    assert [file.name for file in chain] == ["b.txt", "c.txt", "transform.txt"]  # it comes back, and ends
    (tmp_path / "dc_beta.npy").touch()
    assert distortion_map(tmp_path / "calib.json") == tmp_path / "dc_beta.npy"


def test_values_outside_of_the_folder_are_not_read(tmp_path: Path):
    (tmp_path / "v.raw").write_bytes(VALUES.tobytes())
    for name in ("../v.raw", str(tmp_path / "v.raw")):
        meta, nrrd = f"{META}ElementDataFile = {name}\n", f"{NRRD}encoding: raw\ndata file: {name}\n"
        laid(tmp_path / "in", {"a.mhd": meta, "a.nhdr": nrrd})
        for header in ("a.mhd", "a.nhdr"):
            refused(InputError, read_volume, tmp_path / "in" / header)


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_a_nifti_pair_is_read_by_either_file(tmp_path: Path, dtype):
    values = np.arange(4 * 5 * 6).reshape(4, 5, 6).astype(dtype)
    if dtype == np.float32:
        values[1, 2, 3] = np.nan
    image = SimpleITK.GetImageFromArray(values)
    image.SetSpacing((1.0, 2.0, 3.0))
    image.SetOrigin((5.0, 6.0, 7.0))
    SimpleITK.WriteImage(image, str(tmp_path / "fixed.hdr"))
    for name in ("fixed.img", "fixed.hdr"):
        volume = read_volume(tmp_path / name)
        np.testing.assert_array_equal(volume.values, values.astype(np.float32))
        assert (volume.grid.spacing, volume.grid.origin) == ((1.0, 2.0, 3.0), (5.0, 6.0, 7.0))
        assert read_grid(tmp_path / name).size == (6, 5, 4)
    assert volume_files(tmp_path / "fixed.img") == (tmp_path / "fixed.hdr",)
    header = bytearray((tmp_path / "fixed.hdr").read_bytes())
    header[344:348] = bytes(4)
    (tmp_path / "fixed.hdr").write_bytes(header)
    unreadable(tmp_path / "fixed.img")
    assert volume_files(tmp_path / "fixed.img") == ()
