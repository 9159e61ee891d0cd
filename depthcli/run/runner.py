"""A run: skip finished scenes, compute the others, isolate failures, show progress, report.

A scene is computed in a hidden folder beside the others and then moved into place, its record written last. A run can
therefore be killed at any moment and started again: scenes whose record matches the config and the inputs are kept,
all others are computed again.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path

from depthcli.core.errors import ConfigError, IncompleteError, OutputError
from depthcli.io.formats.files import write_text
from depthcli.io.scenes import Scene
from depthcli.kernels.jit import CompileWatch
from depthcli.run import cluster, processes, records
from depthcli.run.activities import Announcer, Board
from depthcli.run.command import ConfigT, SceneCommand, SceneT
from depthcli.run.console import Reporter
from depthcli.run.install import discard, hidden_folder, remove_leftovers, remove_results
from depthcli.run.json_csv import Row
from depthcli.run.plan import Planner, check_files, check_names, inputs_digest, scenes_of_shard
from depthcli.run.report_parts import Part, ReportWriter, drop_parts
from depthcli.run.reports import MEASURED, finished_row, read_report
from depthcli.run.run_folder import check_folder, saved_config
from depthcli.run.sharing import LOCKS_FILE, FolderLock
from depthcli.run.task import Run, RunOptions, Task, run_task
from depthcli.run.warning_counts import WarningCounts

_GOES_ON = "the same command goes on where it stopped"


def run_scenes(
    command: SceneCommand[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    options: RunOptions,
    reporter: Reporter,
) -> list[Row]:
    """Compute every scene that is not done yet, write the run folder, and return the rows of its report.

    Parameters
    ----------
    command : what computes one scene
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
        The folder cannot be used; or the disk became full, and the run stopped there.
    IncompleteError
        Everything was computed, but the report cannot be written; or the connection to the scheduler was lost.
    """
    run = Run.of(command, config, scenes, options)
    own, shard = scenes_of_shard(command, config, scenes, options), options.shard
    part = Part(command.name, run.identity)
    if shard is not None:
        part = Part(command.name, run.identity, shard, inputs_digest(run, scenes), tuple(s.name for s in scenes))
    check_names(run, own, output)
    with FolderLock(output, shard is not None, reporter.info) as lock:
        batch = _Batch(run, part, own, output, reporter, lock)
        earlier = batch.open_folder({scene.name for scene in scenes})
        batch.plan(earlier)
        batch.compute()
    if batch.writer.problem:
        raise IncompleteError(batch.writer.problem)
    return [batch.rows[scene.name] for scene in own if scene.name in batch.rows]


class _Batch:
    """The scenes of one call: the folder opened, rows of the finished scenes, tasks for the others, their results.

    Attributes
    ----------
    rows : scene -> row, of those that are finished or failed
    tasks : what has to be computed
    claimed : those of them that this process began, in a shared run or not
    n_unclaimed : number of those that other processes compute
    disk_full : where and why no more files could be written, which ended the run; or empty
    """

    def __init__(
        self, run: Run, part: Part, scenes: Sequence[Scene], output: Path, reporter: Reporter, lock: FolderLock
    ) -> None:
        self.run, self.part, self.scenes, self.output = run, part, scenes, output
        self.reporter, self.lock, self.options = reporter, lock, run.options
        self.workspace, self.planner = hidden_folder(output), Planner(run, output)
        self.warnings = WarningCounts(reporter)
        self.rows: dict[str, Row] = {}
        self.tasks: list[Task] = []
        self.claimed: list[Task] = []
        self.n_unclaimed = 0
        self.disk_full = ""
        self.writer: ReportWriter

    def open_folder(self, names: set[str]) -> dict[str, Row]:
        """Make the folder that of this run; return scene -> what only its earlier report holds.

        Parameters
        ----------
        names : all scenes, also those of other shards
        """
        output, lock, text, overwrite = self.output, self.lock, self.run.text, self.options.overwrite
        earlier = read_report(output, facts=False)
        first = lock.alone or not lock.locks  # without locks the first shard has no sign that it is the first
        if first:
            check_folder(output, text, overwrite)
        check_files(self.run, self.scenes, output)
        if first and saved_config(output) != text:
            write_text(output / records.RUN_FILE, text)
        if lock.alone:
            with contextlib.suppress(OSError):
                (output / LOCKS_FILE).unlink(missing_ok=True)
            remove_leftovers(output)
            if overwrite:  # scenes of the run that is replaced go; those that its report does not list stay
                for name in earlier.keys() - names:
                    known = records.read_record(output, name)
                    if known is not None and known.run != self.part.run:
                        remove_results(output / name)
                drop_parts(output, keep=self.part)
        if saved_config(output) == text:
            self.part.begin(output)
        lock.settle()
        if saved_config(output) != text:
            raise ConfigError(
                f"{output}: another depthcli writes a run of another config there; choose another --output"
            )
        return {name: {key: row[key] for key in MEASURED if row.get(key)} for name, row in earlier.items()}

    def plan(self, earlier: dict[str, Row]) -> None:
        """Divide the scenes into finished ones and tasks; ``earlier`` is used up."""
        for number, scene in enumerate(self.scenes):
            task = self.planner.task(scene, self.workspace, number)
            measured = earlier.pop(scene.name, {})
            row, known = self.planner.finished(task, measured)
            if row is not None:
                self.rows[scene.name] = _with_interned_keys(row)
                continue
            origin = measured.get("source")
            same_run = known is not None and known.run == task.run
            if same_run and origin and origin != task.source and not self.options.overwrite:
                raise ConfigError(
                    f"{self.output}: holds the result of another {scene.name!r}, made from {origin}; this one is "
                    f"{task.source}; choose another --output, or --overwrite it"
                )
            self.tasks.append(task)
        if self.rows:
            self.reporter.info(f"{len(self.rows)} of {len(self.scenes)} scenes are done already")
        others = []  # of the same run, but not part of this call
        for name, row in earlier.items() if self.options.shard is None else ():
            known = records.read_record(self.output, name)
            if known is not None and known.run == self.part.run:
                others.append(finished_row(known, row))
        earlier.clear()
        order = [scene.name for scene in self.scenes]
        self.writer = ReportWriter(self.output, self.part, self.rows, order, others)

    def compute(self) -> None:
        """Compute all tasks, and keep the report up to date; it is complete also where this is interrupted.

        OutputError where the disk is full: no further scene could be written.
        """
        jobs = 1 if self.options.scheduler is not None else min(self.options.jobs, len(self.tasks))
        board = processes.shared_board(jobs) if jobs > 1 else Board(bytearray(Board.size(1)))
        stopped = False
        try:
            with self.reporter, contextlib.closing(self._computed_rows(jobs, board)) as computed:
                self.reporter.start(len(self.scenes), len(self.rows), self.run.command.name, running=board.running)
                for row in map(_with_interned_keys, computed):
                    if "disk_full" in row:
                        self.disk_full = row["disk_full"]
                        break
                    self._add(row)
                    if stopped := self.options.fail_fast and row["status"] == "failed":
                        break
        finally:
            self._finish()
        if self.disk_full:
            raise OutputError(f"{self.disk_full}; stopped, {self._counts()}; make room there, {_GOES_ON}")
        if stopped:
            self.reporter.info(f"stopped at the first failure, {self._counts()}; {_GOES_ON}")
        if self.n_unclaimed:
            self.reporter.info(f"{self.n_unclaimed} scenes are being computed by other processes")

    def _counts(self) -> str:
        """Return how many scenes were done, failed, or not computed by anybody."""
        failed = sum(row["status"] == "failed" for row in self.rows.values())
        left = len(self.scenes) - len(self.rows) - self.n_unclaimed
        return f"{len(self.rows) - failed} of {len(self.scenes)} scenes done, {failed} failed, {left} not computed"

    def _computed_rows(self, jobs: int, board: Board) -> Generator[Row, None, None]:
        if not self.tasks:
            return
        if self.options.scheduler is not None:
            yield from cluster.compute(self.tasks, self.run, self.reporter, self._claim)
        elif jobs > 1:
            yield from processes.compute(self.tasks, self.run, self.reporter, self._claim, jobs, board)
        else:
            yield from _compute_here(self.tasks, self.run, self.reporter, self._claim, board)

    def _claim(self, task: Task) -> bool:
        """Reserve a scene for this process; False where another process computes it, or has done so since."""
        if self.lock.claim(task.scene.name):
            row = None if self.options.shard is None else self.planner.finished(task, {})[0]
            if row is None:
                self.claimed.append(task)
                return True
            self.rows[task.scene.name] = row
            self.lock.release(task.scene.name)
        else:
            self.n_unclaimed += 1
        self.reporter.step(computed=False)
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
        self.warnings.add(name, row.pop("warnings", []))
        self.writer.update()
        self.reporter.step(failed)

    def _finish(self) -> None:
        """Complete the rows, remove the workspace, and write the report."""
        for task in self.claimed:  # a signal may arrive between a scene's last file and its row
            row = None if task.scene.name in self.rows else self.planner.finished(task, {})[0]
            if row is not None:
                self.rows[task.scene.name] = _with_interned_keys(row)
        for task in self.tasks:
            row = self.rows.get(task.scene.name)
            if row is not None and row["status"] == "done" and not (task.target / records.RECORD_FILE).is_file():
                self.rows[task.scene.name] = task.failed(f"{task.target}: was computed, but its files have gone since")
        self.warnings.close()
        discard(self.workspace)
        self.writer.close(self.lock, complete=len(self.rows) + self.n_unclaimed >= len(self.scenes))
        if self.lock.alone:
            remove_leftovers(self.output)


def _compute_here(
    tasks: list[Task], run: Run, reporter: Reporter, claim: Callable[[Task], bool], board: Board
) -> Iterator[Row]:
    """Yield the rows of the tasks, computed one by one in this process."""
    processes.use_threads(run.options.threads_each())
    announcer = Announcer(board.memory, run.options.preset)

    def compiling(watch: CompileWatch) -> None:
        processes.announce_compilation(reporter)
        announcer.compiling(watch)

    with processes.compile_watch(compiling) as watch:
        for task in filter(claim, tasks):
            kernels, seconds = watch.calls, watch.seconds
            slot = board.add(task.scene.name)
            with announcer.scene(slot):
                row = run_task(task, run, run.options.memory_each())
            board.remove(slot)
            yield row
            processes.report_compilation(reporter, watch.calls - kernels, watch.seconds - seconds)


def _with_interned_keys(row: Row) -> Row:
    """Return the row with keys that all rows share: each comes from a file or a process with strings of its own."""
    return {sys.intern(k): _with_interned_keys(v) if isinstance(v, dict) else v for k, v in row.items()}
