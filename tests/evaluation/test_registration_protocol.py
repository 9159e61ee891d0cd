"""Figures of registration confidence against closed forms."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.volumes import Grid
from depthcli.evaluation.comparison import EvaluationReport, Section
from depthcli.evaluation.protocols import missing_scores, registration
from depthcli.evaluation.protocols.registration import PreparedTruth, RegistrationProtocol, error_classes
from depthcli.evaluation.scores import COMMON_MEAN, MEAN, MapResult
from depthcli.evaluation.statistics import correlation, ranks, roc_area
from depthcli.io.formats.volumes import write_array
from depthcli.io.scenes import StereoScene, VolumePairScene
from depthcli.io.volume_pairs import RegistrationTruth
from depthcli.report.tables import chosen_text
from tests.golden import refused, warned


def test_correlation_area_and_classes():
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert correlation(a, 2 * a + 1) == pytest.approx(1)
    assert correlation(ranks(np.exp(a)), ranks(a)) == pytest.approx(1)
    assert correlation(a, -a) == pytest.approx(-1)
    assert np.isnan(correlation(a, np.ones(4)))
    score, bad = np.array([1.0, 2.0, 2.0, 5.0]), np.array([False, True, False, True])
    in_order = [1.0, 0.5, 1.0, 1.0]  # (2 against 1), (2 against 2), (5 against 1), (5 against 2)
    assert roc_area(score, bad) == pytest.approx(sum(in_order) / 4)
    assert np.isnan(roc_area(score, np.ones(4, bool)))
    assert error_classes(np.array([0.0, 2.99, 3.0, 5.99, 6.0, 40.0])).tolist() == [0, 0, 1, 1, 2, 2]


PROTOCOL = RegistrationProtocol()


def test_truth_and_maps_that_cannot_be_used_are_refused(tmp_path: Path):
    pytest.importorskip("SimpleITK")
    grid, files = Grid((4, 3, 2), (1.0, 1.0, 1.0)), {name: tmp_path / f"{name}.mha" for name in ("fixed", "error_true")}
    for file in files.values():
        write_array(file, grid, np.full(grid.shape, -1, np.float32))  # unknown
    scene = VolumePairScene(name="a", folder=tmp_path, **files)
    refused(InputError, PROTOCOL.truth, StereoScene(name="b", folder=tmp_path, left=files["fixed"]))
    warned(refused, InputError, PROTOCOL.truth, scene)
    write_array(files["error_true"], grid, np.ones(grid.shape, np.float32))
    write_array(tmp_path / "map.mha", replace(grid, spacing=(1.0, 1.0, 2.0)), np.ones(grid.shape, np.float32))
    refused(InputError, PROTOCOL.read, tmp_path / "map.mha", scene, PROTOCOL.truth(scene))


WIDE = (8, 250, 100)  # a volume whose last axis has a common divisor with any round step


def result(scene: str, expected: np.ndarray | None, true: np.ndarray, run: str = "run") -> MapResult:
    """The result of a dense truth; without ``expected``, of a pair that has no map."""
    volume = true.astype(np.float32)
    stored = RegistrationTruth(Grid(volume.shape[::-1], (1.0, 1.0, 1.0)), np.zeros((0, 3)), volume)
    truth = PreparedTruth(volume.ravel(), None, np.ones(volume.shape, bool), stored)
    start = MapResult(run, scene, "set", PROTOCOL.name)
    if expected is None:
        return replace(start, scores=tuple(missing_scores(PROTOCOL, truth)), error="no map")
    estimate = expected.astype(np.float32).ravel()
    pooled = PROTOCOL.points(estimate, truth)[1]
    return replace(start, scores=tuple(PROTOCOL.scores(estimate, truth)), pooling_data=pooled)


def errors_along_x(seed: int, shape: tuple[int, int, int] = WIDE) -> tuple[np.ndarray, np.ndarray]:
    """True errors that grow along x, the last axis, and expected ones that are near them."""
    rng = np.random.default_rng(seed)
    true = np.broadcast_to(np.linspace(0, 9, shape[2]), shape) + rng.uniform(0, 0.2, shape)
    return true + rng.normal(0, 0.5, shape), true


def values(scores: Any) -> dict[str, float]:
    return {score.metric.heading: score.value for score in scores}


@pytest.mark.parametrize("limit", [10**9, 150_000])
def test_pooled_figures_are_those_of_all_points(limit: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(registration, "_MAX_POOLED", limit)
    pairs = [errors_along_x(1), errors_along_x(2, (4, 50, 100))]
    pooled = values(PROTOCOL.mean([result(str(i), *pair) for i, pair in enumerate(pairs)]))
    together = [np.concatenate([pair[k].ravel() for pair in pairs])[None, None] for k in (0, 1)]
    units = {score.metric.name: score.metric.unit for score in result("0", *pairs[0]).scores}
    assert units == dict.fromkeys(("Spearman", "Pearson", "AUC"), "") | {"accuracy": "%"} | dict.fromkeys(
        ("MAE", "expected", "AUSE", "AURG", "TRE", "TRE std", "TRE30"), "mm"
    )
    assert pooled == pytest.approx(values(result("all", *together).scores), rel=1e-12 if limit > 10**6 else 0.01)


def test_areas_of_true_errors_sorted_by_expected_ones():
    """Of errors from 0 to 9 mm, the best part s has a mean of 4.5 s, and the worst of 9 - 4.5 s."""
    true = np.linspace(0, 9, 1000).reshape(1, 10, 100)
    for expected, ause, aurg in ((2 * true, 0, 2.25), (9 - true, 4.5, -2.25)):
        found = values(result("", expected, true).scores)
        assert (found["AUSE"], found["AURG"]) == pytest.approx((ause, aurg), abs=0.02)


def test_a_missing_pair_is_pooled_as_the_worst_points():
    here, lost = errors_along_x(3, (4, 50, 100)), errors_along_x(4, (2, 50, 100))
    full = result("a", *here)
    assert values(PROTOCOL.mean([full])) == values(full.scores) and values(full.scores)["Spearman"] > 0.95
    scores = PROTOCOL.mean([full, result("b", None, lost[1])])
    pooled = values(scores)
    row = values(full.scores)
    assert pooled["Spearman"] == pytest.approx((2 * row["Spearman"] - 1) / 3)
    assert pooled["accuracy"] == pytest.approx(2 * row["accuracy"] / 3)
    assert np.isnan(pooled["MAE"])
    empty = result("b", np.full(lost[1].shape, np.nan), lost[1])
    assert values(PROTOCOL.mean([full, empty])) == pytest.approx(pooled, nan_ok=True)
    assert [score.density for score in scores] == pytest.approx([100 * 2 / 3] * len(scores))
    nothing = values(PROTOCOL.mean([result(name, None, true) for name, (_, true) in (("a", here), ("b", lost))]))
    assert (nothing["Spearman"], nothing["accuracy"]) == (-1, 0) and np.isnan(nothing["TRE"])


def test_what_a_run_lacks_changes_no_other_runs_figures():
    pairs = {name: errors_along_x(seed, (4, 50, 40 + 30 * seed)) for seed, name in enumerate("abc")}
    whole = [result(name, *pair, run="whole") for name, pair in pairs.items()]
    lacking = [result(n, None if n == "c" else e, t, run="lacking") for n, (e, t) in pairs.items()]
    alone = Section("set", PROTOCOL, ("whole",), tuple(whole))
    beside = Section("set", PROTOCOL, ("whole", "lacking"), (*whole, *lacking))
    key = (PROTOCOL.headline, "voxels")
    means = [section.score("whole", MEAN, key) for section in (alone, beside)]
    assert means[0] == means[1]
    common = [beside.score(run, COMMON_MEAN, key) for run in ("whole", "lacking")]
    assert common[0] == common[1]
    assert common[0].value == pytest.approx(values(PROTOCOL.mean(whole[:2]))["Spearman"])


def test_one_word_and_one_number_for_what_is_no_mean():
    results = tuple(result(f"set/{k}", *errors_along_x(k, (2, 3, 10 + 20 * k))) for k in range(3))
    report = EvaluationReport(("run",), results, {PROTOCOL.name: PROTOCOL}, "truth")
    (section,) = report.sections
    key = PROTOCOL.headline, "voxels"
    value = section.score("run", MEAN, key).value
    by_scene = [section.score("run", scene, key).value for scene in section.scenes]
    assert value != pytest.approx(np.mean(by_scene), abs=1e-3)
    narrow, latex = chosen_text(report, ["all"]), chosen_text(report, [], form="latex")
    for text in (narrow, latex):
        assert "pooled of 3" in text and "mean of 3" not in text and f"{value:.2f}" in text
    rows = {row["scene"]: row for row in report.records() if row["metric"] == "Spearman"}
    assert rows["*pooled"]["value"] == value and "*mean" not in rows
    (mean,) = (row for row in report.to_dict()["means"] if row["metric"] == "Spearman")
    assert (mean["statistic"], mean["value"]) == ("pooled", value)
