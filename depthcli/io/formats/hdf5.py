"""Arrays in HDF5 files, read by h5py, an extra (``pip install depthcli[hdf5]``) that is imported here only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.files import naming, open_regular

_MAX_BYTES = 1 << 30  # of an array, as much as the largest images take


def read_hdf5(path: Path | str, name: str, index: int | None = None) -> NDArray[Any]:
    """Return the array of numbers ``name`` at the root of an HDF5 file, or its entry ``index`` along the first axis.

    Links to other files are not followed.

    Raises
    ------
    InputError
        Not readable, damaged, without such an array, too large, or h5py is not installed; one line that names the file.
    """
    with open_regular(path) as file, naming(path):
        h5py = _h5py()
        try:
            with h5py.File(file, "r") as stored:
                return np.asarray(_array(h5py, stored, name, index)[() if index is None else index])
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise InputError(f"not a usable HDF5 file ({str(error)[:200]})") from error


def length_hdf5(path: Path | str, name: str) -> int:
    """Return the length of the first axis of an array; errors as of :func:`read_hdf5`."""
    with open_regular(path) as file, naming(path):
        h5py = _h5py()
        try:
            with h5py.File(file, "r") as stored:
                return len(_array(h5py, stored, name, 0))
        except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
            raise InputError(f"not a usable HDF5 file ({str(error)[:200]})") from error


def _array(h5py: Any, stored: Any, name: str, index: int | None) -> Any:
    link = stored.get(name, getlink=True)
    array = stored[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(array, h5py.Dataset):
        raise InputError(f"no array called {name}; there are: {', '.join(sorted(stored))[:200]}")
    if array.external or array.is_virtual or array.dtype.kind not in "iuf" or 0 in array.shape or not array.shape:
        raise InputError(f"{name}: want an array of numbers in this file, got {array.dtype} of shape {array.shape}")
    if index is not None and index >= len(array):
        raise InputError(f"{name}: no entry {index}, there are {len(array)}")
    if array.nbytes // (1 if index is None else len(array)) > _MAX_BYTES:
        raise InputError(f"{name}: too large ({array.nbytes} bytes)")
    return array


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise InputError("HDF5 files need h5py: pip install 'depthcli[hdf5]'") from None
    return h5py
