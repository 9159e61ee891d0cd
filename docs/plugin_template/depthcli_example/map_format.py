"""Maps as text, a row a line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from depthcli.io.formats.map_format import MapFormat


class Table(MapFormat):
    """Numbers in pixels, separated by spaces; ``nan`` is unknown."""

    suffixes = (".table",)

    def read(self, path: Path) -> NDArray[Any]:
        """Return (H, W) float32."""
        return np.loadtxt(path, np.float32, ndmin=2)
