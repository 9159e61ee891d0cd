"""What is around the methods: help, presets, reports, wrong usage, signals."""

import csv
import json
import re
import shlex
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import depthcli
from depthcli.cli import command_of, main
from depthcli.commands import config_model, find, own_names, text_of
from depthcli.commands import presets as presets_command
from depthcli.commands._options import PairOptions, RunOptions, SceneOptions, parse_bytes
from depthcli.commands._run import job_and_scenes
from depthcli.core import plugins
from depthcli.core.config_file import find_config, load_config
from depthcli.evaluation.sweeps import parse_axes
from depthcli.io.formats.disparity import read_disparity, read_pfm
from depthcli.methods.stereo.pipeline.opencv_sgbm import OpencvSgbm
from tests.command_line import ended, rows, run
from tests.files import laid

FAST = "opencv-bm"  # the quickest preset; the tests here are about what is around the matching


def test_maps_and_reports_for_a_folder_whose_run_file_is_a_config(made_scenes: Path, tmp_path: Path):
    one, a, b = ("-i", made_scenes, "--scenes", "planes_0", "-q", "-o"), tmp_path / "a", tmp_path / "b"
    assert run("stereo", FAST, *one, a, "--set", "block=9") == 0
    names = {"disp_left.pfm", "disp_left.png", "preview.png", "record.json", "status.png"}
    assert {path.name for path in (a / "planes_0").iterdir()} == names
    status, codes = depthcli.read_status(a / "planes_0/status.png"), read_disparity(a / "planes_0/disp_left.png")
    np.testing.assert_allclose(codes, read_pfm(a / "planes_0/disp_left.pfm").clip(1 / 256), atol=1 / 512)
    row = next(csv.DictReader((a / "report.csv").read_text().splitlines()))
    assert status.measured.mean() == pytest.approx(float(row["measured"]), abs=1e-5)
    assert float(row["seconds_load"]) > 0 and int(row["peak_memory"]) > 1 << 20
    assert "read_status" in (a / "status.txt").read_text()
    for more in (("--dry-run", "--jobs", "512"), ("--dry-run", "--jobs", "auto"), ()):
        assert run("stereo", a / "run.yaml", *one, b, *more) == 0
    written = yaml.safe_load((a / "run.yaml").read_text())
    assert written["block"] == 9 and set(written["run"]) == {"command", "versions"}
    for name in ("run.yaml", "planes_0/disp_left.pfm", "planes_0/preview.png"):
        assert (a / name).read_bytes() == (b / name).read_bytes()


def test_one_pair(made_scenes: Path, tmp_path: Path):
    pair = ("--left", made_scenes / "planes_0/left.png", "--right", made_scenes / "planes_0/right.png")
    for name, words in (("planes_0", ()), ("mine", ("--name", "mine"))):  # "left" says nothing: the folder's name
        assert run("stereo", FAST, *pair, "-o", tmp_path / name, "--max-disparity", "12", *words) == 0
        assert (tmp_path / name / name / "disp_left.pfm").exists()


def test_a_range_that_nothing_gives_is_that_of_the_pair_with_a_warning(two_scenes: Path, tmp_path: Path, tool):
    scenes = shutil.copytree(two_scenes, tmp_path / "in", ignore=shutil.ignore_patterns("*.pfm", "*.json", "mask*"))
    line = ("stereo", FAST, "-i", scenes, "-o")
    (said,) = [each for each in tool.err(0, *line, tmp_path / "r").splitlines() if "search range" in each]
    assert "2 scenes" in said and "--max-disparity auto was taken" in said
    for row in rows(tmp_path / "r").values():
        assert f" {row['max_disparity']} " in said and row["range_top"] == row["max_disparity"]
    assert "search range" not in tool.err(0, *line, tmp_path / "auto", "--max-disparity", "auto")
    for file in ("planes_0/disp_left.pfm", "foreground_0/disp_left.pfm"):
        assert (tmp_path / "r" / file).read_bytes() == (tmp_path / "auto" / file).read_bytes()
    laid(scenes / "planes_0", dict.fromkeys(("left.png", "right.png"), np.zeros((48, 64), np.uint8)))  # nothing there
    tool.told(3, *line, tmp_path / "r")


def test_presets_are_listed_and_shown(tool):
    assert "# side of the matched block, pixels, odd\nblock: 5\n" in tool.out(0, "presets", "show", "opencv-sgbm")
    assert run("presets", "show", "opencv-sgmb") == 2
    tool.told(2, "presets", "show", "accurate")
    assert run("presets", "show", "stereo/accurate") == 0
    tool.both(2, "presets", "list")
    shown = [tool.out(0, "presets", *words, "thesis/ch2-kp-dedc") for words in ((), ("show",))]
    assert shown[0] == shown[1] and "\npipeline: segments\n" in shown[0]
    assert {line.split()[0] for line in tool.out(0, "presets", "fuse").splitlines() if line} == {"fuse"}


