"""Scenes and runs to make a page of: maps with holes, status, confidence, odd names."""

import json
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import write_pfm, write_status
from depthcli.io.formats.images import write_png

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
        for file, picture in (("left", image), ("right", image), ("mask_nonocc", visible)):
            write_png(folder / name / f"{file}.png", picture)
        write_pfm(folder / name / "disp_left.pfm", truth)
        (folder / name / "meta.json").write_text(json.dumps({"max_disparity": 15, "protocol": "middlebury_v2"}))
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
            status = np.zeros(SHAPE, np.uint8)
            if place == places[0]:
                write_pfm(place / name / "confidence_lrd.pfm", rng.uniform(0, 1, SHAPE).astype(np.float32))
                status[:, :8] = int(Status.OCCLUDED | Status.FILLED)
                write_status(place / name / "status.png", status)
                bound = np.abs(values - truth_of(seed)) + np.linspace(-0.2, 8, SHAPE[1], dtype=np.float32)
                bound[4] = np.inf
                write_pfm(place / name / "bound.pfm", np.maximum(bound, np.float32(0.01)))
                write_pfm(place / name / "probability.pfm", rng.uniform(0, 1, SHAPE).astype(np.float32))
            else:
                values[10:14, 20:30] = np.nan
            write_pfm(place / name / "disp_left.pfm", values)
    seconds = [{"scene": n, "status": "done", "seconds": {"match": 0.5 + i}} for i, n in enumerate(("plain", ODD))]
    (places[0] / "report.json").write_text(json.dumps({"scenes": seconds}))
    (places[0] / "run.yaml").write_text("method: <census>\n")
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
