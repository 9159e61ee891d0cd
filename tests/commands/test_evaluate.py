"""The evaluation job: files in, tables, scores, pictures and reasons out."""

import csv
import errno
import itertools
import json
import math
import os
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.cli import main
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.evaluation import protocols
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import Choices, evaluate_runs, scenes_with_truth
from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols._disparity import DisparityProtocol
from depthcli.evaluation.scores import MapResult, find_score
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.images import read_image, write_png
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.report.tables import Document, chosen_text, headline_text, report_tables
from depthcli.run.records import Record, write_record
from depthcli.show.view import EMPTY, NO_VALUE, RIGHT, WRONG, View, draw, kind_colors
from tests.command_line import contents
from tests.command_line import run as run_command
from tests.golden import refused, told
from tests.scenes import true

SHAPE = (24, 32)
TRUTH = np.linspace(4, 12, SHAPE[1], dtype=np.float32) * np.ones((SHAPE[0], 1), np.float32)


def evaluated(
    runs: Sequence[Path | str],
    truth: Path,
    output: Path | None,
    protocol: str | None = None,
    settings: Settings | None = None,
) -> EvaluationReport:
    scored_by = None if protocol is None else protocols.load(protocol)(settings or Settings())
    found = scenes_with_truth(truth, protocol=scored_by, settings=settings)
    return evaluate_runs(runs, found, truth, output, Choices(scored_by, settings or Settings(), viewers=[Document()]))


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
    return true(discover_scenes(truth, ALL_KINDS, patterns=[name])[0]).disparity


def run_of(folder: Path, maps: dict[str, np.ndarray]) -> Path:
    for name, values in maps.items():
        write_pfm(folder / name / "disp_left.pfm", values)
    return folder


def text_of(report: EvaluationReport) -> str:
    """All tables, as ``--tables all`` prints them."""
    return chosen_text(report, ["all"])


def bad(result: MapResult, mask: str = "all", threshold: float = 1.0) -> float:
    return find_score(result.scores, "bad", mask, threshold).value


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
    report = evaluated([perfect, wrong], truth, tmp_path / "out")
    assert chosen_text(report, ["scenes"], ["all"]).splitlines()[1].split() == ["scene", "run", "all"]
    assert report.failed == report.warnings() == []
    picture = read_image(tmp_path / "out" / "errors" / "half" / "a.png")
    colors = kind_colors()
    assert tuple(picture[0, 10]) == tuple(colors[WRONG])
    assert tuple(picture[20, 10]) == tuple(colors[RIGHT])
    assert tuple(colors[EMPTY]) == NO_VALUE == tuple(draw(View(np.full((1, 1), np.nan)), "values")[0, 0])


def test_maps_of_other_programs(tmp_path: Path, truth: Path):
    good = exact(truth)
    codes = np.rint(good * 8).astype(np.uint8)
    flat = tmp_path / "flat"
    write_png(flat / "a.png", codes)  # Middlebury-scaled, 8 bit
    np.save(flat / "b.npy", np.rint(good * 16).astype(np.int16))  # OpenCV, 16 bit
    kit = tmp_path / "kit"
    write_pfm(kit / "a" / "disp0ours.pfm", good)
    write_pfm(kit / "a" / "disp0ours_s.pfm", good + 5)
    np.save((kit / "b.npy"), good)
    devkit = tmp_path / "devkit"
    write_disparity_png(devkit / "disp_0" / "a.png", good)
    write_pfm(devkit / "low_res_two_view" / "b.pfm", good)
    report = evaluated([flat, kit, devkit], truth, tmp_path / "out")
    assert report.failed == []
    for result in report.results:
        assert bad(result, "nonocc") == 0, result
    assert report.results[1].source == "a/disp0ours.pfm"


