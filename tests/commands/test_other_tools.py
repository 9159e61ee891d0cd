"""Results for other programs: ``scores.parquet``, and one JSON line a run."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.commands.evaluate import evaluate
from depthcli.core.config_file import load_config
from depthcli.core.errors import ConfigError, InputError, OutputError
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.methods.stereo.config import StereoConfig
from depthcli.run.json_lines import add_lines, check_lines
from depthcli.run.presets import find_preset
from depthcli.run.records import digest
from depthcli.run.run_folder import run_text

SHAPE = (24, 32)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """Two scenes with truth, one of them with a mask."""
    folder, image = tmp_path / "set", np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    for name in ("a", "b"):
        write_png(folder / name / "left.png", image)
        write_png(folder / name / "right.png", image)
        write_pfm(folder / name / "disp_left.pfm", np.full(SHAPE, 5, np.float32))
    write_png(folder / "a" / "mask_nonocc.png", np.ones(SHAPE, bool))
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run of preset ``fast`` with one key changed; half of the pixels of one map are wrong."""
    folder = tmp_path / "runs" / "mine"
    values = np.full(SHAPE, 5, np.float32)
    write_pfm(folder / "a" / "disp_left.pfm", values)
    values[:12] += 3
    write_pfm(folder / "b" / "disp_left.pfm", values)
    file = find_preset("stereo", "fast")
    assert file is not None
    config = load_config(StereoConfig, file, ["optimization.p2=90"])
    (folder / "run.yaml").write_text(run_text("stereo", config))
    return folder


def lines(file: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in file.read_text().splitlines()]


