"""``depthcli help``: topics made from the code, and an explanation for every column of every table."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from pathlib import Path

import pytest

from depthcli.cli import main
from depthcli.commands import command_names, load_command
from depthcli.commands._old_batch import BatchCommand
from depthcli.commands.evaluate import evaluate
from depthcli.commands.help import TOPICS
from depthcli.core.columns import ColumnHelp, find_column
from depthcli.evaluation import columns as evaluation_columns
from depthcli.evaluation.protocols import names
from depthcli.evaluation.tables import report_tables
from depthcli.evaluation.wide_tables import wide_tables
from depthcli.io.layouts import layouts
from depthcli.run import columns as report_columns

REPORTS = {
    "stereo": report_columns.MAPS,
    "fuse": report_columns.MAPS,
    "rectify": report_columns.MAPS,
    "refine-kinect": report_columns.DEPTH,
    "transparent": report_columns.DEPTH,
    "depth": (*report_columns.DEPTH, *report_columns.MAPS),
    "confidence": report_columns.GIVEN_MAPS,
    "fuse-maps": report_columns.GIVEN_MAPS,
    "register-confidence": report_columns.REGISTRATION,
    "sample": (*report_columns.SAMPLES, *report_columns.DEPTH, *report_columns.REGISTRATION),
}
TABLES = (*evaluation_columns.TABLES, *evaluation_columns.METRICS, *evaluation_columns.REGIONS)


def unexplained(columns: Iterable[ColumnHelp], headings: Iterable[str]) -> list[str]:
    columns = tuple(columns)
    return [heading for heading in dict.fromkeys(headings) if heading and find_column(columns, heading) is None]


def header(path: Path) -> list[str]:
    with path.open(newline="") as file:
        return next(csv.reader(file))


def headings(runs: list[Path], truth: Path, protocol: str | None, output: Path | None = None) -> list[str]:
    """Headings of all tables of an evaluation, beside those that are names of scenes or runs."""
    report = evaluate(runs, truth, output, protocol=protocol)
    assert not report.failed
    tables = [*report_tables(report), *wide_tables(report)]
    own = {result.scene.rpartition("/")[2] for result in report.results}
    by_run = {f"{run}: {region}" for run in report.runs for s in report.sections for region in s.regions}
    return [text for table in tables for text in table.header if text not in own | by_run]


@pytest.fixture(scope="module")
def stereo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stereo")
    assert main(["sample", "-o", str(folder / "set"), "-n", "3", "--width", "96", "--height", "64", "-q"]) == 0
    for name, command, config in (("a", "stereo", "fast"), ("b", "stereo", "segments"), ("c", "fuse", "accurate")):
        line = [command, config, "-i", str(folder / "set"), "-o", str(folder / name), "-q"]
        line += ["--set", "confidence=[lrc]"] if name == "a" else []
        assert main(line) == 0
    return folder


@pytest.mark.parametrize("protocol", [name for name in names() if name not in ("depth", "registration")])
def test_columns_of_stereo_evaluations(stereo: Path, tmp_path: Path, protocol: str):
    found = headings([stereo / name for name in "abc"], stereo / "set", protocol, tmp_path / "out")
    assert len(found) > 20
    assert unexplained(TABLES, found) == []
    assert unexplained(evaluation_columns.SCORES, header(tmp_path / "out" / "scores.csv")) == []
    assert unexplained(TABLES, ["nonocc (2 of 3)", "nonsense", "bad", "A5"]) == ["nonsense", "bad", "A5"]


@pytest.mark.parametrize(
    ("command", "kind", "config"),
    [
        ("refine-kinect", "--kinect", "accurate"),
        ("transparent", "--transparent", "crf"),
        ("register-confidence", "--registration", "axes"),
    ],
)
def test_columns_of_other_commands(tmp_path: Path, command: str, kind: str, config: str):
    if command == "register-confidence":
        pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
    size = ["-n", "1"] if command == "register-confidence" else ["--width", "160", "--height", "120"]
    frames = ["--frames", "0"] if command == "refine-kinect" else []
    assert main(["sample", kind, *size, *frames, "-o", str(tmp_path / "set"), "-q"]) == 0
    assert main([command, config, "-i", str(tmp_path / "set"), "-o", str(tmp_path / "run"), "-q"]) == 0
    assert unexplained(TABLES, headings([tmp_path / "run"], tmp_path / "set", None)) == []
    for place, name in (("run", command), ("set", "sample")):
        columns = (*report_columns.REPORT, *REPORTS[name])
        assert unexplained(columns, header(tmp_path / place / "report.csv")) == []
    for points in (tmp_path / "run").glob("*/points.csv"):
        assert unexplained(evaluation_columns.POINTS, header(points)) == []


def test_columns_of_runs_and_sweeps(stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for place, command in (("a", "stereo"), ("b", "stereo"), ("c", "fuse"), ("set", "sample")):
        columns = (*report_columns.REPORT, *REPORTS[command])
        assert unexplained(columns, header(stereo / place / "report.csv")) == []
    for table in (stereo / "b").glob("*/*.csv"):
        assert unexplained(report_columns.SEGMENTS, header(table)) == []
    line = ["sweep", "fast", "--over", "optimization.p1=4,8", "-i", str(stereo / "set")]
    assert main([*line, "-o", str(tmp_path / "sweep"), "-q"]) == 0
    found = header(tmp_path / "sweep" / "sweep.csv")
    assert unexplained((*evaluation_columns.SWEEP, *TABLES), found) == []


def test_printed_columns_of_every_command():
    for name in command_names():
        command = load_command(name)
        if isinstance(command, BatchCommand):
            columns = (*report_columns.REPORT, *REPORTS[name])
            titles = ["scene", "status", *(column.title for column in command.columns()), "seconds", "memory"]
            assert unexplained(columns, titles) == [], name


def test_every_explanation_is_one_line():
    groups = [*vars(report_columns).values(), *vars(evaluation_columns).values()]
    columns = [each for group in groups if isinstance(group, tuple) for each in group]
    assert len(columns) > 100
    for column in columns:
        assert column.about, column.name
        assert len(column.about) <= 115, column.name
        assert not column.about.endswith("."), column.name


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_topics(topic: str, capsys: pytest.CaptureFixture[str]):
    assert main(["help", topic]) == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 100
    assert main(["help", topic, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert all(row["name"].split()[0] in text for row in rows)
    expected = {"layouts": [each.name for each in layouts()], "protocols": names(), "exit-codes": ["0", "3", "143"]}
    assert set(expected.get(topic, [])) <= {row["name"] for row in rows}


def test_help_lists_topics_and_shows_commands(capsys: pytest.CaptureFixture[str]):
    assert main(["help"]) == 0
    text = capsys.readouterr().out
    assert all(topic in text for topic in TOPICS)
    for words in (["help", "stereo"], ["stereo", "--help"]):
        assert main(words) == 0
    first, second = capsys.readouterr().out.split("Usage: ")[1:]
    assert first == second
    assert main(["help", "nope"]) == 2
    assert "no topic or command 'nope'; topics are columns" in capsys.readouterr().err
