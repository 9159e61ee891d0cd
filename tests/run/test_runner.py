"""A run of a small command: resumed, interrupted, damaged, in processes; no scene harms another."""

import contextlib
import errno
import functools
import itertools
import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numba
import pytest
from pydantic import BaseModel

from depthcli.core.context import Clock, Context
from depthcli.core.errors import ConfigError, IncompleteError, InputError, OutputError
from depthcli.io.formats.files import RECORD_FILE, atomic_path
from depthcli.io.scenes import Scene
from depthcli.run import console, job, records, workers
from depthcli.run.console import Reporter
from depthcli.run.job import Execution, Job, Outcome
from depthcli.run.records import discard, hidden_folder, read_report
from depthcli.run.runner import run_scenes
from depthcli.run.scene import Task, Work, _keep_only, compute_scene
from depthcli.show.table import Column, run_table
from tests.command_line import contents, ended
from tests.files import laid
from tests.golden import refused, told


class Config(BaseModel):
    factor: int = 2


@dataclass(frozen=True, kw_only=True)
class Text(Scene):
    file: Path

    @property
    def input_files(self) -> dict[str, Path]:
        return {"text": self.file}

    def load(self) -> str:
        return self.file.read_text()


WRONG: dict[str, Callable[[], BaseException]] = {
    "damaged": lambda: InputError("cannot be read"),
    "bug": lambda: KeyError("no such thing"),
    "quota": lambda: OSError(errno.EDQUOT, os.strerror(errno.EDQUOT), "/tmp/scratch/file"),
    "huge": MemoryError,
    "stop": KeyboardInterrupt,
}


@dataclass(frozen=True)
class Repeat(Job[Text]):
    """Writes the scene's text ``factor`` times; words in the text make it go wrong."""

    command = "repeat"

    config: Config
    log: Path | None = None

    def compute(self, scene: Text, folder: Path, context: Context) -> Outcome:
        text = scene.load()
        if self.log is not None:
            with self.log.open("a") as log:
                log.write(scene.name + "\n")
        (folder / "first.txt").write_text(text)
        if text in WRONG:
            raise WRONG[text]()
        if text == "replaces":  # the files of this scene and of the next one, as somebody else might
            for name in "ab":
                Path(f"{scene.file}.new").write_text("new")
                os.replace(f"{scene.file}.new", scene.file.with_name(name))
        if text.startswith("disk full"):
            with atomic_path(folder / "out.txt") as path:
                path.write_text("half of it")
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        if text == "compiles":
            numba.njit(lambda number: number + 1)(1)
        if text == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if text.startswith("killed once "):
            mark = Path(text.removeprefix("killed once "))
            if not mark.exists():
                mark.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            text = "spared"
        (folder / "out.txt").write_text(text * self.config.factor)
        return Outcome({"length": len(text)}, {"work": 0.5}, ["short"] if len(text) == 1 else [])


class Folder:
    def __init__(self, root: Path) -> None:
        self.root, self.output, self.log = root, root / "run", root / "log"
        self.reporter = Reporter(-1)
        (root / "in").mkdir()
        self.texts = {name: name * 3 for name in "abcd"}

    def run(self, factor: int = 2, only: str | Text = "abcd", **options: Any) -> dict[str, dict[str, Any]]:
        """Run the scenes of these names, or one as it is given; return their rows by name."""
        scenes = [only] if isinstance(only, Text) else []
        for name in "" if isinstance(only, Text) else only:
            file = self.root / "in" / name
            file.write_text(self.texts[name])
            scenes.append(Text(name=name, folder=file.parent, file=file))
        self.log.write_text("")
        batch = Repeat(Config(factor=factor), self.log)
        rows, _ = run_scenes(batch, scenes, self.output, Execution(**options), self.reporter)
        return {row["scene"]: row for row in rows}

    def computed(self) -> str:
        return "".join(sorted(self.log.read_text().split()))

    def result(self, name: str) -> str:
        return (self.output / name / "out.txt").read_text()

    def bytes(self) -> dict[str, bytes]:
        """Return all files but reports; of records what they say of inputs and files, without measured times."""
        found = contents(self.output)
        for path in self.output.rglob(RECORD_FILE):
            record = json.loads(path.read_text())
            said = [record[key] for key in ("scene", "run", "inputs", "files")]
            found[path.relative_to(self.output).as_posix()] = repr(said).encode()
        return found

    def reports(self) -> list[Path]:
        return [self.output / "report.json", self.output / "report.csv"]

    def report(self) -> dict[str, Any]:
        return json.loads((self.output / "report.json").read_text())


