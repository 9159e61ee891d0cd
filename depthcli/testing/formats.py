"""What every format of maps promises."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.io.formats.map_format import MapFormat


def check_format(map_format: MapFormat, file: Path, expected: NDArray[Any]) -> None:
    """Raise AssertionError unless a format reads a file as the map that it holds, and says where one is damaged.

    Parameters
    ----------
    map_format : what is tested
    file : of this format
    expected : (H, W), the map in it
    """
    assert file.suffix.lower() in map_format.suffixes, f"{file.suffix} is none of {map_format.suffixes}"
    values = np.asarray(map_format.read(file))
    assert values.shape == expected.shape, f"want {expected.shape}, got {values.shape}"
    assert values.dtype.kind in "iuf", f"want integers or floats, got {values.dtype}"
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(map_format.read(file), values, "the second reading differs")
    missing = file.with_name(f"missing_{file.name}")
    try:
        map_format.read(missing)
    except (OSError, ValueError, InputError):
        return
    raise AssertionError("a file that is not there is read without an error")
