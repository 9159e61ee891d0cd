"""``evaluate`` from Python: the numbers of the command for the same maps, masks, errors."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import depthcli
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_grey
from depthcli.io.formats.volumes import read_volume
from tests.command_line import Tool, run
from tests.golden import refused


def key(row: dict[str, Any]) -> tuple[Any, ...]:
    return row["metric"], row["mask"], row["threshold"], row["unit"]


def by_command(tool: Tool, words: str, folder: Path, scene: str, output: Path) -> tuple[Path, Any]:
    """Run a command on a scene; return what it wrote, and what its scores should be near."""
    assert run(*words.split(), "-i", folder, "--scenes", scene, "-o", output, "-q") == 0
    arguments = ["--truth", folder, "--scenes", scene, "--output", output / "results"]
    (result,) = json.loads(tool.out(0, "evaluate", output, *arguments, "--json"))["results"]
    scores = {key(row): math.nan if row["value"] is None else row["value"] for row in result["scores"]}
    return output / scene, pytest.approx(scores, nan_ok=True)


def of_python(scores: depthcli.Scores) -> dict[tuple[Any, ...], float]:
    return {key(row): row["value"] for row in scores.rows()}


def masks(folder: Path) -> dict[str, NDArray[np.bool_]]:
    return {path.stem.removeprefix("mask_"): read_grey(path) == 255 for path in folder.glob("mask_*.png")}


def test_disparities_have_the_scores_of_the_command(tmp_path: Path, made_scenes: Path, tool: Tool):
    found, expected = by_command(tool, "stereo fast", made_scenes, "planes_0", tmp_path)
    estimate, truth = (read_pfm(folder / "disp_left.pfm") for folder in (found, made_scenes / "planes_0"))
    scores = depthcli.evaluate(estimate, truth, "middlebury-v2", masks(made_scenes / "planes_0"))
    assert of_python(scores) == expected
    assert scores.headline["all"] == scores.value("bad", "all", 1.0)
    assert scores.error.shape == truth.shape and scores.picture is not None
    assert scores._repr_png_() and repr(scores).startswith("Scores(middlebury-v2, bad 1: nonocc ")


def test_depths_have_the_scores_of_the_command(tmp_path: Path, made_kinect: Path, tool: Tool):
    found, expected = by_command(tool, "refine-kinect nearest", made_kinect, "planes", tmp_path)
    depth, truth = read_pfm(found / "depth.pfm"), read_pfm(made_kinect / "planes" / "depth_true.pfm")
    assert of_python(depthcli.evaluate(depth, truth, "depth", masks(made_kinect / "planes"), fb=43.5)) == expected


def test_registrations_have_the_scores_of_the_command(tmp_path: Path, made_volumes: Path, tool: Tool):
    found, expected = by_command(tool, "register-confidence axes", made_volumes, "pair_0", tmp_path)
    truth, mask = (read_volume(made_volumes / "pair_0" / f"{name}.nii.gz").values for name in ("error_true", "mask"))
    estimate = read_volume(found / "expected_error.nii.gz").values
    scores = depthcli.evaluate(estimate, truth, "registration", mask)
    assert of_python(scores) == expected
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
        (TRUTH, TRUTH, "registration", {"all": TRUTH}),
    ):  # fmt: skip
        refused(depthcli.InputError, depthcli.evaluate, *arguments)
    refused(depthcli.InputError, depthcli.evaluate(TRUTH, TRUTH).value, "bad", "all")