def test_compile_computes_each_preset_that_a_pattern_names(tmp_path: Path, monkeypatch, tool):
    """Bounds have kernels of their own; a preset without bounds fails with them, and that is no failure."""
    computed: list[list[str]] = []

    def computes(words: list[str]) -> str:
        computed.append([word for word in words if not word.startswith(tempfile.gettempdir())])
        return "broken" if words[:2] == ["transparent", "nearest"] or words[-1] == "--bound" else ""

    laid(tmp_path / "kernels", {"a/x.kernel": bytes(3 << 20), "y.kernel": bytes(1 << 20)})
    monkeypatch.setattr("depthcli.kernels.cache.cache_folder", lambda: tmp_path / "kernels")
    monkeypatch.setattr(presets_command, "_run", computes)
    out, err = tool.both(1, "presets", "compile", "stereo/opencv-sgbm*", "nearest", "-q")
    assert out == f"{tmp_path / 'kernels'}: 4 MiB\n" and err == "transparent nearest: broken\n"
    assert sorted(computed) == [
        ["refine-kinect", "nearest", "-i", "-o"], ["sample", "--kinect", "-o"], ["sample", "--transparent", "-o"],
        ["sample", "-o"],
        ["stereo", "opencv-sgbm", "-i", "-o"], ["stereo", "opencv-sgbm", "-i", "-o", "--bound"],
        ["stereo", "opencv-sgbm-wls", "-i", "-o"], ["stereo", "opencv-sgbm-wls", "-i", "-o", "--bound"],
        ["transparent", "nearest", "-i", "-o"],
    ]  # fmt: skip
    assert tool.out(0, "presets", "compile", "stereo/fast", "-q") == out
    computed.clear()
    assert "no preset called 'stereo/fst'" in tool.err(2, "presets", "compile", "fast", "stereo/fst")
    monkeypatch.setattr("depthcli.kernels.cache.cache_folder", lambda: None)
    assert "NUMBA_CACHE_DIR" in tool.err(2, "presets", "compile", "fast")
    assert computed == []


@pytest.mark.slow
def test_compile_fills_the_folder_of_kernels_by_processes(tmp_path: Path, monkeypatch, tool):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("depthcli.kernels.cache.cache_folder", lambda: tmp_path)
    monkeypatch.setattr(presets_command, "_BOUNDED", ())
    monkeypatch.setitem(presets_command._SCENES, "stereo", ["-n", "1", "--width", "64", "--max-disparity", "9"])
    err = tool.err(0, "presets", "compile", "opencv-sgbm")
    assert re.fullmatch(r"1 of 1 compiled, \d+ s: stereo opencv-sgbm\n", err) and list(tmp_path.rglob("*.kernel"))
    monkeypatch.setitem(presets_command._SCENES, "stereo", ["-n", "1", "--width", "64"])
    tool.told(2, "presets", "compile", "opencv-sgbm")