def task_in(root: Path, place: str) -> Task:
    """The scene ``item``, made in a place of ``root`` for the run there."""
    scene = Text(name="item", folder=root, file=root / "item.txt")
    return Task(scene, root / "run", root / place / "0", "run", {}, "", {})


def statuses(rows: dict[str, dict[str, Any]]) -> str:
    return " ".join(rows[name]["status"] for name in sorted(rows))


ALL_DONE = "done done done done"


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_only_what_changed_or_was_damaged_is_done_again(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    first = folder.run()
    before = folder.bytes()
    assert folder.computed() == "abcd"
    assert set(before) == {"run.yaml", *(f"{s}/{f}" for s in "abcd" for f in ("first.txt", "out.txt", "record.json"))}
    assert folder.run() == first and folder.computed() == "" and folder.bytes() == before
    for damaged, content in (("out.txt", b"{"), ("out.txt", b"xxxxxx"), ("record.json", b"{")):
        (folder.output / "c" / damaged).write_bytes(content)
        folder.run()
        assert folder.computed() == "c" and folder.bytes() == before
    folder.texts["b"] = "new"
    assert folder.run()["b"]["length"] == 3
    assert folder.computed() == "b" and folder.result("b") == "newnew"
    monkeypatch.setattr(Repeat, "settings", lambda self, scene: {"range": "64"} if scene.name == "c" else {})
    folder.run()  # what a layout says
    assert folder.computed() == "c"


def test_input_that_changes_during_the_run_leaves_nothing_done(folder: Folder):
    folder.texts["a"] = "replaces"
    rows = folder.run()
    assert statuses(rows) == "failed failed done done"
    assert f"{folder.root / 'in' / 'b'}: changed" in rows["b"]["error"]
    folder.texts["b"] = "new"  # as the other writes it again
    assert statuses(folder.run()) == "failed done done done" and folder.computed() == "ab"
    folder.texts["a"] = "new"
    assert statuses(folder.run()) == ALL_DONE and folder.computed() == "a"


def test_another_config_needs_overwrite_once_a_scene_is_done(folder: Folder):
    folder.texts["a"] = "damaged"
    folder.run(only="a", factor=4)
    folder.texts["a"] = "aaa"
    assert statuses(folder.run()) == ALL_DONE
    before = folder.bytes()
    refused(ConfigError, folder.run, factor=3)
    assert folder.bytes() == before
    (folder.output / "a" / "notes.txt").write_text("mine")
    folder.run(factor=3, only="ab", overwrite=True)
    assert folder.result("a") == "aaa" * 3
    assert (folder.output / "a" / "notes.txt").read_text() == "mine"
    assert not (folder.output / "c").exists()  # belonged to the run that was replaced


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_failures_are_rows(folder: Folder, jobs: int):
    folder.texts |= {"a": "damaged", "b": "bug", "c": "huge"}
    rows = folder.run(jobs=jobs)
    assert statuses(rows) == "failed failed failed done"
    assert rows["a"]["error"] == "cannot be read"
    assert rows["b"]["error"].startswith("a bug in depthcli: KeyError: 'no such thing'; the traceback is in trace")
    assert "no such thing" in (folder.output / "traceback-b.txt").read_text()
    assert rows["c"]["error"].startswith("out of memory")
    left = ["a", "b", "c", "d", "report.csv", "report.json", "run.yaml", "traceback-b.txt"]
    assert sorted(p.name for p in folder.output.iterdir()) == left
    assert folder.report()["failed"] == 3
    folder.texts |= {"a": "well", "b": "mended"}
    assert statuses(folder.run(jobs=jobs)) == "done done failed done"
    assert folder.computed() == "abc"
    assert not (folder.output / "traceback-b.txt").exists()
    name = "b" * 250  # a file's name has at most 255
    file = laid(folder.root / "in", {"long": "bug"}) / "long"
    row = folder.run(only=Text(name=name, folder=file.parent, file=file))[name]
    (trace,) = folder.output.glob("traceback-*.txt")
    assert trace.name in row["error"] and "no such thing" in trace.read_text()


def test_scenes_that_cannot_be_moved_into_place_are_failed_rows(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("depthcli.run.scene.install", Mock(side_effect=OSError(errno.EIO, os.strerror(errno.EIO))))
    told(folder.run(only="a")["a"]["error"])
    assert not (folder.output / "a" / "out.txt").exists()


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_full_disk_ends_the_run_once(folder: Folder, capsys, jobs: int):
    folder.texts |= {name: f"disk full {name}" for name in "bcd"}
    folder.reporter = Reporter(0)
    said = rf"{folder.output}: No space left .*B free .* [01] of 4 scenes done, 0 failed, [34] not computed"
    with pytest.raises(OutputError, match=said):
        folder.run(jobs=jobs)
    assert "No space" not in capsys.readouterr().err
    assert statuses(read_report(folder.output)) in ("", "done")
    assert not list(folder.output.glob(".partial*"))
    folder.texts |= {name: name for name in "bcd"}
    assert statuses(folder.run(jobs=jobs)) == ALL_DONE
    assert folder.computed()[-3:] == "bcd"


def test_a_used_up_quota_elsewhere_is_named_by_its_place(folder: Folder):
    folder.texts["b"] = "quota"
    said = rf"^/tmp/scratch: {os.strerror(errno.EDQUOT)}.*; stopped, 1 of 4 scenes done"
    with pytest.raises(OutputError, match=said) as caught:
        folder.run()
    assert str(caught.value).isprintable()


def test_what_is_told_of_earlier_results(folder: Folder, capsys: pytest.CaptureFixture[str]):
    """Warnings again, results whose input is gone, and what a run has done that stops at a failure."""
    folder.texts["a"] = "x"
    folder.run()
    folder.reporter = Reporter(0)
    assert folder.run(only="abc")["a"]["warnings"] == ["short"]
    assert folder.computed() == ""
    assert folder.report()["scenes"][0]["warnings"] == ["short"]
    assert (folder.output / "report.csv").read_text().splitlines()[1].endswith(",short")
    (folder.root / "in" / "d").unlink()
    folder.run(only="abc")
    told(capsys.readouterr().err)
    shutil.rmtree(folder.output / "d")
    folder.texts |= {"b": "damaged", "c": "new"}
    folder.run(only="abc", fail_fast=True)
    told(capsys.readouterr().err)
    assert [row["scene"] for row in folder.report()["scenes"]] == list("abc")


def test_a_result_does_not_outlive_its_input(folder: Folder):
    folder.run()
    before, other = folder.bytes(), records.Record("a", "another run", {}, {}, {"status": "failed"})
    records.record_failure(folder.output / "a", other, overwrite=False)  # results that another run made meanwhile
    made = laid(folder.root / "made", {"out.txt": "other"})
    refused(OutputError, records.install, made, folder.output / "a", replace(other, files={"out.txt": ""}))
    assert folder.bytes() == before
    folder.texts["a"] = "damaged"
    assert folder.run()["a"]["status"] == "failed"
    assert [path.name for path in (folder.output / "a").iterdir()] == [RECORD_FILE]
    assert folder.report()["scenes"][0]["status"] == "failed"


@pytest.mark.slow
def test_a_dying_worker_takes_nothing_along_and_is_replaced(folder: Folder):
    folder.texts |= {"b": "killed", "c": f"killed once {folder.root / 'mark'}"}
    rows = folder.run(jobs=2)
    assert statuses(rows) == "done failed done done"
    assert "killed, probably out of memory" in rows["b"]["error"]
    assert folder.result("c") == "spared" * 2


def test_interruption_leaves_a_folder_to_go_on_with(folder: Folder):
    folder.texts["c"] = "stop"
    with pytest.raises(KeyboardInterrupt):
        folder.run()
    assert [row["scene"] for row in folder.report()["scenes"]] == ["a", "b"]
    folder.texts["c"] = "ccc"
    assert folder.run()["a"]["seconds"] == {"work": 0.5}  # measured before the interruption
    assert folder.computed() == "cd"


def test_what_is_finished_when_the_signal_comes_is_reported(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    def interrupt(_: int) -> int:  # called when a scene's files are in place
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(workers.memory, "release", interrupt)
        with pytest.raises(KeyboardInterrupt):
            folder.run()
    assert [(row["scene"], row["status"]) for row in folder.report()["scenes"]] == [("a", "done")]
    folder.run()
    assert folder.computed()[-3:] == "bcd"


def test_leftovers_of_killed_runs_are_removed(folder: Folder):
    folder.run()
    before = folder.bytes()
    laid(folder.output, {".partial-12345/0/half": "x", ".report.json.1-2.partial~": "x"})
    (folder.output / ".X.partial~" / "deep").mkdir(parents=True)
    assert hidden_folder(folder.output) != hidden_folder(folder.output)  # numbers of processes come again
    folder.run()
    assert folder.bytes() == before


@pytest.mark.parametrize("name", [
    "", ".hidden", "..", "a/../b", "a//b", "legend.png", "status.txt", "evaluation/a", "evaluation", "run.yaml",
    "in",  # would be written over its own input
])  # fmt: skip
def test_names_that_lead_astray_are_refused(folder: Folder, name: str):
    file = folder.root / "in" / "x"
    file.write_text("x")
    folder.output = folder.root
    refused(ConfigError, folder.run, only=Text(name=name, folder=file.parent, file=file))


def test_another_input_of_the_same_name_is_refused(folder: Folder):
    folder.run(only="a")
    before, file = folder.bytes(), folder.root / "elsewhere"
    other = Text(name="a", folder=folder.root, file=file)
    file.write_text("other")
    refused(ConfigError, folder.run, only=other)
    assert folder.bytes() == before
    file.write_text("aaa")  # the same content, moved: nothing to do
    assert folder.run(only=other)["a"]["status"] == "done"
    file.write_text("other")
    folder.run(only=other, overwrite=True)
    assert folder.result("a") == "otherother"


def test_overwrite_keeps_what_fits_and_other_runs(folder: Folder):
    (folder.root / "in2").mkdir()
    inner = Folder(folder.root / "in2")
    inner.output = folder.output / "inner"
    inner.run(only="ab")
    kept = inner.bytes()
    folder.run(only="ab")
    folder.run(only="ab", overwrite=True)
    assert folder.computed() == ""
    folder.run(only="b", factor=3, overwrite=True)
    assert folder.computed() == "b"
    assert not (folder.output / "a").exists()
    assert inner.bytes() == kept


def test_edited_records_are_not_believed(folder: Folder):
    folder.run(only="ab")
    before = folder.bytes()
    outside = folder.root / "precious"
    outside.write_text("mine")
    record = folder.output / "a" / RECORD_FILE
    whole = json.loads(record.read_text())
    changes = [{"row": whole["row"] | {"length": 99}}, {"inputs": None}, {"run": 3}]
    for change in (*changes, *({"files": files} for files in ({"../../precious": ""}, {"..": 1}, []))):
        record.write_text(json.dumps(whole | change))
        assert folder.run(only="ab", overwrite=True)["a"]["length"] == 3
        assert folder.bytes() == before and outside.read_text() == "mine"
    odd = '{"scenes": [3, {"scene": "../x"}, {"scene": "a", "seconds": [], "source": 3}]}'
    for text in ("[]", "\x00", odd, "{" * 9999):
        (folder.output / "report.json").write_text(text)
        assert folder.run(only="ab")["a"]["status"] == "done"
        assert folder.bytes() == before


def test_a_report_that_cannot_be_written_is_told_after_the_work(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    full = OutputError("report.json: cannot be written (No space left on device)")
    for name, error in (("write_report", full), ("flush_all", OSError(errno.EIO, os.strerror(errno.EIO)))):
        with monkeypatch.context() as patched:
            patched.setattr(f"depthcli.run.runner.{name}", Mock(side_effect=error))
            refused(IncompleteError, folder.run)
    assert (folder.output / "d" / "out.txt").exists()


def test_compilation_is_not_the_method_s_time(monkeypatch: pytest.MonkeyPatch):
    spent = iter([0.0, 1000.0])
    monkeypatch.setattr("depthcli.core.context.compile_seconds", lambda: next(spent))
    clock = Clock()
    clock.start("stage")
    assert 0 <= clock.seconds["stage"] < 1


def test_of_many_items_the_table_shows_failures_and_totals():
    common = {"status": "done", "error": "", "seconds": {"a": 1.0}, "peak_memory": None}
    rows = [{**common, "scene": f"s{k}"} for k in range(60)]
    rows[7]["status"] = "failed"
    lines = run_table(rows, ()).splitlines()
    assert [line.split()[0] for line in lines] == ["scene", "s7", "all"]
    assert "59 done" in lines[-1] and "60.00" in lines[-1]
    assert len(run_table(rows[:50], ()).splitlines()) == 51
    columns = [Column("some", lambda row: row.get("some", "-")), Column("none", lambda _: "-")]
    heading = run_table([*rows[:3], rows[3] | {"some": "7"}], columns).splitlines()[0]
    assert heading.split() == ["scene", "status", "some", "seconds", "memory"]


@pytest.mark.parametrize("again", [True, False])
def test_what_is_left_of_a_folder_that_was_taken_away_is_not_installed(tmp_path: Path, again: bool):
    """A worker of a cluster may outlive its run: its half scene must not pass for a whole one, nor remove another's."""
    made = dict.fromkeys(("a.txt", "b.txt"), "whole")
    gone = []

    class Slow(Repeat):
        def compute(self, scene: Text, folder: Path, context: Context) -> Outcome:
            for number, (name, text) in enumerate(made.items()):
                if number == 1 and not gone:
                    gone.append(folder)
                    discard(folder.parent)  # the run ends, and the next one makes the scene
                    assert compute_scene(task_in(tmp_path, "next"), work, context.memory)()["status"] == "done"
                if again:
                    folder.mkdir(parents=True, exist_ok=True)  # as most writers of files do
                (folder / name).write_text(text)
            return Outcome()

    work = Work(Slow(Config()), Execution(), frozenset())
    row = compute_scene(task_in(tmp_path, "making"), work, 1 << 30)()
    reason = "the run has ended" if again else "b.txt: No such file or directory"
    assert row["status"] == "failed" and reason in row["error"]
    known = records.read_record(tmp_path / "run/item")
    assert set(known.files) == set(made)
    assert task_in(tmp_path, "making").is_done(known)


@pytest.mark.parametrize("overwrite", [False, True])
def test_files_that_no_record_claims_are_never_replaced(folder: Folder, overwrite: bool):
    """Own files in the place of a result, with a name of a result or of its record: the scene fails, they stay."""
    mine = ("a/out.txt", "b/record.json", "c/notes.txt")
    laid(folder.output, dict.fromkeys(mine, '{"my": 1}'))
    rows = folder.run(overwrite=overwrite)
    assert statuses(rows) == "failed failed done done"
    assert "a: out.txt would be replaced" in rows["a"]["error"]
    assert "b: record.json would be" in rows["b"]["error"]
    assert {(folder.output / file).read_text() for file in mine} == {'{"my": 1}'}
    assert not (folder.output / "a/first.txt").exists()
    (folder.output / "a/out.txt").unlink()
    assert folder.run(only="a")["a"]["status"] == "done"


@pytest.mark.parametrize(("name", "overwrite"), [("run.yaml", False), ("report.csv", True), ("status.txt", True)])
def test_a_folder_with_own_files_is_no_run_folder(folder: Folder, name: str, overwrite: bool):
    laid(folder.output, {name: "pipeline: mine"})
    refused(ConfigError, folder.run, overwrite=overwrite)
    assert [path.name for path in folder.output.iterdir()] == [name]
    assert (folder.output / name).read_text() == "pipeline: mine"


def test_scenes_of_another_run_need_overwrite(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    folder.run(only="d")  # the last scene of the runs that follow
    for file in (folder.output / "run.yaml", *folder.reports()):
        file.unlink()
    before = folder.bytes()
    with monkeypatch.context() as patched:
        patched.setattr("depthcli.run.runner.digest_and_state", lambda file: pytest.fail(f"{file} was digested before"))
        refused(ConfigError, folder.run, factor=3)
    assert folder.bytes() | before == folder.bytes()
    folder.run(factor=3, overwrite=True)
    assert folder.result("a") == "a" * 9


def test_results_behind_a_link_stay(folder: Folder):
    folder.run()
    before, mine = folder.bytes(), folder.output
    folder.output = folder.root / "other"
    folder.output.mkdir()
    (folder.output / "a").symlink_to(mine / "a")
    folder.texts["a"] = "new"
    refused(ConfigError, folder.run, overwrite=True)
    folder.output = mine
    assert folder.bytes() == before
    (mine / "a/out.txt").rename(folder.root / "precious")  # a link in the place of a file is replaced
    (mine / "a/out.txt").symlink_to(folder.root / "precious")
    folder.run()
    assert (folder.root / "precious").read_text() == "aaa" * 2


@pytest.mark.parametrize("when", ["unlink", "replace"])
def test_an_interrupted_replacement_is_known_as_ours(folder: Folder, monkeypatch: pytest.MonkeyPatch, when: str):
    """At every step in which a scene's old files make room for new ones, a kill leaves files that a record claims."""
    folder.run(only="a")
    (folder.output / "a/notes.txt").write_text("mine")  # the folder cannot be renamed
    module: Any = {"unlink": Path, "replace": os}[when]
    original = getattr(module, when)
    for step in range(8):
        folder.texts["a"] = f"text {step}"
        calls = itertools.count()

        def killed(*arguments: Any, step: int = step, calls: Iterator[int] = calls, **options: Any) -> Any:
            if next(calls) >= step:
                raise KeyboardInterrupt
            return original(*arguments, **options)

        with monkeypatch.context() as patched, contextlib.suppress(KeyboardInterrupt):
            patched.setattr(module, when, killed)
            folder.run(only="a")
        assert folder.run(only="a")["a"]["status"] == "done"
        assert folder.result("a") == f"text {step}" * 2
        left = {path.name for path in (folder.output / "a").iterdir()}
        assert left == {"first.txt", "notes.txt", "out.txt", "record.json"}


def test_shards_are_apart_and_together_everything_and_the_report_is_that_of_the_records(folder: Folder):
    folder.texts["b"] = "damaged"
    for first in (1, 2, 3):
        folder.run(shard=(first, 3))
        assert folder.computed() == "abcd"[first - 1 :: 3]
    assert [row["scene"] for row in folder.report()["scenes"]] == list("abcd")
    assert folder.run().keys() == set("abcd") and folder.computed() == "b"
    before = [path.read_text() for path in folder.reports()]
    for path in folder.reports():
        path.unlink()
    folder.run(only="a")
    assert [path.read_text() for path in folder.reports()] == before


def test_files_are_kept_by_their_paths_and_memory_is_shared(tmp_path: Path):
    (tmp_path / "frame").mkdir()
    for name in ("frame/a.txt", "a.txt"):
        (tmp_path / name).touch()
    _keep_only(("frame/*",), tmp_path)
    assert (tmp_path / "frame/a.txt").exists() and not (tmp_path / "a.txt").exists()
    assert Execution(jobs=2, max_memory=100).memory_each() == 50


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for the same")
def test_what_a_control_group_and_a_system_without_proc_leave(monkeypatch: pytest.MonkeyPatch):
    import resource

    files = {
        "/sys/fs/cgroup/cpu.max": "150000 100000", "/proc/meminfo": "MemAvailable: 5 kB",
        "/sys/fs/cgroup/memory.max": "3000", "/sys/fs/cgroup/memory.current": "1000",
    }  # fmt: skip

    def read_text(path: Path, *_: str) -> str:
        if str(path) in files:
            return files[str(path)]
        raise FileNotFoundError

    with monkeypatch.context() as patched:
        patched.setattr(Path, "read_text", read_text)
        assert (job.cores(), job.available_memory()) == (1, 2000)
        files.clear()
        found = job.cores(), job.available_memory(), job.peak_memory()
    assert found[0] == len(os.sched_getaffinity(0))
    assert found[1] == os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert found[2] == pytest.approx(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, rel=0.1)


@pytest.mark.parametrize(("left", "took", "busy", "options", "need", "found"), [
    (0, 0.05, 0.05, {}, 0, [1]),  # there was a single scene
    (9, 0.2, 0.2, {}, 0, [1]),  # as soon done as others have started
    (198, 0.05, 0.05, {}, 0, range(2, 9)), (1000, 1.0, 1.0, {}, 0, [8]),
    (1000, 1.0, 8.0, {}, 0, [1]),  # threads keep all cores busy
    (1000, 1.0, 1.0, {"threads": 3}, 0, [2]), (1000, 1.0, 1.0, {"threads": 16}, 0, [1]),
    (1000, 1.0, 1.0, {"max_memory": 4 << 30}, 1 << 30, [3]), (1000, 1.0, 1.0, {"max_memory": 1 << 30}, 1 << 30, [1]),
    (1000, 1.0, 1.0, {}, None, [1]),
])  # fmt: skip
def test_how_many_processes_finish_first_on_eight_cores(left, took, busy, options, need, found, monkeypatch):
    monkeypatch.setattr(workers, "cores", lambda: 8)
    how = Execution(**{"jobs": None, "max_memory": 64 << 30} | options)
    assert workers.n_processes(how, left, took, busy, lambda: need) in found


@pytest.mark.slow
@pytest.mark.parametrize(("jobs", "said"), [(1, "compiling kernels: 1 so far, 0 s"), (2, "compiling kernels for")])
def test_a_process_that_compiles_says_so_and_does_it_alone(folder: Folder, jobs: int, said: str, capsys, monkeypatch):
    monkeypatch.setattr(console, "_PROGRESS", -1)
    folder.texts, folder.reporter = dict.fromkeys("abcd", "compiles"), Reporter(0)
    assert statuses(folder.run(jobs=jobs)) == ALL_DONE
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("terminal", [False, True])
def test_progress_is_a_line_now_and_then_or_beside_the_bar(terminal: bool, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    monkeypatch.setattr(console, "_HEARTBEAT", -1)
    monkeypatch.setattr(console, "_PROGRESS", -1)
    reporter = Reporter()
    with reporter.counting(3, 1, "stereo"):
        reporter.progress("compiling", 2.6)
        reporter.step(failed=True)
        reporter.error("s: cannot be read")
    said = capsys.readouterr().err
    lines = ["compiling, 3 s", "stereo: 2 of 3 scenes, 1 failed", "s: cannot be read"]
    if terminal:
        assert "1/3" in said and lines[0] in said and "\rs: cannot be read\n" in said
    else:
        assert said.splitlines() == lines


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs copies of processes")
def test_many_scenes_are_computed_in_copies_of_the_process(tmp_path: Path):
    code = f"""if True:
        from pathlib import Path
        from depthcli.run import workers
        from tests.run.test_runner import Folder, Repeat, statuses
        Repeat.memory = lambda self, scene: 0
        workers._MIN_SCENES, workers.cores = 2, lambda: 2
        folder = Folder(Path({str(tmp_path)!r}))
        folder.texts |= {{"a": "compiles", "b": "damaged", "c": "killed", "d": f"killed once {tmp_path / "mark"}"}}
        assert workers._may_fork()
        print(statuses(folder.run(jobs=None)))
        assert not workers._has_threads.is_set()
        workers.use_threads(1)
        assert not workers._may_fork()
    """
    done = ended(0, sys.executable, "-c", code)
    assert done.stdout == "done failed failed done\n", done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_processes_take_over_where_they_finish_sooner(folder: Folder, monkeypatch: pytest.MonkeyPatch):
    folder.run()
    alone = folder.bytes()
    shutil.rmtree(folder.output)
    chosen: list[int] = []

    def two(how: Execution, left: int, *measured: Any) -> int:
        chosen.append(left)
        return 2

    monkeypatch.setattr(workers, "n_processes", two)
    folder.texts["c"] = f"killed once {folder.root / 'mark'}"  # not this process
    assert statuses(folder.run(jobs=None)) == ALL_DONE and chosen == [2]
    folder.texts["c"] = "ccc"
    folder.run(jobs=None)
    assert chosen == [2] and folder.computed() == "c" and folder.bytes() == alone


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs signals to threads")
def test_ctrl_c_waits_until_a_worker_has_started():
    """Any thread may get it, whatever the main thread blocks."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where tests run in the background

    def interrupt() -> None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    started = []

    def start() -> None:
        with workers._ctrl_c_later():
            thread = threading.Thread(target=interrupt)
            thread.start()
            thread.join()
            for _ in range(1000):  # in which a handler would be called
                started.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            start()
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(started) == 1000


@pytest.mark.parametrize("foreign", [False, True])
def test_files_are_on_the_disk_before_their_record_says_done(folder: Folder, foreign: bool, monkeypatch):
    """What the system is asked for, in order: ("flush", path) and ("move", from, to), of the disk as it is after it."""
    steps: list[tuple[str, ...]] = []
    names: dict[int, str] = {}
    side_by_side = threading.Barrier(3)  # a disk writes them in one go
    really = {name: getattr(os, name) for name in ("open", "fsync", "rename", "replace")}

    def opened(path: Any, *flags: int, **more: Any) -> int:
        handle: int = really["open"](path, *flags, **more)
        names[handle] = os.path.relpath(path, folder.output)
        return handle

    def flushed(handle: int) -> None:
        if names[handle].endswith(("first.txt", "out.txt", "record.json")):
            side_by_side.wait(timeout=30)
        steps.append(("flush", names[handle]))

    def moved(how: str, source: Any, target: Any) -> None:
        really[how](source, target)
        steps.append(("move", *(os.path.relpath(path, folder.output) for path in (source, target))))

    monkeypatch.setattr(os, "open", opened)
    monkeypatch.setattr(os, "fsync", flushed)
    for how in ("rename", "replace"):
        monkeypatch.setattr(os, how, functools.partial(moved, how))
    if foreign:  # which keeps the folder from being moved as a whole
        laid(folder.output, {"a/notes.txt": "mine"})
    folder.run(only="a")
    run_file = steps.index(("flush", "run.yaml"))
    hidden = next(step[1] for step in steps if step[0] == "flush" and step[1].endswith("0"))
    record = next(k for k, step in enumerate(steps) if step[0] == "move" and step[2] == f"{hidden}/record.json")
    assert not [step for step in steps[run_file + 1 : record] if step[0] == "flush"]
    rest = [step for step in steps[record + 1 :] if "a" in Path(step[-1]).parts or step[0] == "flush"]
    made = {f"{hidden}/{name}" for name in ("first.txt", "out.txt", "record.json")}
    assert {step[1] for step in rest[:5]} == {*made, hidden, "."}  # and the moves of earlier scenes
    if foreign:
        done = rest.index(("move", "a/.claim.json", "a/record.json"))
        assert {step[2] for step in rest[:done] if step[0] == "move"} == {"a/.claim.json", "a/first.txt", "a/out.txt"}
        assert rest[done - 1] == rest[done + 1] == ("flush", "a")
    else:
        assert rest[5] == ("move", hidden, "a")
    assert rest[-1] == ("flush", ".")
