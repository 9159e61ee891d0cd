import json
import math
from pathlib import Path

import numpy as np
import pytest

from depthcli.evaluation.curves import N_BINS, HiddenPixels, Reliability, hidden_pixels, reliability
from depthcli.evaluation.map_files import DisparityFiles
from depthcli.evaluation.protocols.registration import ExpectedErrorFiles
from depthcli.io.formats.images import read_grey, write_png
from tests.files import laid


def test_confidence_beside_a_map(tmp_path: Path):
    """A measure called probability is not that of the map; of a registration, the confidence is a plane."""
    names = ("confidence", "probability", "confidence_probability", "confidence_pkr")
    laid(tmp_path, dict.fromkeys(("disp_left.pfm", *(f"{name}.pfm" for name in names)), b""))
    found = DisparityFiles().planes(tmp_path / "disp_left.pfm")
    assert found == {"pkr" if name == "confidence_pkr" else name: tmp_path / f"{name}.pfm" for name in names}
    laid(tmp_path, {"expected_error.nii.gz": b"", "confidence.nii.gz": b""})
    found = ExpectedErrorFiles(("expected_error",), (".nii.gz",)).planes(tmp_path / "expected_error.nii.gz")
    assert found == {"confidence": tmp_path / "confidence.nii.gz"}


def test_expected_calibration_error_by_hand():
    found = reliability(np.array([0.91, 0.93, 0.12, 1.0, 0.11]), np.array([True, False, False, True, False]))
    # Bins [.9, .95): mean .92, half right; [.1, .15): mean .115, none right; [.95, 1]: 1, all right.
    assert found.ece == pytest.approx((2 * 0.42 + 2 * 0.115 + 0) / 5)
    assert (found.pixels[18], found.right[18]) == (2, 0.5) and math.isnan(found.right[0])


def test_pooled_is_that_of_all_pixels_together():
    rng = np.random.default_rng(1)
    p, right = rng.random(1000), rng.random(1000) < 0.6
    pooled, whole = Reliability.pooled(reliability(p[k::3], right[k::3]) for k in range(3)), reliability(p, right)
    assert pooled.pixels == whole.pixels and len(pooled.pixels) == N_BINS
    assert pooled.ece == pytest.approx(whole.ece)


def test_hidden_pixels_by_hand():
    known = np.array([[1, 1, 1, 1, 1, 0]], bool)
    status = np.array([[1, 4, 1, 0, 0, 1]], np.uint8)  # occluded, or out of range
    found = hidden_pixels(status, {"all": known, "nonocc": np.array([[0, 1, 1, 0, 1, 0]], bool)})
    assert found == HiddenPixels(both=1, marked=3, true=2, pixels=5)
    shares = found.shares()
    expected = {"precision": 33.33, "recall": 50, "F1": 40, "said": 60, "true": 40}
    assert {name: round(shares[name], 2) for name in expected} == expected
    assert HiddenPixels.pooled([found, found]).marked == 6
    assert math.isnan(HiddenPixels(0, 0, 0, 4).shares()["precision"])


def test_evaluate_reads_confidence_and_status(made_scenes: Path, tmp_path: Path, tool):
    name = "curved_0"
    visible = read_grey(made_scenes / name / "mask_nonocc.png") == 255
    maps = {"disp_left": 5, "confidence": 0.25, "confidence_da": 0.5}  # which is a share, no probability
    folder = laid(tmp_path / "run" / name, {f"{k}.pfm": np.full(visible.shape, v, np.float32) for k, v in maps.items()})
    write_png(folder / "status.png", np.where(visible, 0, [1, 4] * (visible.shape[1] // 2)).astype(np.uint8))
    words = ["evaluate", tmp_path / "run", "--truth", made_scenes, "--scenes", name, "-o", tmp_path / "out", "--html"]
    assert "Hidden pixels" in tool.out(0, *words, "--tables", "confidence,hidden")
    (result,) = json.loads((tmp_path / "out" / "scores.json").read_text())["results"]
    assert result["hidden"]["F1"] == 100
    curve = next(c for c in result["confidence"] if (c["measure"], c["mask"], c["of"]) == ("confidence", "all", "bad"))
    assert curve["ece"] == pytest.approx(abs(0.25 - (1 - curve["mean"])), abs=1e-6)
    assert all(c["reliability"] is None for c in result["confidence"] if c["measure"] == "da")
    assert {c["of"] for c in result["confidence"] if c["measure"] == "da"} == {"bad", "error"}
    assert "Reliability, all" in (tmp_path / "out" / "report.html").read_text("utf-8")
    (folder / "status.png").write_bytes(b"damaged")
    tool.told(0, *words)
