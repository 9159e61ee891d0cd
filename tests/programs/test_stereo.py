"""Programs as methods of ``stereo``: real ones, every failure as a row, resuming, sweeps, tiles, the Middlebury SDK."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_image
from depthcli.methods.stereo.config import StereoConfig
from tests.programs._runs import assert_one_failed, rows

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
    if kind == "missing":
        sys.exit()
    if kind == "empty":
        open(output, "wb")
        sys.exit()
    if kind == "rubbish":
        open(output, "wb").write(b"rubbish" * 100)
        sys.exit()
    if kind == "size":
        values = values[:-1]
    if kind == "nan":
        values[:] = np.nan
    if kind == "negative":
        values[:] = -1
    if kind == "stays" and os.fork() == 0:
        os.setsid()
        time.sleep(300)
    if kind == "memory":
        block = bytearray(b"x" * (700 << 20))
        time.sleep(60)
np.save(output, values)
"""
FAILURES = {
    "hangs": "was ended after 2 s; see timeout: cannot go on",
    "crashes": "was ended by SIGABRT: cannot go on",
    "missing": "the program wrote no output.npy",
    "empty": "the program wrote an empty output.npy",
    "rubbish": "the program's map cannot be read: ",
    "size": "output.npy has another size than the images: 96 x 63, want 96 x 64",
    "nan": "no pixel of the program's output.npy has a value",
    "negative": "no pixel of the program's map has a disparity from 0 to 12",
    "stays": "left processes running, which were ended: cannot go on",
    "memory": "took more than the 500 MiB that may be used; see --max-memory, --jobs: cannot go on",
}


@pytest.fixture
def here(here: Path) -> Path:
    """The current folder, with the programs in it."""
    (here / "sgbm.py").write_text(SGBM)
    (here / "failing.py").write_text(FAILING)
    write_config(here / "sgbm.yaml", ["sgbm.py", "{left}", "{right}", "{output}", "{max_disparity}", "{block}"])
    return here


def write_config(path: Path, words: list[str], **fields: object) -> Path:
    config = {"pipeline": "command", "run": [sys.executable, *words], "parameters": {"block": 5}, "format": "npy"}
    path.write_text(json.dumps(config | fields))
    return path


def stereo(config: str, scenes: Path, output: str, *options: str) -> int:
    return main(["stereo", config, "-i", str(scenes), "-o", output, "-q", *options])


@pytest.mark.slow
def test_a_program_with_opencvs_matcher_is_as_good_as_the_matcher(here: Path, made_scenes: Path):
    options = ("--scenes", "planes_[012]")
    assert stereo("sgbm.yaml", made_scenes, "others", *options) == 0
    assert stereo("opencv-sgbm", made_scenes, "ours", *options, "--set", "fill=false") == 0
    found = rows(here / "others")["planes_0"]
    assert found["density"] > 0.7
    assert found["seconds"].keys() >= {"write", "program", "read"}
    assert found["program_cpu"] > 0.05
    assert found["program_memory"] > 20 << 20
    for scene in ("planes_0", "planes_1", "planes_2"):
        one, other = (read_pfm(here / run / scene / "disp_left.pfm") for run in ("others", "ours"))
        both = np.isfinite(one) & np.isfinite(other)
        assert both.mean() > 0.6
        assert np.mean(np.abs(one[both] - other[both]) < 1) > 0.95
    assert not list((here / "scratch").iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAILURES)
def test_each_failure_is_a_row_and_the_other_scenes_are_written(here: Path, made_scenes: Path, kind: str):
    write_config(here / "c.yaml", ["failing.py", "{left}", "{output}", "{name}", kind, "{scratch}"], timeout="2 s")
    memory = ("--max-memory", "500MiB")
    assert stereo("c.yaml", made_scenes, "run", "--scenes", "planes_[012]", *memory) == 3
    assert_one_failed(here, "planes_1", ["done", "failed", "done"], FAILURES[kind], "left.png")