WRONG = {
    "stereo opencv-sgmb -i . -o x": "did you mean 'opencv-sgbm'?",
    "stereo absent.yaml -i . -o x": "absent.yaml: neither a file nor a preset",
    "stereo fast -o x": "give --input DIR, or --left FILE and --right FILE",
    "stereo fast -i . --left a -o x": "--left needs --right",
    "stereo fast -i . --left a --right b -o x": "exclude each other",
    "stereo fast -i absent -o x": "absent: no such folder",
    "stereo opencv-bm -i . -o x --set blok=3": "--set blok: no such key (got 3); did you mean",
    "stereo fast -i . -o x --set cost.window=9": "--set cost.window: should be a valid tuple (got 9); write [9, 9]",
    "stereo fast -i . -o x --max-memory lots": "--max-memory: must be a size such as 2GiB",
    "stereo fast -i .": "give --output DIR",
    "stereo fast -i . -o https://host/out": "not to URLs",
    "stereo fast -i . -o -": "stdout",
    "stereo fast -i . -o ''": "-o: is empty",
    "stereo fast -i . --output=": "--output: is empty",
    "stereo fast -i . -o x --left ''": "--left: is empty",
    "stereo fast -i . -o x ''": "an argument: is empty",
    "stereo fast -i . -o x --jobs 0": "--jobs: must be auto, or 1 to 512 (got '0')",
    "stereo fast -i . -o x --jobs 513": "--jobs: must be auto, or 1 to 512 (got '513')",
    "stereo fast -i . -o x --jobs many": "--jobs: must be auto, or 1 to 512 (got 'many')",
    "stereo fast -i . -o x --shard 1/2 --evaluate": "--evaluate needs all scenes",
    "depth run -o x --shard 1/2 --html": "--html needs all scenes",
    "stereo fast -i absent -o x --flag 'measured<much'": "--flag: expected COLUMN<NUMBER",
    "stereo fast -i absent -o x --fail-flagged": "--fail-flagged needs a condition, such as --flag",
    "stereo": "Missing argument 'CONFIG'",
    "sterio": "Did you mean 'stereo'?",
    "nope": "No such command 'nope'",
    "presets --jso": "--json",
    "sample -o x --count 0 --width 3": "Invalid value for '--count'",
    "sample -o x --speckles 0.1": "--speckles has no effect on stereo scenes",
    "sample -o x --max-disparity 300": "at most width / 2 = 200",
    "sample -o x --kinect --width 64": "--width: at least 96",
    "sample -o x --real --count 3": "--count has no effect on real scenes",
    "sample -o x --registration --kinect": "--kinect and --registration exclude each other",
    "sample -o s3://bucket/out": "not to URLs",
    "evaluate run --truth scenes -o -": "stdout",
    "evaluate . --truth . --resize 3x0": "--resize: expected WIDTHxHEIGHT, such as 256x144 (got '3x0')",
    "export run --for eth3d --method m -o -": "stdout",
    "export run --for eth4d --method m -o a.zip": "no benchmark called 'eth4d'; one of: middlebury-v3",
    "export run --for eth3d --method m -o a.zip --split val": "--split: must be training or test (got 'val')",
    "export run --for eth3d --method m -o a.zip": "run: no such folder",
    "calibrate . --board 9x6 -o -": "stdout",
    "calibrate . --board 9x6 --square 25mm -o c.yml": "no photos",
    "calibrate . --board 9by6 --square 25mm -o c.yml": "--board: expected 9x6 (inner corners)",
    "calibrate . --board 2x2 --square 25mm -o c.yml": "2x2 has too few or too many corners",
    "calibrate . --board 9x6 --square 2cm --marker 1cm -o c.yml": "--marker and --dictionary describe a ChArUco board",
    "calibrate . --board charuco:7x5 --square 2cm --marker 20mm -o c.yml": "20mm is not smaller than a square of 2cm",
    "calibrate . . . --board 9x6 --square 2cm -o c.yml": "PHOTOS: one folder, or one of each camera",
    "calibrate . --board 9x6 --square 2cm -o c.json": "expected FILE.yml (got c.json)",
    "calibrate . --board 9x6 --square 25 -o c.yml": "a length with its unit, such as 25mm (got '25')",
    "calibrate . --board charuco:7x5 --square 25mm -o c.yml": "--marker 18mm",
    "calibrate . --board charuco:30x20 --square 2cm --marker 1cm -o c.yml": "4X4_50 has 50 markers, the board 300",
    "calibrate . --board charuco:7x5 --square 2cm --marker 1cm --dictionary 9X9 -o c.yml": "no 9X9",
    "rectify --left l --right r -o x": "give --calibration FILE, or --uncalibrated",
    "rectify --left l --right r -o x --calibration a --uncalibrated": "give --calibration FILE, or --uncalibrated",
    "rectify -i . -o x --calibration c.yml --cameras 2,2": "cameras: must be two numbers such as 2,3",
    "depth run -o x --focal 700": "--focal and --baseline belong together",
    "depth run -o x --focal 700 --baseline 1 --calibration c": "exclude each other",
    "depth run -o x --focal 700 --baseline 1 --unit mm": "--unit and --focal exclude each other",
    "depth run -o x --mask sure": "mask: must be measured, all, or confident",
    "depth run -o x --near 3 --far 1": "--near 3, --far 1: no depth",
    "refine-kinect nearest --color c.png -o x": "--color needs --depth",
    "refine-kinect nearest -i . -o x --level 0.2": "Invalid value for '--level'",
    "refine-kinect nearest -i . -o x --within 7": "--within: should be less than or equal to 1",
    "confidence -i . --maps m -o x --share 0.8 --threshold 0.5": "--share and --threshold exclude each other",
    "confidence -i . --maps m -o x --keep 0.8": "the share of the surest pixels is --share 0.8",
    "confidence -i . --maps m -o x --max-disparity 0": "--max-disparity: expected a whole number from 1",
    "confidence -i . --maps m -o x --measure sharpness": "--measure: no measure called 'sharpness'; one of: all, left",
    "fuse accurate -i . --maps a -o x": "--maps goes with depthcli fuse maps",
    "fuse maps -i . -o x": "--maps: give 1 to",
    "fuse maps -i . --maps a -o x --set p=1": "--set does not go with fuse maps",
    "fuse maps -i . --maps a -o x --min-disparity 3": "--min-disparity does not go with fuse maps",
    "register-confidence mind --fixed a.nii -o x": "--fixed needs --warped",
    "register-confidence mind --warped a.nii -o x": "--warped needs --fixed",
    "register-confidence mind --fixed a.nii --warped b.nii --field spm -o x": "--field: ",
    "sweep fast -i . -o x --over optimization.pp=2,8": "--over optimization.pp: no such key",
    "sweep fast -i . -o x --over optimization.p2=2 --command evaluate": "--command: must be one of stereo, fuse",
}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage_is_exit_2_and_a_line(line: str, tmp_path: Path, monkeypatch, tool):
    monkeypatch.chdir(tmp_path)
    out, err = tool.both(2, *shlex.split(line))
    assert WRONG[line] in err and out == "" and "Traceback" not in err
    assert len([said for said in err.splitlines() if said.startswith(("depthcli: ", "Error: "))]) == 1
    assert not list(tmp_path.iterdir())


