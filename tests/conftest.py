"""Scenes that many tests run on."""

from __future__ import annotations

from pathlib import Path

import pytest

from depthcli.cli import main


@pytest.fixture(scope="session")
def made_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve small generated scenes with ground truth; never write into it."""
    folder = tmp_path_factory.mktemp("scenes")
    size = ("--width", "96", "--height", "64", "--max-disparity", "12")
    assert main(["sample", "-o", str(folder), "-n", "12", *size, "-q"]) == 0
    return folder