@pytest.mark.slow
def test_workers_and_shards_write_the_same_bytes(here: Path, made_scenes: Path):
    assert stereo("sgbm.yaml", made_scenes, "one") == 0
    assert stereo("sgbm.yaml", made_scenes, "jobs", "--jobs", "2") == 0
    for part in ("1/2", "2/2"):
        assert stereo("sgbm.yaml", made_scenes, "shards", "--shard", part) == 0
    for file in (here / "one").glob("*/*"):
        if file.parent.name != "evaluation":
            assert (here / "jobs" / file.relative_to(here / "one")).read_bytes() == file.read_bytes()
            assert (here / "shards" / file.relative_to(here / "one")).read_bytes() == file.read_bytes()


@pytest.mark.slow
def test_a_run_goes_on_unless_program_or_version_are_others(here: Path, made_scenes: Path, capsys):
    options = ("--scenes", "planes_0")
    run = ["stereo", "sgbm.yaml", "-i", str(made_scenes), "-o", "run", *options]
    assert main(run) == 0
    assert main(run) == 0
    assert "1 of 1 scenes are done already" in capsys.readouterr().err
    assert main(["stereo", "run/run.yaml", *run[2:]]) == 0
    assert "1 of 1 scenes are done already" in capsys.readouterr().err
    assert rows(here / "run")["planes_0"]["program_memory"] > 0
    (here / "sgbm.py").write_text(SGBM.replace("raw / 16", "raw / 8"))
    before = read_pfm(here / "run" / "planes_0" / "disp_left.pfm")
    assert main(run) == 0
    assert "already" not in capsys.readouterr().err
    after = read_pfm(here / "run" / "planes_0" / "disp_left.pfm")
    both = np.isfinite(before) & np.isfinite(after) & (before > 0)
    assert np.median(after[both] / before[both]) == 2
    assert main([*run, "--set", "version=2.1"]) == 2
    assert "version: '2.1'" in capsys.readouterr().err


@pytest.mark.slow
def test_a_sweep_goes_over_parameters(here: Path, made_scenes: Path):
    over = ["--over", "parameters.block=3,9", "--scenes", "planes_0"]
    assert main(["sweep", "sgbm.yaml", *over, "-i", str(made_scenes), "-o", "sweep", "-q"]) == 0
    table = json.loads((here / "sweep" / "sweep.json").read_text())
    assert {run["parameters.block"] for run in table["results"][0]["runs"]} == {"3", "5", "9"}


def program(words: list[str], **fields: object) -> StereoConfig:
    return StereoConfig.model_validate({"pipeline": "command", "program": words, **fields})


@pytest.mark.slow
def test_it_is_a_method_for_python_matched_in_tiles_where_a_halo_is_given(here: Path):
    rng = np.random.default_rng(0)
    left = rng.integers(0, 256, (160, 320), np.uint8)
    right = np.roll(left, -7, axis=1)
    words = [sys.executable, "sgbm.py", "{left}", "{right}", "{output}", "{max_disparity}", "{block}"]
    fields = {"format": "npy", "parameters": {"block": 5}, "max_disparity": 15, "tiles": "always"}
    whole = depthcli.stereo(left, right, preset=program(words, **fields))
    tiled = depthcli.stereo(left, right, preset=program(words, **fields, halo=20))
    assert np.nanmedian(whole.values) == np.nanmedian(tiled.values) == 7
    assert "tiles" not in whole.details.figures
    assert tiled.details.figures["tiles"] >= 1


@pytest.mark.slow
def test_a_matcher_for_loops_runs_it_for_pairs_alone(here: Path):
    code = "import sys, numpy; open('../../ran', 'a').write('x'); numpy.save(sys.argv[1], numpy.ones((20, 30)))"
    image = np.zeros((20, 30), np.uint8)
    match = depthcli.matcher(program([sys.executable, "-c", code, "{output}"], format="npy"), max_disparity=15)
    assert not (here / "ran").exists()
    assert (match(image, image).values == 1).all()
    assert (here / "ran").read_text() == "x"


