"""The evaluation job: files in, tables, scores, pictures and reasons out."""

import csv
import errno
import itertools
import json
import math
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.evaluation import protocols
from depthcli.evaluation.comparison import EvaluationReport
from depthcli.evaluation.evaluate import Choices, can_be_missed, evaluate_runs, scenes_with_truth
from depthcli.evaluation.protocols import Settings
from depthcli.evaluation.protocols._disparity import DisparityProtocol
from depthcli.evaluation.scores import MapResult, find_score
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.images import read_image
from depthcli.io.scenes import StereoScene
from depthcli.report.tables import Document, chosen_text, headline_text, report_tables
from depthcli.run.console import Reporter
from depthcli.run.records import Record, write_record
from depthcli.show.view import EMPTY, NO_VALUE, RIGHT, WRONG, View, draw, kind_colors
from tests.command_line import contents
from tests.command_line import run as run_command
from tests.files import laid
from tests.golden import refused, told

SHAPE = (24, 32)
GOOD = np.rint(8 * np.linspace(4, 12, SHAPE[1], dtype=np.float32) * np.ones((SHAPE[0], 1), np.float32)) / 8
"""The truth of all scenes."""


def evaluated(runs, truth: Path, output=None, protocol=None, settings: Settings | None = None) -> EvaluationReport:
    scored_by = None if protocol is None else protocols.load(protocol)(settings or Settings())
    found = scenes_with_truth(truth, protocol=scored_by, settings=settings)
    return evaluate_runs(runs, found, truth, output, Choices(scored_by, settings or Settings(), viewers=[Document()]))


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """Two scenes with masks and 8-bit truth (x8), in our own layout."""
    rng, meta = np.random.default_rng(0), {"disp_scale": 8, "max_disparity": 15}
    for name in ("a", "b"):
        image = rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
        laid(tmp_path / "set" / name, {
            "left.png": image, "right.png": image, "disp_left.png": (8 * GOOD).astype(np.uint8), "meta.json": meta,
            "mask_nonocc.png": np.broadcast_to(np.arange(SHAPE[1]) >= 8, SHAPE),
            "mask_disc.png": np.eye(*SHAPE, dtype=np.uint8) * np.uint8(255),
        })  # fmt: skip
    return tmp_path / "set"


def run_of(folder: Path, maps: dict[str, np.ndarray] | None = None) -> Path:
    """Write a run; by default, one whose maps are the truth."""
    given = {"a": GOOD, "b": GOOD} if maps is None else maps
    return laid(folder, {f"{name}/disp_left.pfm": values for name, values in given.items()})


def others(folder: Path, place: str) -> Path:
    """A folder with a perfect map of every scene, under another program's names; the ending says the kind."""
    for file in (folder / place.replace("{scene}", name) for name in ("a", "b")):
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".npz":
            np.savez_compressed(file, disp=GOOD, seconds=np.ones(3))
        elif file.suffix == ".tiff":
            cv2.imwrite(str(file), GOOD)
        else:
            laid(file.parent, {file.name: GOOD if file.suffix == ".pfm" else np.rint(GOOD * 100).astype(np.uint16)})
    return folder


def bad(result: MapResult, mask: str = "all", threshold: float = 1.0) -> float:
    return find_score(result.scores, "bad", mask, threshold).value


