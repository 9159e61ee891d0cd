"""Programs as methods of ``stereo``: real ones, every failure as a row, resuming, tiles, nothing left running."""

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.core.context import Context
from depthcli.io.formats.disparity import read_pfm, write_disparity_png, write_pfm
from depthcli.io.formats.images import read_image, write_png
from depthcli.methods.stereo.pipeline._process import ProgramError, run_program
from depthcli.problems.stereo import StereoConfig
from depthcli.testing.inputs import texture
from tests.command_line import rows
from tests.golden import refused

# OpenCV's matcher as a program of somebody else: reads two images, writes a map as .npy.
SGBM = """
import sys
import cv2
import numpy as np
left, right, output, top, block = sys.argv[1:]
n = (int(top) // 16 + 1) * 16
views = [cv2.copyMakeBorder(cv2.imread(f, 0), 0, 0, n, 0, cv2.BORDER_REPLICATE) for f in (left, right)]
raw = cv2.StereoSGBM.create(0, n, int(block), P1=200, P2=800).compute(*views)[:, n:]
np.save(output, np.where(raw < 0, -1, raw / 16).astype(np.float32))
"""
# Fails for one scene in the way that its argument says, and writes a plane for the others.
FAILING = """
import os, sys, time
import numpy as np
left, output, name, kind, folder = sys.argv[1:]
values = np.full((64, 96), 3, np.float32)
if name == "planes_1":
    print("cannot go on", file=sys.stderr)
    if kind == "hangs":
        time.sleep(300)
    if kind == "crashes":
        os.abort()
    if kind == "rubbish":
        open(output, "wb").write(b"rubbish" * 100)
        sys.exit()
    if kind == "size":
        values = values[:-1]
np.save(output, values)
"""
FAILURES = {
    "hangs": "was ended after 8 s; see timeout: cannot go on",
    "crashes": "was ended by SIGABRT: cannot go on",
    "rubbish": "the program's map cannot be read: ",
    "size": "output.npy has another size than the images: 96 x 63, expected 96 x 64",
}
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
SGBM_WORDS = [sys.executable, "sgbm.py", "{left}", "{right}", "{output}", "{max_disparity}", "{block}"]
NPY = {"format": "npy", "parameters": {"block": 5}}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with the programs in it and a place for scratch folders below."""
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sgbm.py").write_text(SGBM)
    (tmp_path / "failing.py").write_text(FAILING)
    write_config("sgbm.yaml", SGBM_WORDS)
    return tmp_path


def write_config(file: str, words: list[str], **fields: object) -> None:
    Path(file).write_text(json.dumps({"pipeline": "command", "run": words, **NPY, **fields}))


def stereo(config: str, scenes: Path, output: str, *options: str) -> int:
    return main(["stereo", config, "-i", str(scenes), "-o", output, "-q", *options])


def map_of(run: str) -> np.ndarray:
    return read_pfm(Path(run, "planes_0", "disp_left.pfm"))


def program(words: list[str], **fields: object) -> StereoConfig:
    return StereoConfig.model_validate({"pipeline": "command", "program": words, **fields})


@pytest.mark.slow
def test_a_program_with_opencvs_matcher_is_as_good_as_the_matcher(here: Path, made_scenes: Path):
    options = ("--scenes", "planes_[01]")
    assert stereo("sgbm.yaml", made_scenes, "others", *options, "--jobs", "2") == 0
    assert stereo("opencv-sgbm", made_scenes, "ours", *options, "--set", "fill=false") == 0
    found = rows(here / "others")["planes_0"]
    assert found["density"] > 0.7 and found["seconds"].keys() >= {"write", "program", "read"}
    assert found["program_cpu"] > 0.05 and 20 << 20 < found["program_memory"] < 400 << 20
    one, other = map_of("others"), map_of("ours")
    both = np.isfinite(one) & np.isfinite(other)
    assert both.mean() > 0.6 and np.mean(np.abs(one[both] - other[both]) < 1) > 0.95
    assert not list((here / "scratch").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAILURES)
def test_each_failure_is_a_row_and_the_other_scenes_are_written(here: Path, made_scenes: Path, kind: str):
    words = [sys.executable, "failing.py", "{left}", "{output}", "{name}", kind, "{scratch}"]
    write_config("c.yaml", words, timeout="8 s" if kind == "hangs" else "60 s")
    assert stereo("c.yaml", made_scenes, "run", "--scenes", "planes_[012]") == 3
    found = rows(here / "run")
    assert [row["status"] for row in found.values()] == ["done", "failed", "done"]
    assert FAILURES[kind] in found["planes_1"]["error"]
    (kept,) = (here / "scratch").iterdir()
    assert str(kept) in found["planes_1"]["error"] and (kept / "left.png").is_file()


@pytest.mark.slow
def test_a_run_goes_on_unless_program_or_version_are_others(here: Path, made_scenes: Path, tool):
    run = ["stereo", "sgbm.yaml", "-i", str(made_scenes), "-o", "run", "--scenes", "planes_0"]
    assert main(run) == 0
    tool.told(0, "stereo", "run/run.yaml", *run[2:])
    (here / "sgbm.py").write_text(SGBM.replace("raw / 16", "raw / 8"))
    before = map_of("run")
    assert main(run) == 0
    both = np.isfinite(before) & np.isfinite(map_of("run")) & (before > 0)
    assert np.median(map_of("run")[both] / before[both]) == 2
    tool.told(2, *run, "--set", "version=2.1")


@pytest.mark.slow
def test_it_is_a_method_for_python_matched_in_tiles_where_a_halo_is_given(here: Path):
    left = texture((160, 320))
    whole, tiled = (
        depthcli.stereo(left, np.roll(left, -7, axis=1), max_disparity=15, preset=program(SGBM_WORDS, **fields))
        for fields in ({**NPY, "tiles": "always"}, {**NPY, "tiles": "always", "halo": 20})
    )
    assert np.nanmedian(whole.values) == np.nanmedian(tiled.values) == 7
    assert "tiles" not in whole.details.figures
    assert tiled.details.figures["tiles"] >= 1


@pytest.mark.slow
def test_formats_scales_and_values_that_mean_none(here: Path):
    values = np.full((20, 30), 4.5, np.float32)
    values[0, :5] = (-10, np.nan, 40, 15.5, 16)
    write_pfm(here / "map.pfm", values)
    np.save(here / "map.npy", values)
    write_disparity_png(here / "kitti.png", np.where(np.isfinite(values), np.abs(values), np.nan))
    write_png(here / "map.png", np.nan_to_num(values * 2 + 20).astype(np.uint8))
    image = np.zeros((20, 30), np.uint8)

    def found(file: str, **fields: object):
        words = [sys.executable, "-c", "import shutil, sys; shutil.copy(*sys.argv[1:])", str(here / file), "{output}"]
        return depthcli.stereo(image, image, preset=program(words, **fields), max_disparity=15)

    kitti = {"format": "kitti", "invalid": [2560]}
    for file, fields in (("map.pfm", {"invalid": [-10]}), ("map.npy", {"format": "npy"}), ("kitti.png", kitti)):
        result = found(file, **fields)
        assert list(result.status[0, :6]) == [2, 2, 4, 0, 4, 0]
        np.testing.assert_array_equal(np.isnan(result.values), result.status > 0)
        assert (result.values[1:] == 4.5).all()
    assert found("map.png", format="png", scale=2).values[5, 5] == 14.5
    with pytest.raises(ProgramError, match="from 0 to 15"):
        found("map.npy", format="npy", invalid=[4.5, 15.5])
    with pytest.raises(ProgramError, match=r"wrote no output\.pfm"):
        depthcli.stereo(image, image, preset=program(["true"]), max_disparity=15)
    assert found("map.npy", format="npy", scale=0.5).values[5, 5] == 9


@pytest.mark.slow
@pytest.mark.parametrize(("images", "kind"), [("png", (20, 30, 3)), ("pgm", (20, 30)), ("ppm", (20, 30, 3))])
def test_images_are_written_as_the_program_reads_them(here: Path, images: str, kind: tuple[int, ...]):
    left = texture((20, 30, 3))
    code = f"import shutil, sys, numpy as n; shutil.copy(sys.argv[1], r'{here}'); n.save('map.npy', n.ones((20, 30)))"
    preset = program([sys.executable, "-c", code, "{left}"], images=images, format="npy", output="map.npy")
    match = depthcli.matcher(preset, max_disparity=15)
    assert not (here / f"left.{images}").exists()  # it is not run to compile kernels
    assert (match(left, left).values == 1).all()
    written = read_image(here / f"left.{images}")
    assert written.shape == kind
    assert len(kind) == 2 or np.array_equal(written, left)


@pytest.mark.slow
def test_original_images_are_the_scene_s_own_files_or_refused(here: Path, made_scenes: Path, tool):
    code = """import sys, numpy
