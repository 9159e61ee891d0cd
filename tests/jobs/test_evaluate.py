"""The evaluation job: files in, tables, scores, pictures and reasons out."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.disparity import read_disparity, write_disparity_png, write_pfm
from depthcli.io.images import read_image, write_png
from depthcli.io.scenes import find_scenes
from depthcli.jobs.evaluate import evaluate

DATA = Path(__file__).parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real scenes of ../shared/data are not here")

SHAPE = (24, 32)
TRUTH = np.linspace(4, 12, SHAPE[1], dtype=np.float32) * np.ones((SHAPE[0], 1), np.float32)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """Two scenes with masks and 8-bit truth (x8), in our own layout."""
    folder = tmp_path / "set"
    rng = np.random.default_rng(0)
    for name in ("a", "b"):
        image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
        write_png(folder / name / "left.png", image)
        write_png(folder / name / "right.png", image)
        write_png(folder / name / "disp_left.png", np.rint(TRUTH * 8).astype(np.uint8))
        visible = np.ones(SHAPE, bool)
        visible[:, :8] = False
        write_png(folder / name / "mask_nonocc.png", visible)
        write_png(folder / name / "mask_disc.png", np.eye(*SHAPE, dtype=np.uint8) * np.uint8(255))
        (folder / name / "meta.json").write_text(json.dumps({"disp_scale": 8, "max_disparity": 15}))
    return folder


def exact(truth: Path, name: str = "a") -> np.ndarray:
    return find_scenes(truth, pattern=name)[0].load_truth().disparity


def run_of(folder: Path, maps: dict[str, np.ndarray]) -> Path:
    for name, values in maps.items():
        write_pfm(folder / name / "disp_left.pfm", values)
    return folder


def rows(output: Path) -> list[dict[str, str]]:
    with (output / "scores.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_two_runs_side_by_side(tmp_path: Path, truth: Path):
    good = exact(truth)
    half = good.copy()
    half[:12] += 2
    half[0, 20] = np.nan
    perfect = run_of(tmp_path / "perfect", {"a": good, "b": good})
    wrong = run_of(tmp_path / "half", {"a": half, "b": half})
    report = evaluate([perfect, wrong], truth, tmp_path / "out")
    assert report.failed == []
    assert report.warnings == []
    text = report.text()
    assert "perfect" in text
    assert "mean of all figures" in text
    for row in rows(tmp_path / "out"):
        if row["run"] == "perfect" and row["metric"] == "bad":
            assert float(row["value"]) == 0
    (row,) = [
        r
        for r in rows(tmp_path / "out")
        if (r["run"], r["scene"], r["metric"], r["mask"], r["threshold"]) == ("half", "a", "bad", "nonocc", "1.0")
    ]
    pixels = 24 * 24
    assert (row["pixels"], row["wrong"]) == (str(pixels), str(pixels // 2))
    assert float(row["value"]) == 50
    assert float(row["density"]) == pytest.approx(100 * (pixels - 1) / pixels)
    assert row["convention"] == "missing counts as bad"
    assert row["map"] == "a/disp_left.pfm"
    document = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert document == json.loads(json.dumps(report.to_dict()))
    figures = {f["run"]: f for f in document["mean_of_all_figures"]}
    assert figures["perfect"]["value"] == 0
    assert figures["half"]["figures"] == 6
    (comparison,) = document["comparisons"]
    assert (comparison["scenes"], comparison["wins"], comparison["losses"]) == (2, 0, 2)
    assert "Paired comparison" in (tmp_path / "out" / "report.md").read_text()
    picture = read_image(tmp_path / "out" / "errors" / "half" / "a.png")
    assert tuple(picture[0, 10]) == (0, 0, 0)
    assert tuple(picture[20, 10]) == (170, 170, 170)


def test_maps_of_other_programs(tmp_path: Path, truth: Path):
    good = exact(truth)
    codes = np.rint(good * 8).astype(np.uint8)
    flat = tmp_path / "flat"
    write_png(flat / "a.png", codes)  # Middlebury-scaled, 8 bit
    write_disparity_png(flat / "b.png", good)  # KITTI, 16 bit
    kit = tmp_path / "kit"
    write_pfm(kit / "a" / "disp0ours.pfm", good)
    write_pfm(kit / "a" / "disp0ours_s.pfm", good + 5)
    np.save((kit / "b.npy"), good)
    devkit = tmp_path / "devkit"
    write_disparity_png(devkit / "disp_0" / "a.png", good)
    write_pfm(devkit / "low_res_two_view" / "b.pfm", good)
    report = evaluate([flat, kit, devkit], truth, tmp_path / "out")
    assert report.failed == []
    for result in report.results:
        assert result.headline("nonocc") == 0, result
    assert report.results[1].source == "a/disp0ours.pfm"


def test_what_is_missing_or_broken_has_a_reason(tmp_path: Path, truth: Path):
    good = exact(truth)
    run = run_of(tmp_path / "run", {"b": good[:10]})
    broken = run_of(tmp_path / "broken", {"a": good, "b": good})
    (broken / "a" / "disp_left.pfm").write_bytes(b"Pf\n3 3\n-1\nxx")
    told = run_of(tmp_path / "told", {"b": good})
    (told / "report.json").write_text(json.dumps({"scenes": [{"scene": "a", "status": "failed", "error": "too dark"}]}))
    report = evaluate([run, broken, told], truth, tmp_path / "out")
    reasons = {(r.run, r.scene): r.error for r in report.failed}
    assert set(reasons) == {("run", "a"), ("run", "b"), ("broken", "a"), ("told", "a")}
    assert "no map of scene a" in reasons["run", "a"]
    assert "32 x 10" in reasons["run", "b"]
    assert "damaged PFM" in reasons["broken", "a"]
    assert "too dark" in reasons["told", "a"]
    assert "Not evaluated" in report.text()
    assert sum(row["metric"] == "failed" for row in rows(tmp_path / "out")) == 4
    assert {r["run"] for r in json.loads((tmp_path / "out" / "scores.json").read_text())["failed"]} == {
        "run", "broken", "told",
    }  # fmt: skip


def test_broken_truth_spoils_only_its_scene(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run", {"a": exact(truth), "b": exact(truth)})
    (truth / "a" / "disp_left.png").write_bytes(b"nothing")
    report = evaluate([run], truth, tmp_path / "out")
    assert [r.scene for r in report.failed] == ["a"]
    assert report.results[1].headline("all") == 0
    (truth / "a" / "meta.json").write_text("[]")
    report = evaluate([run], truth, tmp_path / "out")
    assert "meta.json" in report.failed[0].error
    assert report.results[1].headline("all") == 0
    (truth / "b" / "meta.json").write_text("[]")
    with pytest.raises(InputError, match=r"meta\.json"):
        evaluate([run], truth, tmp_path / "out")


def test_wrong_scale_is_said(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run", {"a": exact(truth) * 16, "b": exact(truth)})
    report = evaluate([run], truth, tmp_path / "out")
    assert len(report.warnings) == 1
    assert "run: a: the values are about 16 times the truth" in report.warnings[0]
    assert report.warnings[0] in report.text()


def test_scale_of_the_maps_can_be_said(tmp_path: Path, truth: Path):
    np.save(tmp_path / "fixed.npy", np.rint(exact(truth) * 16).astype(np.int16))
    (tmp_path / "run").mkdir()
    for name in ("a", "b"):
        shutil.copy(tmp_path / "fixed.npy", tmp_path / "run" / f"{name}.npy")
    report = evaluate([tmp_path / "run"], truth, tmp_path / "out", scale=16)
    assert [r.headline("all") for r in report.results] == [0, 0]


def test_confidence_gives_curves(tmp_path: Path, truth: Path):
    good = exact(truth)
    bad = good.copy()
    bad[:6] += 3
    run = run_of(tmp_path / "run", {"a": bad, "b": good})
    knows = np.where(bad == good, 1, 0).astype(np.float32)
    write_pfm(run / "a" / "confidence_oracle.pfm", knows)
    write_pfm(run / "a" / "confidence_blind.pfm", np.zeros(SHAPE, np.float32))
    write_pfm(run / "b" / "confidence_small.pfm", np.zeros((3, 3), np.float32))
    report = evaluate([run], truth, tmp_path / "out")
    assert list(report.results[0].curves) == ["nonocc", "all"]
    a = report.results[0].curves["nonocc"]
    assert list(a) == ["blind", "oracle"]
    assert a["blind"].auc == pytest.approx(0.25)
    assert a["oracle"].rates[14] == 0  # 75 % of the pixels are right
    assert a["oracle"].pixels == 24 * 24
    assert report.results[0].curves["all"]["oracle"].pixels == 24 * 32
    assert "oracle" in report.text()
    assert "AUC/optimal" in report.text()
    assert "<polyline" in (tmp_path / "out" / "curves" / "run" / "a_nonocc.svg").read_text()
    assert "confidence_small.pfm" in report.warnings[0]


def test_runs_of_one_name_are_told_apart(tmp_path: Path, truth: Path):
    good = exact(truth)
    for parent in ("x", "y"):
        run_of(tmp_path / parent / "run", {"a": good, "b": good})
    report = evaluate([tmp_path / "x" / "run", tmp_path / "y" / "run"], truth, tmp_path / "out")
    assert report.runs == ("x_run", "y_run")
    with pytest.raises(InputError, match="given twice"):
        evaluate([tmp_path / "x" / "run", tmp_path / "x" / "run"], truth, tmp_path / "out")


def test_scene_names_match_with_and_without_their_data_set(tmp_path: Path, truth: Path):
    good = exact(truth)
    short = run_of(tmp_path / "short", {"a": good, "b": good})
    long = run_of(tmp_path / "long", {"set/a": good, "set/b": good})
    over = tmp_path / "over"
    shutil.copytree(truth, over / "set")
    for where in (truth, over):
        report = evaluate([short, long], where, tmp_path / "out")
        assert report.failed == []


def test_evaluating_twice_gives_the_same_bytes(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run", {"a": exact(truth) + 2, "b": exact(truth)})
    seen = []
    for _ in range(2):
        evaluate([run], truth, tmp_path / "out")
        seen.append({p.relative_to(tmp_path): p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()})
        shutil.rmtree(tmp_path / "out")
    files = seen[0]
    assert files == seen[1]
    assert {str(p.relative_to("out")) for p in files} == {
        "report.md", "scores.csv", "scores.json", "errors/run/a.png", "errors/run/b.png",
    }  # fmt: skip


def test_nothing_to_evaluate(tmp_path: Path, truth: Path):
    with pytest.raises(InputError, match="no run"):
        evaluate([], truth, tmp_path / "out")
    with pytest.raises(InputError, match="no such folder"):
        evaluate([tmp_path / "absent"], truth, tmp_path / "out")
    for name in ("a", "b"):
        (truth / name / "disp_left.png").unlink()
    with pytest.raises(InputError, match="ground truth"):
        evaluate([tmp_path], truth, tmp_path / "out")


@needs_data
def test_real_scenes_truth_is_zero_and_two_pixels_off_is_hundred(tmp_path: Path):
    """One folder of every kind; the figures of every mask and threshold below two pixels."""
    wanted = {"Venus": "v2", "Motorcycle": "v3", "2012_000070_10": "kitti"}
    for scene in find_scenes(DATA):
        if scene.name.rpartition("/")[2] in wanted:
            disparity = scene.load_truth().disparity
            write_pfm(tmp_path / "truth" / scene.name / "disp_left.pfm", disparity)
            write_pfm(tmp_path / "shifted" / scene.name / "disp_left.pfm", disparity - np.float32(2.25))
    for pattern, metric in wanted.items():
        report = evaluate([tmp_path / "truth", tmp_path / "shifted"], DATA, tmp_path / "out", scenes=pattern)
        assert report.failed == []
        right, shifted = report.results
        assert right.metric == metric
        assert all(s.value == 0 for s in right.scores if s.unit == "%")
        thresholds = [s for s in shifted.scores if s.metric in ("bad", "totbad", "out") and (s.threshold or 9) <= 2]
        assert thresholds
        assert all(s.value == 100 for s in thresholds)


@needs_data
def test_kitti_pairs_end_to_end(tmp_path: Path):
    """The D1 of DATA.md for maps as another program wrote them: one 16-bit PNG a scene."""
    run = tmp_path / "network"
    run.mkdir()
    for pair in ("pair_01", "pair_04", "pair_07"):
        shutil.copy(DATA / "kitti_eval_pairs" / pair / "disp_est.png", run / f"{pair}.png")
    report = evaluate([run], DATA / "kitti_eval_pairs", tmp_path / "out")
    found = [round(r.value("D1", "occ", 3.0, "estimated pixels only"), 2) for r in report.results]
    assert found == [4.19, 3.54, 8.30]
    assert "4.19" in report.text()
    assert read_disparity(run / "pair_01.png").shape == (375, 1242)


def test_absurd_values_and_damaged_maps_never_break_the_job(tmp_path: Path, truth: Path):
    rng = np.random.default_rng(0)
    run = tmp_path / "run"
    values = exact(truth).copy()
    values[:4] = [[np.finfo(np.float32).max], [-np.finfo(np.float32).max], [1e-45], [-1]]
    write_pfm(run / "b" / "disp_left.pfm", np.full(SHAPE, np.nan, np.float32))
    write_pfm(run / "a" / "disp_left.pfm", values)
    data = (run / "a" / "disp_left.pfm").read_bytes()
    for kind in (None, "v3", "kitti"):
        if kind is not None:
            for name in ("a", "b"):
                for mask in (truth / name).glob("mask_*.png"):
                    mask.unlink()
                if kind == "v3":
                    write_pfm(truth / name / "disp_left.pfm", TRUTH)
                    (truth / name / "disp_left.png").unlink()
                    (truth / name / "meta.json").write_text("{}")
                else:
                    (truth / name / "meta.json").write_text('{"masks": "none (sparse GT)"}')
        for _ in range(15):
            report = evaluate([run], truth, tmp_path / "out")
            assert {r.metric for r in report.results} == {kind or "v2"}
            json.loads((tmp_path / "out" / "scores.json").read_text(), parse_constant=pytest.fail)
            broken = bytearray(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data)
            for _ in range(rng.integers(1, 9)):
                broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
            (run / "a" / "disp_left.pfm").write_bytes(broken)
        (run / "a" / "disp_left.pfm").write_bytes(data)


def test_truth_without_a_known_pixel_is_a_reason_and_not_an_empty_column(tmp_path):
    scene = tmp_path / "truth" / "a"
    scene.mkdir(parents=True)
    image = np.zeros((4, 5), np.uint8)
    for side in ("left", "right"):
        write_png(scene / f"{side}.png", image)
    write_pfm(scene / "disp_left.pfm", np.full((4, 5), np.nan, np.float32))
    (tmp_path / "run").mkdir()
    write_pfm(tmp_path / "run" / "a.pfm", np.ones((4, 5), np.float32))
    report = evaluate([tmp_path / "run"], tmp_path / "truth", tmp_path / "out")
    assert [result.scene for result in report.failed] == ["a"]
    assert "no known pixel" in report.failed[0].error
