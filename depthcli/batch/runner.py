"""The loop of every batch command: skip finished scenes, isolate failures, show progress, use several processes.

A scene is computed in a hidden folder beside the others and then moved into place, its record written last. A run can
therefore be killed at any moment and started again: scenes whose record matches the config and the inputs are kept,
all others are computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import sys
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path

from depthcli.batch import cluster, processes, records, report_writer, run_folder
from depthcli.batch.command import ConfigT, SceneT
from depthcli.batch.console import Reporter
from depthcli.batch.json_csv import Row
from depthcli.batch.sharing import LOCKS_FILE, FolderLock
from depthcli.batch.task import OTHER_RUN, Run, RunOptions, SceneCommand, Task, discard, run_task
from depthcli.core.errors import ConfigError, IncompleteError
from depthcli.data.formats.files import ends_of_file
from depthcli.data.scenes import Scene

_WORKSPACE_PREFIX = ".partial-"
# Digests that are remembered: calibrations and videos belong to several scenes that follow each other.
_MAX_REMEMBERED = 16


def run_scenes(
    work: SceneCommand[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    options: RunOptions,
    reporter: Reporter,
) -> list[Row]:
    """Compute every scene that is not done yet, write the run folder, and return the rows of its report.

    Parameters
    ----------
    work : the command that computes one scene
    config : its config; together with the command's name and all versions it identifies the run
    scenes : all scenes, with unique names
    output : the run folder

    Returns
    -------
    One row per scene of this call (of its shard; up to the first failure with ``fail_fast``), in order: ``scene``,
    ``status`` (done or failed), ``error``, facts, ``seconds`` by stage, ``peak_memory`` in bytes, ``source``.

    Raises
    ------
    ConfigError
        The folder holds another run or the result of another input of the same name, is in use, or contains
        the inputs.
    OutputError
        The folder cannot be used.
    IncompleteError
        Everything was computed, but the report cannot be written; or the connection to the scheduler was lost.
    """
    run = Run(work, config, options)
    own = scenes_of_shard(work, config, scenes, options)
    inputs = "" if options.shard is None else _inputs_digest(run, scenes)
    _check_names(run, own, output)
    with FolderLock(output, options.shard is not None, reporter.info) as lock:
        earlier = _open_folder(run, scenes, output, lock, inputs)
        batch = _Batch(run, own, output, reporter, lock, inputs)
        batch.plan(earlier)
        batch.compute()
    if batch.writer.problem:
        raise IncompleteError(batch.writer.problem)
    return [batch.rows[scene.name] for scene in own if scene.name in batch.rows]


def scenes_of_shard(
    work: SceneCommand[ConfigT, SceneT], config: ConfigT, scenes: Sequence[SceneT], options: RunOptions
) -> list[SceneT]:
    """Return the scenes that this process computes: those of its shard, or all."""
    if options.shard is None:
        return list(scenes)
    return options.shard.of(scenes, lambda scene: work.effort(config, scene))


def _check_names(run: Run, scenes: Sequence[Scene], output: Path) -> None:
    for scene in scenes:
        if any(not part or part.startswith(".") or "\0" in part for part in scene.name.split("/")):
            raise ConfigError(f"{scene.name!r} is no name for a folder of results; give one with --name")
        target = os.path.realpath(output / scene.name)  # Path.resolve() raises for loops of links, realpath does not
        files = () if scene.problem else run.work.files(run.config, scene).values()
        if any(target == os.path.dirname(os.path.realpath(file)) for file in files):
            raise ConfigError(f"{output}: {scene.name} would be written over its own input; choose another --output")
        if target != os.path.join(os.path.realpath(output), *scene.name.split("/")):
            raise ConfigError(f"{output}: {scene.name} is a link to {target}; give the folder that it leads to instead")


def _inputs_digest(run: Run, scenes: Sequence[Scene]) -> str:
    """Return what the inputs of all shards are known by: names, and sizes and ends of files, wherever they lie."""
    sha = hashlib.sha256()
    for scene in sorted(scenes, key=lambda scene: scene.name):
        files = {} if scene.problem else run.work.files(run.config, scene)
        sha.update(repr((scene.name, [(role, ends_of_file(file)) for role, file in sorted(files.items())])).encode())
    return sha.hexdigest()


def _open_folder(run: Run, scenes: Sequence[Scene], output: Path, lock: FolderLock, inputs: str) -> dict[str, Row]:
    """Make ``output`` the folder of this run; return scene -> what only its earlier report holds."""
    text = run_folder.run_text(run.work.name, run.config)
    earlier = {
        name: {key: row[key] for key in ("seconds", "peak_memory", "source") if row.get(key)}
        for name, row in run_folder.read_report(output, facts=False).items()
    }
    if lock.alone or not lock.locks:  # without locks the first shard has no sign that it is the first
        run_folder.open_run(output, text, run.options.overwrite)
    if lock.alone:
        _remove_leftovers(output)
        if run.options.overwrite:  # scenes of the run that is replaced go; those that its report does not list stay
            chosen, identity = {scene.name for scene in scenes}, records.digest(text.encode())
            for name in earlier:
                known = None if name in chosen else run_folder.reported_record(output, name)
                if known is not None and known.run != identity:
                    records.remove_scene(output / name)
            report_writer.drop_parts(output, other_than=(identity, inputs))
    if run.options.shard is not None and run_folder.saved_config(output) == text:
        report_writer.open_part(output, run.work.name, records.digest(text.encode()), run.options.shard, inputs)
    lock.settle()
    run_folder.join_run(output, text)
    return earlier


def _remove_leftovers(output: Path) -> None:
    """Remove what killed runs left."""
    with contextlib.suppress(OSError):
        (output / LOCKS_FILE).unlink(missing_ok=True)
    for leftover in (*output.glob(f"{_WORKSPACE_PREFIX}*"), *output.glob(".*.partial~")):
        if leftover.is_dir() and not leftover.is_symlink():
            discard(leftover)
        else:
            with contextlib.suppress(OSError):
                leftover.unlink(missing_ok=True)


class Inspector:
    """Finds out which scenes of a run are done; it reads only."""

    def __init__(self, run: Run, output: Path) -> None:
        self.run, self.output = run, output
        self.identity = records.digest(run_folder.run_text(run.work.name, run.config).encode())
        self._digests: dict[Path, str] = {}

    def task(self, scene: Scene, workspace: Path, number: int) -> Task:
        """Return the task that computes a scene, with the digests of all that its result depends on."""
        work, config, keep = self.run.work, self.run.config, self.run.options.keep
        files = {} if scene.problem else work.files(config, scene)
        inputs = {role: self._digest(file) for role, file in files.items()}
        inputs |= {} if scene.problem else work.settings(config, scene)
        inputs |= {"keep": " ".join(keep)} if keep else {}
        source = str(next(iter(files.values()), scene.folder).absolute())
        return Task(scene, self.output, workspace, number, self.identity, inputs, source, keep)

    def finished(self, task: Task, measured: Mapping[str, object]) -> tuple[Row | None, records.SceneRecord | None]:
        """Return the row of a scene that is done, and its record; None where it is not done, or has no record."""
        known = records.read_record(task.target)
        if known is None or not known.is_done(task.target, task.run, task.inputs):
            return None, known
        return report_writer.finished_row(known, {**measured, "source": task.source}), known

    def _digest(self, file: Path) -> str:
        if file not in self._digests:
            if len(self._digests) >= _MAX_REMEMBERED:
                self._digests.pop(next(iter(self._digests)))
            self._digests[file] = records.file_digest(file)
        return self._digests[file]


class _Batch:
    """The scenes of one call: rows of those that are done, tasks for the others."""

    def __init__(
        self, run: Run, scenes: Sequence[Scene], output: Path, reporter: Reporter, lock: FolderLock, inputs: str
    ) -> None:
        self.inputs = inputs
        self.run, self.scenes, self.output, self.reporter, self.lock = run, scenes, output, reporter, lock
        self.options = run.options
        self.workspace = output / (f"{_WORKSPACE_PREFIX}{re.sub(r'[^A-Za-z0-9-]', '_', platform.node())}-{os.getpid()}")
        self.inspector = Inspector(run, output)
        self.rows: dict[str, Row] = {}
        self.tasks: list[Task] = []
        self.claimed: list[Task] = []
        self.n_unclaimed = 0
        self.writer: report_writer.ReportWriter

    def plan(self, earlier: dict[str, Row]) -> None:
        """Divide the scenes into finished ones and tasks; ``earlier`` rows that are read are removed."""
        for number, scene in enumerate(self.scenes):
            task = self.inspector.task(scene, self.workspace, number)
            measured = earlier.pop(scene.name, {})
            row, known = self.inspector.finished(task, measured)
            if row is not None:
                self.rows[scene.name] = _with_interned_keys(row)
                continue
            origin = measured.get("source")
            same_run = known is not None and known.run == task.run
            if known is not None and not same_run and not self.options.overwrite:
                raise ConfigError(f"{task.target}: {OTHER_RUN}")
            if same_run and origin and origin != task.source and not self.options.overwrite:
                raise ConfigError(
                    f"{self.output}: holds the result of another {scene.name!r}, made from {origin}; this one is "
                    f"{task.source}; choose another --output or --name, or --overwrite it"
                )
            self.tasks.append(task)
        if self.rows:
            self.reporter.info(f"{len(self.rows)} of {len(self.scenes)} scenes are done already")
        others = [] if self.options.shard is not None else self._other_rows(earlier)
        earlier.clear()
        self.writer = report_writer.ReportWriter(
            self.output,
            self.run.work.name,
            self.inspector.identity,
            self.rows,
            self.scenes,
            others,
            self.options.shard,
            self.inputs,
        )

    def _other_rows(self, earlier: dict[str, Row]) -> list[Row]:
        """Rows of scenes of the same run that are not part of this call."""
        chosen, rows = {scene.name for scene in self.scenes}, []
        for name, row in earlier.items():
            known = None if name in chosen else run_folder.reported_record(self.output, name)
            if known is not None and known.run == self.inspector.identity:
                rows.append(report_writer.finished_row(known, row))
        return rows

    def compute(self) -> None:
        """Compute all tasks, and keep the report up to date; it is complete also where this is interrupted."""
        try:
            with self.reporter, contextlib.closing(self._computed_rows()) as computed:
                self.reporter.start(len(self.scenes), len(self.rows), self.run.work.name)
                for row in map(_with_interned_keys, computed):
                    self._add(row)
                    if self.options.fail_fast and row["status"] == "failed":
                        self.reporter.info("stopped at the first failure; the same command goes on where it stopped")
                        break
        finally:
            self._finish()
        if self.n_unclaimed:
            self.reporter.info(f"{self.n_unclaimed} scenes are being computed by other processes")

    def _computed_rows(self) -> Generator[Row, None, None]:
        jobs = min(self.options.jobs, len(self.tasks))
        if not self.tasks:
            return
        if self.options.scheduler is not None:
            yield from cluster.compute(self.tasks, self.run, self.reporter, self._claim)
        elif jobs > 1:
            yield from processes.compute(self.tasks, self.run, self.reporter, self._claim, jobs)
        else:
            yield from _compute_here(self.tasks, self.run, self.reporter, self._claim)

    def _claim(self, task: Task) -> bool:
        """Reserve a scene for this process; False where another process computes it, or has done so since."""
        if self.lock.claim(task.scene.name):
            row = None if self.options.shard is None else self.inspector.finished(task, {})[0]
            if row is None:
                self.claimed.append(task)
                return True
            self.rows[task.scene.name] = row
            self.lock.release(task.scene.name)
        else:
            self.n_unclaimed += 1
        self.reporter.step()
        return False

    def _add(self, row: Row) -> None:
        """Take the row of a scene that was just computed."""
        name, failed = row["scene"], row["status"] == "failed"
        self.rows[name] = row
        self.lock.release(name)
        if failed:
            self.reporter.error(f"{name}: {row['error']}")
        else:
            self.reporter.detail(f"{name}: {sum(row['seconds'].values()):.2f} s")
        for line in row.pop("warnings", ()):
            self.reporter.info(f"{name}: warning: {line}")
        self.writer.update()
        self.reporter.step(failed)

    def _finish(self) -> None:
        """Complete the rows, remove the workspace, and write the report."""
        for task in self.claimed:  # a signal may arrive between a scene's last file and its row
            row = None if task.scene.name in self.rows else self.inspector.finished(task, {})[0]
            if row is not None:
                self.rows[task.scene.name] = _with_interned_keys(row)
        for task in self.tasks:
            row = self.rows.get(task.scene.name)
            if row is not None and row["status"] == "done" and not (task.target / records.RECORD_FILE).is_file():
                self.rows[task.scene.name] = task.failed(f"{task.target}: was computed, but its files have gone since")
        discard(self.workspace)
        self.writer.close(self.lock)
        if self.lock.alone:
            _remove_leftovers(self.output)


def _compute_here(tasks: list[Task], run: Run, reporter: Reporter, claim: Callable[[Task], bool]) -> Iterator[Row]:
    """Yield the rows of the tasks, computed one by one in this process."""
    processes.use_threads(run.options.threads_each())
    with processes.compile_watch(lambda: processes.announce_compilation(reporter)) as watch:
        for task in filter(claim, tasks):
            kernels, seconds = watch.kernels, watch.seconds
            yield run_task(task, run, run.options.memory_each())
            processes.report_compilation(reporter, watch.kernels - kernels, watch.seconds - seconds)


def _with_interned_keys(row: Row) -> Row:
    """Return the row with keys that all rows share: each comes from a file or a process with strings of its own."""
    return {sys.intern(k): _with_interned_keys(v) if isinstance(v, dict) else v for k, v in row.items()}
