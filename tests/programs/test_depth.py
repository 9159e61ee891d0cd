"""Programs as methods of ``refine-kinect`` and ``transparent``."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.io.formats.depth import read_depth

# Fills gaps with the median; where it gets sparse depth, that replaces the sensor's.
FILL = """
import sys
import cv2
import numpy as np
color, depth, output, sparse = sys.argv[1:]
codes = cv2.imread(depth, cv2.IMREAD_UNCHANGED)
assert cv2.imread(color).shape == (*codes.shape, 3) and codes.dtype == np.uint16
codes[codes == 0] = np.median(codes[codes > 0])
if sparse != "none":
    other = cv2.imread(sparse, cv2.IMREAD_UNCHANGED)
    codes[other > 0] = other[other > 0]
cv2.imwrite(output, codes)
"""


@pytest.fixture
def here(here: Path) -> Path:
    """The current folder, with the program, configs for both commands and scenes in it."""
    (here / "fill.py").write_text(FILL)
    for name, sparse in (("refine-kinect", "none"), ("transparent", "{sparse}")):
        words = [sys.executable, "fill.py", "{color}", "{depth}", "{output}", sparse]
        config = {"pipeline": "command", "program": words, "format": "png"}
        (here / f"{name}.yaml").write_text(json.dumps(config))
    size = ("--width", "128", "--height", "96", "-q")
    assert main(["sample", "--kinect", "--frames", "0", *size, "-o", "refine-kinect"]) == 0
    assert main(["sample", "--transparent", "--share", "0.1", *size, "-o", "transparent"]) == 0
    return here


@pytest.mark.slow
@pytest.mark.parametrize("command", ["refine-kinect", "transparent"])
def test_a_program_gets_codes_and_its_codes_become_a_map(here: Path, command: str):
    assert main([command, f"{command}.yaml", "-i", command, "-o", "run", "-q"]) == 0
    row = json.loads((here / "run" / "report.json").read_text())["scenes"][0]
    assert row["density"] == 1
    assert row["known"] < 1
    assert row["filled"] == pytest.approx(1 - row["known"], abs=2e-6)
    assert row["seconds"].keys() >= {"write", "program", "read"}
    assert row["program_cpu"] > 0
    scene = here / "run" / row["scene"]
    values, sensor = read_depth(scene / "depth.pfm"), read_depth(here / command / row["scene"] / "depth.pfm")
    known = np.isfinite(sensor)
    filled = values[~known]
    if command == "refine-kinect":
        assert np.allclose(values[known], sensor[known], atol=6e-4)
        assert np.allclose(filled, np.median(sensor[known]), atol=2e-3)
    else:
        assert row["replaced"] > 0
        assert np.mean(np.abs(values[known] - sensor[known]) < 6e-4) > 0.5
        sparse = read_depth(here / command / row["scene"] / "sparse.pfm")
        at = np.isfinite(sparse)
        assert np.allclose(values[at], sparse[at], atol=0.011)
    assert not list((here / "scratch").iterdir())


@pytest.mark.slow
def test_a_map_without_values_and_an_unknown_input_are_refused(here: Path, capsys):
    (here / "fill.py").write_text(FILL + "cv2.imwrite(output, 0 * codes)\n")
    assert main(["refine-kinect", "refine-kinect.yaml", "-i", "refine-kinect", "-o", "run", "-q"]) == 3
    error = capsys.readouterr().err
    assert "no pixel of the program's output.png has a value; its files are in " in error
    words = json.dumps([sys.executable, "fill.py", "{sparse}"])
    assert main(["refine-kinect", "refine-kinect.yaml", "-i", "x", "-o", "y", "--set", f"program={words}"]) == 2
    assert "no placeholder {sparse}; there are: color, depth, output" in capsys.readouterr().err
