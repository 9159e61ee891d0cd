"""Bounds of the error: by hand on vectors, and through ``evaluate`` on maps whose errors are known."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.bound import Bound
from depthcli.core.volumes import Grid
from depthcli.evaluation.bounds import BAD, COVERAGE, COVERING, WORST, bound_means, bound_scores, judged, promised
from depthcli.evaluation.protocols.depth import DepthProtocol, DepthTruth
from depthcli.evaluation.protocols.registration import PreparedTruth, RegistrationProtocol
from depthcli.evaluation.scores import Score, Tally
from depthcli.io.formats.disparity import read_disparity
from depthcli.io.formats.images import read_grey, read_image
from depthcli.io.volume_pairs import RegistrationTruth
from tests.files import laid
from tests.golden import told

NAN = math.nan
KNOWN = [0.25, 0.5, 0.5, 0.75, 8]


def scores_of(error: list[float], bound: list[float], level: float = 0.9) -> dict[str, Score]:
    """Return heading -> score; errors above 1 are wrong."""
    errors = np.array(error, np.float32)
    found = bound_scores(Tally("all", errors), np.array(bound, np.float64), errors > 1, level, "px")
    return {score.metric.heading: score for score in found}


@pytest.mark.parametrize(("error", "bound", "expected"), [
    # A constant is as sharp as the constant, and orders nothing; one that knows the error is sharp, and orders all.
    ([0.5, 1, 2, 4], [1] * 4, {"coverage 90": 50, "median": 1, "/ constant": 1, 100: 50, 90: 50, 80: 50, 50: 50}),
    (KNOWN, KNOWN, {"coverage 90": 100, "/ constant": 0.25, 100: 20, 80: 0, 50: 0}),
    # Values without a bound are not covered, pixels without a value do not count.
    ([0.5, 0.5, 0.5, NAN], [1, NAN, 1, NAN], {"coverage 90": 200 / 3}),
    # Open bounds are counted apart, and make no bound less sharp.
    ([0.5, 2, 9], [1, 1, math.inf], {"coverage 90": 50, "finite": 200 / 3}),
    ([0.5, 1, 9], [1, 1, math.inf], {"/ constant": 1, 50: 0}),
    ([1], [math.inf], {"median": math.inf}),
    # Nothing covered has no sharpness.
    ([1, 2], [0.5, 0.5], {"coverage 90": 0, "/ constant": None}),
    ([1, 2], [NAN, NAN], {"coverage 90": 0}),
])  # fmt: skip
def test_scores_by_hand(error: list[float], bound: list[float], expected: dict[str | int, float | None]):
    found = scores_of(error, bound)
    named = {f"bound {name}" if isinstance(name, str) else f"{BAD} {name}": value for name, value in expected.items()}
    values = {heading: found[heading].value if heading in found else None for heading in named}
    assert values == pytest.approx(named)


def test_pixels_of_bounds():
    coverage = scores_of([0.5, 1, 2, 4], [1] * 4)[f"{COVERAGE} 90"]
    assert (coverage.wrong, coverage.pixels, coverage.density) == (2, 4, 100)
    found = scores_of([0.5, 0.5, 0.5, NAN], [1, NAN, 1, NAN])
    assert (found[f"{COVERAGE} 90"].pixels, found["bound median"].pixels, found["bound median"].density) == (3, 2, 75)
    assert scores_of([NAN], [1]) == {}


def test_means_weigh_maps_alike_and_know_the_worst():
    def means(*maps: tuple[list[float], list[float]]) -> dict[str, Score]:
        scores = bound_means([[*scores_of(*each).values()] for each in maps])
        return {score.metric.name: score for score in scores if score.metric.name != BAD}

    found = means(*(([1.0] * n, [2.0] * inside + [0.5] * (n - inside)) for n, inside in ((10, 8), (100, 70))))
    assert [found[name].value for name in (COVERAGE, WORST, COVERING)] == [75, 70, 50]
    assert (found[COVERAGE].pixels, found[COVERING].pixels) == (110, 2)
    assert math.isnan(scores_of([1.0], [math.inf])[f"{COVERAGE} 90"].value)  # open bounds have no coverage
    found = means(([1.0], [math.inf]), ([1.0], [2.0]))
    assert [found[name].value for name in (COVERAGE, WORST, COVERING, "bound finite")] == [100, 100, 100, 50]


def test_bounds_of_depth_are_in_meters_and_by_the_status_of_depth_maps():
    depth = np.full((2, 4), 2, np.float32)
    truth = DepthTruth(depth, {"all": np.ones((2, 4), bool)}, None, 1000)
    estimate = depth + np.array([[0.01] * 4, [0.03] * 4], np.float32)
    status = np.array([[0] * 4, [1, 1, 2, 2]], np.uint8)
    bound = np.full((2, 4), 0.02, np.float32)
    curves, scores, outside = judged(DepthProtocol(), estimate, truth, {}, bound, status, None)
    assert {s.region: s.value for s in scores if s.metric.name == COVERAGE} == {
        "all": 50, "said filled": 0, "said corrected": 0, "said kept": 100
    }  # fmt: skip
    (median,) = (s for s in scores if (s.metric.name, s.region) == ("bound median", "all"))
    assert (median.value, median.metric.unit) == (pytest.approx(20), "mm")
    assert outside is not None and outside.tolist() == [[False] * 4, [True] * 4]
    assert {curve.confidence for curve in curves} == {"bound"}


def test_bounds_of_registrations_are_of_the_true_error():
    stored = RegistrationTruth(Grid((4, 4, 4), (1, 1, 1)), np.zeros((4, 3)), np.array([1, 2, 5, 9], np.float32))
    truth = PreparedTruth(stored.error, np.zeros((4, 3)), None, stored)
    expected = np.array([9, 9, 9, NAN], np.float32)
    scores = judged(RegistrationProtocol(), expected, truth, {}, np.full(4, 3, np.float32), None, None)[1]
    (coverage,) = (s for s in scores if s.metric.name == COVERAGE)
    assert coverage.value == pytest.approx(200 / 3)
    assert (coverage.pixels, coverage.density, coverage.region) == (3, 75, "landmarks")


def test_promise_of_a_config():
    assert promised("bound: {level: 0.8, within: 2}") == Bound(level=0.8, within=2)
    assert {promised(text) for text in ("bound: {level: 80, within: many}", "bound: true", "", "{")} == {None}


def test_evaluate_reads_bounds_confidences_and_status_of_two_runs(made_scenes: Path, tmp_path: Path, tool):
    """Errors of .5 px above row 20, 4 px below, and 1 px of bound; hidden pixels as they are."""
    name, out, runs = "curved_0", tmp_path / "out", (tmp_path / "a", tmp_path / "b")
    truth = read_disparity(made_scenes / name / "disp_left.pfm")
    error = np.full(truth.shape, 4, np.float32)
    error[:20] = 0.5
    for run, level in zip(runs, (0.9, 0.5), strict=True):
        laid(run / name, {"disp_left.pfm": truth + error, "bound.pfm": np.full_like(truth, 1)})
        laid(run, {"run.yaml": f"bound: {{level: {level}, within: 5}}\n"})
    visible = read_grey(made_scenes / name / "mask_nonocc.png") == 255
    status = np.where(error < 1, 0, 16) + np.where(visible, 0, [1, 4] * (visible.shape[1] // 2))
    shares = {"probability": 1, "confidence": 0.25, "confidence_da": 0.5}  # which is a share, no probability
    laid(runs[0] / name, {f"{key}.pfm": np.full_like(truth, value) for key, value in shares.items()})
    laid(runs[0] / name, {"status.png": status.astype(np.uint8)})
    words = ["evaluate", *runs, "--truth", made_scenes, "--scenes", name, "-o", out, "--html", "--tables"]
    printed = tool.out(0, *words, "bounds,confidence,hidden")
    assert "said filled" in printed and "Hidden pixels" in printed
    report = json.loads((out / "scores.json").read_text())
    rows = {(r["run"], r["mask"], r["metric"]): r for r in report["bounds"] if r["metric"] != BAD}
    assert [rows["a", region, COVERAGE]["value"] for region in ("said measured", "said filled")] == [100, 0]
    assert rows["a", "said measured", "bound / constant"]["value"] == pytest.approx(2, abs=1e-4)
    assert [rows[run, "all", COVERAGE]["threshold"] for run in "ab"] == [90, 50]
    assert len({rows[of]["value"] for of in (("a", "all", COVERAGE), ("a", "all", WORST), ("b", "all", COVERAGE))}) == 1
    # Of a probability that all errors are within 5 px, and so they are.
    curves = [c for c in report["results"][0]["confidence"] if (c["mask"], c["of"]) == ("all", "bad")]
    by_measure = {c["measure"]: c for c in curves}
    eces = {name: c["ece"] for name, c in by_measure.items() if c["reliability"] is not None}
    right = 1 - by_measure["confidence"]["mean"]
    assert eces == {"probability": 0, "confidence": pytest.approx(abs(0.25 - right), abs=1e-6)}
    assert report["results"][0]["hidden"]["F1"] == 100
    lines = list(csv.DictReader((out / "scores.csv").read_text("utf-8").splitlines()))
    areas = {tuple(line["metric"].split(":")) for line in lines if line["metric"].endswith(":bad")}
    assert {name for area, name, _ in areas if area == "ece"} == {*eces}
    assert {name for area, name, _ in areas if area == "auc"} == {*by_measure}
    wanted = {"run": "b", "scene": "*mean", "mask": "all", "metric": COVERAGE}
    (mean,) = (line for line in lines if wanted.items() <= line.items())
    assert float(mean["density"]) == 100 and int(mean["wrong"] or 0) <= int(mean["pixels"])
    picture = read_image(*(out / "bounds" / "a").rglob("*.png"))
    inside, outside = ({tuple(c) for c in part.reshape(-1, 3).tolist()} for part in (picture[:20], picture[20:]))
    assert not inside & outside - {(255, 255, 255)}
    page = (out / "report.html").read_text("utf-8")
    assert "Coverage of the bounds against their level, nonocc" in page and "Reliability, all" in page
    assert "bounds/b/" in (out / "report.md").read_text("utf-8")
    # Without bounds there is no table, and damaged ones have a warning.
    (runs[0] / name / "bound.pfm").unlink()
    (runs[1] / name / "bound.pfm").write_bytes(b"damaged")
    (runs[0] / name / "status.png").write_bytes(b"damaged")
    printed = tool.both(0, *words, "all")
    assert "bounds of the error" not in printed.out
    told(printed.err)
    assert json.loads((out / "scores.json").read_text())["bounds"] == []
    assert "Coverage of the bounds" not in (out / "report.html").read_text("utf-8")
