"""A folder of two scenes in the layout of this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.plugins import load_plugin
from depthcli.io.formats.images import write_png
from depthcli.testing.inputs import shifted_pair

load_plugin("depthcli_example")


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    """Two planes of random texture, one with its truth in the format of this package."""
    for name, shift in (("near", 9), ("far", 5)):
        folder, pair = tmp_path / "scenes" / name, shifted_pair(48, 64, shift)
        folder.mkdir(parents=True)
        write_png(folder / "first.png", pair.left)
        write_png(folder / "second.png", pair.right)
        np.savetxt(folder / "first_truth.table", np.full((48, 64), shift))
    return tmp_path / "scenes"