COPY = "import shutil, sys; shutil.copy(*sys.argv[1:])"


@pytest.mark.slow
def test_formats_scales_and_values_that_mean_none(here: Path):
    from depthcli.io.formats.disparity import write_disparity_png, write_pfm
    from depthcli.io.formats.images import write_png

    values = np.full((20, 30), 4.5, np.float32)
    values[0, :3] = (-10, np.nan, 40)
    write_pfm(here / "map.pfm", values)
    np.save(here / "map.npy", values)
    write_disparity_png(here / "kitti.png", np.where(np.isfinite(values), np.abs(values), np.nan))
    write_png(here / "map.png", np.nan_to_num(values * 2 + 20).astype(np.uint8))
    image = np.zeros((20, 30), np.uint8)

    def found(file: str, **fields: object):
        words = [sys.executable, "-c", COPY.replace("{", "{{"), str(here / file), "{output}"]
        return depthcli.stereo(image, image, preset=program(words, **fields), max_disparity=15)

    for file, fields in (
        ("map.pfm", {"invalid": [-10]}),
        ("map.npy", {"format": "npy"}),
        ("kitti.png", {"format": "kitti", "invalid": [2560]}),
    ):
        result = found(file, **fields)
        assert np.isnan(result.values[0, :3]).all()
        assert list(result.status[0, :4]) == [2, 2, 4, 0]
        assert (result.values[1:] == 4.5).all()
    assert found("map.png", format="png", scale=2).values[5, 5] == 14.5
    assert found("map.npy", format="npy", scale=0.5).values[5, 5] == 9


@pytest.mark.slow
@pytest.mark.parametrize(("images", "kind"), [("png", (20, 30, 3)), ("pgm", (20, 30)), ("ppm", (20, 30, 3))])
def test_images_are_written_as_the_program_reads_them(here: Path, images: str, kind: tuple[int, ...]):
    left = np.random.default_rng(1).integers(0, 256, (20, 30, 3), np.uint8)
    code = (
        f"import shutil, sys, numpy; shutil.copy(sys.argv[1], r'{here}'); numpy.save('map.npy', numpy.ones((20, 30)))"
    )
    words = [sys.executable, "-c", code, "{left}"]
    preset = program(words, images=images, format="npy", output="map.npy")
    assert (depthcli.stereo(left, left, preset=preset, max_disparity=15).values == 1).all()
    written = read_image(here / f"left.{images}")
    assert written.shape == kind
    if len(kind) == 3:
        assert np.array_equal(written, left)


@pytest.mark.slow
def test_original_images_are_the_scene_s_own_files_or_refused(here: Path, made_scenes: Path, capsys):
    code = (
        "import sys, numpy; open(sys.argv[4], 'a').write('\\n'.join(sys.argv[1:3]) + '\\n'); "
        "numpy.save(sys.argv[3], numpy.full((64, 96), 3, numpy.float32))"
    )
    write_config(
        here / "c.yaml", ["-c", code, "{left}", "{right}", "{output}", "{cwd}/seen"], images="original", halo=20
    )
    options = ("--scenes", "planes_[01]")
    assert stereo("c.yaml", made_scenes, "run", *options, "--jobs", "2") == 0
    seen = set((here / "seen").read_text().split())
    assert len(seen) == 4
    assert seen <= {str(path) for n in (0, 1) for path in (made_scenes / f"planes_{n}").glob("*.png")}
    assert (read_pfm(here / "run" / "planes_0" / "disp_left.pfm") == 3).all()
    assert not list((here / "scratch").iterdir())
    for setting in ("min_disparity=1", "tiles=always"):
        assert stereo("c.yaml", made_scenes, f"of {setting}", *options, "--set", setting) == 3
        assert "images: original: no image files hold this pair as it is matched" in capsys.readouterr().err
    image = np.zeros((64, 96), np.uint8)
    with pytest.raises(depthcli.InputError, match="images: original: no image files"):
        depthcli.stereo(image, image, preset="c.yaml", max_disparity=15)
    assert not list((here / "scratch").iterdir())


