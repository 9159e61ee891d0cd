"""What a run has to compute: its scenes and those of one shard, which of them are done, and what stands in the way.

Nothing here writes; ``--dry-run`` prints what it finds.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pydantic import BaseModel

from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.text import show_bytes
from depthcli.io.formats.files import ends_of_file
from depthcli.io.inputs import origin
from depthcli.io.scenes import Scene
from depthcli.run.command import ConfigT, SceneCommand, SceneT
from depthcli.run.console import aligned
from depthcli.run.install import OTHER_RUN, foreign_results, not_ours
from depthcli.run.json_csv import Row
from depthcli.run.records import Record, file_digest, read_record
from depthcli.run.reports import finished_row
from depthcli.run.run_folder import refusal, saved_config
from depthcli.run.task import Run, RunOptions, Task

# Digests that are remembered: calibrations and videos belong to several scenes that follow each other.
_MAX_REMEMBERED = 16
DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"


def scenes_of_shard(
    command: SceneCommand[ConfigT, SceneT], config: ConfigT, scenes: Sequence[SceneT], options: RunOptions
) -> list[SceneT]:
    """Return the scenes that this process computes: those of its shard, or all."""
    if options.shard is None:
        return list(scenes)
    return options.shard.of(scenes, lambda scene: command.effort(config, scene))


def check_names(run: Run, scenes: Sequence[Scene], output: Path) -> None:
    """Raise ConfigError where a scene's name cannot name a folder, or its folder is a link or holds its own input."""
    for scene in scenes:
        if any(not part or part.startswith(".") or "\0" in part for part in scene.name.split("/")):
            raise ConfigError(f"{scene.name!r} is no name for a folder of results; choose another name for the scene")
        target = os.path.realpath(output / scene.name)  # Path.resolve() raises for loops of links, realpath does not
        files = () if scene.problem else run.command.files(run.config, scene).values()
        if any(target == os.path.dirname(os.path.realpath(file)) for file in files):
            raise ConfigError(f"{output}: {scene.name} would be written over its own input; choose another --output")
        if target != os.path.join(os.path.realpath(output), *scene.name.split("/")):
            raise ConfigError(f"{output}: {scene.name} is a link to {target}; give the folder that it leads to instead")


def check_files(run: Run, scenes: Sequence[Scene], output: Path) -> None:
    """Raise ConfigError where results would replace a scene of another run, or files that no run wrote.

    In a folder of this very run they may be results whose record was lost: these are compared when they are computed.
    """
    identity, text = run.identity, run.text
    for scene in scenes if not run.options.overwrite else []:
        if (known := read_record(output, scene.name)) is not None and known.run != identity:
            raise ConfigError(f"{output / scene.name}: {OTHER_RUN}")
    foreign = [
        f"{scene.name}/{name}"
        for scene in (scenes if saved_config(output) != text else [])
        for name in foreign_results(output / scene.name, run.command.results)
    ]
    if foreign:
        raise ConfigError(f"{output}: {not_ours(foreign)}")


def inputs_digest(run: Run, scenes: Sequence[Scene]) -> str:
    """Return a digest of the inputs of all shards: names of scenes, sizes and ends of files, but not their folders."""
    sha = hashlib.sha256()
    for scene in sorted(scenes, key=lambda scene: scene.name):
        files = {} if scene.problem else run.command.files(run.config, scene)
        sha.update(repr((scene.name, [(role, ends_of_file(file)) for role, file in sorted(files.items())])).encode())
    return sha.hexdigest()


class Planner:
    """Makes the tasks of a run, and finds those whose results are there."""

    def __init__(self, run: Run, output: Path) -> None:
        self.run, self.output, self.identity = run, output, run.identity
        self._digests: dict[Path, str] = {}

    def task(self, scene: Scene, workspace: Path, number: int) -> Task:
        """Return the task that computes a scene, with the digests of all that its result depends on."""
        command, config, keep = self.run.command, self.run.config, self.run.options.keep
        files = {} if scene.problem else command.files(config, scene)
        inputs = {role: self._digest(file) for role, file in files.items()}
        inputs |= {} if scene.problem else command.settings(config, scene)
        inputs |= {"keep": " ".join(keep)} if keep else {}
        source = origin(next(iter(files.values()), scene.folder).absolute())
        return Task(scene, self.output, workspace, number, self.identity, inputs, source)

    def finished(self, task: Task, measured: Mapping[str, object]) -> tuple[Row | None, Record | None]:
        """Return the row of a scene that is done, and its record; None where it is not done, or has no record."""
        known = read_record(task.target)
        if known is None or not known.is_done(task.target, task.run, task.inputs):
            return None, known
        return finished_row(known, {**measured, "source": task.source}), known

    def _digest(self, file: Path) -> str:
        if file not in self._digests:
            if len(self._digests) >= _MAX_REMEMBERED:
                self._digests.pop(next(iter(self._digests)))
            self._digests[file] = file_digest(file)
        return self._digests[file]


def plan_document(
    command: SceneCommand[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    memory: Callable[[ConfigT, SceneT], int | None],
    options: RunOptions,
) -> Row:
    """Return what :func:`~depthcli.run.runner.run_scenes` would do with the same arguments.

    Parameters
    ----------
    memory : estimates the peak memory of a scene, bytes, or None

    Returns
    -------
    ``config``, ``refused`` (why the folder would be refused, or empty) and ``scenes``, one row per scene
    """
    run = Run.of(command, config, scenes, options)
    planner, own = Planner(run, output), scenes_of_shard(command, config, scenes, options)
    rows = []
    for scene in own:
        row: Row = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            row["status"] = TO_DO if planner.finished(planner.task(scene, output, 0), {})[0] is None else DONE
            try:
                row["memory"] = memory(config, scene)
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    refused = f"{output}: holds a run made with another config; needs --overwrite" if refusal(output, run.text) else ""
    try:
        check_files(run, own, output)
    except ConfigError as error:
        refused = refused or str(error)
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    return {"command": command.name, "config": values, "output": str(output), "refused": refused, "scenes": rows}


def plan_text(document: Row, config: BaseModel | Mapping[str, object]) -> str:
    """Return a plan as the text that ``--dry-run`` prints: config, table of scenes, counts."""
    rows = document["scenes"]
    lines = [("scene", "status", "memory", "")]
    for row in rows:
        memory = show_bytes(row["memory"]) if row["memory"] is not None else "-"
        lines.append((row["scene"], row["status"], memory, row["problem"]))
    counts = {status: sum(row["status"] == status for row in rows) for status in (DONE, TO_DO, BROKEN)}
    summary = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
    notes = [f"{len(rows)} scenes: {summary}", *filter(None, [document["refused"]]), "nothing was computed"]
    text = dump_config(config) if isinstance(config, BaseModel) else to_yaml(dict(config))
    return "\n".join([text, aligned(lines), "", *notes]) + "\n"