def test_parquet_has_the_rows_of_the_csv_with_types(tmp_path: Path, truth: Path, run: Path):
    parquet = pytest.importorskip("pyarrow.parquet")
    write_pfm(tmp_path / "half" / "a" / "disp_left.pfm", np.full(SHAPE, 5, np.float32))  # no map of b
    for output in ("one", "two"):
        evaluate([run, tmp_path / "half"], truth, tmp_path / output, parquet=True)
    table = parquet.read_table(tmp_path / "one" / "scores.parquet")
    with (tmp_path / "one" / "scores.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [{k: "" if v is None else str(v) for k, v in row.items()} for row in table.to_pylist()] == rows
    types = {field.name: str(field.type) for field in table.schema}
    assert {types[name] for name in ("threshold", "value", "density")} == {"double"}
    assert (types["pixels"], types["wrong"], types["run"]) == ("int64", "int64", "string")
    assert any(row["metric"] == "failed" and row["value"] is None for row in table.to_pylist())
    facts = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    identity = digest((run / "run.yaml").read_bytes())
    assert json.loads(facts["depthcli.config_digests"]) == {"mine": identity, "half": ""}
    assert facts["depthcli.version"]
    assert (tmp_path / "one" / "scores.parquet").read_bytes() == (tmp_path / "two" / "scores.parquet").read_bytes()


def test_parquet_of_an_earlier_evaluation_is_replaced_with_it(tmp_path: Path, truth: Path, run: Path):
    pytest.importorskip("pyarrow")
    command = ["evaluate", str(run), "--truth", str(truth), "--output", str(tmp_path / "out"), "-q"]
    assert main([*command, "--parquet"]) == 0
    assert (tmp_path / "out" / "scores.parquet").exists()
    assert main(command) == 0
    assert not (tmp_path / "out" / "scores.parquet").exists()


def test_parquet_without_the_package_or_a_folder_is_refused(
    tmp_path: Path, truth: Path, run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    command = ["evaluate", str(run), "--truth", str(truth), "--parquet"]
    assert main(command) == 2
    assert "--parquet wants --output" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main([*command, "--output", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.strip() == "depthcli: --parquet wants pyarrow: pip install 'depthcli[parquet]'"
    assert not (tmp_path / "out").exists()


def test_a_run_is_logged_in_one_line_and_not_twice(tmp_path: Path, truth: Path, run: Path):
    log = tmp_path / "logs" / "runs.jsonl"
    command = ["evaluate", str(run), f"other={run}", "--truth", str(truth), "--log", str(log), "-q"]
    assert main(command) == 0
    first = log.read_bytes()
    assert main(command) == 0
    assert log.read_bytes() == first
    line, other = lines(log)
    assert (line["run"], other["run"]) == ("mine", "other")
    assert (line["command"], line["preset"], line["changes"]) == ("stereo", "fast", {"optimization.p2": 90.0})
    assert line["config_digest"] == digest((run / "run.yaml").read_bytes())
    assert line["config"]["optimization"]["p2"] == 90  # type: ignore[index]
    assert line["data_sets"] == {"set": {"protocol": "middlebury-v2", "scenes": 2, "missing": 0}}
    metrics = line["metrics"]
    assert isinstance(metrics, dict)
    assert metrics["set/all/bad 1"] == 25
    assert metrics["set/nonocc/bad 1"] == 0
    assert metrics["set/overall/bad 1"] == 25  # over regions that all scenes have
    assert {type(value) for value in metrics.values()} == {float}
    assert {"depthcli", "numpy"} <= line["versions"].keys()  # type: ignore[attr-defined]

    values = np.full(SHAPE, 5, np.float32)
    write_pfm(run / "b" / "disp_left.pfm", values)
    assert main(["evaluate", str(run), "--truth", str(truth), "--log", str(log), "-q"]) == 0
    assert log.read_bytes().startswith(first)
    assert lines(log)[2]["metrics"]["set/all/bad 1"] == 0  # type: ignore[index]


def test_maps_of_other_programs_are_logged_without_a_config(tmp_path: Path, truth: Path):
    write_pfm(tmp_path / "net" / "a.pfm", np.full(SHAPE, 5, np.float32))
    (tmp_path / "net" / "run.yaml").write_text("run: [1, 2\n")  # damaged, or of another program
    assert main(["evaluate", str(tmp_path / "net"), "--truth", str(truth), "--log", str(tmp_path / "l"), "-q"]) == 3
    (line,) = lines(tmp_path / "l")
    assert (line["preset"], line["config"], line["versions"]) == (None, None, {})
    assert line["data_sets"]["set"]["missing"] == 1  # type: ignore[index]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        *((content, "holds something else than JSON lines") for content in ("run,value\n", "[1]\n", "\x00\x01")),
        ('{"cut": ', "its first line is cut off or damaged"),
    ],
)
def test_a_log_that_holds_something_else_is_refused_and_kept(
    content: str, message: str, tmp_path: Path, truth: Path, run: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "log").write_text(content)
    command = ["evaluate", str(run), "--truth", str(truth), "--output", str(tmp_path / "out")]
    assert main([*command, "--log", str(tmp_path / "log")]) == 2
    assert message in capsys.readouterr().err
    assert (tmp_path / "log").read_text() == content
    assert not (tmp_path / "out").exists()


def test_places_that_cannot_be_a_log(tmp_path: Path):
    with pytest.raises(ConfigError, match="a folder; want the name of a file"):
        check_lines(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="want a regular file"):
        check_lines(tmp_path / "pipe")
    (tmp_path / "file").write_text("{}\n")
    with pytest.raises(OutputError, match="cannot be written"):
        add_lines(tmp_path / "file" / "log", ["{}"], print)


def test_a_log_that_cannot_be_written_keeps_the_scores(
    tmp_path: Path, truth: Path, run: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").write_text("")
    command = ["evaluate", str(run), "--truth", str(truth), "--output", str(tmp_path / "out")]
    assert main([*command, "--log", str(tmp_path / "file" / "log")]) == 2
    printed = capsys.readouterr()
    assert "Middlebury v2" in printed.out
    assert printed.err.splitlines()[-1].startswith(f"depthcli: {tmp_path / 'file' / 'log'}: cannot be written (")
    assert (tmp_path / "out" / "scores.csv").exists()


def test_lines_of_several_processes_and_of_killed_ones(tmp_path: Path):
    file, link = tmp_path / "log", tmp_path / "link"
    file.write_text('{"old": 1}')  # the last line of another program may lack its end
    file.chmod(0o640)
    link.symlink_to(file)
    (tmp_path / ".log.1-2.partial~").write_text("{")  # of a killed process
    texts = [json.dumps({"line": number % 20}) for number in range(40)]
    with ThreadPoolExecutor(8) as threads:
        added = sum(threads.map(lambda text: add_lines(link, [text], pytest.fail), texts))
    assert added == 20
    found = file.read_text().splitlines()
    assert found[0] == '{"old": 1}'
    assert sorted(found[1:]) == sorted(texts[:20])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "log"]
    assert link.is_symlink()
    assert file.stat().st_mode & 0o777 == 0o640


_KILLED_AT_EACH_STEP = """
import os, signal, sys
from pathlib import Path
from depthcli.run.json_lines import add_lines

file, old = Path(sys.argv[1]), '{"old": 1}\\n'
for step in range(1, 200):
    file.write_text(old)
    child = os.fork()
    if child == 0:
        left = [step]
        def count(event, arguments):
            left[0] -= event.partition(".")[0] in ("open", "os", "fcntl", "shutil")
            if left[0] == 0:
                os.kill(os.getpid(), signal.SIGKILL)
        sys.addaudithook(count)
        add_lines(file, ['{"new": 2}'], print)
        os._exit(0)
    killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    text = file.read_text()
    assert text in (old, old + '{"new": 2}\\n') and (killed or text != old), (step, text)
    add_lines(file, ['{"new": 2}'], print)  # the same command again
    assert file.read_text() == old + '{"new": 2}\\n', step
    assert os.listdir(file.parent) == [file.name], step
    if not killed:
        print(step)
        break
"""


def test_a_process_killed_at_any_step_leaves_whole_lines(tmp_path: Path):
    (tmp_path / "log").touch()
    command = [sys.executable, "-c", _KILLED_AT_EACH_STEP, str(tmp_path / "log")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 5  # steps at which it was killed: opening, locking, writing, renaming
