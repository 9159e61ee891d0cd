"""Volumes and transforms that point to other files: those belong to the inputs, and headers are checked first."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.io.formats import kinect, transforms
from depthcli.io.formats.volume_headers import check_volume, files_behind
from depthcli.io.formats.volumes import read_grid, read_volume, write_array
from depthcli.io.scenes.volume_pair import VolumePairScene

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
        behind = files_behind(header)
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
    chain = transforms.files_read_with(tmp_path / "transform.txt")
    assert [file.name for file in chain] == ["b.txt", "c.txt", "transform.txt"]  # it comes back, and ends
    (tmp_path / "dc_beta.npy").touch()
    assert kinect.files_read_with(tmp_path / "calib.json") == (tmp_path / "dc_beta.npy",)


def test_a_changed_file_behind_a_header_is_computed_again(tmp_path: Path):
    from depthcli.cli import main
    from depthcli.simulate.samples.registration import smooth_noise

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


BAD_META = {
    "dimensions": ("NDims = 3", "NDims = 300000000"),
    "no dimensions": ("NDims = 3", "NDims = 0"),
    "digits": ("NDims = 3", "NDims = " + "3" * 5000),
    "sizes": ("DimSize = 6 5 4", "DimSize = 6 5 400000000"),
    "a size of 0": ("DimSize = 6 5 4", "DimSize = 6 5 0"),
    "a negative size": ("DimSize = 6 5 4", "DimSize = 6 5 -4"),
    "too few sizes": ("DimSize = 6 5 4", "DimSize = 6 5"),
    "type": ("MET_FLOAT", "MET_STRING"),
    "wider type": ("MET_FLOAT", "MET_DOUBLE"),
    "channels": ("NDims = 3", "NDims = 3\nElementNumberOfChannels = 100000"),
    "header size": ("NDims = 3", "NDims = 3\nHeaderSize = 99999999999999999999"),
    "twice": ("NDims = 3", "NDims = 3\nNDims = 30000"),
    "long text": ("NDims = 3", "NDims = 3\nName = " + "x" * 300),  # which ends the process in MetaIO
    "long line": ("NDims = 3", "NDims = 3\nComment = " + "x" * 100_000),
}
BAD_NRRD = {
    "dimensions": ("dimension: 3", "dimension: 300000000"),
    "sizes": ("sizes: 6 5 4", "sizes: 6 5 400000000"),
    "product": ("sizes: 6 5 4", "sizes: 4294967296 4294967296 4294967296"),
    "type": ("type: float", "type: block"),
    "wider type": ("type: float", "type: double"),
    "encoding": ("encoding: raw", "encoding: zrl"),
    "skip": ("encoding: raw", "encoding: raw\nbyte skip: 99999999"),
    "twice": ("dimension: 3", "dimension: 3\ndimension: 4"),
    "long units": ("dimension: 3", "dimension: 3\nspace units: " + "x" * 300),  # which end the process
    "long numbers": ("dimension: 3", "dimension: 3\nkinds: " + "1 " * 300),
}


@pytest.mark.parametrize("behind", [False, True])
@pytest.mark.parametrize("kind", [f"meta {name}" for name in BAD_META] + [f"nrrd {name}" for name in BAD_NRRD])
def test_headers_are_checked_before_the_library_sees_them(tmp_path: Path, kind: str, behind: bool):
    form, name = kind.split(" ", 1)
    old, new = (BAD_META if form == "meta" else BAD_NRRD)[name]
    data = VALUES.astype("<f4").tobytes()
    (tmp_path / "v.raw").write_bytes(data)
    if form == "meta":
        text = META + f"ElementDataFile = {'v.raw' if behind else 'LOCAL'}\n"
    else:
        text = NRRD + "encoding: raw\n" + ("data file: v.raw\n" if behind else "\n")
    assert old in text
    path = put(tmp_path / ("a.mha" if form == "meta" else "a.nrrd"), text, b"" if behind else data)
    assert read_grid(path).size == SIZE
    path = put(path, text.replace(old, new), b"" if behind else data)
    for read in (check_volume, read_grid, read_volume):
        with pytest.raises(InputError) as caught:
            read(path)
        assert len(str(caught.value)) < 600 and "\n" not in str(caught.value)


@pytest.mark.parametrize("field", ["vox_offset", "dim", "datatype", "magic", "pixdim"])
def test_headers_of_nifti_are_checked(tmp_path: Path, field: str):
    path = tmp_path / "a.nii"
    write_array(path, Grid(SIZE, (1.0, 1.0, 1.0)), VALUES)
    whole = path.read_bytes()
    places = {
        "vox_offset": (108, [np.array(v, "<f4").tobytes() for v in (1e30, -1e30, np.nan, np.inf, 3.0)]),
        "dim": (40, [np.array(v, "<i2").tobytes() for v in ([300], [0], [-1], [3, -6], [7, 32767, 32767, 32767], [1])]),
        "datatype": (70, [np.array(v, "<i2").tobytes() for v in (64, 0, 9999, -1)]),
        "magic": (344, [b"ni1\0", b"\0\0\0\0"]),
        "pixdim": (80, [np.array(v, "<f4").tobytes() for v in (np.nan, np.inf, 0.0)]),
    }
    at, wrong = places[field]
    for data in wrong:
        for kind in (".nii", ".nii.gz"):
            damaged = whole[:at] + data + whole[at + len(data) :]
            file = tmp_path / f"b{kind}"
            file.write_bytes(gzip.compress(damaged) if kind == ".nii.gz" else damaged)
            for read in (read_grid, read_volume):
                if read is read_grid and field == "datatype" and data == wrong[0]:
                    continue  # a header alone does not say how long the file is
                with pytest.raises(InputError):
                    read(file)


@pytest.mark.parametrize("special", ["pipe", "device", "folder", "socket link"])
def test_only_regular_files_are_opened(tmp_path: Path, special: str):
    path = tmp_path / "v.raw"
    {
        "pipe": lambda: os.mkfifo(path),
        "device": lambda: path.symlink_to("/dev/zero"),
        "folder": path.mkdir,
        "socket link": lambda: path.symlink_to("/dev/tty"),
    }[special]()
    started = time.monotonic()
    for header in (
        put(tmp_path / "a.mhd", f"{META}ElementDataFile = v.raw\n"),
        put(tmp_path / "a.nhdr", f"{NRRD}encoding: raw\ndata file: v.raw\n"),
    ):
        for read in (read_grid, read_volume):
            with pytest.raises(InputError, match=r"v\.raw"):
                read(header)
    chain = tmp_path / "t.txt"
    chain.write_text(
        '(Transform "TranslationTransform")\n(TransformParameters 0 0 0)\n'
        '(InitialTransformParametersFileName "v.raw")\n'
    )
    with pytest.raises(InputError, match=r"v\.raw"):
        transforms.read_transform(chain)
    assert time.monotonic() - started < 5


def test_other_kinds_of_volume_are_not_tried(tmp_path: Path):
    """The library knows tens of formats; what a file's ending does not say is not looked for."""
    write_array(tmp_path / "a.mha", Grid(SIZE, (1.0, 1.0, 1.0)), VALUES)
    for name in ("a.dcm", "a.vtk", "a"):
        (tmp_path / name).write_bytes((tmp_path / "a.mha").read_bytes())
        with pytest.raises(InputError, match=r"want \.nii"):
            read_volume(tmp_path / name)