def test_a_shell_is_only_used_where_wanted_and_gets_quoted_values(here: Path):
    image = np.zeros((20, 30), np.uint8)
    np.save(here / "map.npy", np.ones((20, 30), np.float32))
    fields = {"format": "npy", "max_disparity": 15, "parameters": {"odd": "a b; exit 7"}}
    line = f"test {{odd}} = 'a b; exit 7' && cat {here}/map.npy > {{output}}"
    config = StereoConfig.model_validate({"pipeline": "command", "program": line, "shell": True, **fields})
    assert (depthcli.stereo(image, image, preset=config).values == 1).all()
    with pytest.raises(depthcli.InputError, match="exit code"):
        depthcli.stereo(image, image, preset=program(["/bin/sh", "-c", "exit 7 > /dev/null"], **fields))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["run=[./absent, '{left}']"], r"program: \./absent: no such file, or it cannot be run"),
        (["run=[surely-not-in-path, '{left}']"], "not in PATH; for a file here write ./ before"),
        (["run=[python, '{lefft}']"], r"--set run: .*no placeholder \{lefft\}; did you mean \{left\}\?"),
        (["run=[python, '{zzzz}']"], r"no placeholder \{zzzz\}; there are: left, right, max_disparity"),
        (["run=[python, '{']"], "a brace is written"),
        (["timeout=10 parsecs"], "--set timeout: want a time such as 30 s, 10 min or 2 h"),
        (["parameters.left=3"], "'left' cannot be the name of a parameter"),
        (["shell=true"], "want one text with shell: true, not a list"),
        (["formatt=pfm"], "did you mean 'format'"),
    ],
)
def test_what_is_wrong_with_a_config_is_said_before_any_scene_is_opened(
    here: Path, made_scenes: Path, capsys, settings: list[str], message: str
):
    options = [word for setting in settings for word in ("--set", setting)]
    assert stereo("sgbm.yaml", made_scenes, "run", *options) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (here / "run").exists()


@pytest.mark.slow
def test_a_method_of_the_middlebury_sdk_runs_as_it_is(here: Path, made_scenes: Path, capsys):
    folder = here / "alg-Mine"
    folder.mkdir()
    run = folder / "run"
    run.write_text(
        f"#!/bin/sh\nset -e\n{sys.executable} ./alg-Mine/m.py $1 $2 $4/disp0Mine.pfm $3\necho 0.1 > $4/timeMine.txt\n"
    )
    (folder / "m.py").write_text(
        "import sys, cv2, numpy as np\n"
        "h, w = cv2.imread(sys.argv[1]).shape[:2]\n"
        "values = np.full((h, w), float(sys.argv[4]) / 2, '<f4')\n"
        "values[0, 0] = np.inf\n"
        "open(sys.argv[3], 'wb').write(b'Pf\\n%d %d\\n-1\\n' % (w, h) + values[::-1].tobytes())\n"
    )
    assert stereo("middlebury-sdk", made_scenes, "absent") == 2
    assert "alg-NAME: want a folder alg-NAME that holds a program called run" in capsys.readouterr().err
    run.chmod(0o755)
    options = ("--set", "program=alg-Mine", "--scenes", "planes_0", "--set", "max_disparity=11")
    assert stereo("middlebury-sdk", made_scenes, "sdk", *options) == 0
    values = read_pfm(here / "sdk" / "planes_0" / "disp_left.pfm")
    assert np.isinf(values[0, 0])
    assert (values.ravel()[1:] == 6).all()
    shutil.move(folder / "m.py", folder / "gone.py")
    assert stereo("middlebury-sdk", made_scenes, "failed", *options) == 3
    assert "run ended with exit code 2" in rows(here / "failed")["planes_0"]["error"]


