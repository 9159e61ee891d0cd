"""Several processes in one run folder: who does what, who waits for whom, and what is left when one is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from depthcli.run.report_parts import joined_rows
from depthcli.run.reports import write_rows
from depthcli.run.sharing import LOCKS_FILE, Shard, parse_shard

from depthcli.cli import main
from depthcli.commands.stereo import COMMAND as STEREO
from depthcli.core.errors import ConfigError
from depthcli.io.formats.images import write_png
from depthcli.io.scenes.stereo import StereoScene
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run import run_folder
from depthcli.run.folder import REPORT_FILES, FolderLock
from depthcli.run.report import read_report

FAST = "opencv-bm"


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "depthcli", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def contents(folder: Path) -> dict[str, bytes]:
    """Every file but the reports, hidden ones included."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name not in REPORT_FILES)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def report(folder: Path) -> dict[str, str]:
    return {row["scene"]: row["status"] for row in json.loads((folder / "report.json").read_text())["scenes"]}


@pytest.fixture(scope="module")
def whole(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process makes of the twelve scenes."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    assert run("stereo", FAST, "-i", made_scenes, "-o", folder, "-q") == 0
    return folder


def test_what_a_shard_is():
    assert parse_shard(None, {}) is None
    assert parse_shard("2/8", {"SLURM_ARRAY_TASK_ID": "5", "SLURM_ARRAY_TASK_COUNT": "6"}) == Shard(2, 8)
    slurm = {"SLURM_ARRAY_TASK_ID": "5", "SLURM_ARRAY_TASK_COUNT": "6"}
    assert parse_shard(None, slurm) == Shard(6, 6)
    assert parse_shard(None, slurm | {"SLURM_ARRAY_TASK_MIN": "1"}) == Shard(5, 6)
    assert parse_shard(None, slurm | {"SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_STEP": "2"}) == Shard(3, 6)
    with pytest.raises(ConfigError, match="give --shard"):
        parse_shard(None, {"SLURM_ARRAY_TASK_ID": "50", "SLURM_ARRAY_TASK_COUNT": "6"})
    for text in ("0/4", "5/4", "3", "a/b", "-1/4", "1/0"):
        with pytest.raises(ConfigError, match="must be part/parts"):
            parse_shard(text, {})


def test_shards_are_balanced_by_pixels_and_disparities(tmp_path: Path):
    """A large flat image takes longer than a small one of noise, whatever their files take."""
    rng = np.random.default_rng(0)
    config = StereoConfig.model_validate({"pipeline": "opencv-bm"})
    scenes = []
    for number in range(24):
        large = number % 4 == 0
        image = np.zeros((80, 120), np.uint8) if large else rng.integers(0, 256, (20, 30)).astype(np.uint8)
        file = tmp_path / f"{number:02}.png"
        write_png(file, image)
        scenes.append(StereoScene(name=file.stem, folder=tmp_path, left=file, max_disparity=40 if large else 10))
    assert scenes[0].left.stat().st_size < scenes[1].left.stat().st_size

    def effort(scene: StereoScene) -> int | None:
        return STEREO.effort(config, scene)

    assert [effort(scene) for scene in scenes[:2]] == [80 * 120 * 41, 20 * 30 * 11]
    parts = [Shard(index, 3).of(scenes, effort) for index in (1, 2, 3)]
    assert sorted(scene.name for part in parts for scene in part) == [scene.name for scene in scenes]
    assert [sum(scene.max_disparity == 40 for scene in part) for part in parts] == [2, 2, 2]
    wide = config.model_copy(update={"max_disparity": 10})
    assert STEREO.effort(wide, scenes[0]) == 80 * 120 * 11
    # Of one file the header does not tell: all go by their files' sizes, alike in every process.
    scenes[5].left.write_bytes(b"no image")
    assert effort(scenes[5]) is None
    assert [Shard(k, 3).of(scenes, effort) for k in (1, 2, 3)] == [Shard(k, 3).of(scenes) for k in (1, 2, 3)]


def test_shards_are_apart_complete_and_balanced(tmp_path: Path):
    scenes = []
    for number in range(48):
        file = tmp_path / f"{number:02}.png"
        file.write_bytes(b"x" * (1000 if number % 4 == 0 else 10))  # a plain division gives one of four all large ones
        scenes.append(StereoScene(name=file.stem, folder=tmp_path, left=file))
    parts = [Shard(index, 4).of(scenes) for index in range(1, 5)]
    assert sorted(scene.name for part in parts for scene in part) == [scene.name for scene in scenes]
    loads = [sum(scene.left.stat().st_size for scene in part) for part in parts]
    assert max(loads) < 1.3 * min(loads)
    assert Shard(2, 4).of(scenes[::-1]) == parts[1]
    assert [len(Shard(index, 50).of(scenes)) for index in range(1, 51)].count(0) == 2


@pytest.mark.slow
def test_processes_side_by_side_make_what_one_makes(made_scenes: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "-v")
    running = [start(*common, "--shard", f"{index}/2") for index in (1, 2)]
    said = [process.communicate(timeout=60)[1] for process in running]
    assert [process.returncode for process in running] == [0, 0], said
    assert contents(out) == contents(whole)
    assert report(out) == report(whole)
    assert (out / "report.csv").read_text().splitlines()[1].startswith("curved_0,done")
    assert all("shard" in text for text in said)
    # Again, by one process: nothing is left to do.
    assert run("stereo", FAST, "-i", made_scenes, "-o", out, "-q") == 0
    assert contents(out) == contents(whole)


def test_what_a_process_left_that_was_killed_in_its_report_goes(made_scenes: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "-q", "--shard")
    assert run(*common, "1/2") == 0
    (out / ".parts/.1-of-2.json.1-2.partial~").write_bytes(b"")
    assert run(*common, "2/2") == 0
    assert contents(out) == contents(whole)
    assert not (out / ".parts").exists()


def test_a_part_of_a_finished_run_done_again_leaves_nothing(made_scenes: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "run"
    for part in ("1/2", "2/2", "1/2"):
        assert run("stereo", FAST, "-i", made_scenes, "-o", out, "--shard", part, "-q") == 0
    assert contents(out) == contents(whole)
    assert report(out) == report(whole)


@pytest.mark.slow
def test_the_same_part_twice_is_done_once(made_scenes: Path, whole: Path, tmp_path: Path):
    common = ("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run", "-v", "--shard", "1/1")
    running = [start(*common), start(*common, "--jobs", "2")]
    said = [process.communicate(timeout=60)[1] for process in running]
    assert [process.returncode for process in running] == [0, 0], said
    made = Counter(line.partition(":")[0] for text in said for line in text.splitlines() if line.endswith(" s"))
    assert all(count == 1 for scene, count in made.items() if "_" in scene), made
    assert contents(tmp_path / "run") == contents(whole)
    assert report(tmp_path / "run") == report(whole)


@pytest.mark.system
def test_a_killed_process_leaves_its_part_to_be_done_again(tmp_path: Path):
    size = ("--width", "240", "--height", "180", "--max-disparity", "32")
    assert run("sample", "-o", tmp_path / "in", "-n", "8", *size, "-q") == 0
    common = ("stereo", "accurate", "-i", tmp_path / "in", "--threads", "1")
    assert run(*common, "-o", tmp_path / "whole", "-q") == 0
    out = tmp_path / "run"
    victim, other = (start(*common, "-o", out, "--shard", f"{index}/2") for index in (1, 2))
    mine = {f"{out}/{line}/record.json" for line in _names(tmp_path / "in", "1/2")}
    end = time.monotonic() + 60
    while not any(os.path.exists(path) for path in mine) and time.monotonic() < end:
        time.sleep(0.002)
    victim.send_signal(signal.SIGKILL)
    victim.communicate()
    assert other.communicate(timeout=60) is not None
    assert other.returncode == 0
    left = set(report(tmp_path / "whole")) - set(report(out))
    # The report is that of what is there, the killed process's scenes too as soon as somebody lists them.
    code = run("merge", out, "-q")
    there = {path.parent.name for path in out.glob("*/record.json")}
    assert set(report(out)) == there
    assert 5 <= len(there) <= 8
    assert code == (0 if len(there) == 8 else 3)
    assert left >= set(report(tmp_path / "whole")) - there
    assert run(*common, "-o", out, "--shard", "1/2", "-q") == 0
    assert contents(out) == contents(tmp_path / "whole")
    assert report(out) == report(tmp_path / "whole")


def _names(folder: Path, shard: str) -> list[str]:
    command = ("stereo", "accurate", "-i", folder, "-o", folder / "x", "--list-scenes", "--shard", shard)
    process = start(*command)
    return process.communicate(timeout=60)[0].split()


def test_who_may_come_in(made_scenes: Path, tmp_path: Path, capsys, monkeypatch):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "--scenes", "planes_0", "-q")
    monkeypatch.setattr("depthcli.run.sharing._SETUP_TIMEOUT", 0.1)
    assert run(*common, "--shard", "1/1") == 0
    with FolderLock(out, True, print) as lock:
        assert lock.alone
        assert run(*common, "--shard", "1/1") == 2  # still being set up
        assert "another depthcli is writing there now" in capsys.readouterr().err
        lock.settle()
        assert run(*common) == 2
        assert "another depthcli is writing there now" in capsys.readouterr().err
        assert run(*common, "--shard", "1/1", "--set", "block=7", "--overwrite") == 2
        assert "writes a run of another config there" in capsys.readouterr().err
        assert run(*common, "--shard", "1/1") == 0
        assert run("merge", out, "-q") == 0
        assert (out / LOCKS_FILE).exists()
        assert lock.last()
        assert not (out / LOCKS_FILE).exists()
    with FolderLock(out, False, print):
        assert run(*common, "--shard", "1/1") == 2
    assert run(*common, "--shard", "1/1", "--set", "block=7") == 2
    assert run(*common, "--shard", "1/1", "--set", "block=7", "--overwrite") == 0
    assert run(*common) == 2
    assert run(*common, "--overwrite") == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "legend.png", "planes_0", "report.csv", "report.json", "run.yaml",
    ]  # fmt: skip


