"""Scenes and runs to make a page of: maps with holes, status, confidence, odd names."""

from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.maps import Status
from tests.files import laid

SHAPE = (36, 48)
ODD = """<script>alert("1")<&'x"""


def truth_of(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.rint((np.linspace(4, 12, SHAPE[1]) + rng.uniform(0, 1, (SHAPE[0], 1))) * 16).astype(np.float32) / 16


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes with exact truth (PFM), a mask of visible pixels; one has a hostile name."""
    folder = tmp_path_factory.mktemp("page") / "set"
    rng = np.random.default_rng(0)
    for seed, name in enumerate(("plain", ODD)):
        image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
        truth, visible = truth_of(seed), np.ones(SHAPE, bool)
        truth[:2, :5], visible[:, :8] = np.nan, False
        files = {"left.png": image, "right.png": image, "mask_nonocc.png": visible, "disp_left.pfm": truth}
        laid(folder / name, files | {"meta.json": {"max_disparity": 15, "protocol": "middlebury_v2"}})
    return folder


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A good run with status, confidence and bound, and a bad one with holes that lacks nothing."""
    folder = tmp_path_factory.mktemp("runs")
    places = [folder / "good", folder / 'bad "<b>"']
    rng = np.random.default_rng(1)
    for place, spread in zip(places, (0.25, 2.0), strict=True):
        for seed, name in enumerate(("plain", ODD)):
            values = np.maximum(truth_of(seed) + rng.normal(0, spread, SHAPE).astype(np.float32), np.float32(0.5))
            files = {"disp_left.pfm": values}
            if place == places[0]:
                status = np.zeros(SHAPE, np.uint8)
                status[:, :8] = int(Status.OCCLUDED | Status.FILLED)
                bound = np.abs(values - truth_of(seed)) + np.linspace(-0.2, 8, SHAPE[1], dtype=np.float32)
                bound[4] = np.inf
                files |= {"status.png": status, "bound.pfm": np.maximum(bound, np.float32(0.01))}
                for measure in ("confidence_lrd", "probability"):
                    files[f"{measure}.pfm"] = rng.uniform(0, 1, SHAPE).astype(np.float32)
            else:
                values[10:14, 20:30] = np.nan
            laid(place / name, files)
    seconds = [{"scene": n, "status": "done", "seconds": {"match": 0.5 + i}} for i, n in enumerate(("plain", ODD))]
    laid(places[0], {"report.json": {"scenes": seconds}, "run.yaml": "method: <census>\n"})
    return places


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, scenes: Path, runs: list[Path]) -> Path:
    """The report of both runs."""
    output = tmp_path_factory.mktemp("report") / "out"
    assert main(["evaluate", *map(str, runs), "--truth", str(scenes), "--output", str(output), "--html", "-q"]) == 0
    return output


@pytest.fixture(scope="session")
def volumes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of a run on one small pair of volumes, which lie beside it."""
    pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
    folder = tmp_path_factory.mktemp("volumes")
    scenes, run, output = folder / "set", folder / "run", folder / "out"
    assert main(["sample", "--registration", "-n", "1", "-o", str(scenes), "-q"]) == 0
    assert main(["register-confidence", "axes", "-i", str(scenes), "-o", str(run), "-q"]) == 0
    assert main(["evaluate", str(run), "--truth", str(scenes), "-o", str(output), "--html", "-q"]) == 0
    return output