open(sys.argv[4], 'a').write(chr(10).join(sys.argv[1:3]))
numpy.save(sys.argv[3], numpy.full((64, 96), 3, numpy.float32))"""
    words = [sys.executable, "-c", code, "{left}", "{right}", "{output}", "{cwd}/seen"]
    write_config("c.yaml", words, images="original")
    assert stereo("c.yaml", made_scenes, "run", "--scenes", "planes_0") == 0
    seen = set((here / "seen").read_text().split())
    assert seen == {str(path) for path in (made_scenes / "planes_0").glob("[lr]*.png")}
    shifted = ("-o", "shifted", "-q", "--scenes", "planes_0", "--set", "min_disparity=1")
    tool.told(3, "stereo", "c.yaml", "-i", made_scenes, *shifted)
    assert not list((here / "scratch").iterdir())


@pytest.mark.parametrize("name", ["$(touch ran)", "`touch ran`", "a'; touch ran; '", "a b"])
def test_no_shell_reads_the_name_of_a_scene(here: Path, made_scenes: Path, name: str):
    shutil.copytree(made_scenes / "planes_0", here / "in" / name)
    line = 'test "$1" = "$DEPTHCLI_NAME" && printf "%s" "$DEPTHCLI_NAME" > "$DEPTHCLI_CWD/name"; exit 9'
    write_config("c.yaml", ["sh", "-c", line, "sh", "{name}"])
    assert stereo("c.yaml", here / "in", "run", "--max-disparity", "15") == 3
    assert (here / "name").read_text() == name
    assert not list(here.rglob("ran"))


def test_what_is_wrong_with_a_config_is_said_before_any_scene_is_opened(here: Path, made_scenes: Path, tool):
    for setting in (
        "run=[./absent, '{left}']", "run=[]", "run=[python, '{zzzz}']", "run=[python, '{']",
        "run=[python, '{max_disparity:03}']", "timeout=10 parsecs", "parameters.left=3", "shell=true",
        "run=[bash, -ec, 'echo \"{name}\"']",
    ):  # fmt: skip
        tool.told(2, "stereo", "sgbm.yaml", "-i", made_scenes, "-o", "run", "--set", setting)
    assert not (here / "run").exists()


@pytest.mark.slow
def test_programs_are_found_beside_the_config_before_the_current_folder(here: Path, made_scenes: Path):
    work = here / "study"
    work.mkdir()
    for folder, value in ((work, 4), (here, 7)):
        (folder / "plane").write_text(f'#!/bin/sh\nexec {sys.executable} "$1" "$2" {value}\n')
        (folder / "plane").chmod(0o755)
    code = "import sys, numpy as np; np.save(sys.argv[1], np.full((64, 96), float(sys.argv[2]), np.float32))"
    (work / "plane.py").write_text(code)
    write_config("study/plane.yaml", ["./plane", "plane.py", "{output}"])
    assert stereo("study/plane.yaml", made_scenes, "run", "--scenes", "planes_0") == 0
    assert (map_of("run") == 4).all()
    assert str(work / "plane.py") in (here / "run" / "run.yaml").read_text()
    (work / "plane").unlink()  # then the one in the current folder
    assert stereo("study/plane.yaml", made_scenes, "other", "--scenes", "planes_0") == 0
    assert (map_of("other") == 7).all()


def run(folder: Path, code: str, timeout: float = 60.0, memory: int = 1 << 40) -> None:
    (folder / "program.py").write_text(textwrap.dedent(code))
    run_program([sys.executable, "program.py"], folder, timeout, Context(program_memory=memory))


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def within_seconds(condition: Callable[[], bool]) -> bool:
    """Return whether a condition becomes true in the next 60 seconds."""
    return any(condition() or time.sleep(0.01) for _ in range(6000))


def ends(pid: int) -> bool:
    return within_seconds(lambda: not running(pid))


def test_exit_codes_and_signals_are_named_with_the_end_of_the_output(tmp_path: Path):
    for code in (
        "import sys; print('no licence', file=sys.stderr); sys.exit(3)",
        "print('only stdout'); raise SystemExit(1)",
        "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
        "print('y' * 9999); 1 / 0",
    ):
        refused(ProgramError, run, tmp_path, code)
    refused(ProgramError, run_program, ["./absent"], tmp_path, 1.0, Context())


@pytest.mark.skipif(not shutil.which("ps"), reason="no ps")
def test_systems_that_lack_a_way_to_look_at_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """macOS, which has no /proc and had no waitid, and Windows."""
    import resource

    context = Context()
    monkeypatch.delattr(os, "waitid", raising=False)
    monkeypatch.setattr("depthcli.methods.stereo.pipeline._process._resident_bytes", lambda session: 0)
    monkeypatch.setattr(resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=0))
    run_program([sys.executable, "-c", "bytearray(40 << 20)"], tmp_path, 60.0, context)
    assert 40 << 20 < context.used["program_memory"] < 4 << 30
    monkeypatch.setitem(sys.modules, "resource", None)
    refused(ProgramError, run_program, ["true"], tmp_path, 1.0, context)


CHILD = """
import os, signal, time
from pathlib import Path
signal.signal(signal.SIGTERM, signal.SIG_IGN)
if os.fork() == 0:
    Path("hidden").write_text(str(os.getpid()))
    Path("hidden").rename("child")
    time.sleep(300)