def test_a_truth_of_no_scene_has_the_scale_of_its_meta_json(tmp_path: Path):
    write_pfm(tmp_path / "map.pfm", TRUTH)
    write_png(tmp_path / "true" / "gt.png", np.rint(TRUTH * 8).astype(np.uint8))
    (tmp_path / "true" / "meta.json").write_text('{"disp_scale": 8}')
    report = evaluated([tmp_path / "map.pfm"], tmp_path / "true" / "gt.png", None)
    assert bad(report.results[0]) == 0


def test_what_is_missing_or_broken_has_a_reason(tmp_path: Path, truth: Path):
    good = exact(truth)
    run = run_of(tmp_path / "run", {"b": good[:10]})
    broken = run_of(tmp_path / "broken", {"a": good, "b": good})
    (broken / "a" / "disp_left.pfm").write_bytes(b"Pf\n3 3\n-1\nxx")
    says = run_of(tmp_path / "told", {"b": good})
    (says / "report.json").write_text(json.dumps({"scenes": [{"scene": "a", "status": "failed", "error": "too dark"}]}))
    report = evaluated([run, broken, says], truth, tmp_path / "out")
    reasons = {(r.run, r.scene): r.error for r in report.failed}
    assert set(reasons) == {("run", "a"), ("run", "b"), ("broken", "a"), ("told", "a")}
    told("\n".join(reasons.values()))
    assert "Not evaluated" in text_of(report)
    assert sum(row["metric"] == "failed" for row in rows(tmp_path / "out")) == 4