def test_a_scene_that_would_not_fit_fails_before_it_starts(made_scenes, tmp_path, tool, monkeypatch):
    monkeypatch.setattr(OpencvSgbm, "peak_bytes", lambda self, shape, top: 3 << 30)
    monkeypatch.setattr(OpencvSgbm, "__call__", lambda *a: pytest.fail("was started"))
    command = ("stereo", "opencv-sgbm", "-i", made_scenes, "--scenes", "planes_0", "--max-memory", "2G", "-o")
    err = tool.err(3, *command, tmp_path / "r")
    assert re.search(r"planes_0: needs at least 33\d\d MiB of memory even in tiles, 1907", err)
    tool.told(3, *command, tmp_path / "s", "--set", "tiles=never")


@pytest.mark.parametrize(("error", "code"), [(ZeroDivisionError, 1), (KeyboardInterrupt, 130)])
def test_a_bug_and_ctrl_c_have_their_exit_codes(error, code: int, monkeypatch, tool, tmp_path: Path):
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("depthcli.core.config_file.find_config", fail)
    err = tool.err(code, "stereo", FAST, "-i", tmp_path, "-o", tmp_path / "x")
    assert ("this is a bug" in err) == ("ZeroDivisionError" in err) == (code == 1)
    assert ("interrupted" in err) == (code == 130)


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from depthcli.cli import main; main(['stereo', '--help']);"
        "sys.exit(', '.join({'numba', 'numpy', 'cv2', 'skimage', 'yaml', 'rich'} & set(sys.modules)) or 0)"
    )
    assert "--max-memory" in ended(0, sys.executable, "-c", code).stdout


@pytest.mark.parametrize("below", ["out", "results/out"])
def test_results_inside_the_input_are_no_scenes(made_scenes: Path, tmp_path: Path, below: str, tool):
    """A rectified pair is a scene by its files: the same command again finds the scenes that it found before."""
    scenes = tmp_path / "in"
    shutil.copytree(made_scenes / "planes_0", scenes / "planes_0")
    command = ("rectify", "--uncalibrated", "-i", scenes, "-o", scenes / below)
    assert run(*command) == 0
    before = sorted(scenes.rglob("*"))
    tool.told(0, *command)
    assert sorted(scenes.rglob("*")) == before


ROOT = Path(__file__).parents[2]
TWO_FILES = ROOT / "docs" / "plugin_template" / "depthcli_example" / "layout.py"


def examples() -> list[str]:
    """Commands of the help texts, and of README and CONTRIBUTING up to a pipe, but for those with a placeholder."""
    texts = [text_of(function) for name in own_names() if (function := find(name)) is not None]
    pages = "".join((ROOT / name).read_text("utf-8") for name in ("README.md", "CONTRIBUTING.md"))
    lines = [line.strip() for text in (*texts, pages.replace("\\\n", " ")) for line in text.splitlines()]
    found = [re.split(r" \|\|? | > |  # ", line)[0] for line in lines] + re.findall(r"`(depthcli [^`]+)`", pages)
    return sorted({line for line in found if re.match(r"depthcli [a-z](?!.*([$]|NAME|squared_difference))", line)})


