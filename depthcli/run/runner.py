"""Run scenes: skip finished ones, compute the others, isolate failures, show progress, report.

A scene is computed in a hidden folder of the run and then moved into place, the record last. If a run is killed and
started again, scenes whose record matches config and inputs are kept, and all others are computed again. Processes with
the same config may share the folder.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from depthcli.core.errors import RESUME, ConfigError, IncompleteError, OutputError
from depthcli.core.method import used_files, used_plugins
from depthcli.core.plugins import Plugin, loaded, plugins_of
from depthcli.io.formats.files import flush_all
from depthcli.io.scenes import plugins_of_scenes
from depthcli.io.scenes.places import origin
from depthcli.run.cluster import compute_on_cluster
from depthcli.run.console import Reporter, WarningCounts
from depthcli.run.folder import FOLDER_FILES, FolderLock
from depthcli.run.job import Execution, Job, SceneT
from depthcli.run.records import (
    OTHER_RUN,
    digest,
    digest_and_state,
    discard,
    hidden_folder,
    is_gone,
    is_inside,
    read_record,
    remove_leftovers,
    write_record,
    write_report,
)
from depthcli.run.scene import Task, Work
from depthcli.run.workers import compute_on_this_machine
from depthcli.show.table import Row

# Number of cached digests; calibrations and videos belong to several consecutive scenes.
_MAX_REMEMBERED = 16


def run_scenes(
    job: Job[SceneT], scenes: Sequence[SceneT], output: Path, how: Execution, reporter: Reporter
) -> tuple[list[Row], list[str]]:
    """Compute every scene that is not done yet, and write the run folder ``output``.

    Returns
    -------
    The rows of the report in order, one per scene of this call or its shard (with ``fail_fast`` up to the first
    failure): ``scene``, ``status`` (done or failed), ``error``, facts, ``seconds`` by stage, ``peak_memory``
    in bytes, ``source``, ``warnings``. Also the names of scenes without a row, which other processes still compute;
    there are none for the process that ends last.

    Raises
    ------
    ConfigError
        If the folder has another run or a result from another input of the same name, or contains the inputs.
    OutputError
        If the folder cannot be used, or the disk became full.
    IncompleteError
        If all scenes were computed but the report cannot be written, or the connection to the scheduler was lost.
    """
    plan = Plan(job, scenes, output, how)
    plan.check_names()
    with FolderLock(output, reporter.info) as lock:
        lock.set_up(plan.text, how.overwrite)
        return _Run(plan, lock, reporter, WarningCounts(reporter)).rows_of_all()


class Plan:
    """Creates the tasks of a run's scenes."""

    def __init__(self, job: Job[Any], scenes: Sequence[Any], output: Path, how: Execution) -> None:
        plugins = set[Plugin]()
        if loaded:
            files = (file for scene in scenes for file in scene.input_files.values())
            plugins = used_plugins(job.config) | plugins_of([type(job)]) | plugins_of_scenes(scenes, files)
        self.work, self.output, self.scenes = Work(job, how, frozenset(plugins)), output, how.own(scenes)
        self.names = {scene.name for scene in self.scenes}
        self.text = self.work.text  # of run.yaml
        self.identity = digest(self.text.encode())
        self.workspace = hidden_folder(output)
        self._shared = used_files(job.config)  # files named in the config, inputs of every scene
        self._digest = lru_cache(maxsize=_MAX_REMEMBERED)(digest_and_state)

    def check_names(self) -> None:
        """Raise ConfigError if a name is no folder name, or the folder is a link or contains the scene's input."""
        for scene in self.scenes:
            parts = scene.name.split("/")
            if not is_inside(scene.name) or "/." in f"/{scene.name}":
                problem = "is no name for a folder of results; choose another name for the scene"
                raise ConfigError(f"{scene.name!r} {problem}")
            if parts[0] in FOLDER_FILES:
                problem = "has the name of a file or folder of the run itself; choose another name for the scene"
                raise ConfigError(f"{scene.folder}: a scene called {parts[0]!r} {problem}")
            target = os.path.realpath(self.output / scene.name)  # Path.resolve() raises for loops of links
            if any(target == os.path.dirname(os.path.realpath(file)) for file in self._files(scene).values()):
                problem = "would be written over its own input; choose another --output"
                raise ConfigError(f"{self.output}: {scene.name} {problem}")
            if target != os.path.join(os.path.realpath(self.output), *parts):
                problem = f"is a link to {target}; give the folder that it leads to instead"
                raise ConfigError(f"{self.output}: {scene.name} {problem}")

    def task(self, scene: Any, number: int) -> Task:
        """Return the task that computes a scene, with the digests of all its inputs."""
        files = self._files(scene)
        watched = {file: self._digest(file) for file in dict.fromkeys(files.values())}
        inputs = {role: watched[file][0] for role, file in files.items()}
        inputs |= {} if scene.problem else self.work.job.settings(scene)
        inputs |= {"keep": " ".join(keep)} if (keep := self.work.how.keep) else {}
        source = origin(next(iter(files.values()), scene.folder).absolute())
        return Task(scene, self.output, self.workspace / str(number), self.identity, inputs, source, watched)

    def _files(self, scene: Any) -> dict[str, Path]:
        return {} if scene.problem else self.work.job.files(scene) | self._shared


