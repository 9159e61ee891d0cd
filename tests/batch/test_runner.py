from __future__ import annotations

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

from depthcli.batch.reporter import Reporter
from depthcli.batch.runner import Options, Outcome, run_scenes
from depthcli.core.errors import ConfigError, InputError


class Config(BaseModel):
    factor: int = 2


@dataclass(frozen=True)
class TextScene:
    name: str
    file: Path

    @property
    def input_files(self) -> tuple[Path, ...]:
        return (self.file,)


@dataclass(frozen=True)
class Repeat:
    """Writes the scene's text ``factor`` times; words in the text make it go wrong."""

    factor: int = 2
    log: Path | None = None

    def __call__(self, scene: TextScene, folder: Path, memory: int) -> Outcome:
        text = scene.file.read_text()
        if self.log is not None:
            with self.log.open("a") as log:
                log.write(scene.name + "\n")
        (folder / "first.txt").write_text(text)
        if text == "damaged":
            raise InputError(f"{scene.file}: damaged")
        if text == "bug":
            raise KeyError("no such thing")
        if text == "huge":
            raise MemoryError
        if text == "stop":
            raise KeyboardInterrupt
        if text == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        (folder / "out.txt").write_text(text * self.factor)
        return Outcome({"length": len(text)}, {"work": 0.5})

    def settings(self, scene: TextScene) -> dict[str, str]:
        return {}


class Folder:
    def __init__(self, root: Path) -> None:
        self.root = root
        self.output = root / "run"
        self.log = root / "log"
        (root / "in").mkdir()
        self.texts: dict[str, str] = {name: name * 3 for name in "abcd"}

    def run(self, factor: int = 2, only: str = "abcd", **options: Any) -> dict[str, dict[str, Any]]:
        scenes = []
        for name in only:
            file = self.root / "in" / name
            file.write_text(self.texts[name])
            scenes.append(TextScene(name, file))
        self.log.write_text("")
        work = Repeat(factor, self.log)
        rows = run_scenes("repeat", Config(factor=factor), scenes, work, self.output, Options(**options), Reporter(-1))
        return {row["scene"]: row for row in rows}

    def computed(self) -> list[str]:
        return sorted(self.log.read_text().split())

    def bytes(self) -> dict[str, bytes]:
        files = [p for p in self.output.rglob("*") if p.is_file() and p.parent / p.name not in self.reports()]
        return {str(p.relative_to(self.output)): p.read_bytes() for p in sorted(files)}

    def reports(self) -> list[Path]:
        return [self.output / "report.json", self.output / "report.csv"]

    def report(self) -> dict[str, Any]:
        return json.loads((self.output / "report.json").read_text())


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_what_is_done_is_not_done_again(folder: Folder):
    first = folder.run()
    assert folder.computed() == list("abcd")
    before = folder.bytes()
    assert folder.run() == first
    assert folder.computed() == []
    assert folder.bytes() == before
    assert sorted(before) == sorted(
        ["run.yaml", *(f"{s}/{f}" for s in "abcd" for f in ("first.txt", "out.txt", "record.json"))]
    )


def test_changed_input_is_computed_again(folder: Folder):
    folder.run()
    folder.texts["b"] = "new"
    assert folder.run()["b"]["length"] == 3
    assert folder.computed() == ["b"]
    assert (folder.output / "b" / "out.txt").read_text() == "newnew"


@pytest.mark.parametrize("lost", ["out.txt", "record.json"])
def test_lost_or_cut_files_are_made_again(folder: Folder, lost: str):
    folder.run()
    before = folder.bytes()
    (folder.output / "c" / lost).write_bytes(b"{")
    folder.run()
    assert folder.computed() == ["c"]
    assert folder.bytes() == before


