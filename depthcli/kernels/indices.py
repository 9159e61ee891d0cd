"""Names for the positions in arrays that kernels read and write."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Iterable
from typing import Any


def indices(names: Iterable[str]) -> Any:
    """Return the position of each name as a field: ``indices(("cost", "hidden")).hidden`` is 1."""
    order = list(names)
    return namedtuple("Indices", order)(*range(len(order)))
