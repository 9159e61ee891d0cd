"""A cost measure, a confidence measure, a protocol and a command are one file each, a layout is a row of a YAML file.

The package is copied; the files of ``new_files``, the command of the plug-in template, and the cost measure of
docs/extend.md are put beside the others, and used as a user would.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.frames import StereoPair
from depthcli.io.formats.disparity import read_pfm, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.testing.inputs import shifted_pair

ROOT = Path(__file__).parents[2]
NEW = Path(__file__).parent / "new_files"
TEMPLATE = ROOT / "docs" / "plugin_template" / "depthcli_example"
SQUARED = """\
pipeline: local
cost: squared_difference
aggregation: {method: constant_window, window: 3}
refinement: []
confidence: [spread]
"""

LAYOUT = """\
two-files:
  left: first.*
  right: second.*
  disparity_left: first_truth.*
  max_disparity: 12
  protocol: eighth-pixel
"""
IN = ("-i", "in", "--layout", "two.yaml")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with the new files in it, and two pairs of the new layout."""
    root = tmp_path_factory.mktemp("checkout")
    for name in ("depthcli", "configs"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    shutil.copytree(NEW, root / "depthcli", dirs_exist_ok=True, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TEMPLATE / "command.py", root / "depthcli" / "commands" / "constant.py")
    (root / "two.yaml").write_text(LAYOUT)
    shutil.copytree(TEMPLATE / "presets" / "constant", root / "configs" / "constant")
    page = (ROOT / "docs" / "extend.md").read_text("utf-8")
    (cost,) = re.findall(r"^```python file=squared.py\n(.*?)^```$", page, re.M | re.S)
    (root / "depthcli" / "methods" / "stereo" / "cost" / "squared_difference.py").write_text(cost)
    (root / "squared.yaml").write_text(SQUARED)
    for name, shift in (("near", 9), ("far", 5)):
        pair = shifted_pair(48, 64, shift)
        assert isinstance(pair, StereoPair)
        write_pfm(root / "in" / name / "first_truth.pfm", np.full((48, 64), shift, np.float32))
        write_png(root / "in" / name / "first.png", pair.left)
        write_png(root / "in" / name / "second.png", pair.right)
    return root


def run(checkout: Path, *arguments: str | Path, module: str = "depthcli") -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    command = [sys.executable, "-m", module, *map(str, arguments)]
    return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)


def test_they_are_shown_and_run_as_any_other_and_the_protocol_ranks_the_runs(checkout: Path):
    code = "from depthcli.cli import main; [main(w.split()) for w in ('--help', 'presets', 'presets show five')]"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=checkout, env=os.environ | {"PYTHONPATH": str(checkout)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "constant Write the same disparity everywhere." in " ".join(done.stdout.split())
    assert re.search(r"^constant five +Five pixels everywhere", done.stdout, re.M)
    assert "# disparity of every pixel, pixels\ndisparity: 5.0" in done.stdout
    done = run(checkout, "constant", "five", *IN, "-o", "constant", "--jobs", "2", "--evaluate")
    assert done.returncode == 0, done.stderr
    assert "Eighth of a pixel" in done.stdout
    assert np.all(read_pfm(checkout / "constant" / "near" / "disp_left.pfm") == 5)
    done = run(checkout, "stereo", "squared.yaml", *IN, "-o", "squared")
    assert done.returncode == 0, done.stderr
    assert np.isfinite(read_pfm(checkout / "squared" / "near" / "confidence_spread.pfm")).all()
    assert np.mean(read_pfm(checkout / "squared" / "near" / "disp_left.pfm")[:, 9:] == 9) > 0.95
    compared = run(checkout, "evaluate", "squared", "constant", "--truth", *IN[1:], "-o", "report")
    assert compared.returncode == 0, compared.stderr
    document = json.loads((checkout / "report" / "scores.json").read_text())
    assert document["runs"] == ["squared", "constant"]
    assert "eighth-pixel" in json.dumps(document)


@pytest.mark.system
def test_they_pass_the_tests_of_their_families(checkout: Path):
    shutil.copytree(ROOT / "tests", checkout / "tests", ignore=shutil.ignore_patterns("__pycache__", "new_files"))
    files = ("contracts/test_families", "evaluation/test_protocols", "report/test_plots")
    options = ("-q", "-p", "no:cacheprovider", "--renew")  # the new members have no messages yet
    done = run(checkout, *options, *(f"tests/{name}.py" for name in files), module="pytest")
    assert done.returncode == 0, done.stdout[-3000:]
