"""Plots as SVG: well formed, escaped, the same bytes again, and the numbers that the tables have."""

import csv
import json
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.evaluation.curves import Reliability, sparsification
from depthcli.evaluation.protocols import Settings, load, missing_scores, names
from depthcli.evaluation.protocols._disparity import DisparityTruth
from depthcli.evaluation.protocols.depth import DepthProtocol, DepthTruth
from depthcli.evaluation.scores import in_order
from depthcli.io.scenes import StereoScene
from depthcli.io.stereo_pairs import StereoTruth
from depthcli.report import plots
from depthcli.report.plots import Line, curve_plot, line_plot
from tests.command_line import ended


def _texts(svg: str) -> list[str]:
    return ["".join(e.itertext()) for e in ElementTree.fromstring(svg).iter() if e.tag.endswith("text")]


def test_a_plot_is_well_formed_and_escapes():
    lines = [Line("a<b & c$", [5, 50, 100], [0, 0.1, 0.2]), Line("_flat", [5, 9], [0, 0]), Line("b", [1], [1], True)]
    svg = line_plot(lines, "t<", "x", "y")
    texts = _texts(svg)
    assert {"a<b & c$", "t<", "x", "y", "b"} <= {text.strip("\u200b") for text in texts}
    assert any("_flat" in text for text in texts)
    assert svg == line_plot(lines, "t<", "x", "y") and "dc:date" not in svg
    of_nothing = SimpleNamespace(
        runs=("a",), overall=lambda run: SimpleNamespace(value=float("nan")), results_of=lambda run: ()
    )
    ElementTree.fromstring(plots._times(of_nothing, "bad"))  # no run has a mean


def test_a_plot_has_six_curves_at_most_the_best():
    rng = np.random.default_rng(0)
    error, noise = np.linspace(0, 1, 200) ** 2, rng.normal(0, 1, 200)
    curves = {f"measure{k}": sparsification(-error - k * noise, error) for k in range(9)}
    svg = curve_plot(curves, "run: scene", "error")
    best = sorted(curves, key=lambda name: curves[name].auc)[:6]
    assert {name for name in curves if f"{name} " in svg} == set(best)
    assert "the best 6 of 9" in svg


def test_the_spread_over_scenes_begins_at_zero():
    values = {"a": [40.0, 50.0, 60.0], "b": [np.nan, 55.0, 70.0]}
    section = SimpleNamespace(
        runs=tuple(values), scenes=range(3), regions=("all",), protocol=SimpleNamespace(headline=None),
        score=lambda run, scene, _: SimpleNamespace(value=values[run][scene]),
    )  # fmt: skip
    assert {"0", "a", "b", "bad"} <= set(_texts(plots._boxes(section, "bad")))


@pytest.mark.slow
def test_matplotlib_is_not_imported_where_nothing_is_drawn(tmp_path: Path, scenes: Path, runs: list[Path]):
    code = "import sys\nfrom depthcli.cli import main\nsys.exit(main(sys.argv[1:]) or ('matplotlib' in sys.modules))"
    ended(0, sys.executable, "-c", code, "evaluate", runs[1], "--truth", scenes, "-o", tmp_path, "-q")