def test_another_config_needs_overwrite(folder: Folder):
    folder.run()
    before = folder.bytes()
    with pytest.raises(ConfigError, match=r"another config \(it says 'factor: 2', this run 'factor: 3'\).*--overwrite"):
        folder.run(factor=3)
    assert folder.bytes() == before
    (folder.output / "a" / "notes.txt").write_text("mine")
    folder.run(factor=3, only="ab", overwrite=True)
    assert (folder.output / "a" / "out.txt").read_text() == "aaa" * 3
    assert (folder.output / "a" / "notes.txt").read_text() == "mine"
    assert not (folder.output / "c").exists()  # belonged to the run that was replaced


@pytest.mark.parametrize("jobs", [1, 2])
def test_failures_are_rows(folder: Folder, jobs: int):
    folder.texts |= {"a": "damaged", "b": "bug", "c": "huge"}
    rows = folder.run(jobs=jobs)
    assert [rows[s]["status"] for s in "abcd"] == ["failed", "failed", "failed", "done"]
    assert rows["a"]["error"].endswith("in/a: damaged")
    assert rows["b"]["error"] == "a bug in depthcli: KeyError: 'no such thing'"
    assert rows["c"]["error"].startswith("out of memory")
    assert sorted(p.name for p in folder.output.iterdir()) == ["d", "report.csv", "report.json", "run.yaml"]
    assert folder.report()["failed"] == 3
    folder.texts["a"] = "well"
    assert folder.run(jobs=jobs)["a"]["status"] == "done"
    assert folder.computed() == ["a", "b", "c"]


def test_a_result_does_not_outlive_its_input(folder: Folder):
    folder.run()
    folder.texts["a"] = "damaged"
    assert folder.run()["a"]["status"] == "failed"
    assert not (folder.output / "a").exists()


def test_a_dying_worker_takes_nothing_along(folder: Folder):
    folder.texts["b"] = "killed"
    rows = folder.run(jobs=2)
    assert [rows[s]["status"] for s in "abcd"] == ["done", "failed", "done", "done"]
    assert "killed, probably out of memory" in rows["b"]["error"]


def test_interruption_leaves_a_folder_to_go_on_with(folder: Folder):
    folder.texts["c"] = "stop"
    with pytest.raises(KeyboardInterrupt):
        folder.run()
    assert [row["scene"] for row in folder.report()["scenes"]] == ["a", "b"]
    folder.texts["c"] = "ccc"
    rows = folder.run()
    assert folder.computed() == ["c", "d"]
    assert rows["a"]["seconds"] == {"work": 0.5}  # measured before the interruption


def test_workers_give_the_same_bytes(folder: Folder, tmp_path_factory: pytest.TempPathFactory):
    folder.run(jobs=2)
    other = Folder(tmp_path_factory.mktemp("other"))
    other.run()
    assert folder.bytes() == other.bytes()


def test_leftovers_of_killed_runs_are_removed(folder: Folder):
    folder.run()
    before = folder.bytes()
    leftover = folder.output / ".partial-12345" / "0"
    leftover.mkdir(parents=True)
    (leftover / "half").write_text("x")
    (folder.output / ".report.json.1-2.partial~").write_text("x")
    folder.run()
    assert folder.bytes() == before


def test_scenes_of_the_same_run_stay_in_the_report(folder: Folder):
    folder.run(only="ab")
    rows = folder.run(only="cd")
    assert sorted(rows) == ["c", "d"]
    assert [row["scene"] for row in folder.report()["scenes"]] == list("abcd")


def test_inputs_are_never_written_over(folder: Folder):
    folder.output = folder.root
    scene = TextScene("in", folder.root / "in" / "x")
    scene.file.write_text("x")
    with pytest.raises(ConfigError, match="over its own input"):
        run_scenes("repeat", Config(), [scene], Repeat(), folder.root, Options(), Reporter(-1))


def test_two_runs_do_not_share_a_folder(folder: Folder):
    fcntl = pytest.importorskip("fcntl")
    folder.run()
    handle = os.open(folder.output, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        with pytest.raises(ConfigError, match="another depthcli"):
            folder.run()
    finally:
        os.close(handle)
    folder.run()
