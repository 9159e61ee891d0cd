"""The loop of every batch command: resume, isolate failures, show progress, spread over processes.

An scene is computed into a hidden folder beside the others and then moved into place with its record
written last, so that a run can be killed at any moment and started again: what has a record that
matches the config and the inputs is kept, anything else is made anew.
"""

from __future__ import annotations

import contextlib
import os
import platform
import re
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

from depthcli.batch import cluster, record, workers
from depthcli.batch.command import ConfigT, SceneT
from depthcli.batch.making import BUG as BUG
from depthcli.batch.making import AnyWork, RunOptions, Task, Work, discard, failed_row, remove, run_one
from depthcli.batch.making import Outcome as Outcome
from depthcli.batch.report import ReportWriter, row_of
from depthcli.batch.reporter import Reporter
from depthcli.batch.sharing import LOCKS_FILE, FolderLock
from depthcli.core.errors import ConfigError, IncompleteError
from depthcli.data.scenes import Scene

_HIDDEN = ".partial-"
_REMEMBERED = 16  # digests of files that several scenes share


def run_scenes(
    work: Work[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    options: RunOptions,
    reporter: Reporter,
) -> list[dict[str, Any]]:
    """Run ``work`` on every scene that is not done yet; write the run folder.

    Parameters
    ----------
    work : what to do with each
    config : together with the command's name and the versions it is the identity of the run folder
    scenes : what to run on, names unique
    output : the run folder

    Returns
    -------
    One row an scene of this call (of its shard; up to the first failure with ``fail_fast``), in order: ``scene``,
    ``status`` (done or failed), ``error``, facts, ``seconds`` by stage, ``peak_memory`` in bytes, ``source``.

    Raises
    ------
    ConfigError
        The folder holds another run or the result of another input of the same name, is in use, or lies
        where the inputs are.
    OutputError
        The folder cannot be used.
    IncompleteError
        Everything was computed, but the report cannot be written; or the scheduler was lost.
    """
    own = list(scenes) if options.shard is None else options.shard.of(scenes, lambda scene: work.effort(config, scene))
    _check_names(work, config, own, output)
    text = record.run_text(work.name, config)
    with FolderLock(output, options.shard is not None, reporter.info) as lock:
        earlier = {name: _measured(row) for name, row in record.read_report(output, facts=False).items()}
        if lock.alone:
            record.open_run(output, text, options.overwrite)
            _clean(output)
            if options.overwrite:
                _drop_others(output, record.digest(text.encode()), earlier, {scene.name for scene in scenes})
        lock.settle()
        run = record.join_run(output, text)
        making = output / f"{_HIDDEN}{re.sub(r'[^A-Za-z0-9-]', '_', platform.node())}-{os.getpid()}"
        rows: dict[str, dict[str, Any]] = {}
        tasks = []
        look = Inspector(work, config, output, run, options.keep)
        for number, scene in enumerate(own):
            inputs, source = look.inputs(scene)
            task = Task(scene, output, making, number, run, inputs, source, options.keep)
            before = earlier.pop(scene.name, {})
            row, known = look.finished(task, before)
            if row is not None:
                rows[scene.name] = _with_common_keys(row)
                continue
            origin = before.get("source")
            if known is not None and known.get("run") == run and origin and origin != source and not options.overwrite:
                raise ConfigError(
                    f"{output}: holds the result of another {scene.name!r}, made from {origin}; this one is "
                    f"{source}; choose another --output or --name, or --overwrite it"
                )
            tasks.append(task)
        if rows:
            reporter.info(f"{len(rows)} of {len(own)} scenes are done already")
        others = [] if options.shard is not None else _other_rows(output, run, earlier, own)
        earlier.clear()
        writer = ReportWriter(output, work.name, run, rows, own, others, options.shard)
        unclaimed: list[Task] = []
        begun: list[Task] = []

        def claim(task: Task) -> bool:
            """Nobody else makes it, or has made it since."""
            if lock.claim(task.scene.name):
                row = None if options.shard is None else look.finished(task, {})[0]
                if row is None:
                    begun.append(task)
                    return True
                rows[task.scene.name] = row
                lock.release(task.scene.name)
            else:
                unclaimed.append(task)
            reporter.step()
            return False

        try:
            with reporter, contextlib.closing(_compute(tasks, work, config, options, reporter, claim)) as computed:
                reporter.start(len(own), len(rows), work.name)
                for row in map(_with_common_keys, computed):
                    rows[row["scene"]] = row
                    lock.release(row["scene"])
                    if row["status"] == "failed":
                        reporter.error(f"{row['scene']}: {row['error']}")
                    else:
                        reporter.detail(f"{row['scene']}: {sum(row['seconds'].values()):.2f} s")
                    for line in row.pop("warnings", ()):
                        reporter.info(f"{row['scene']}: warning: {line}")
                    writer.update()
                    reporter.step(row["status"] == "failed")
                    if options.fail_fast and row["status"] == "failed":
                        reporter.info("stopped at the first failure; the same command goes on where it stopped")
                        break
        finally:
            for task in begun:  # a signal may come between an item's last file and its row
                row = None if task.scene.name in rows else look.finished(task, {})[0]
                if row is not None:
                    rows[task.scene.name] = _with_common_keys(row)
            for task in tasks:
                if task.scene.name in rows:
                    rows[task.scene.name] = _still_there(task, rows[task.scene.name])
            discard(making)
            writer.close(lock)
            if lock.alone:
                _clean(output)
        if unclaimed:
            reporter.info(f"{len(unclaimed)} scenes are being computed by other processes")
    if writer.problem:
        raise IncompleteError(writer.problem)
    return [rows[scene.name] for scene in own if scene.name in rows]


def _with_common_keys(row: dict[str, Any]) -> dict[str, Any]:
    """The row with one string a key for all rows: each comes from a file or a process, with strings of its own."""
    return {sys.intern(k): _with_common_keys(v) if isinstance(v, dict) else v for k, v in row.items()}


class Inspector:
    """Which scenes of a run are done already; it reads only.

    Parameters
    ----------
    work, config, output, run : of the run
    keep : patterns of the files that stay of an scene
    """

    def __init__(self, work: AnyWork, config: Any, output: Path, run: str, keep: tuple[str, ...]) -> None:
        self.work, self.config, self.output, self.run, self.keep = work, config, output, run, keep
        self._digests: dict[Path, str] = {}

    def inputs(self, scene: Scene) -> tuple[dict[str, str], str]:
        """What the result depends on, by role, and where it lies."""
        files = {} if scene.problem else self.work.files(self.config, scene)
        inputs = {role: self._digest(file) for role, file in files.items()}
        inputs |= {} if scene.problem else self.work.settings(self.config, scene)
        inputs |= {"keep": " ".join(self.keep)} if self.keep else {}
        return inputs, str(next(iter(files.values()), scene.folder).absolute())

    def finished(self, task: Task, measured: Mapping[str, Any]) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
        """The row of an scene that is done, and its record; None where it is not, or has none."""
        known = record.read_record(task.target)
        if known is None or not record.is_done(task.target, self.run, task.inputs, known):
            return None, known
        return row_of(known, {**measured, "source": task.source}), known

    def _digest(self, file: Path) -> str:
        """Of the last few files: calibrations and videos belong to many scenes."""
        if file not in self._digests:
            if len(self._digests) >= _REMEMBERED:
                self._digests.pop(next(iter(self._digests)))
            self._digests[file] = record.file_digest(file)
        return self._digests[file]


def _still_there(task: Task, row: dict[str, Any]) -> dict[str, Any]:
    """The row, unless what it speaks of was deleted since."""
    if row["status"] == "done" and not (task.target / record.RECORD_FILE).is_file():
        return failed_row(task, f"{task.target}: was computed, but its files have gone since")
    return row


def _check_names(work: Work[ConfigT, SceneT], config: ConfigT, scenes: Sequence[SceneT], output: Path) -> None:
    for scene in scenes:
        if any(not part or part.startswith(".") or "\0" in part for part in scene.name.split("/")):
            raise ConfigError(f"{scene.name!r} is no name for a folder of results; give one with --name")
        target = os.path.realpath(output / scene.name)  # unlike resolve() it lives with loops of links
        files = () if scene.problem else work.files(config, scene).values()
        if any(target == os.path.dirname(os.path.realpath(file)) for file in files):
            raise ConfigError(f"{output}: {scene.name} would be written over its own input; choose another --output")


def _measured(row: Mapping[str, Any]) -> dict[str, Any]:
    """What a row says that its record does not."""
    return {key: row[key] for key in ("seconds", "peak_memory", "source") if row.get(key)}


def _other_rows(
    output: Path, run: str, earlier: dict[str, dict[str, Any]], scenes: Sequence[Scene]
) -> list[dict[str, Any]]:
    """Rows of scenes that this call does not concern but that belong to the same run."""
    chosen = {scene.name for scene in scenes}
    rows = []
    for name, row in earlier.items():
        known = record.read_record(output / name) if name not in chosen and record.is_inside(name) else None
        if known is not None and known.get("run") == run:
            rows.append(row_of(known, row))
    return rows


def _clean(output: Path) -> None:
    """Remove what killed runs left."""
    for leftover in (*output.glob(f"{_HIDDEN}*"), *output.glob(".*.partial~"), output / LOCKS_FILE):
        if leftover.is_dir() and not leftover.is_symlink():
            discard(leftover)
        else:
            with contextlib.suppress(OSError):
                leftover.unlink(missing_ok=True)


def _drop_others(output: Path, run: str, earlier: dict[str, dict[str, Any]], chosen: set[str]) -> None:
    """Remove the scenes of the run that is replaced, which are those its report lists; other runs' stay."""
    for name in earlier:
        known = record.read_record(output / name) if name not in chosen and record.is_inside(name) else None
        if known is not None and known.get("run") != run:
            remove(output / name, known)


def _compute(
    tasks: list[Task],
    work: AnyWork,
    config: Any,
    options: RunOptions,
    reporter: Reporter,
    claim: Callable[[Task], bool],
) -> Generator[dict[str, Any], None, None]:
    if not tasks:
        return
    if options.scheduler is not None:
        yield from cluster.compute(tasks, work, config, options, reporter, claim)
        return
    jobs = min(options.jobs, len(tasks))
    if jobs > 1:
        yield from workers.compute(tasks, work, config, options, reporter, jobs, claim)
        return
    workers.use_threads(options.threads_each())
    compiled: Callable[[int, float], None] = workers.say_compiled(reporter)
    with workers.compile_watch(lambda: workers.say_compiling(reporter)) as watch:
        for task in tasks:
            if not claim(task):
                continue
            kernels, seconds = watch.kernels, watch.seconds
            yield run_one(task, work, config, options.memory_each())
            compiled(watch.kernels - kernels, watch.seconds - seconds)
