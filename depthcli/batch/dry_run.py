"""What a run would do, without doing it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from pydantic import BaseModel

from depthcli.batch.command import ConfigT, SceneT
from depthcli.batch.console import aligned
from depthcli.batch.json_csv import Row
from depthcli.batch.run_folder import holds_another, run_text
from depthcli.batch.runner import Inspector, scenes_of_shard
from depthcli.batch.task import Run, RunOptions, SceneCommand
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import InputError
from depthcli.core.memory import show_bytes

DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"


def plan(
    work: SceneCommand[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    memory: Callable[[ConfigT, SceneT], int | None],
    options: RunOptions,
) -> Row:
    """Return what :func:`~depthcli.batch.runner.run_scenes` would do with the same arguments; write nothing.

    Parameters
    ----------
    memory : estimates the peak memory of a scene, bytes, or None

    Returns
    -------
    ``config``, ``refused`` (why the folder would be refused, or empty) and ``scenes``, one row per scene
    """
    inspector = Inspector(Run(work, config, options), output)
    rows = []
    for scene in scenes_of_shard(work, config, scenes, options):
        row: Row = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            row["status"] = TO_DO if inspector.finished(inspector.task(scene, output, 0), {})[0] is None else DONE
            try:
                row["memory"] = memory(config, scene)
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    other = holds_another(output, run_text(work.name, config))
    refused = f"{output}: holds a run made with another config; needs --overwrite" if other else ""
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    return {"command": work.name, "config": values, "output": str(output), "refused": refused, "scenes": rows}


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