def rows(output: Path) -> list[dict[str, str]]:
    with (output / "scores.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_maps_of_other_programs_and_scene_names_without_their_data_set(tmp_path: Path, truth: Path):
    laid(tmp_path, {
        "flat/a.png": (GOOD * 8).astype(np.uint8), "flat/b.npy": np.rint(GOOD * 16).astype(np.int16),  # as OpenCV
        "kit/a/disp0ours.pfm": GOOD, "kit/a/disp0ours_s.pfm": GOOD + 5, "kit/b.npy": GOOD,
        "devkit/low_res_two_view/b.pfm": GOOD,
    })  # fmt: skip
    write_disparity_png(tmp_path / "devkit" / "disp_0" / "a.png", GOOD)
    report = evaluated([tmp_path / name for name in ("flat", "kit", "devkit")], truth)
    assert report.failed == [] and [bad(result, "nonocc") for result in report.results] == [0] * 6
    assert report.results[1].source == "a/disp0ours.pfm"
    laid(tmp_path, {"kit/a/disp0other.pfm": GOOD, "unnamed/first.pfm": GOOD})
    for name in ("kit", "unnamed"):
        told("\n".join(result.error for result in evaluated([tmp_path / name], truth).failed))
    long = run_of(tmp_path / "long", {"set/a": GOOD, "set/b": GOOD})
    shutil.copytree(truth, tmp_path / "over" / "set")
    for where in (truth, tmp_path / "over"):
        assert evaluated([run_of(tmp_path / "short"), long], where).failed == []


def test_what_is_missing_or_broken_has_a_reason(tmp_path: Path, truth: Path):
    run, broken = run_of(tmp_path / "run", {"b": GOOD[:10]}), run_of(tmp_path / "broken")
    laid(broken, {"a/disp_left.pfm": b"Pf\n3 3\n-1\nxx"})
    says = run_of(tmp_path / "told", {"b": GOOD})
    laid(says, {"report.json": {"scenes": [{"scene": "a", "status": "failed", "error": "too dark"}]}})
    report = evaluated([run, broken, says], truth, tmp_path / "out")
    reasons = {(r.run, r.scene): r.error for r in report.failed}
    assert set(reasons) == {("run", "a"), ("run", "b"), ("broken", "a"), ("told", "a")}
    told("\n".join(reasons.values()))
    assert "Not evaluated" in chosen_text(report, ["all"])
    assert sum(row["metric"] == "failed" for row in rows(tmp_path / "out")) == 4


def test_broken_truth_spoils_only_its_scene(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run")
    for file, content, said in (
        ("disp_left.png", "nothing", "disp_left.png"),
        ("meta.json", '{"protocol": "kitty"}', "no protocol called 'kitty'"),
        ("meta.json", "[]", "meta.json"),
    ):
        (truth / "a" / file).write_text(content)
        report = evaluated([run], truth)
        assert [r.scene for r in report.failed] == ["a"] and bad(report.results[1]) == 0
        assert said in report.failed[0].error
    (truth / "b" / "meta.json").write_text("[]")
    refused(InputError, evaluated, [run], truth)


@pytest.mark.slow
def test_confidence_gives_curves(tmp_path: Path, truth: Path):
    wrong = GOOD.copy()
    wrong[:6] += 3
    run = run_of(tmp_path / "run", {"a": wrong, "b": GOOD})
    laid(run, {
        "a/confidence_oracle.pfm": (wrong == GOOD).astype(np.float32), "a/confidence_blind.pfm": 0 * GOOD,
        "b/confidence_small.pfm": 0 * GOOD[:3, :3], "b/confidence_levels.npy": np.full(SHAPE, -3, np.int16),
    })  # fmt: skip
    report = evaluated([run], truth, tmp_path / "out")
    curves = {(c.region, c.confidence, c.of): c.line for c in report.results[0].curves}
    assert list(curves) == list(itertools.product(("nonocc", "all"), ("blind", "oracle"), ("bad", "error")))
    assert curves["nonocc", "blind", "bad"].auc == pytest.approx(0.25)
    assert curves["nonocc", "oracle", "bad"].errors[14] == 0  # 75 % of the pixels are right
    assert curves["nonocc", "oracle", "bad"].ratio == pytest.approx(1)
    assert curves["nonocc", "blind", "error"].mean == pytest.approx(0.75)
    assert [curves[mask, "oracle", "bad"].pixels for mask in ("nonocc", "all")] == [24 * 24, 24 * 32]
    # Negative numbers are confidences, not missing codes.
    assert {c.confidence for c in report.results[1].curves} == {"levels"}
    plot = (tmp_path / "out" / "curves" / "run" / "a_nonocc_bad.svg").read_text()
    assert all(f"{name} {curves['nonocc', name, 'bad'].auc:.4f}" in plot for name in ("blind", "oracle"))
    assert "confidence_small.pfm" in report.warnings()[0]


def test_a_run_of_other_scenes_is_told(tmp_path: Path, truth: Path):
    def hints(scene: str, status: str) -> tuple[str, ...]:
        report = {"scenes": [{"scene": scene, "status": status}]}
        return evaluated([laid(tmp_path / "run", {"report.json": report})], truth).hints

    (hint,) = hints("c", "done")
    assert "(c)" in hint and "(a, b)" in hint
    assert hints("b", "failed") == ()


def test_gaps_that_cost_nothing_are_not_told_where_there_are_none(tmp_path: Path, truth: Path):
    full = run_of(tmp_path / "full", {"a": GOOD + 1, "b": GOOD})
    assert "gaps are not" not in headline_text(evaluated([full, f"b={full}"], truth, protocol="eth3d"))


def test_an_evaluation_replaces_its_own_files_and_no_others(tmp_path: Path, truth: Path, monkeypatch, tool):
    """Own files under the names of results are refused before a scene is opened; earlier results make room."""
    run, other = run_of(tmp_path / "run", {"a": GOOD + 2, "b": GOOD}), run_of(tmp_path / "other")
    out, mine = tmp_path / "out", tmp_path / "mine"
    evaluated([run], truth, out)
    before = contents(out)
    (out / "notes.txt").write_text("mine")
    evaluated([other], truth, out)
    assert set(contents(out)) == {name.replace("/run/", "/other/") for name in before} | {"notes.txt"}
    laid(out, {"errors/run/a.png": "mine"})  # beside a record: found when results are moved in
    refused(OutputError, evaluated, [run], truth, out)
    assert (out / "errors/other/a.png").is_file() and not list(out.glob(".partial*"))

    monkeypatch.setattr("depthcli.evaluation.evaluate._Scoring.all_results", None)  # nothing is computed from here on
    for name in ("scores.csv", "report.md", "contact_sheet.png", "errors/run/deeper/a.png"):
        laid(mine, {name: "mine"})
        tool.told(2, "evaluate", run, "--truth", truth, "-o", mine)
        assert contents(mine) == {name: b"mine"}
        shutil.rmtree(mine)
    write_record(run, Record("", "another", {}, {}, {}))
    refused(ConfigError, evaluated, [run], truth, run)


@pytest.mark.slow
def test_absurd_values_and_damaged_maps_never_break_the_job(tmp_path: Path, truth: Path):
    rng, values = np.random.default_rng(0), GOOD.copy()
    values[:4] = [[np.finfo(np.float32).max], [-np.finfo(np.float32).max], [1e-45], [-1]]
    run = run_of(tmp_path / "run", {"a": values, "b": np.full(SHAPE, np.nan, np.float32)})
    file = run / "a" / "disp_left.pfm"
    data = file.read_bytes()
    for protocol in protocols.names():
        if not issubclass(protocols.load(protocol), DisparityProtocol):
            continue
        file.write_bytes(data)
        for _ in range(12):
            report = evaluated([run], truth, tmp_path / "out", protocol=protocol)
            assert {r.protocol for r in report.results} == {protocol}
            json.loads((tmp_path / "out" / "scores.json").read_text(), parse_constant=pytest.fail)
            broken = bytearray(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data)
            for _ in range(rng.integers(1, 9)):
                broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
            file.write_bytes(broken)


def test_a_run_that_cannot_be_read_is_left_out_and_pairs_are_compared(tmp_path: Path, truth: Path, tool):
    one, two = (run_of(tmp_path / name, {"a": GOOD + k, "b": GOOD + k}) for name, k in (("one", 0), ("two", 2)))
    three = laid(tmp_path / "three", {"a/disp_left.npy": np.zeros((2, 5, 6), np.float32)})
    words = ("--truth", truth, "-o", tmp_path / "out", "--compare", "all")
    out, err = tool.both(3, "evaluate", one, two, three, *words)
    assert "three" not in out and any("three" in line and "left out" in line for line in err.splitlines())
    assert "all pairs of runs" in out and "all pairs of runs" in (tmp_path / "out" / "report.md").read_text()
    document = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert [(pair["run"], pair["against"], pair["losses"]) for pair in document["pairs"]] == [("two", "one", 2)]
    assert {row["run"] for row in document["means"]} == {"one", "two"} and len(document["failed"]) == 2
    shutil.copytree(three / "a", three / "b")  # with every map there, and none that can be read, it is an error
    err = tool.err(2, "evaluate", one, three, "--truth", truth, "-o", tmp_path / "none", "-q")
    assert "three: none of its maps can be read: " in err and "disp_left.npy: expected an (H, W)" in err
    assert not (tmp_path / "none" / "scores.csv").exists()


def test_a_missing_scene_never_makes_a_run_look_better(tmp_path: Path, truth: Path):
    poor = GOOD.copy()
    poor[:12] += 3
    runs = [run_of(tmp_path / "both", {"a": GOOD, "b": poor}), run_of(tmp_path / "easy", {"a": GOOD})]
    report = evaluated(runs, truth, tmp_path / "out")
    picture, colors = read_image(tmp_path / "out" / "errors" / "both" / "b.png"), kind_colors()
    assert tuple(picture[0, 10]) == tuple(colors[WRONG]) and tuple(picture[20, 10]) == tuple(colors[RIGHT])
    assert tuple(colors[EMPTY]) == NO_VALUE == tuple(draw(View(np.full((1, 1), np.nan)), "values")[0, 0])
    means = {(m["run"], m["metric"], m["mask"], m["threshold"]): m for m in report.to_dict()["means"]}
    full, lacking = (means[run, "bad", "all", 1.0] for run in ("both", "easy"))
    assert (full["value"], full["scenes"], full["missing"], full["common"], full["value_common"]) == (25, 2, 0, 1, 0)
    assert (lacking["value"], lacking["scenes"], lacking["missing"], lacking["value_common"]) == (50, 2, 1, 0)
    # No bound, no mean over all: but one over what both have.
    full, lacking = (means[run, "avgerr", "all", None] for run in ("both", "easy"))
    assert full["value"] == pytest.approx(0.75) and math.isnan(lacking["value"]) and lacking["value_common"] == 0
    for text in (chosen_text(report, ["all"]), (tmp_path / "out" / "report.md").read_text()):
        for said in ("2, 1 missing*", "50.00*", "1 common", "*: all pixels of scenes without a map count as incorrect"):
            assert said in text
    written = {(r["run"], r["scene"], r["metric"], r["mask"], r["threshold"]): r for r in rows(tmp_path / "out")}
    figures = {scene: written["easy", scene, "bad", "all", "1.0"] for scene in ("b", "*mean", "*common mean")}
    assert [row["value"] for row in figures.values()] == ["100.0", "50.0", "0.0"]
    assert "missing, all pixels count as incorrect" in figures["b"]["note"] and "1 missing" in figures["*mean"]["note"]
    assert written["easy", "*mean", "avgerr", "all", ""]["value"] == ""
    assert run_command("evaluate", *runs, "--truth", truth, "-o", tmp_path / "page", "--html", "-q") == 3
    page = (tmp_path / "page" / "report.html").read_text("utf-8")
    assert "1 map missing" in page and "100.00*" in page
    # Ranks and comparisons are over what both have: a tie.
    (summary, *_) = report_tables(report)
    column = summary.header.index("avg rank")
    assert [row[column] for row in summary.lines[1:]] == ["", "1.5", "", "1.5"]
    (comparison,) = report.sections[0].ranking.tests.values()
    assert (comparison.scenes, comparison.wins, comparison.losses, comparison.ties) == (1, 0, 0, 1)


def test_the_protocol_is_given_or_named_by_the_scene(tmp_path: Path, truth: Path):
    run = run_of(tmp_path / "run")
    laid(truth, {"a/meta.json": {"disp_scale": 8, "protocol": "kitti_2012"}})
    both = evaluated([run], truth)  # different benchmarks are never averaged or compared with each other
    assert [r.protocol for r in both.results] == ["kitti-2012", "middlebury-v2"]
    assert [(s.protocol.name, s.scenes) for s in both.sections] == [("kitti-2012", ["a"]), ("middlebury-v2", ["b"])]
    assert [r.protocol for r in evaluated([run], truth, protocol="ETH3D").results] == ["eth3d"] * 2
    refused(InputError, evaluated, [run], truth, protocol="kitty")
    unnamed = StereoScene(name="a", folder=truth, left=truth / "a/left.png", disparity_left=truth / "a/disp_left.png")
    told(evaluate_runs([run], [unnamed], truth, None, Choices(None, Settings())).failed[0].error)


def test_a_single_map_against_a_single_file(tmp_path: Path, truth: Path, tool):
    write_pfm(tmp_path / "m.pfm", GOOD + 2)
    single = truth / "a" / "disp_left.png"
    # The file of a scene brings the scene's masks and scale.
    report = evaluated([tmp_path / "m.pfm"], single)
    assert report.results[0].scores[0].region == "nonocc" and bad(report.results[0]) == 100
    document = json.loads(tool.out(0, "evaluate", tmp_path / "m.pfm", "--truth", single, "--json"))
    assert document["headlines"][0]["value"] == 100
    # Any other file stands for itself, with the scale of the meta.json beside it.
    plain = Path(shutil.copy(single, tmp_path / "gt.png"))
    report = evaluated([tmp_path / "m.pfm"], plain, settings=Settings(scale=8, threshold=3))
    assert (bad(report.results[0]), bad(report.results[0], threshold=3)) == (100, 0)
    assert "8-bit disparities need a scale" in evaluated([tmp_path / "m.pfm"], plain).failed[0].error
    (tmp_path / "meta.json").write_text('{"disp_scale": 8}')
    assert bad(evaluated([tmp_path / "m.pfm"], plain, settings=Settings(threshold=3)).results[0], threshold=3) == 0
    refused(InputError, evaluated, [tmp_path / "m.pfm"], truth)
    refused(InputError, evaluated, [tmp_path / "m.pfm"], plain, protocol="registration")


@pytest.mark.parametrize(("name", "true", "protocol"), [
    ("depth", "gt", "depth"), ("m", "depth_true", "depth"), ("m", "gt", "middlebury-v2"),
])  # fmt: skip
def test_files_called_depth_are_no_disparities(tmp_path: Path, tool, name: str, true: str, protocol: str):
    file, single = f"a/{name}.png", f"b/{true}.png"
    laid(tmp_path, dict.fromkeys((file, single), np.full(SHAPE, 700, np.uint16)))
    words = ("--truth", tmp_path / single, "--json", "--scale", "256")
    out, err = tool.both(0, "evaluate", tmp_path / file, *words)
    assert json.loads(out)["results"][0]["protocol"] == protocol
    assert f"by {protocol}, unless --protocol" in err


@pytest.mark.parametrize(("place", "options"), [
    ("{scene}/disparity.tiff", []),
    ("{scene}/out/{scene}_final.pfm", []),
    ("maps/{scene}.result.npz", []),
    ("{scene}_disp.png", ["--scale", "other=100"]),
])  # fmt: skip
def test_maps_under_any_name(tmp_path: Path, truth: Path, tool, place: str, options: list[str]):
    line = ("evaluate", f"other={others(tmp_path / 'x', place)}", "--truth", truth, "--protocol", "eth3d", "--json")

    def scores(*more: str) -> tuple[list[float], list[str]]:
        document = json.loads(tool.out(0, *line, *options, *more))
        assert document["runs"] == ["other"]
        found = [s["value"] for r in document["results"] for s in r["scores"] if s["metric"] == "avgerr"]
        return found, document["warnings"]

    given, warnings = scores("--pattern", f"other={place}")
    assert max(given) < 0.01 and warnings == []
    assert scores("--pattern", f"other={Path(place).with_suffix('.*')}") == (given, warnings)
    assert scores() == (given, [f"other: taken as its maps: {place} (--pattern sets others)"])


def test_each_run_has_its_own_scale_and_invalid_value(tmp_path: Path, truth: Path):
    plain, codes, out = others(tmp_path / "plain", "{scene}.pfm"), tmp_path / "codes", tmp_path / "out"
    values = GOOD * 16
    values[:, -8:] = 7
    laid(codes, {"a_raw.pfm": values, "b_raw.pfm": values})
    line = ("evaluate", f"p={plain}", f"c={codes}", "--truth", truth, "-o", out, "--protocol", "eth3d")
    assert run_command(*line, "--pattern", "c={scene}_raw.pfm", "--scale", "c=16", "--invalid", "c=7") == 0
    found = {(r["run"], r["metric"]): float(r["value"]) for r in rows(out) if r["scene"] == "a" and r["mask"] == "all"}
    assert (found["p", "avgerr"], found["c", "avgerr"]) == (0, 0)
    assert (found["p", "coverage"], found["c", "coverage"]) == (100, 75)


def test_a_folder_with_several_kinds_of_maps_is_refused(tmp_path: Path, truth: Path, tool):
    folder = others(tmp_path / "x", "{scene}/first.tiff")
    line = ("evaluate", folder, "--truth", truth, "-q")
    others(folder, "{scene}/confidence.pfm")  # named as something else
    assert run_command(*line) == 0
    laid(folder, {"a/log.pfm": "no map", "b/log.pfm": "no map"})
    assert run_command(*line) == 0
    others(folder, "{scene}/second.tiff")
    tool.told(2, *line)
    assert run_command(*line, "--pattern", "x={scene}/second.tiff") == 0
    tool.told(0, *line[:-1], "--maps", "x={scene}/second.tiff")  # its former name


def test_nothing_to_evaluate_and_options_that_do_not_fit(tmp_path: Path, truth: Path, tool):
    line = ("evaluate", others(tmp_path / "x", "{scene}.pfm"), "--truth", truth)
    tool.told(0, *line, "--resolution", "q")
    for options in (
        ("--format", "word"), ("--pattern", "y={scene}.png"), ("--pattern", "../{scene}.png"), ("--scale", "0"),
        ("--invalid", "1", "--invalid", "2"), ("--compare", "some"), ("--tables", "metric"),
        ("--tables", "metrics-edges"), ("--tables", "all,metrics-edges"), ("--html",),
        ("--format", "latex", "--tables", "scenes", "--caption", "x"),
    ):  # fmt: skip
        tool.told(2, *line, *options)
    for runs in ([], [tmp_path / "absent"], [truth, truth], [f"x={truth}", f"x={tmp_path}"]):
        refused(InputError, evaluated, runs, truth)
    for name in ("a", "b"):
        (truth / name / "disp_left.png").unlink()
    refused(InputError, evaluated, [tmp_path], truth)


def test_frames_that_look_like_kitti_are_named_once(tmp_path: Path, tool):
    rng, shape, full = np.random.default_rng(0), (375, 1242), np.linspace(5, 60, 1242, dtype=np.float32)
    maps = {name: np.broadcast_to(full, shape).copy() for name in ("f0", "f1")}
    for name, values in maps.items():  # of KITTI's size, with truth at a fifth of the pixels
        folder = laid(tmp_path / "set" / name, dict.fromkeys(("left.png", "right.png"), np.zeros(shape, np.uint8)))
        write_disparity_png(folder / "disp_left.png", np.where(rng.random(shape) < 0.2, values, np.nan))
    runs = [run_of(tmp_path / name, maps) for name in ("x", "y")]
    command = ("evaluate", *runs, "--truth", tmp_path / "set")
    tool.told(0, *command, "-o", tmp_path / "out")
    assert "scored as middlebury-v2" in (tmp_path / "out" / "report.md").read_text()
    for protocol in ("kitti-2015", "kitti-2012", "eth3d"):  # named: no doubt about it
        assert "look like" not in tool.err(0, *command, "--protocol", protocol)


def test_no_mean_is_over_several_data_sets(tmp_path: Path, truth: Path):
    """Two sets of one protocol: a figure and a test for each, with the number of its scenes."""
    shutil.copytree(truth, tmp_path / "all" / "one")
    shutil.copytree(truth / "a", tmp_path / "all" / "two" / "a")
    maps = {"one/a": GOOD, "one/b": GOOD + 2, "two/a": GOOD + 2}
    runs = [run_of(tmp_path / "x", maps), run_of(tmp_path / "y", {**maps, "two/a": GOOD})]
    report = evaluated(runs, tmp_path / "all", tmp_path / "out")
    (overview,) = [table for table in report_tables(report) if table.name == "overview"]
    assert [(row[0], *row[4:7], row[-1]) for row in overview.lines[1:]] == [
        ("one", "x", "2", "50.00", "best"), ("one", "y", "2", "50.00", "too few scenes"),
        ("two", "y", "1", "0.00", "best"), ("two", "x", "1", "100.00", "too few scenes"),
    ]  # fmt: skip
    assert "all scenes" not in (tmp_path / "out" / "report.md").read_text()
    told(headline_text(report))
    assert {h["scenes"] for h in report.to_dict()["headlines"] if h["data_set"] == "one"} == {2}


def test_the_terminal_shows_the_headline_within_100_columns(tmp_path: Path, truth: Path, tool):
    rng, runs, report = np.random.default_rng(0), [], tmp_path / "out" / "report.md"
    for name in "cdefgh":
        shutil.copytree(truth / "a", truth / name)
    for k, spread in enumerate((0.3, 3.0, 0.3)):
        name = f"aggregation.window={k},optimization.p1=0.5,optimization.p2=2.0,cost.name=census"
        maps = {s: GOOD + rng.normal(0, spread, SHAPE).astype(np.float32) for s in "abcdefgh"}
        runs.append(run_of(tmp_path / name, maps))
    out, err = tool.both(0, "evaluate", *runs, "--truth", truth, "-o", report.parent, "--html")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 100 and len(lines) <= 12
    assert [line.split()[-1] for line in lines[3:6]] == ["best", "significant", "worse"]
    assert str(report.parent) in err and "every metric" in report.read_text()
    assert "Spread over the scenes (bad 1, %, nonocc)" in report.with_suffix(".html").read_text("utf-8")
    chosen = tool.out(0, "evaluate", *runs, "--truth", truth, "--tables", "metrics-all,scenes")
    assert "every metric, all" in chosen and "by scene" in chosen and "every metric, disc" not in chosen


def test_a_table_for_a_paper(tmp_path: Path, truth: Path, tool):
    runs = [run_of(tmp_path / name, {"a": GOOD + d, "b": GOOD}) for name, d in (("one", 0), ("two", 2))]
    command = ("evaluate", *runs, "--truth", truth, "--format", "latex", "--tables")
    out = tool.out(0, *command, "scenes-nonocc", "--columns", "b, mean of 2", "--caption", "Bad pixels, 1 % off")
    assert r"\caption{Bad pixels, 1 \% off}" in out and r"\label{tab:scenes-nonocc}" in out
    assert r"run & b & mean of 2 \\" in out and r"\begin{tabular}{lrr}" in out and out.count(r"\begin{table}") == 1
    for run, seconds in zip(runs, (2.5, 0.5), strict=True):
        done = [{"scene": scene, "status": "done", "seconds": {"match": seconds}} for scene in ("a", "b")]
        laid(run, {"report.json": {"scenes": done}})
    out = tool.out(0, *command, "headline", "--columns", "nonocc,seconds")
    assert r"\textbf{0.50} \\" in out and r"\underline{2.50} \\" in out
    for columns in ("nonocc", "nonocc,p (Holm)"):
        assert ("Wilcoxon" in tool.out(0, *command, "headline", "--columns", columns)) == ("Holm" in columns)
    tool.told(2, *command, "scenes-nonocc", "--columns", "z")


@pytest.mark.parametrize(("full", "missing"), [
    ("contact_sheet.png", "contact_sheet.png"), ("report.html", "report.html"), ("scene-0.js", "report.html"),
])  # fmt: skip
def test_a_page_or_sheet_that_cannot_be_written_is_said_and_costs_no_scores(
    truth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tool, full: str, missing: str
):
    put = os.replace

    def replace(source: Path, target: Path) -> None:
        if Path(target).name == full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
        put(source, target)

    monkeypatch.setattr(os, "replace", replace)
    match, out = ("opencv-bm", "-i", truth, "--html"), tmp_path / "out"
    for command, folder in {
        ("evaluate", run_of(tmp_path / "maps"), "--truth", truth, "--html", "-o", out / "scores"): out / "scores",
        ("stereo", *match, "-o", out / "run"): out / "run" / "evaluation",
        ("sweep", *match, "-o", out / "sweep", "--over", "block=5,7"): out / "sweep" / "evaluation",
    }.items():
        said = tool.err(3, *command)
        assert said.count(f"no {missing}: ") == 1, said
        assert said.endswith("report.html\n") == (missing != "report.html"), said
        assert not (folder / missing).exists()
        assert not json.loads((folder / "scores.json").read_text())["failed"]
        report = json.loads(tool.out(3, *command, "--json"))
        assert "evaluate" not in command or list(report["unwritten"]) == [missing]
    unwritten: dict[str, str] = {}
    with can_be_missed("report.html", unwritten, Reporter()):
        raise ZeroDivisionError("of a fault")
    assert unwritten == {"report.html": "ZeroDivisionError: of a fault"}
