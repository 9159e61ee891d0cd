"""A cost measure, a confidence measure, a protocol and a command are one file each, a layout is a row of a YAML file.

The package is copied; the files of ``new_files``, the command of the plug-in template, and the cost measure of
docs/extend.md are put beside the others, and used as a user would.
"""

import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.io.formats.disparity import read_pfm
from depthcli.testing.inputs import shifted_pair
from tests.command_line import ended
from tests.files import laid

ROOT = Path(__file__).parents[2]
CACHES = shutil.ignore_patterns("__pycache__")
TEMPLATE = ROOT / "docs" / "plugin_template" / "depthcli_example"
SQUARED = """\
pipeline: local
cost: squared_difference
aggregation: {method: constant_window, window: 3}
refinement: []
confidence: [spread]
"""
LAYOUT = """\
two-files: {left: first.*, right: second.*, disparity_left: first_truth.*, max_disparity: 12, protocol: eighth-pixel}
"""
IN = ("-i", "in", "--layout", "two.yaml")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with the new files in it, and two pairs of the new layout."""
    root = tmp_path_factory.mktemp("checkout")
    for name in ("depthcli", "configs"):
        shutil.copytree(ROOT / name, root / name, ignore=CACHES)
    shutil.copy(ROOT / "pyproject.toml", root)
    shutil.copytree(Path(__file__).parent / "new_files", root / "depthcli", dirs_exist_ok=True, ignore=CACHES)
    shutil.copy(TEMPLATE / "command.py", root / "depthcli" / "commands" / "constant.py")
    shutil.copytree(TEMPLATE / "presets" / "constant", root / "configs" / "constant")
    page = (ROOT / "docs" / "extend.md").read_text("utf-8")
    (cost,) = re.findall(r"^```python file=squared.py\n(.*?)^```$", page, re.M | re.S)
    own = "depthcli/methods/stereo/cost/squared_difference.py"
    laid(root, {"two.yaml": LAYOUT, "squared.yaml": SQUARED, own: cost})
    for name, shift in (("near", 9), ("far", 5)):
        pair, truth = shifted_pair(48, 64, shift), np.full((48, 64), shift, np.float32)
        laid(root / "in" / name, {"first.png": pair.left, "second.png": pair.right, "first_truth.pfm": truth})
    return root


def run(checkout: Path, *words: str | Path) -> str:
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    return ended(0, sys.executable, *words, cwd=checkout, env=environment).stdout


def test_they_are_shown_and_run_as_any_other_and_the_protocol_ranks_the_runs(checkout: Path):
    code = "from depthcli.cli import main; [main(w.split()) for w in ('--help', 'presets', 'presets show five')]"
    shown, tool = run(checkout, "-c", code), ("-m", "depthcli")
    assert "constant Write the same disparity everywhere." in " ".join(shown.split())
    assert re.search(r"^constant five +Five pixels everywhere", shown, re.M)
    assert "# disparity of every pixel, pixels\ndisparity: 5.0" in shown
    words = ("constant", "five", *IN, "-o", "constant", "--jobs", "2", "--evaluate")
    assert "Eighth of a pixel" in run(checkout, *tool, *words)
    assert np.all(read_pfm(checkout / "constant" / "near" / "disp_left.pfm") == 5)
    run(checkout, *tool, "stereo", "squared.yaml", *IN, "-o", "squared")
    assert np.isfinite(read_pfm(checkout / "squared" / "near" / "confidence_spread.pfm")).all()
    assert np.mean(read_pfm(checkout / "squared" / "near" / "disp_left.pfm")[:, 9:] == 9) > 0.95
    run(checkout, *tool, "evaluate", "squared", "constant", "--truth", *IN[1:], "-o", "report")
    document = json.loads((checkout / "report" / "scores.json").read_text())
    assert document["runs"] == ["squared", "constant"] and "eighth-pixel" in json.dumps(document)


@pytest.mark.system
def test_they_pass_the_tests_of_their_families(checkout: Path):
    shutil.copytree(ROOT / "tests", checkout / "tests", ignore=shutil.ignore_patterns("__pycache__", "new_files"))
    files = ("contracts/test_families", "evaluation/test_protocols", "report/test_plots")
    options = ("-q", "-p", "no:cacheprovider", "--renew")  # the new members have no messages yet
    run(checkout, "-m", "pytest", *options, *(f"tests/{name}.py" for name in files))