def test_a_scene_is_claimed_by_one(tmp_path: Path):
    """Two processes, since these locks are a process's."""
    code = f"""
from pathlib import Path
from depthcli.run.folder import FolderLock
with FolderLock(Path({str(tmp_path / "run")!r}), True, print) as lock:
    lock.settle()
    print(*(lock.claim(name) for name in ("a", "b", "c")), flush=True)
    input()
    lock.release("a")
    print("released", flush=True)
    input()
"""
    with FolderLock(tmp_path / "run", True, print) as lock:
        lock.settle()
        assert lock.claim("b")
        other = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert other.stdin is not None and other.stdout is not None
        assert other.stdout.readline().split() == ["True", "False", "True"]
        assert not lock.claim("a")
        assert not lock.last()
        other.stdin.write("\n")
        other.stdin.flush()
        other.stdout.readline()
        assert lock.claim("a")
        assert not lock.claim("c")
        other.kill()
        other.communicate()
        assert lock.claim("c")
        assert lock.last()


def test_parts_are_read_before_they_are_joined(tmp_path: Path, whole: Path):
    run_id, command = run_folder.opened_run(whole)
    assert command == "stereo"
    rows = list(read_report(whole).values())
    folder = tmp_path / "run"
    for name in ("run.yaml", *(row["scene"] + "/record.json" for row in rows)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes((whole / name).read_bytes())
    write_rows(folder / ".parts/1-of-2.json", rows[:5], {"command": "stereo", "run": run_id}, {})
    write_rows(folder / ".parts/2-of-2.json", rows[5:9], {"command": "stereo", "run": run_id}, {})
    write_rows(folder / ".parts/1-of-9.json", [{**rows[0], "status": "failed"}], {"run": "of another config"}, {})
    assert read_report(folder) == {row["scene"]: row for row in rows[:9]}
    failed = {"scene": "zebra", "status": "failed", "error": "no stripes", "seconds": {}, "peak_memory": None}
    write_rows(folder / ".parts/3-of-3.json", [failed], {"command": "stereo", "run": run_id}, {})
    names = [row["scene"] for row in rows]
    joined = joined_rows(folder, run_id, names)
    assert [row["scene"] for row in joined] == [*names, "zebra"]
    assert joined[0]["seconds"] == rows[0]["seconds"]
    assert joined[10]["seconds"] == {}
    assert joined_rows(folder, "another run") == [failed | {"source": ""}]


def test_what_would_be_done(made_scenes: Path, tmp_path: Path, capsys):
    out = tmp_path / "run"
    common = ("stereo", "accurate", "-i", made_scenes, "-o", out)
    assert run(*common, "--list-scenes", "--scenes", "planes_*") == 0
    assert capsys.readouterr().out == "planes_0\nplanes_1\nplanes_2\n"
    parts = []
    for index in (1, 2):
        assert run(*common, "--list-scenes", "--shard", f"{index}/2", "--json") == 0
        parts += json.loads(capsys.readouterr().out)["scenes"]
    assert len(parts) == len(set(parts)) == 12
    assert not out.exists()
    assert run(*common, "--scenes", "planes_0", "-q") == 0
    assert run(*common, "--dry-run", "--json", "--shard", "1/1") == 0
    rows = {row["scene"]: row["status"] for row in json.loads(capsys.readouterr().out)["scenes"]}
    assert (rows["planes_0"], rows["planes_1"], len(rows)) == ("done, kept", "to do", 12)
    assert run(*common, "--dry-run", "--json", "--keep", "*.pfm", "--scenes", "planes_0") == 0
    assert json.loads(capsys.readouterr().out)["scenes"][0]["status"] == "to do"


@pytest.mark.slow
def test_stopping_at_the_first_failure(made_scenes: Path, tmp_path: Path, capsys):
    scenes = tmp_path / "in"
    for scene in ("planes_0", "planes_1", "planes_2"):
        for path in (made_scenes / scene).iterdir():
            (scenes / scene).mkdir(parents=True, exist_ok=True)
            (scenes / scene / path.name).write_bytes(path.read_bytes())
    (scenes / "planes_1" / "left.png").write_bytes(b"damaged")
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        assert run("stereo", FAST, "-i", scenes, "-o", out, "--fail-fast", "--jobs", jobs) == 3
        captured = capsys.readouterr().err
        assert "stopped at the first failure, " in captured
        assert f"{sum(status == 'done' for status in report(out).values())} of 3 scenes done, in {out}" in captured
        assert report(out)["planes_1"] == "failed"
        if jobs == "1":
            assert report(out) == {"planes_0": "done", "planes_1": "failed"}
        assert not list(out.glob(".*"))
    (scenes / "planes_1" / "left.png").write_bytes((made_scenes / "planes_1" / "left.png").read_bytes())
    assert run("stereo", FAST, "-i", scenes, "-o", tmp_path / "1", "--fail-fast", "-q") == 0
    assert set(report(tmp_path / "1").values()) == {"done"}


def test_leaving_files_out(made_scenes: Path, whole: Path, tmp_path: Path):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out, "--scenes", "planes_0", "-q")
    assert run(*common, "--keep", "disp_left.pfm, record.json") == 0
    assert sorted(path.name for path in (out / "planes_0").iterdir()) == ["disp_left.pfm", "record.json"]
    stamp = (out / "planes_0/disp_left.pfm").stat().st_mtime_ns
    assert run(*common, "--keep", "disp_left.pfm, record.json") == 0
    assert (out / "planes_0/disp_left.pfm").stat().st_mtime_ns == stamp
    assert run(*common, "--keep", "*.png") == 0
    assert sorted(path.name for path in (out / "planes_0").iterdir()) == [
        "disp_left.png", "preview.png", "record.json", "status.png",
    ]  # fmt: skip
    assert run(*common) == 0
    assert contents(out / "planes_0") == contents(whole / "planes_0")


