"""``evaluate`` from Python: the numbers of the command for the same maps, masks, errors."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import depthcli
from depthcli.cli import main
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_grey
from depthcli.io.formats.volumes import read_volume
from tests.command_line import Tool
from tests.golden import refused


def key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["metric"], row["mask"], row["threshold"], row["unit"]


def of_command(tool: Tool, folder: Path, scene: str, run: Path) -> dict[tuple[Any, ...], float]:
    arguments = ["--truth", str(folder), "--scenes", scene, "--output", str(run / "results")]
    (result,) = json.loads(tool.out(0, "evaluate", run, *arguments, "--json"))["results"]
    return {key(row): math.nan if row["value"] is None else row["value"] for row in result["scores"]}


def of_python(scores: depthcli.Scores) -> dict[tuple[Any, ...], float]:
    return {key(row): row["value"] for row in scores.rows()}


def masks(folder: Path) -> dict[str, NDArray[np.bool_]]:
    return {path.stem.removeprefix("mask_"): read_grey(path) == 255 for path in folder.glob("mask_*.png")}


def test_disparities_have_the_scores_of_the_command(tmp_path: Path, made_scenes: Path, tool: Tool):
    run = tmp_path / "run"
    assert main(["stereo", "fast", "-i", str(made_scenes), "--scenes", "planes_0", "-o", str(run), "-q"]) == 0
    scene = made_scenes / "planes_0"
    estimate, truth = read_pfm(run / "planes_0" / "disp_left.pfm"), read_pfm(scene / "disp_left.pfm")
    scores = depthcli.evaluate(estimate, truth, "middlebury-v2", masks(scene))
    assert of_python(scores) == pytest.approx(of_command(tool, made_scenes, "planes_0", run), nan_ok=True)
    assert scores.headline["all"] == scores.value("bad", "all", 1.0)
    assert scores.error.shape == truth.shape and scores.picture is not None
    assert scores._repr_png_() and repr(scores).startswith("Scores(middlebury-v2, bad 1: nonocc ")


def test_depths_have_the_scores_of_the_command(tmp_path: Path, made_kinect: Path, tool: Tool):
    run, scene = tmp_path / "run", made_kinect / "planes"
    assert main(["refine-kinect", "nearest", "-i", str(made_kinect), "--scenes", "planes", "-o", str(run), "-q"]) == 0
    truth = read_pfm(scene / "depth_true.pfm")
    scores = depthcli.evaluate(read_pfm(run / "planes" / "depth.pfm"), truth, "depth", masks(scene), fb=43.5)
    assert of_python(scores) == pytest.approx(of_command(tool, made_kinect, "planes", run), nan_ok=True)


def test_registrations_have_the_scores_of_the_command(tmp_path: Path, made_volumes: Path, tool: Tool):
    folder, run = made_volumes, tmp_path / "run"
    assert main(["register-confidence", "axes", "-i", str(folder), "--scenes", "pair_0", "-o", str(run), "-q"]) == 0
    volumes = (run / "pair_0" / "expected_error.nii.gz", folder / "pair_0" / "error_true.nii.gz")
    estimate, truth, mask = (read_volume(file).values for file in (*volumes, folder / "pair_0" / "mask.nii.gz"))
    scores = depthcli.evaluate(estimate, truth, "registration", mask)
    expected = of_command(tool, folder, "pair_0", run)
    assert of_python(scores) == pytest.approx(expected, nan_ok=True)
    at_points = depthcli.evaluate(estimate[mask > 0], truth[mask > 0], "registration")
    assert [score.value for score in at_points] == pytest.approx([score.value for score in scores], nan_ok=True)
    assert at_points.scores[0].region == "landmarks"


def test_results_are_estimates_and_kitti_has_its_regions(made_scenes: Path):
    scene = made_scenes / "planes_0"
    truth = read_pfm(scene / "disp_left.pfm")
    visible = masks(scene)["nonocc"]
    scores = depthcli.evaluate(truth + np.float32(4), truth, "kitti-2015", {"noc": visible})
    assert scores.headline == {"occ": 100.0, "noc": 100.0}
    assert "sign" not in "".join(scores.warnings)
    assert depthcli.evaluate(-truth, truth).warnings[0].startswith("the values are about -1 times")
    assert np.isnan(depthcli.evaluate(truth, truth, mask=visible).error[~visible]).all()


TRUTH = np.ones((4, 5), np.float32)


def test_what_cannot_be_compared_is_refused_and_a_score_that_is_not_there_named():
    for arguments in (
        (TRUTH, TRUTH, "middlebury-v4"), *((TRUTH[:2], TRUTH, *of) for of in ([], ["registration"], ["depth"])),
        (TRUTH.astype(str), TRUTH), (TRUTH, TRUTH * np.nan), (TRUTH, TRUTH, "depth", {"gap": TRUTH[:3]}),
    ):  # fmt: skip
        refused(depthcli.InputError, depthcli.evaluate, *arguments)
    refused(depthcli.InputError, depthcli.evaluate(TRUTH, TRUTH).value, "bad", "all")