@dataclass(eq=False)
class _Run:
    """The scenes of one call, from their records to the report."""

    plan: Plan
    lock: FolderLock
    reporter: Reporter
    warnings: WarningCounts
    rows: dict[str, Row] = field(default_factory=dict)  # of the finished scenes
    elsewhere: dict[str, Task] = field(default_factory=dict)  # scene -> task, of those that other processes compute
    # Why the run ended before all scenes were computed:
    first_failure: bool = False  # with ``fail_fast``
    disk_full: str = ""  # the disk, and how much is free there

    def rows_of_all(self) -> tuple[list[Row], list[str]]:
        """Compute unfinished scenes, write the report, and return the results of ``run_scenes``."""
        plan, work, reporter = self.plan, self.plan.work, self.reporter
        tasks, no_report = self._tasks(), ""
        if work.how.scheduler is not None and tasks:
            computed = compute_on_cluster(self._claimed(tasks), work, reporter, plan.workspace)
        else:
            computed = compute_on_this_machine(self._claimed(tasks), work, reporter, [task.scene for task in tasks])
        counting = reporter.counting(len(plan.scenes), len(self.rows), work.job.command)
        try:
            with counting, contextlib.closing(computed):
                self._collect(computed)
        finally:
            discard(plan.workspace)
            with self.lock.reporting():
                self._take_from_others()
                try:
                    self._tell_of_gone(write_report(plan.output, work.job.command, plan.identity))
                    # The last scenes are on the disk under their names before the run ends.
                    flush_all({plan.output, *((plan.output / name).parent for name in self.rows)})
                except OutputError as error:  # scenes that cannot be written have failed rows instead
                    no_report = str(error)
                except OSError as error:
                    no_report = f"{plan.output}: cannot be written ({error.strerror or error})"
            self.warnings.close()
            if self.lock.last():
                remove_leftovers(plan.output)
        self._sum_up()
        if no_report:
            raise IncompleteError(no_report)
        return [self.rows[scene.name] for scene in plan.scenes if scene.name in self.rows], list(self.elsewhere)

    def _tasks(self) -> list[Task]:
        """Return the tasks of unfinished scenes, and take the rows of finished ones.

        Raise ConfigError if results of another run, or from another input of the same name, would be replaced.
        """
        plan, replaces = self.plan, self.plan.work.how.overwrite
        records = {scene.name: read_record(plan.output / scene.name) for scene in plan.scenes}
        for name, known in records.items():  # before digesting files, which can take long
            if known is not None and known.run != plan.identity and known.row.get("status") == "done" and not replaces:
                raise ConfigError(f"{plan.output / name}: {OTHER_RUN}")
        tasks = []
        for number, scene in enumerate(plan.scenes):
            task, known = plan.task(scene, number), records[scene.name]
            if known is not None and task.is_done(known):
                if known.row.get("source") != task.source:  # the inputs have moved
                    known.row["source"] = task.source
                    write_record(task.target, known)
                self._take(known.row)
                continue
            source = known.row.get("source") if known is not None and known.run == task.run and known.files else None
            if source and source != task.source and not replaces:
                raise ConfigError(
                    f"{plan.output}: has the result of another {scene.name!r}, made from {source}; this one is "
                    f"{task.source}; choose another --output, or --overwrite it"
                )
            tasks.append(task)
        if self.rows:
            self.reporter.info(f"{len(self.rows)} of {len(plan.scenes)} scenes are done already")
        return tasks

    def _claimed(self, tasks: Sequence[Task]) -> Iterator[Task]:
        """Yield the tasks that no other process computes or has computed meanwhile."""
        for task in tasks:
            if self.lock.claim(task.scene.name):
                known = read_record(task.target)
                if known is None or not task.is_done(known):
                    yield task
                    continue
                self._take(known.row)
                self.lock.release(task.scene.name)
            else:
                self.elsewhere[task.scene.name] = task
            self.reporter.step()

    def _collect(self, computed: Iterable[Row]) -> None:
        """Take all rows, or stop at a full disk or, with ``fail_fast``, at the first failure."""
        for row in computed:
            if "disk_full" in row:
                self.disk_full = row["disk_full"]
                return
            name, failed = row["scene"], row["status"] == "failed"
            self.lock.release(name)
            if failed:
                self.reporter.error(f"{name}: {row['error']}")
            else:
                self.reporter.detail(f"{name}: {sum(row['seconds'].values()):.2f} s")
            self._take(row)
            self.reporter.step(failed)
            if failed and self.plan.work.how.fail_fast:
                self.first_failure = True
                return

    def _take_from_others(self) -> None:
        """Take the rows of scenes that other processes have computed.

        Processes do this one at a time, after they have released their own scenes, so that the last one gets all rows.
        """
        for name, task in list(self.elsewhere.items()):
            if self.lock.claim(name):
                known = read_record(task.target)
                self.lock.release(name)
                of_task = known is not None and (known.run, known.inputs) == (task.run, task.inputs)
                self._take(known.row if known and of_task else task.failed("its process ended; run the command again"))
                del self.elsewhere[name]

    def _tell_of_gone(self, rows: Iterable[Row]) -> None:
        """Print scenes of earlier calls whose input was removed; report and folder still have them."""
        others = [row for row in rows if row["scene"] not in self.plan.names]
        if gone := [row["scene"] for row in others if is_gone(str(row.get("source")))]:
            more = f" and {len(gone) - 1} more" if len(gone) > 1 else ""
            self.reporter.info(
                f"{self.plan.output}: the report still has {gone[0]}{more}, without an input now; to drop results, "
                "remove their folder and run this again"
            )

    def _take(self, row: Row) -> None:
        self.rows[row["scene"]] = row
        self.warnings.add(row["scene"], row.get("warnings") or [])

    def _sum_up(self) -> None:
        """Print or raise the reasons for missing scenes."""
        if self.disk_full or self.first_failure:
            n_all, n_failed = len(self.plan.names), sum(row["status"] == "failed" for row in self.rows.values())
            left = n_all - len(self.rows) - len(self.elsewhere)
            counts = f"{len(self.rows) - n_failed} of {n_all} scenes done, {n_failed} failed, {left} not computed"
            if self.disk_full:
                raise OutputError(f"{self.disk_full}; stopped, {counts}; make room there, and {RESUME}")
            self.reporter.info(f"stopped at the first failure, {counts}; {RESUME}")
        if self.elsewhere:
            self.reporter.info(f"{len(self.elsewhere)} scenes are being computed by other processes")
