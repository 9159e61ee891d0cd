"""Inputs that many tests run on, generated once; never write into them."""

import os
import random
import shutil
from collections.abc import Generator
from pathlib import Path

import pytest

from depthcli.cli import main
from tests import golden
from tests.command_line import Tool

MESSAGES = pytest.StashKey[dict[str, list[str]]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--renew", action="store_true", help="keep what the program says and writes now as golden texts")


def pytest_sessionstart(session: pytest.Session) -> None:
    session.stash[MESSAGES] = golden.read_messages()


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.getoption("renew"):
        golden.renew()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Compare what the test was told with ``tests/messages.txt``."""
    golden.temporary = item.config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
    result = yield
    golden.given.setdefault(item.nodeid, [])
    if not item.config.getoption("renew"):
        told, kept = golden.given[item.nodeid], item.session.stash[MESSAGES].get(item.nodeid, [])
        assert told == kept, "look at the words; with --renew, pytest keeps them in tests/messages.txt"
    return result


@pytest.hookimpl(tryfirst=True)  # before -k and -m leave tests out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put tests that take minutes first: processes that run out of tests take others from the rest.

    The others are shuffled by the seed ``TEST_ORDER``, if there is one: files, and the tests of each.
    """
    if not any("[" in argument for argument in config.args):
        golden.collected.update(item.nodeid for item in items)
    if seed := os.environ.get("TEST_ORDER"):
        chance = {item.path: random.Random(f"{seed} {item.path.name}") for item in items}
        files = {path: each.random() for path, each in chance.items()}
        places = {item: (files[item.path], item.path, chance[item.path].random()) for item in items}
        items.sort(key=places.__getitem__)
    items.sort(key=lambda item: item.get_closest_marker("first") is None)


@pytest.fixture
def same(request: pytest.FixtureRequest) -> golden.Same:
    """Compare a whole output with a file: ``same(name, text)``."""
    return lambda name, text: golden.same_text(name, text, request.config.getoption("renew"))


@pytest.fixture
def tool(capsys: pytest.CaptureFixture[str]) -> Tool:
    return Tool(capsys)


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
