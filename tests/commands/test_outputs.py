"""What commands print and write on one small input, compared whole (``tests/outputs``)."""

import re
from pathlib import Path

import numpy as np
import pytest

from depthcli.evaluation.benchmarks import TEST, TRAINING
from tests.commands.test_export import V3, quarter, run_of
from tests.files import laid
from tests.golden import Same, steady_csv, steady_json


def steady_table(text: str) -> str:
    return re.sub(r"(?m) +\d+\.\d+ +\d+ MiB$| +memory$", "", text).replace("  seconds", "")


RUNS = {
    "stereo": ("two_scenes", "stereo", "fast", "--bound"),
    "fuse": ("two_scenes", "fuse", "consensus", "--max-disparity", "12"),
    "refine-kinect": ("made_kinect", "refine-kinect", "fast", "--scenes", "planes"),
    "transparent": ("made_glass", "transparent", "sparse", "--scenes", "glass_0"),
    "confidence": ("two_scenes", "confidence", "--maps", "{input}", "--measure", "all"),
    "rectify": ("two_scenes", "rectify", "--uncalibrated"),
    "register-confidence": ("made_volumes", "register-confidence", "axes", "--scenes", "pair_0"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_a_run(name: str, same: Same, request: pytest.FixtureRequest, tmp_path: Path, tool):
    fixture, *words = RUNS[name]
    scenes = str(request.getfixturevalue(fixture))
    words = [*(word.format(input=scenes) for word in words), "-i", scenes, "-o", str(tmp_path / "run")]
    same(f"{name}.table.txt", steady_table(tool.out(0, *words)))
    same(f"{name}.report.csv", steady_csv((tmp_path / "run" / "report.csv").read_text()))
    same(f"{name}.json", steady_json(tool.out(0, *words, "--json")))


@pytest.fixture
def scored(tmp_path: Path) -> list[str]:
    """Words of an evaluation of two runs of two scenes: a good one, and one with wrong values, gaps and times."""
    rng = np.random.default_rng(0)
    truth = np.linspace(4, 12, 32, dtype=np.float32) * np.ones((24, 1), np.float32)
    wrong = truth.copy()
    wrong[:8, ::3] += 1.5
    wrong[10:14, 12:20], wrong[20] = np.nan, 0
    for k, name in enumerate(("a", "b")):
        images = {f"{side}.png": rng.integers(0, 256, (24, 32, 3)).astype(np.uint8) for side in ("left", "right")}
        masks = np.arange(32) >= np.full((24, 1), 8), np.eye(24, 32, dtype=np.uint8) * np.uint8(255)
        laid(tmp_path / "set" / name, {
            **images, "disp_left.pfm": truth, "mask_nonocc.png": masks[0], "mask_disc.png": masks[1],
            "meta.json": {"max_disparity": 15},
        })  # fmt: skip
        laid(tmp_path / "good" / name, {"disp_left.pfm": truth + np.float32(0.3 * k)})
        laid(tmp_path / "poor" / name, {
            "disp_left.pfm": np.roll(wrong, k, axis=0), "confidence_pkr.pfm": rng.random((24, 32), np.float32),
            "bound.pfm": np.float32(0.2) + rng.random((24, 32), np.float32),
        })  # fmt: skip
    done = {"status": "done", "width": 32, "height": 24}
    rows = [{"scene": name, **done, "seconds": {"a": 0.5, "b": 1 + k}} for k, name in enumerate(("a", "b"))]
    for run in ("good", "poor"):
        laid(tmp_path / run, {"report.json": {"scenes": rows}})
    return ["evaluate", str(tmp_path / "good"), str(tmp_path / "poor"), "--truth", str(tmp_path / "set")]


@pytest.mark.parametrize("protocol", ["middlebury-v2", "middlebury-v3", "kitti-2012", "kitti-2015", "eth3d", "booster"])
def test_an_evaluation(protocol: str, scored: list[str], same: Same, tmp_path: Path, tool):
    words = [*scored, "--protocol", protocol]
    same(f"evaluate.{protocol}.txt", tool.out(0, *words, "--tables", "all", "-o", tmp_path / "out"))
    if protocol != "middlebury-v2":
        return
    for form in ("latex", "markdown", "csv"):
        out = tool.out(0, *words, "--format", form)
        same(f"evaluate.{form}.txt", steady_csv(out) if form == "csv" else out)
    same("evaluate.json", steady_json(tool.out(0, *words, "--json"), ("version",)))
    same("evaluate.report.md", (tmp_path / "out" / "report.md").read_text())
    same("evaluate.scores.csv", steady_csv((tmp_path / "out" / "scores.csv").read_text()[:7000].rpartition("\n")[0]))


def test_depth(scored: list[str], same: Same, tmp_path: Path, tool):
    words = ["depth", str(tmp_path / "good" / "a" / "disp_left.pfm"), "--focal", "40", "--baseline", "0.2"]
    words += ["--doffs", "2", "-o", str(tmp_path / "depth")]
    same("depth.table.txt", steady_table(tool.out(0, *words)))
    same("depth.json", steady_json(tool.out(0, *words, "--json")))


def test_export(same: Same, tmp_path: Path, tool):
    run = run_of(tmp_path / "run", [*V3.scenes[TRAINING], *V3.scenes[TEST]], quarter)
    words = ["export", str(run), "--for", "middlebury-v3", "--method", "ours", "-o", str(tmp_path / "a.zip")]
    same("export.txt", "".join(tool.both(0, *words)))
    same("export.json", steady_json(tool.out(0, *words, "--overwrite", "--json")))


def test_presets(same: Same, tool):
    same("presets.json", steady_json(tool.out(0, "presets", "--json")))
    same("presets.txt", tool.out(0, "presets"))


@pytest.mark.slow
def test_a_sweep(two_scenes: Path, same: Same, tmp_path: Path, tool):
    words = ["sweep", "fast", "-i", str(two_scenes), "-o", str(tmp_path / "sweep"), "--over", "optimization.p2=2,8"]
    same("sweep.txt", re.sub(r"(?m) +\d+\.\d+$", "", tool.out(0, *words)))
    same("sweep.json", steady_json(tool.out(0, *words, "--json")))


def test_samples(same: Same, tmp_path: Path, tool):
    words = ["sample", "-n", "3", "--width", "64", "--height", "48", "--max-disparity", "8", "-o", str(tmp_path / "s")]
    same("sample.json", steady_json(tool.out(0, *words, "--json")))
