"""Volumes and transforms that point to other files: those belong to the inputs, and headers are checked first."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats.files_behind import kinect_files, transform_files, volume_files
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.io.scenes import VolumePairScene

pytest.importorskip("SimpleITK")

SIZE = (6, 5, 4)
VALUES = np.random.default_rng(0).uniform(1, 2, SIZE[::-1]).astype(np.float32)
META = "ObjectType = Image\nNDims = 3\nDimSize = 6 5 4\nElementType = MET_FLOAT\nElementSpacing = 1 1 1\n"
NRRD = "NRRD0004\ntype: float\ndimension: 3\nsizes: 6 5 4\nendian: little\nspacings: 1 1 1\n"


def put(path: Path, header: str, data: bytes = b"") -> Path:
    path.write_bytes(header.encode() + data)
    return path


def pointing(folder: Path) -> dict[str, Path]:
    """A volume of every kind that keeps its values in other files: name of the kind -> header."""
    data = VALUES.astype("<f4").tobytes()
    (folder / "v.raw").write_bytes(data)
    (folder / "v.raw.gz").write_bytes(gzip.compress(data))
    slices = [f"s{number:02}.raw" for number in range(1, 5)]
    for name, values in zip(slices, VALUES, strict=True):
        (folder / name).write_bytes(values.astype("<f4").tobytes())
    listed = "\n".join(slices)
    return {
        "meta": put(folder / "a.mhd", f"{META}ElementDataFile = v.raw\n"),
        "meta list": put(folder / "b.mhd", f"{META}ElementDataFile = LIST\n{listed}\n"),
        "meta pattern": put(folder / "c.mhd", f"{META}ElementDataFile = s%02d.raw 1 4 1\n"),
        "meta .mha": put(folder / "d.mha", f"{META}ElementDataFile = v.raw\n"),
        "nrrd": put(folder / "e.nhdr", f"{NRRD}encoding: raw\ndata file: v.raw\n"),
        "nrrd gzip": put(folder / "f.nhdr", f"{NRRD}encoding: gzip\ndata file: v.raw.gz\n"),
        "nrrd list": put(folder / "g.nhdr", f"{NRRD}encoding: raw\ndata file: LIST\n{listed}\n"),
        "nrrd pattern": put(folder / "h.nhdr", f"{NRRD}encoding: raw\ndata file: s%02d.raw 1 4 1\n"),
    }


def test_files_with_values_are_inputs(tmp_path: Path):
    for kind, header in pointing(tmp_path).items():
        np.testing.assert_array_equal(read_volume(header).values, VALUES, err_msg=kind)
        behind = volume_files(header)
        wanted = {"v.raw.gz"} if "gzip" in kind else {"v.raw"}
        if "list" in kind or "pattern" in kind:
            wanted = {f"s{number:02}.raw" for number in range(1, 5)}
        assert {file.name for file in behind} == wanted, kind
        scene = VolumePairScene(name="a", folder=tmp_path, fixed=header, moving_warped=header)
        assert set(scene.input_files.values()) == {header, *behind}, kind


def test_what_is_read_beside_a_file_is_an_input(tmp_path: Path):
    (tmp_path / "fixed.img").touch()
    scene = VolumePairScene(name="a", folder=tmp_path, fixed=tmp_path / "fixed.img")
    assert tmp_path / "meta.json" in scene.input_files.values()
    (tmp_path / "transform.txt").write_text(
        '(Transform "AffineTransform")\n(InitialTransformParametersFileName "/else/where/b.txt")\n'
    )
    (tmp_path / "b.txt").write_text('(Transform "A")\n(InitialTransformParameterFileName "./c.txt")\n')
    (tmp_path / "c.txt").write_text('(Transform "A")\n(InitialTransformParameterFileName "transform.txt")\n')
    chain = transform_files(tmp_path / "transform.txt")
    assert [file.name for file in chain] == ["b.txt", "c.txt", "transform.txt"]  # it comes back, and ends
    (tmp_path / "dc_beta.npy").touch()
    assert kinect_files(tmp_path / "calib.json") == (tmp_path / "dc_beta.npy",)


def test_a_changed_file_behind_a_header_is_computed_again(tmp_path: Path):
    from depthcli.cli import main
    from depthcli.simulate.deformed_volumes import smooth_noise

    values = smooth_noise(np.random.default_rng(0), (16, 20, 24), 1.5).astype("<f4")
    header = META.replace("6 5 4", "24 20 16")
    (tmp_path / "in").mkdir()
    for name in ("fixed", "moving_warped"):
        put(tmp_path / "in" / f"{name}.mhd", f"{header}ElementDataFile = {name}.raw\n")
        (tmp_path / "in" / f"{name}.raw").write_bytes(values.tobytes())
    command = ["register-confidence", "coarse", "-i", str(tmp_path / "in"), "-o", str(tmp_path / "out")]
    assert main(command) == 0
    record = next((tmp_path / "out").rglob("record.json"))
    before = record.read_bytes(), record.stat().st_mtime_ns
    assert main(command) == 0
    assert (record.read_bytes(), record.stat().st_mtime_ns) == before
    (tmp_path / "in" / "moving_warped.raw").write_bytes(values[:, :, ::-1].tobytes())
    assert main(command) == 0
    assert record.read_bytes() != before[0]


def test_values_outside_of_the_folder_are_not_read(tmp_path: Path):
    (tmp_path / "in").mkdir()
    (tmp_path / "v.raw").write_bytes(VALUES.tobytes())
    for name in ("../v.raw", str(tmp_path / "v.raw")):
        for header in (
            put(tmp_path / "in" / "a.mhd", f"{META}ElementDataFile = {name}\n"),
            put(tmp_path / "in" / "a.nhdr", f"{NRRD}encoding: raw\ndata file: {name}\n"),
        ):
            with pytest.raises(InputError, match="its own folder"):
                read_volume(header)


def test_other_kinds_of_volume_are_not_tried(tmp_path: Path):
    """The library knows tens of formats; what a file's ending does not say is not looked for."""
    write_array(tmp_path / "a.mha", Grid(SIZE, (1.0, 1.0, 1.0)), VALUES)
    for name in ("a.dcm", "a.vtk", "a"):
        (tmp_path / name).write_bytes((tmp_path / "a.mha").read_bytes())
        with pytest.raises(InputError, match=r"want \.nii"):
            read_volume(tmp_path / name)
