"""Arrays of HDF5 files, and what is said of files that cannot be used."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.hdf5 import length_hdf5, read_hdf5

VALUES = np.arange(24, dtype=np.float32).reshape(2, 3, 4)


def write(path: Path) -> Path:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("values", data=VALUES, compression="gzip")
        file.create_dataset("empty", data=np.zeros((0, 3)))
        file.create_dataset("number", data=1.0)
        file.create_dataset("names", data=np.array([b"a", b"b"]))
        file.create_group("group")
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/values")
        file.create_dataset("outside", (4,), "u1", external=[(str(path.with_name("secret")), 0, 4)])
    return path


def test_arrays_and_their_entries(tmp_path: Path):
    path = write(tmp_path / "a.h5")
    np.testing.assert_array_equal(read_hdf5(path, "values"), VALUES)
    np.testing.assert_array_equal(read_hdf5(path, "values", 1), VALUES[1])
    assert length_hdf5(path, "values") == 2


@pytest.mark.parametrize(("name", "index", "said"), [
    ("absent", None, "no array called absent; there are: elsewhere, empty"), ("group", None, "no array called group"),
    ("empty", None, "want an array of numbers"), ("number", None, "want an array of numbers"),
    ("names", None, "want an array of numbers"), ("values", 2, "no entry 2, there are 2"),
    ("elsewhere", None, "no array called elsewhere"), ("outside", None, "want an array of numbers in this file"),
])  # fmt: skip
def test_what_is_no_array_of_the_file(tmp_path: Path, name: str, index: int | None, said: str):
    path = write(tmp_path / "a.h5")
    write(tmp_path / "other.h5")
    (tmp_path / "secret").write_bytes(b"1234")
    with pytest.raises(InputError, match=rf"a\.h5: [^\n]*{said}[^\n]*$"):
        read_hdf5(path, name, index)


@pytest.mark.parametrize("size", [0, 10, 600, 2000])
def test_damaged_files(tmp_path: Path, size: int):
    path = write(tmp_path / "a.h5")
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match=r"a\.h5: not a usable HDF5 file \([^\n]*\)$"):
        read_hdf5(path, "values")


def test_a_missing_file_and_a_missing_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match=r"absent\.h5"):
        read_hdf5(tmp_path / "absent.h5", "values")
    monkeypatch.setitem(sys.modules, "h5py", None)
    (tmp_path / "a.h5").write_bytes(b"1")
    with pytest.raises(InputError, match=r"a\.h5: HDF5 files need h5py: pip install 'depthcli\[hdf5\]'"):
        read_hdf5(tmp_path / "a.h5", "values")
