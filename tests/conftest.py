"""Scenes that many tests run on."""

from __future__ import annotations

from pathlib import Path

import pytest

from depthcli.jobs.sample import SampleOptions, write_samples


@pytest.fixture(scope="session")
def made_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve small generated scenes with ground truth; never write into it."""
    folder = tmp_path_factory.mktemp("scenes")
    write_samples(folder, SampleOptions(count=12, width=96, height=64, max_disparity=12))
    return folder