def test_shards_and_evaluation_exclude_each_other(made_scenes: Path, tmp_path: Path, capsys):
    common = ("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run")
    assert run(*common, "--shard", "1/2", "--evaluate") == 2
    assert run(*common, "--shard", "3/2") == 2
    assert "must be part/parts" in capsys.readouterr().err
    assert run("merge", tmp_path / "absent") == 2
    assert run("merge", made_scenes.parent) == 2


def test_merge_says_what_is_missing(made_scenes: Path, whole: Path, tmp_path: Path, capsys):
    out = tmp_path / "run"
    common = ("stereo", FAST, "-i", made_scenes, "-o", out)
    assert run(*common, "--shard", "1/3", "-q") == 0
    assert run(*common, "--shard", "3/3", "-q") == 0
    capsys.readouterr()
    there, names = set(report(out)), sorted(report(whole))
    missing = [name for name in names if name not in there]
    assert 3 <= len(missing) <= 5
    for _ in range(2):
        assert run("merge", out) == 3
        said, err = capsys.readouterr()
        lines = [line.split() for line in said.splitlines()]
        assert lines[0] == ["scene", "status", "size", "density", "measured", "seconds", "memory"]
        assert [line[0] for line in lines[1:]] == names
        assert [line[0] for line in lines if line[1] == "missing"] == missing
        assert err.splitlines()[0] == (
            f"shard 2 of 3 has not ended; {len(missing)} scenes are missing: {', '.join(missing)}; "
            "start that shard again with the same command"
        )
        assert f"{len(there)} of 12 scenes done, in {out}" in err
    assert run("merge", out, "--json", "-q") == 3
    document = json.loads(capsys.readouterr().out)
    assert (document["missing"], document["unfinished_shards"]) == (missing, ["2 of 3"])
    assert run(*common, "--shard", "2/3", "-q") == 0
    assert contents(out) == contents(whole)  # nothing hidden is left
    capsys.readouterr()
    assert run("merge", out) == 0
    merged = capsys.readouterr().out
    assert run("stereo", FAST, "-i", made_scenes, "-o", whole) == 0
    alone = capsys.readouterr().out
    timeless = [[line.split()[:6] for line in text.splitlines()] for text in (merged, alone)]
    assert timeless[0] == timeless[1]
    first, second = (json.loads((folder / "report.json").read_text()) for folder in (out, whole))
    assert [list(row) for row in first["scenes"]] == [list(row) for row in second["scenes"]]