@pytest.mark.slow
def test_plots_tables_and_files_name_the_same_statistic(tmp_path: Path, scenes: Path, runs: list[Path], tool):
    """KITTI 2015 pools its scores over the pixels; areas of curves are means of maps, calibration errors pooled."""
    words = ["evaluate", str(runs[0]), "--truth", str(scenes), "--protocol", "kitti-2015"]
    assert main([*words, "-o", str(tmp_path), "--html"]) == 0
    printed = {}
    for form in ("", "latex", "csv"):
        printed[form] = tool.out(0, *words, "--tables", "confidence", *(["--format", form] if form else []))
        assert "mean of 2" in printed[form] and "pooled of 2" in printed[form]
    document = json.loads((tmp_path / "scores.json").read_text())
    (curve,) = document["by_threshold"]
    assert {curve["statistic"]} == {row["statistic"] for row in document["means"]} == {"pooled"}
    plots_of = {path.stem.partition("kitti-2015_")[2]: path for path in (tmp_path / "curves/all_scenes").iterdir()}
    svg = {name: path.with_suffix(".svg").read_text("utf-8") for name, path in plots_of.items()}
    rows = {name: list(csv.DictReader(path.with_suffix(".csv").read_text("utf-8").splitlines()))
            for name, path in plots_of.items() if path.with_suffix(".csv").exists()}  # fmt: skip
    assert [float(row["out"]) for row in rows["threshold"]] == curve["values"]
    expected = {"threshold": "pooled", "sparsification_occ_bad": "mean of 2", "reliability_occ": "pooled of 2"}
    for name, statistic in expected.items():
        assert {row["statistic"] for row in rows[name]} == {statistic}
        assert statistic in svg[name]
    own = [c for r in document["results"] for c in r["confidence"]
           if (c["mask"], c["of"], c["measure"]) == ("occ", "bad", "probability")]  # fmt: skip
    errors = [float(row["share of incorrect pixels"]) for row in rows["sparsification_occ_bad"]
              if row["curve"] == "probability"]  # fmt: skip
    assert errors == pytest.approx(np.mean([c["errors"] for c in own], axis=0))
    ece = Reliability.pooled(
        Reliability(*(tuple(np.nan if v is None else v for v in part) for part in c["reliability"].values()))
        for c in own
    ).ece
    assert f"probability {ece:.3f}" in svg["reliability_occ"]
    assert f"{ece:.4f}" in printed[""] and f"{ece:.4f}" in printed["latex"] and str(ece)[:9] in printed["csv"]
    page = (tmp_path / "report.html").read_text("utf-8")
    assert all(f"{what}, occ" in page for what in ("Sparsification", "Reliability"))
    assert "most confident pixels, mean of 2" in page and "calibration error, pooled of 2" in page


STEREO = [name for name in names() if load(name).kind is StereoScene]


@pytest.mark.parametrize("threshold", [None, 5.0])
@pytest.mark.parametrize("name", STEREO)
def test_dense_thresholds_agree_with_the_table(name: str, threshold: float | None):
    rng = np.random.default_rng(4)
    stored = rng.uniform(5, 40, (30, 40)).astype(np.float32)
    stored[:3] = np.nan
    judge = load(name)(Settings(threshold=threshold))
    noc = stored.copy()
    noc[:, :6] = np.nan
    masks = judge.masks(StereoTruth(stored, None, noc, None, {}))
    truth = DisparityTruth(stored, {m: masks[m] for m in in_order(masks, judge.region_order)}, noc)
    estimate = np.where(rng.random(stored.shape) < 0.1, np.nan, stored + rng.normal(0, 2, stored.shape))
    estimate = estimate.astype(np.float32)
    before = judge.all_thresholds
    dense = {s.metric.threshold: s for s in judge.threshold_curve(estimate, truth)}
    assert judge.all_thresholds == before
    assert len(dense) >= 24 and list(dense) == sorted(dense)
    main = next(iter(truth.regions))
    assert {s.region for s in dense.values()} == {main}
    table = [score for score in judge.scores(estimate, truth) if score.region == main]
    same = [s for s in table if (at := s.metric.threshold) is not None and s.metric == judge.at(at)]
    assert len(same) >= min(3, len(judge.thresholds)) and all(dense[s.metric.threshold] == s for s in same)
    values = [s.value for s in dense.values()]
    assert values == sorted(values, reverse=True)
    assert all(s.value == s.metric.worst for s in missing_scores(judge, truth, dense=True))


def test_dense_ratios_of_depth_agree_with_the_table():
    rng = np.random.default_rng(5)
    depth = rng.uniform(1, 3, (20, 30)).astype(np.float32)
    truth = DepthTruth(depth, {"all": np.ones(depth.shape, bool)}, None, 1000.0)
    judge, estimate = DepthProtocol(), (depth * rng.normal(1, 0.1, depth.shape)).astype(np.float32)
    dense = {s.metric: s for s in judge.threshold_curve(estimate, truth)}
    same = [s for s in judge.scores(estimate, truth) if s.metric in dense]
    assert len(same) == 3  # 1.05, 1.10, 1.25
    assert all(dense[s.metric] == s for s in same)