@pytest.mark.parametrize("name", ["", *own_names()])
@pytest.mark.parametrize("columns", ["80", "200"])
def test_a_help_text_fits_a_terminal(name: str, columns: str, tool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", columns)
    assert max(map(len, tool.out(0, *([name] if name else []), "--help").splitlines())) <= 80


@pytest.mark.parametrize("example", examples())
def test_examples_parse_and_their_configs_load(example: str):
    _, name, *words = shlex.split(example)
    command = command_of(name)
    values: dict[str, Any] = command.make_context(name, words).params
    if values.get("preset") is not None:
        assert main([name, *words]) == 0
    model = config_model(values.get("command", name))
    if "config" in values and model is not None and values["config"] != "maps":
        axes = parse_axes(values.get("over") or ())
        settings = [*(values["set"] or ()), *(f"{key}={value}" for key in axes for value in axes[key])]
        load_config(model, find_config(values.get("command", name), values["config"]), settings)


def test_without_a_command_the_help_is_shown(tool):
    tool.told(2)


@pytest.mark.parametrize(("words", "completed", "not_completed"), [
    ("ste", {"stereo"}, {"fuse"}),
    ("evaluate --thr", {"--threshold"}, {"--truth"}),
    ("stereo ac", {"accurate"}, {"cross"}),
    ("fuse thesis/ch6-c", {"thesis/ch6-cw", "thesis/ch6-cross"}, {"thesis/ch6-all", "accurate"}),
    ("presets show ac", {"accurate"}, {"fast"}),
    ("stereo fast --layout mid", {"middlebury-v2", "middlebury-v3"}, {"kitti-2015"}),
    (f"stereo fast --plugin {TWO_FILES} --layout two", {"two-files"}, {"middlebury-v2"}),
    ("evaluate run --protocol ki", {"kitti-2012", "kitti-2015"}, {"eth3d"}),
    ("stereo fast --max-disparity 9 --set optimization", {"optimization=", "optimization.p2="}, {"cost="}),
    ("sweep consensus --command fuse --set meas", {"measures="}, {"cost="}),
    ("stereo no-such-preset --set cost", set(), {"cost="}),
])  # fmt: skip
def test_shells_complete_names_and_keys(words: str, completed: set[str], not_completed: set[str], monkeypatch, capsys):
    monkeypatch.setenv("COMP_WORDS", f"depthcli {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    monkeypatch.setenv("_DEPTHCLI_COMPLETE", "complete_bash")
    with pytest.raises(SystemExit):
        main([])
    for module in list(plugins.loaded):
        plugins.forget(module)
    out, err = capsys.readouterr()
    assert completed <= set(out.split()) and not not_completed & set(out.split()) and err == ""


def test_sizes_have_units_of_1000_or_of_1024():
    sizes = {"2GiB": 2 << 30, "500M": 500 * 10**6, "1.5 kB": 1500, "64KiB": 1 << 16, "1e9": 10**9}
    assert {text: parse_bytes(text) for text in sizes} == sizes


def test_the_largest_need_of_a_scene(two_scenes: Path, tmp_path: Path):
    """Where the pair gives the range, that of the widest one; None for what is computed by others."""
    pairs, options = PairOptions(input=two_scenes), RunOptions(output=tmp_path)

    def needs(*settings: str, config: str = "fast") -> tuple[int | None, int | None]:
        job, scenes = job_and_scenes("stereo", config, pairs, options, settings)
        return job.memory(scenes[0]), job.memory_bound(scenes[0])

    known, bound = needs()
    assert known is not None and known == bound == needs("max_disparity=12")[1]
    for auto in ("max_disparity=auto", "min_disparity=auto"):
        unknown, widest = needs(auto)
        assert unknown is None and widest is not None and widest > known
    program = [sys.executable, "-c", "pass", "{left}", "{right}", "{output}"]
    (tmp_path / "program.yaml").write_text(json.dumps({"pipeline": "command", "program": program}))
    assert needs(config=str(tmp_path / "program.yaml"))[1] is None
    frame = dict.fromkeys(("color.png", "depth.png"), np.ones((30, 40), np.uint8))
    laid(tmp_path / "in/a", frame | {"sparse.png": frame["depth.png"], "ir.png": frame["depth.png"]})
    for command, config in (("refine-kinect", "fast"), ("transparent", "nearest"), ("transparent", "kinect")):
        job, (scene,) = job_and_scenes(command, config, SceneOptions(input=tmp_path / "in"), options, ())
        known, of = job.memory(scene), job.config.pipeline if command == "transparent" else job.config
        assert known == of.peak_bytes((30, 40)), config
        assert job.memory_bound(scene) == (None if config == "kinect" else known)