def test_a_shard_that_stopped_at_a_failure_has_not_ended(made_scenes: Path, tmp_path: Path, capsys):
    scenes, out = tmp_path / "in", tmp_path / "run"
    for name in ("planes_0", "planes_1", "planes_2"):
        shutil.copytree(made_scenes / name, scenes / name)
    (scenes / "planes_0" / "left.png").write_bytes(b"damaged")
    common = ("stereo", FAST, "-i", scenes, "-o", out)
    assert run(*common, "--shard", "1/1", "--fail-fast") == 3
    assert "stopped at the first failure, 0 of 3 scenes done, 1 failed, 2 not computed" in capsys.readouterr().err
    assert run("merge", out, "-q") == 3
    assert capsys.readouterr().err.startswith("shard 1 of 1 has not ended; 2 scenes are missing: planes_1, planes_2; ")
    assert run(*common, "--shard", "1/1", "-q") == 3  # one failed; nothing is missing
    assert not (out / ".parts").exists()
    capsys.readouterr()
    assert run("merge", out, "-q") == 3
    assert "missing" not in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash, which runs the job script")
def test_the_job_array_of_slurm(made_scenes: Path, whole: Path, tmp_path: Path):
    """The script that sbatch takes, its tasks one after the other as a job array would start them."""
    script = Path(__file__).parents[2] / "scripts/cluster/shards.sbatch"
    out = tmp_path / "run"
    slurm = {"SLURM_ARRAY_TASK_COUNT": "3", "SLURM_ARRAY_TASK_MIN": "1", "SLURM_CPUS_PER_TASK": "1"}
    more = {"DEPTHCLI": f"{sys.executable} -m depthcli"}
    done = []
    for task in ("1", "2", "3"):
        environment = os.environ | slurm | more | {"SLURM_ARRAY_TASK_ID": task}
        command = ["bash", str(script), FAST, str(made_scenes), str(out)]
        process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (process.returncode, process.stderr) == (0, "")
        done.append(len(report(out)))
    assert 0 < done[0] < done[1] < done[2] == len(report(whole))
    assert contents(out) == contents(whole)
    plain = {name: value for name, value in os.environ.items() if not name.startswith("SLURM_")}
    for words, missing in (([], "usage"), ([FAST, str(made_scenes), str(out)], "job array")):
        process = subprocess.run(["bash", str(script), *words], env=plain, capture_output=True, text=True, check=False)
        assert process.returncode != 0
        assert missing in process.stderr