def test_broken_truth_spoils_only_its_scene(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run", {"a": exact(truth), "b": exact(truth)})
    (truth / "a" / "disp_left.png").write_bytes(b"nothing")
    report = evaluated([run], truth, tmp_path / "out")
    assert [r.scene for r in report.failed] == ["a"]
    assert bad(report.results[1]) == 0
    (truth / "a" / "meta.json").write_text("[]")
    report = evaluated([run], truth, tmp_path / "out")
    assert "meta.json" in report.failed[0].error
    assert bad(report.results[1]) == 0
    (truth / "b" / "meta.json").write_text("[]")
    refused(InputError, evaluated, [run], truth, tmp_path / "out")


@pytest.mark.slow
def test_confidence_gives_curves(tmp_path: Path, truth: Path):
    good = exact(truth)
    bad = good.copy()
    bad[:6] += 3
    run = run_of(tmp_path / "run", {"a": bad, "b": good})
    knows = np.where(bad == good, 1, 0).astype(np.float32)
    write_pfm(run / "a" / "confidence_oracle.pfm", knows)
    write_pfm(run / "a" / "confidence_blind.pfm", np.zeros(SHAPE, np.float32))
    write_pfm(run / "b" / "confidence_small.pfm", np.zeros((3, 3), np.float32))
    np.save(run / "b" / "confidence_levels.npy", np.full(SHAPE, -3, np.int16))
    report = evaluated([run], truth, tmp_path / "out")
    curves = {(c.region, c.confidence, c.of): c.line for c in report.results[0].curves}
    assert list(curves) == list(itertools.product(("nonocc", "all"), ("blind", "oracle"), ("bad", "error")))
    assert curves["nonocc", "blind", "bad"].auc == pytest.approx(0.25)
    assert curves["nonocc", "oracle", "bad"].errors[14] == 0  # 75 % of the pixels are right
    assert curves["nonocc", "oracle", "bad"].ratio == pytest.approx(1)
    assert curves["nonocc", "blind", "error"].mean == pytest.approx(0.75)
    assert curves["nonocc", "oracle", "bad"].pixels == 24 * 24
    assert curves["all", "oracle", "bad"].pixels == 24 * 32
    # Negative numbers are confidences, not missing codes.
    assert {c.confidence for c in report.results[1].curves} == {"levels"}
    assert "AUC/optimal" in text_of(report)
    assert "AUSE" in text_of(report)
    plot = (tmp_path / "out" / "curves" / "run" / "a_nonocc_bad.svg").read_text()
    assert all(f"{name} {curves['nonocc', name, 'bad'].auc:.4f}" in plot for name in ("blind", "oracle"))
    assert "confidence_small.pfm" in report.warnings()[0]


def test_scene_names_match_with_and_without_their_data_set(tmp_path: Path, truth: Path):
    good = exact(truth)
    short = run_of(tmp_path / "short", {"a": good, "b": good})
    long = run_of(tmp_path / "long", {"set/a": good, "set/b": good})
    over = tmp_path / "over"
    shutil.copytree(truth, over / "set")
    for where in (truth, over):
        report = evaluated([short, long], where, tmp_path / "out")
        assert report.failed == []


def test_a_run_of_other_scenes_is_told(tmp_path: Path, truth: Path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "report.json").write_text(json.dumps({"scenes": [{"scene": "c", "status": "done"}]}))
    (hint,) = evaluated([run], truth, None).hints
    assert "(c)" in hint and "(a, b)" in hint
    (run / "report.json").write_text(json.dumps({"scenes": [{"scene": "b", "status": "failed"}]}))
    assert evaluated([run], truth, None).hints == ()


def test_gaps_that_cost_nothing_are_told(tmp_path: Path, truth: Path):
    holes = exact(truth)
    holes[:, 8:16] = np.nan
    full = run_of(tmp_path / "full", {"a": exact(truth) + 1, "b": exact(truth)})
    runs = [full, run_of(tmp_path / "holes", {"a": holes, "b": exact(truth)})]
    for protocol, is_told in (("eth3d", True), ("middlebury_v2", False)):
        assert ("gaps are not" in headline_text(evaluated(runs, truth, None, protocol)).replace("\n", " ")) == is_told
    assert "gaps are not" not in headline_text(evaluated([full, "b=" + str(full)], truth, None, "eth3d"))


def test_an_evaluation_replaces_its_own_files_and_no_others(tmp_path: Path, truth: Path, monkeypatch, tool):
    """Own files under the names of results are refused before a scene is opened; earlier results make room."""
    run = run_of(tmp_path / "run", {"a": exact(truth) + 2, "b": exact(truth)})
    out = tmp_path / "out"
    evaluated([run], truth, out)
    before = contents(out)
    (out / "notes.txt").write_text("mine")
    other = run_of(tmp_path / "other", {"a": exact(truth), "b": exact(truth)})
    evaluated([other], truth, out)
    assert set(contents(out)) == {name.replace("/run/", "/other/") for name in before} | {"notes.txt"}
    (out / "errors/run").mkdir()
    (out / "errors/run/a.png").write_text("mine")  # beside a record: found when results are moved in
    refused(OutputError, evaluated, [run], truth, out)
    assert (out / "errors/other/a.png").is_file()
    assert not list(out.glob(".partial*"))

    monkeypatch.setattr("depthcli.evaluation.evaluate._Scoring.all_results", None)  # nothing is computed from here on
    for name in ("scores.csv", "report.md", "contact_sheet.png", "errors/run/deeper/a.png"):
        place = tmp_path / "mine" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text("mine")
        tool.told(2, "evaluate", run, "--truth", truth, "-o", tmp_path / "mine")
        assert contents(tmp_path / "mine") == {name: b"mine"}
        shutil.rmtree(tmp_path / "mine")
    write_record(run, Record("", "another", {}, {}, {}))
    refused(ConfigError, evaluated, [run], truth, run)


def test_nothing_to_evaluate(tmp_path: Path, truth: Path):
    for runs in ([], [tmp_path / "absent"], [truth, truth]):
        refused(InputError, evaluated, runs, truth, tmp_path / "out")
    for name in ("a", "b"):
        (truth / name / "disp_left.png").unlink()
    refused(InputError, evaluated, [tmp_path], truth, tmp_path / "out")


@pytest.mark.slow
def test_absurd_values_and_damaged_maps_never_break_the_job(tmp_path: Path, truth: Path):
    rng = np.random.default_rng(0)
    run = tmp_path / "run"
    values = exact(truth).copy()
    values[:4] = [[np.finfo(np.float32).max], [-np.finfo(np.float32).max], [1e-45], [-1]]
    write_pfm(run / "b" / "disp_left.pfm", np.full(SHAPE, np.nan, np.float32))
    write_pfm(run / "a" / "disp_left.pfm", values)
    data = (run / "a" / "disp_left.pfm").read_bytes()
    for protocol in protocols.names():
        if not issubclass(protocols.load(protocol), DisparityProtocol):
            continue
        for _ in range(12):
            report = evaluated([run], truth, tmp_path / "out", protocol=protocol)
            assert {r.protocol for r in report.results} == {protocol}
            json.loads((tmp_path / "out" / "scores.json").read_text(), parse_constant=pytest.fail)
            broken = bytearray(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data)
            for _ in range(rng.integers(1, 9)):
                broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
            (run / "a" / "disp_left.pfm").write_bytes(broken)
        (run / "a" / "disp_left.pfm").write_bytes(data)


def test_a_run_that_cannot_be_read_is_left_out_and_pairs_are_compared(tmp_path: Path, truth: Path, tool):
    good = exact(truth)
    runs = [
        run_of(tmp_path / name, {"a": good + 2 * k, "b": good + 2 * k})
        for k, name in enumerate(("one", "two", "three"))
    ]
    (tmp_path / "three" / "a" / "disp_left.pfm").write_bytes(b"no map")
    (tmp_path / "three" / "b" / "disp_left.pfm").unlink()
    words = ["evaluate", *map(str, runs), "--truth", str(truth), "-o", str(tmp_path / "out"), "--compare"]
    out, err = tool.both(3, *words, "all")
    assert "three" not in out
    assert any("three" in line and "left out" in line for line in err.splitlines())
    assert "all pairs of runs" in out and "all pairs of runs" in (tmp_path / "out" / "report.md").read_text()
    document = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert [(pair["run"], pair["against"], pair["losses"]) for pair in document["pairs"]] == [("two", "one", 2)]
    assert {row["run"] for row in document["means"]} == {"one", "two"}
    assert len(document["failed"]) == 2
    tool.told(2, *words, "some")


def test_a_missing_scene_never_makes_a_run_look_better(tmp_path: Path, truth: Path):
    good = exact(truth)
    poor = good.copy()
    poor[:12] += 3
    both = run_of(tmp_path / "both", {"a": good, "b": poor})
    easy = run_of(tmp_path / "easy", {"a": good})
    report = evaluated([both, easy], truth, tmp_path / "out")
    means = {(m["run"], m["metric"], m["mask"], m["threshold"]): m for m in report.to_dict()["means"]}
    full, lacking = (means[run, "bad", "all", 1.0] for run in ("both", "easy"))
    assert (full["value"], full["scenes"], full["missing"], full["common"], full["value_common"]) == (25, 2, 0, 1, 0)
    assert (lacking["value"], lacking["scenes"], lacking["missing"], lacking["value_common"]) == (50, 2, 1, 0)
    # No bound, no mean over all: but one over what both have.
    assert means["both", "avgerr", "all", None]["value"] == pytest.approx(0.75)
    assert math.isnan(means["easy", "avgerr", "all", None]["value"])
    assert means["easy", "avgerr", "all", None]["value_common"] == 0
    text, markdown = text_of(report), (tmp_path / "out" / "report.md").read_text()
    for said in ("2, 1 missing*", "50.00*", "1 common", "*: all pixels of scenes without a map count as incorrect"):
        assert said in text
        assert said in markdown
    written = {(r["run"], r["scene"], r["metric"], r["mask"], r["threshold"]): r for r in rows(tmp_path / "out")}
    figures = {scene: written["easy", scene, "bad", "all", "1.0"] for scene in ("b", "*mean", "*common mean")}
    assert [row["value"] for row in figures.values()] == ["100.0", "50.0", "0.0"]
    assert "missing, all pixels count as incorrect" in figures["b"]["note"] and "1 missing" in figures["*mean"]["note"]
    assert written["easy", "*mean", "avgerr", "all", ""]["value"] == ""
    # Ranks and comparisons are over what both have: a tie.
    (summary, *_) = report_tables(report)
    column = summary.header.index("avg rank")
    assert [row[column] for row in summary.lines[1:]] == ["", "1.5", "", "1.5"]
    (comparison,) = report.sections[0].ranking.tests.values()
    assert (comparison.scenes, comparison.wins, comparison.losses, comparison.ties) == (1, 0, 0, 1)


def test_the_protocol_is_given_or_named_by_the_scene(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run", {"a": exact(truth), "b": exact(truth)})
    (truth / "a" / "meta.json").write_text(json.dumps({"disp_scale": 8, "protocol": "kitti_2012"}))
    both = evaluated([run], truth, None)  # different benchmarks are never averaged or compared with each other
    assert [r.protocol for r in both.results] == ["kitti-2012", "middlebury-v2"]
    assert [(s.protocol.name, s.scenes) for s in both.sections] == [("kitti-2012", ["a"]), ("middlebury-v2", ["b"])]
    assert [r.protocol for r in evaluated([run], truth, None, protocol="ETH3D").results] == ["eth3d"] * 2
    refused(InputError, evaluated, [run], truth, None, protocol="kitty")
    (truth / "a" / "meta.json").write_text(json.dumps({"disp_scale": 8, "protocol": "kitty"}))
    report = evaluated([run], truth, None)
    assert "no protocol called 'kitty'" in report.failed[0].error
    assert bad(report.results[1]) == 0


def test_a_single_map_against_a_single_file(tmp_path: Path, truth: Path, capsys: pytest.CaptureFixture[str]):
    good = exact(truth)
    write_pfm(tmp_path / "m.pfm", good + 2)
    # The file of a scene brings the scene's masks and scale.
    report = evaluated([tmp_path / "m.pfm"], truth / "a" / "disp_left.png", None)
    assert report.results[0].scores[0].region == "nonocc"
    assert bad(report.results[0]) == 100
    # Any other file stands for itself.
    shutil.copy(truth / "a" / "disp_left.png", tmp_path / "gt.png")
    plain = evaluated([tmp_path / "m.pfm"], tmp_path / "gt.png", None, settings=Settings(scale=8, threshold=3))
    assert (bad(plain.results[0]), bad(plain.results[0], threshold=3)) == (100, 0)
    (failed,) = evaluated([tmp_path / "m.pfm"], tmp_path / "gt.png", None).failed
    assert "8-bit disparities need a scale" in failed.error
    refused(InputError, evaluated, [tmp_path / "m.pfm"], truth, None)
    single = truth / "a" / "disp_left.png"
    assert main(["evaluate", str(tmp_path / "m.pfm"), "--truth", str(single), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["headlines"][0]["value"] == 100


@pytest.mark.parametrize(("name", "true", "protocol"), [
    ("depth", "gt", "depth"), ("m", "depth_true", "depth"), ("m", "gt", "middlebury-v2"),
])  # fmt: skip
def test_files_called_depth_are_no_disparities(tmp_path: Path, tool, name: str, true: str, protocol: str):
    for file in (tmp_path / "a" / f"{name}.png", tmp_path / "b" / f"{true}.png"):
        write_png(file, np.full(SHAPE, 700, np.uint16))
    line = ["evaluate", str(tmp_path / "a" / f"{name}.png"), "--truth", str(tmp_path / "b" / f"{true}.png"), "--json"]
    line += ["--scale", "256"]
    printed = tool.both(0, *line)
    assert json.loads(printed.out)["results"][0]["protocol"] == protocol
    assert f"by {protocol}, unless --protocol" in printed.err


def test_options_that_do_not_fit(tmp_path: Path, truth: Path, tool):
    run = run_of(tmp_path / "run", {"a": exact(truth), "b": exact(truth)})
    command = ["evaluate", str(run), "--truth", str(truth)]
    tool.told(0, *command, "--resolution", "q")
    tool.told(2, *command, "--format", "word")


def others(folder: Path, truth: Path, place: str) -> Path:
    """A folder with a perfect map of every scene, under another program's names; the ending says the kind."""
    for name in ("a", "b"):
        file, good = folder / place.replace("{scene}", name), exact(truth, name)
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".pfm":
            write_pfm(file, good)
        elif file.suffix == ".npz":
            np.savez_compressed(file, disp=good, seconds=np.ones(3))
        elif file.suffix == ".tiff":
            cv2.imwrite(str(file), good)
        else:
            write_png(file, np.rint(good * 100).astype(np.uint16))
    return folder


@pytest.mark.parametrize(
    ("place", "options"),
    [
        ("{scene}/disparity.tiff", []),
        ("{scene}/out/{scene}_final.pfm", []),
        ("maps/{scene}.result.npz", []),
        ("{scene}_disp.png", ["--scale", "other=100"]),
    ],
)
def test_maps_under_any_name(tmp_path: Path, truth: Path, tool, place: str, options: list[str]):
    folder = others(tmp_path / "x", truth, place)
    line = ["evaluate", f"other={folder}", "--truth", str(truth), "--protocol", "eth3d", "--json", *options]

    def scores(*more: str) -> tuple[list[float], list[str]]:
        document = json.loads(tool.out(0, *line, *more))
        assert document["runs"] == ["other"]
        found = [s["value"] for r in document["results"] for s in r["scores"] if s["metric"] == "avgerr"]
        return found, document["warnings"]

    given, warnings = scores("--pattern", f"other={place}")
    assert scores("--pattern", f"other={Path(place).with_suffix('.*')}") == (given, warnings)
    assert max(given) < 0.01
    assert warnings == []
    taken, (hint,) = scores()
    assert taken == given
    assert hint == f"other: taken as its maps: {place} (--pattern sets others)"


def test_each_run_has_its_own_scale_and_invalid_value(tmp_path: Path, truth: Path):
    plain, codes = others(tmp_path / "plain", truth, "{scene}.pfm"), tmp_path / "codes"
    for name in ("a", "b"):
        values = exact(truth, name) * 16
        values[:, -8:] = 7
        write_pfm(codes / f"{name}_raw.pfm", values)
    out = tmp_path / "out"
    line = ["evaluate", f"p={plain}", f"c={codes}", "--truth", str(truth), "-o", str(out), "--protocol", "eth3d"]
    assert main([*line, "--pattern", "c={scene}_raw.pfm", "--scale", "c=16", "--invalid", "c=7"]) == 0
    found = {(r["run"], r["metric"]): float(r["value"]) for r in rows(out) if r["scene"] == "a" and r["mask"] == "all"}
    assert (found["p", "avgerr"], found["c", "avgerr"]) == (0, 0)
    assert (found["p", "coverage"], found["c", "coverage"]) == (100, 75)


def test_a_folder_with_several_kinds_of_maps_is_refused(tmp_path: Path, truth: Path, tool):
    folder = others(tmp_path / "x", truth, "{scene}/first.tiff")
    others(folder, truth, "{scene}/confidence.pfm")  # named as something else
    assert main(["evaluate", str(folder), "--truth", str(truth), "-q"]) == 0
    (folder / "a" / "log.pfm").write_bytes(b"no map")
    (folder / "b" / "log.pfm").write_bytes(b"no map")
    assert main(["evaluate", str(folder), "--truth", str(truth), "-q"]) == 0
    others(folder, truth, "{scene}/second.tiff")
    tool.told(2, "evaluate", folder, "--truth", truth)
    assert main(["evaluate", str(folder), "--truth", str(truth), "-q", "--pattern", "x={scene}/second.tiff"]) == 0


@pytest.mark.parametrize(
    "options",
    [
        ["--pattern", "y={scene}.png"],
        ["--pattern", "../{scene}.png"],
        ["--scale", "0"],
        ["--invalid", "1", "--invalid", "2"],
    ],
)
def test_wrong_options_of_maps(tmp_path: Path, truth: Path, tool, options: list[str]):
    folder = others(tmp_path / "x", truth, "{scene}.pfm")
    tool.told(2, "evaluate", folder, "--truth", truth, *options)


def kitti_like(folder: Path, name: str, rng: np.random.Generator) -> np.ndarray:
    """Write a frame of KITTI's size with truth at a fifth of the pixels, and return the truth without gaps."""
    disparity = np.broadcast_to(np.linspace(5, 60, 1242, dtype=np.float32), (375, 1242)).copy()
    for side in ("left", "right"):
        write_png(folder / name / f"{side}.png", np.zeros((375, 1242), np.uint8))
    write_disparity_png(folder / name / "disp_left.png", np.where(rng.random(disparity.shape) < 0.2, disparity, np.nan))
    return disparity


def test_frames_that_look_like_kitti_are_named_once(tmp_path: Path, tool):
    rng = np.random.default_rng(0)
    maps = {name: kitti_like(tmp_path / "set", name, rng) for name in ("f0", "f1")}
    runs = [str(run_of(tmp_path / name, maps)) for name in ("x", "y")]
    command = ["evaluate", *runs, "--truth", str(tmp_path / "set")]
    tool.told(0, *command, "-o", tmp_path / "out")
    assert "scored as middlebury-v2" in (tmp_path / "out" / "report.md").read_text()
    for protocol in ("kitti-2015", "kitti-2012", "eth3d"):  # named: no doubt about it
        assert "look like" not in tool.err(0, *command, "--protocol", protocol)


def test_no_mean_is_over_several_data_sets(tmp_path: Path, truth: Path):
    """Two sets of one protocol: a figure and a test for each, with the number of its scenes."""
    shutil.copytree(truth, tmp_path / "all" / "one")
    shutil.copytree(truth / "a", tmp_path / "all" / "two" / "a")
    good = exact(truth)
    maps = {"one/a": good, "one/b": good + 2, "two/a": good + 2}
    runs = [run_of(tmp_path / "x", maps), run_of(tmp_path / "y", {**maps, "two/a": good})]
    report = evaluated(runs, tmp_path / "all", tmp_path / "out")
    (overview,) = [table for table in report_tables(report) if table.name == "overview"]
    assert [(row[0], *row[4:7], row[-1]) for row in overview.lines[1:]] == [
        ("one", "x", "2", "50.00", "best"), ("one", "y", "2", "50.00", "too few scenes"),
        ("two", "y", "1", "0.00", "best"), ("two", "x", "1", "100.00", "too few scenes"),
    ]  # fmt: skip
    assert "all scenes" not in (tmp_path / "out" / "report.md").read_text()
    assert {h["scenes"] for h in report.to_dict()["headlines"] if h["data_set"] == "one"} == {2}


def test_the_terminal_shows_the_headline_within_100_columns(tmp_path: Path, truth: Path, tool):
    rng = np.random.default_rng(0)
    for name in "cdefgh":
        shutil.copytree(truth / "a", truth / name)
    scenes = "abcdefgh"
    runs = []
    for k, spread in enumerate((0.3, 3.0, 0.3)):
        name = f"aggregation.window={k},optimization.p1=0.5,optimization.p2=2.0,cost.name=census"
        maps = {s: exact(truth) + rng.normal(0, spread, SHAPE).astype(np.float32) for s in scenes}
        runs.append(str(run_of(tmp_path / name, maps)))
    command = ["evaluate", *runs, "--truth", str(truth)]
    out, err = tool.both(0, *command, "-o", tmp_path / "out")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 100
    assert len(lines) <= 12
    assert [line.split()[-1] for line in lines[3:6]] == ["best", "significant", "worse"]
    assert f"{tmp_path / 'out' / 'report.md'}" in err
    assert "every metric" in (tmp_path / "out" / "report.md").read_text()
    chosen = tool.out(0, *command, "--tables", "metrics-all,scenes")
    assert "every metric, all" in chosen and "by scene" in chosen and "every metric, disc" not in chosen
    for names in ("metrics-edges", "all,metrics-edges"):
        tool.told(2, *command, "--tables", names)
    tool.told(2, *command, "--tables", "metric")


def test_a_table_for_a_paper(tmp_path: Path, truth: Path, tool):
    runs = [str(run_of(tmp_path / n, {"a": exact(truth) + d, "b": exact(truth)})) for n, d in (("one", 0), ("two", 2))]
    command = ["evaluate", *runs, "--truth", str(truth), "--format", "latex", "--tables", "scenes-nonocc"]
    out = tool.out(0, *command, "--columns", "b, mean of 2", "--caption", "Bad pixels, 1 % off")
    assert r"\caption{Bad pixels, 1 \% off}" in out and r"\label{tab:scenes-nonocc}" in out
    assert r"run & b & mean of 2 \\" in out and r"\begin{tabular}{lrr}" in out
    assert out.count(r"\begin{table}") == 1
    for run, seconds in zip(runs, (2.5, 0.5), strict=True):
        done = [{"scene": scene, "status": "done", "seconds": {"match": seconds}} for scene in ("a", "b")]
        (Path(run) / "report.json").write_text(json.dumps({"scenes": done}))
    out = tool.out(0, *command[:-1], "headline", "--columns", "nonocc,seconds")
    assert r"\textbf{0.50} \\" in out and r"\underline{2.50} \\" in out
    assert "Wilcoxon" not in tool.out(0, *command[:-1], "headline", "--columns", "nonocc")
    assert "Wilcoxon" in tool.out(0, *command[:-1], "headline", "--columns", "nonocc,p (Holm)")
    tool.told(2, *command[:-1], "scenes", "--caption", "x")
    tool.told(2, *command, "--columns", "z")


@pytest.mark.parametrize(
    ("full", "missing"),
    [("contact_sheet.png", "contact_sheet.png"), ("report.html", "report.html"), ("scene-0.js", "report.html")],
)
def test_a_page_or_sheet_that_cannot_be_written_is_said_and_costs_no_scores(
    truth: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tool,
    full: str,
    missing: str,
):
    put = os.replace

    def replace(source: Path, target: Path) -> None:
        if Path(target).name == full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        put(source, target)

    monkeypatch.setattr(os, "replace", replace)
    maps = run_of(tmp_path / "maps", {"a": TRUTH, "b": TRUTH})
    match = ("opencv-bm", "-i", truth, "--html")
    out = tmp_path / "out"
    for command, folder in {
        ("evaluate", maps, "--truth", truth, "--html", "-o", out / "scores"): out / "scores",
        ("stereo", *match, "-o", out / "run"): out / "run" / "evaluation",
        ("sweep", *match, "-o", out / "sweep", "--over", "block=5,7"): out / "sweep" / "evaluation",
    }.items():
        assert run_command(*command) == 3, command
        said = capsys.readouterr().err
        assert said.count(f"no {missing}: ") == 1, said
        assert said.endswith("report.html\n") == (missing != "report.html"), said
        assert not (folder / missing).exists()
        assert not json.loads((folder / "scores.json").read_text())["failed"]
        report = json.loads(tool.out(3, *command, "--json"))
        if "evaluate" in command:
            assert list(report["unwritten"]) == [missing]


def test_a_run_of_which_no_map_can_be_read_is_an_error(tmp_path: Path, truth: Path, capsys):
    for name in ("a", "b"):
        (tmp_path / "broken" / name).mkdir(parents=True)
        np.save(tmp_path / "broken" / name / "disp_left.npy", np.zeros((2, 5, 6), np.float32))
    good = others(tmp_path / "good", truth, "{scene}.pfm")
    line = ["evaluate", str(good), str(tmp_path / "broken"), "--truth", str(truth), "-o", str(tmp_path / "out"), "-q"]
    assert main(line) == 2
    assert re.search(
        r"broken: none of its maps can be read: .*disp_left\.npy: expected an \(H, W\)", capsys.readouterr().err
    )
    assert not (tmp_path / "out" / "scores.csv").exists()
