"""Options and surroundings that a command refuses before it computes anything."""

import errno
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError, shortage
from depthcli.io.scenes.pairs import scenes_of_table
from tests.command_line import rows, run
from tests.files import laid
from tests.golden import told


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    noise = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (40, 80), np.uint8), (0, 0), 1.5)
    return laid(tmp_path / "in", {"a/left.png": noise[:, :70], "a/right.png": noise[:, 6:76]})


def stereo(scene: Path, *words: str | Path) -> int:
    return run("stereo", "opencv-bm", "-i", scene, "--max-disparity", "16", "-q", *words)


@pytest.mark.parametrize(("command", "keep", "wrong"), [
    ("stereo opencv-bm", "depth.pfm", "depth.pfm"),
    ("stereo opencv-bm", "disp_left.pfm,prevew.png", "prevew.png"),
    ("stereo opencv-bm", "disp_*.pfm,confidence_peak_ratio.pfm", ""),
    ("fuse consensus", "*.tif", "*.tif"),
    ("rectify --uncalibrated", "disp_left.pfm", "disp_left.pfm"),
    ("rectify --uncalibrated", "*.png", ""),
    ("refine-kinect nearest", "disp_left.pfm", "disp_left.pfm"),
    ("transparent sensor", "unreliable.pfm", "unreliable.pfm"),
    ("register-confidence planes", "confidence.nii.gz,eror.nii.gz", "eror.nii.gz"),
])  # fmt: skip
def test_keep_names_files_of_the_command(command: str, keep: str, wrong: str, tmp_path: Path, tool):
    names = ("left", "right", "color", "depth", "fixed", "moving_warped", "mask_transparent")
    scenes = laid(tmp_path / "in", {f"a/{name}.png": np.full((20, 30), 900, np.uint16) for name in names})
    words = (*command.split(), "-i", scenes, "--keep", keep, "-o", tmp_path / "o", "--dry-run")
    err = tool.err(2 if wrong else 0, *words)
    assert not wrong or f"--keep {wrong}: no file of {command.split()[0]} has that name" in err


def test_a_scene_of_which_no_file_is_kept_fails(scene: Path, tmp_path: Path):
    assert stereo(scene, "--keep", "confidence_mine.pfm", "-o", tmp_path / "o") == 3
    assert "matches no file of the scene; there are disp_left.pfm" in rows(tmp_path / "o")["a"]["error"]


def test_wrong_variables_are_one_line(scene: Path, tmp_path: Path, monkeypatch, capsys):
    for name, value in (("SLURM_ARRAY_TASK_ID", "x"), ("SLURM_ARRAY_TASK_COUNT", ""), ("NUMBA_NUM_THREADS", "0")):
        with monkeypatch.context() as patch:
            patch.setenv("SLURM_ARRAY_TASK_COUNT", "3")
            patch.setenv(name, value)
            assert stereo(scene, "-o", tmp_path / "o") == 2
        err = capsys.readouterr().err
        assert f"{name}: expected a whole number" in err and len(err.splitlines()) == 1


@pytest.mark.parametrize(("error", "said"), [
    (MemoryError(), "address space"),
    (ImportError("x.so: failed to map segment from shared object"), "address space"),
    (RuntimeError("can't start new thread"), "address space"),
    (OSError(errno.EMFILE, "Too many open files"), "open files"),
    (ImportError("a.so: cannot open shared object file: Too many open files"), "open files"),
    (ValueError("bad"), ""),
])  # fmt: skip
def test_what_a_machine_lacks_is_no_bug(error: Exception, said: str, scene: Path, tmp_path: Path, monkeypatch, capsys):
    """Raised itself, or as the cause of another; on the way to the scenes, and in one."""
    assert said in shortage(error) and bool(said) == bool(shortage(error))
    wrapped = InputError("x")
    wrapped.__cause__ = error
    assert shortage(wrapped) == shortage(error)

    def fails(*arguments: object, **options: object) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr("depthcli.commands._run.run_job", fails)
        assert stereo(scene, "-o", tmp_path / "o") == (2 if said else 1)
    told(capsys.readouterr().err)
    monkeypatch.setattr("depthcli.problems.stereo.load_pair", fails)
    assert stereo(scene, "-o", tmp_path / "o") == (3 if said else 1)
    assert ("bug" in rows(tmp_path / "o")["a"]["error"]) != bool(said)


def test_dry_runs_refuse_what_the_run_refuses(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    laid(tmp_path, {"file": "", "foreign/run.yaml": "mine: 1\n"})
    for output in ("file", "foreign", "in"):
        said = []
        for more in ((), ("--dry-run",), ("--dry-run", "--json")):
            assert stereo(scene, "-o", tmp_path / output, *more) == 2
            said.append(capsys.readouterr().err.splitlines()[-1])
        assert said[0].rpartition("(")[0] == said[1].rpartition("(")[0] and said[1] == said[2]


def test_bases_have_the_names_that_presets_show_takes(scene: Path, tmp_path: Path):
    for command, code in (("stereo", 0), ("fuse", 2)):
        (tmp_path / f"{command}.yaml").write_text(f"base: {command}/opencv-bm\n")
        for config in (f"{command}/opencv-bm", tmp_path / f"{command}.yaml"):
            assert run("stereo", config, "-i", scene, "-o", tmp_path / "o", "--dry-run", "-q") == code


def test_cells_of_tables_keep_their_line_breaks_and_tabs_separate_them(tmp_path: Path):
    (tmp_path / "t.csv").write_text('left,right,name\na.png,b.png,"a\nb"\nc.png,d.png,ab\n')
    assert [scene.name for scene in scenes_of_table(tmp_path / "t.csv")] == ["a\nb", "ab"]
    (tmp_path / "t.csv").write_text("left\tright\tname\na.png\tb.png\tx, y\n")
    assert [(scene.left.name, scene.name) for scene in scenes_of_table(tmp_path / "t.csv")] == [("a.png", "x, y")]
