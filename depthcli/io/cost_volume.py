"""Cost volumes made by other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError


def read_cost_volume(path: Path) -> NDArray[Any]:
    """Map an ``.npy`` file of (H, W, D) costs into memory; only what is used of it is read.

    Raises
    ------
    InputError
        The file is missing, damaged, or holds no three-dimensional array of numbers.
    """
    try:
        costs = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError, SyntaxError) as error:
        raise InputError(f"{path}: not an .npy array: {error}") from error
    if not isinstance(costs, np.ndarray) or costs.ndim != 3 or costs.dtype.kind not in "fiub":
        raise InputError(f"{path}: want an (H, W, D) array of numbers")
    return costs