while not Path("child").is_file():
    time.sleep(0.01)
"""


@LINUX
@pytest.mark.slow
@pytest.mark.parametrize("end", ["time.sleep(300)", ""], ids=["hangs", "leaves a child"])
def test_a_program_ends_with_all_its_children(tmp_path: Path, end: str):
    with pytest.raises(ProgramError, match="was ended after 1 s") if end else nullcontext():
        run(tmp_path, CHILD + end, timeout=1.0)
    assert ends(int((tmp_path / "child").read_text()))


@LINUX
@pytest.mark.slow
def test_memory_of_all_processes_together_is_limited(tmp_path: Path):
    code = """
        import os, time
        for _ in range(3):
            if os.fork() == 0:
                break
        block = bytearray(b"x" * (80 << 20))
        time.sleep(60)
    """
    refused(ProgramError, run, tmp_path, code, memory=200 << 20)


@LINUX
@pytest.mark.slow
def test_it_ends_with_the_process_that_wanted_it(tmp_path: Path):
    (tmp_path / "program.py").write_text(CHILD + "time.sleep(300)")
    call = (
        "import sys; from pathlib import Path; from depthcli.core.context import Context; "
        "from depthcli.methods.stereo.pipeline._process import run_program; "
        "run_program([sys.executable, 'program.py'], Path(sys.argv[1]), 300.0, Context())"
    )
    caller = subprocess.Popen([sys.executable, "-c", call, str(tmp_path)])
    assert within_seconds((tmp_path / "child").is_file)
    pid = int((tmp_path / "child").read_text())
    assert running(pid)
    os.kill(caller.pid, signal.SIGKILL)
    caller.wait()
    assert ends(pid)