def other_inputs(made_scenes: Path, folder: Path) -> Path:
    """The same names, and files of the same sizes."""
    shutil.copytree(made_scenes, folder)
    for path in folder.glob("*/*.png"):
        data = path.read_bytes()
        path.write_bytes(data[:-8] + bytes(8))
    return folder


def test_shards_of_other_inputs_are_refused(made_scenes: Path, whole: Path, tmp_path: Path, capsys):
    out, moved = tmp_path / "run", tmp_path / "moved"
    shutil.copytree(made_scenes, moved)
    scenes = ("--scenes", "planes_*", "-q")
    common = ("stereo", FAST, "-o", out)
    assert run(*common, "-i", made_scenes, *scenes, "--shard", "1/2") == 0
    before = contents(out)
    other = other_inputs(made_scenes, tmp_path / "in")
    for wrong in (("-i", other, *scenes), ("-i", made_scenes, "-q")):
        assert run(*common, *wrong, "--shard", "2/2") == 2
        assert "shard 1-of-2 of this run computed other inputs than these" in capsys.readouterr().err
        assert contents(out) == before
    assert run(*common, "-i", moved, *scenes, "--shard", "2/2") == 0  # wherever another machine has them
    assert not (out / ".parts").exists()
    assert run(*common, "-i", made_scenes, *scenes, "--shard", "1/2") == 0
    assert run(*common, "-i", other, *scenes, "--shard", "2/2", "--overwrite") == 3
    assert run("merge", out, "-q") == 3