@pytest.mark.slow
def test_a_run_script_of_the_middlebury_sdk_writes_disp0_beside_a_sparse_map(here: Path, made_scenes: Path, capsys):
    """The SDK's own ``alg-ELAS/run`` does; ``runalg`` adds the name of the method to the files afterwards."""
    folder = here / "sdk" / "alg-Two"
    folder.mkdir(parents=True)
    (folder / "write.py").write_text(
        "import sys, cv2, numpy as np\n"
        "h, w = cv2.imread(sys.argv[1]).shape[:2]\n"
        "for name, value in (('disp0', 5), ('disp0_s', 1)):\n"
        "    values = np.full((h, w), value, '<f4').tobytes()\n"
        "    open(f'{sys.argv[2]}/{name}.pfm', 'wb').write(b'Pf\\n%d %d\\n-1\\n' % (w, h) + values)\n"
    )
    run = folder / "run"
    run.write_text(
        "#!/bin/sh\n"
        'if [ $# -ne 4 ]; then echo "usage: $0 im0.png im1.png ndisp outdir" >&2; exit 1; fi\n'
        f'{sys.executable} alg-Two/write.py "$1" "$4" && echo 0.25 > "$4/time.txt"\n'
    )
    run.chmod(0o755)
    options = ("--set", "program=sdk/alg-Two", "--scenes", "planes_0")
    assert stereo("middlebury-sdk", made_scenes, "two", *options) == 0
    assert (read_pfm(here / "two" / "planes_0" / "disp_left.pfm") == 5).all()
    run.write_text(run.read_text() + 'mv "$4/disp0.pfm" "$4/disp0Other.pfm"\n')
    assert stereo("middlebury-sdk", made_scenes, "other", *options) == 3
    assert "wrote 2 maps, but neither disp0Two.pfm nor disp0.pfm" in rows(here / "other")["planes_0"]["error"]


@pytest.mark.slow
def test_programs_are_found_beside_the_config_before_the_current_folder(
    here: Path, made_scenes: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    work = here / "study"
    work.mkdir()
    for folder, value in ((work, 4), (here, 7)):
        (folder / "plane").write_text(f'#!/bin/sh\nexec {sys.executable} "$1" "$2" {value}\n')
        (folder / "plane").chmod(0o755)
    (work / "plane.py").write_text(
        "import sys, numpy as np\nnp.save(sys.argv[1], np.full((64, 96), float(sys.argv[2]), np.float32))\n"
    )
    config = {"pipeline": "command", "run": ["./plane", "plane.py", "{output}"], "format": "npy"}
    (work / "plane.yaml").write_text(json.dumps(config))
    assert stereo("study/plane.yaml", made_scenes, "run", "--jobs", "2") == 0
    for scene in rows(here / "run"):
        assert (read_pfm(here / "run" / scene / "disp_left.pfm") == 4).all()
    assert str(work / "plane.py") in (here / "run" / "run.yaml").read_text()
    capsys.readouterr()
    monkeypatch.chdir(work)
    assert stereo(str(here / "run" / "run.yaml"), made_scenes, str(here / "run")) == 0  # from anywhere: nothing to do
    monkeypatch.chdir(here)
    (work / "plane").unlink()  # then the one in the current folder
    assert stereo("study/plane.yaml", made_scenes, "other", "--scenes", "planes_0") == 0
    assert (read_pfm(here / "other" / "planes_0" / "disp_left.pfm") == 7).all()
    setting = "run=[./absent, '{output}']"
    assert stereo("study/plane.yaml", made_scenes, "none", "--set", setting) == 2
    assert f"neither seen from the config file nor from {here}" in capsys.readouterr().err