def test_random_damage_never_ends_the_process(tmp_path: Path):
    script = """
import sys, warnings
warnings.simplefilter("ignore", DeprecationWarning)
from pathlib import Path
import numpy as np
from depthcli.core.errors import InputError
from depthcli.io.formats.transforms import read_transform
from depthcli.io.formats.volumes import read_grid, read_volume
folder = Path(sys.argv[1])
rng = np.random.default_rng(0)
words = [b"-1", b"0", b"99999999999999999999", b"nan", b"1e308", b"LIST", b"%s%s%n", b"=", b":", b"3" * 3000, b""]
for case in range(300):
    name = ("a.mha", "a.nrrd", "a.nii")[case % 3] if case < 288 else ("a.tfm", "a.mat", "a.h5")[case % 3]
    data = bytearray((folder / name).read_bytes())
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(min(len(data), 400)))
        if name in ("a.nii", "a.mat", "a.h5") or rng.random() < 0.4:
            data[at] = rng.integers(256)
        else:
            word = words[rng.integers(len(words))]
            data[at : at + rng.integers(6)] = word
    path = folder / name.replace("a.", "b.")
    path.write_bytes(bytes(data))
    for read in (read_grid, read_volume) if case < 288 else (read_transform,):
        try:
            read(path)
        except InputError:
            pass
print("whole")
"""
    grid = Grid(SIZE, (1.0, 1.0, 1.0))
    sitk = pytest.importorskip("SimpleITK")
    for suffix in (".tfm", ".mat", ".h5"):
        sitk.WriteTransform(sitk.Euler3DTransform(), str(tmp_path / f"a{suffix}"))
    for suffix in (".mha", ".nrrd", ".nii"):
        write_array(tmp_path / f"a{suffix}", grid, VALUES)
    done = subprocess.run([sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout.strip()) == (0, "whole"), done.stderr[-2000:]


def test_a_transform_that_ends_the_process_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a.tfm").write_text("#Insight Transform File V1.0\n")
    monkeypatch.setattr(transforms, "_REWRITE", "import os; os.abort()")
    with pytest.raises(InputError, match="crashes"):
        transforms.read_transform(tmp_path / "a.tfm")