def test_merge_refuses_shards_that_began_together_with_other_inputs(whole: Path, tmp_path: Path, capsys):
    out = tmp_path / "run"
    shutil.copytree(whole, out)
    run_id, command = run_folder.opened_run(out)
    for index in (1, 2):
        head = {"command": command, "run": run_id, "inputs": f"{index:064}"}
        write_rows(out / f".parts/{index}-of-2.json", [], head, {})
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert run("merge", out, "-q") == 2
    assert "its shards 1-of-2 and 2-of-2 computed different inputs" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_shards_on_a_file_system_without_locks(made_scenes: Path, whole: Path, tmp_path: Path, monkeypatch, capsys):
    def refused(*arguments: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", refused)
    monkeypatch.setattr("fcntl.lockf", refused)
    for index in (1, 2):
        assert run("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run", "--shard", f"{index}/2") == 0
        assert capsys.readouterr().err.count("no locks on this file system") == 1
    assert run("merge", tmp_path / "run", "-q") == 0
    there = contents(tmp_path / "run")
    assert {name: data for name, data in there.items() if not name.startswith(".")} == contents(whole)
    assert report(tmp_path / "run") == report(whole)
    again = ("stereo", FAST, "-i", made_scenes, "-o", tmp_path / "run", "--set", "block=7", "--shard", "1/2")
    assert run(*again) == 2
    assert "made with another config" in capsys.readouterr().err
