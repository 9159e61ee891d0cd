"""Cost volumes made by other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from depthcli.data.formats.npy import map_npy


def read_cost_volume(path: Path) -> NDArray[Any]:
    """Map an ``.npy`` file of (H, W, D) costs into memory; only what is used of it is read.

    Raises
    ------
    InputError
        The file is missing, damaged, or holds no three-dimensional array of numbers.
    """
    return map_npy(path, 3)
