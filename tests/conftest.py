"""Inputs that many tests run on, generated once; never write into them."""

import shutil
from pathlib import Path

import pytest

from depthcli.cli import main


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests that take minutes first: processes that run out of tests take others from the rest."""
    items.sort(key=lambda item: item.get_closest_marker("first") is None)


def sampled(place: pytest.TempPathFactory, *options: str) -> Path:
    """A folder that ``depthcli sample`` fills."""
    folder = place.mktemp("made")
    assert main(["sample", "-o", str(folder), "-q", *options]) == 0
    return folder


@pytest.fixture(scope="session")
def made_scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve small stereo scenes with ground truth."""
    return sampled(tmp_path_factory, "-n", "12", "--width", "96", "--height", "64", "--max-disparity", "12")


@pytest.fixture(scope="session")
def two_scenes(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two of them, in a folder of their own."""
    folder = tmp_path_factory.mktemp("two")
    for name in ("foreground_0", "planes_0"):
        shutil.copytree(made_scenes / name, folder / name)
    return folder


@pytest.fixture(scope="session")
def made_kinect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of a Kinect and two sequences of four."""
    return sampled(tmp_path_factory, "--kinect", "--width", "96", "--height", "72", "--frames", "4")


@pytest.fixture(scope="session")
def made_glass(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames of transparent objects, ``glass_0`` and others."""
    return sampled(tmp_path_factory, "--transparent", "--width", "128", "--height", "96", "--share", "0.1")


@pytest.fixture(scope="session")
def made_volumes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two registered pairs of volumes, ``pair_0`` and ``pair_1``, with dense truth."""
    pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
    return sampled(tmp_path_factory, "--registration", "-n", "2")
