"""What a run would do, without doing it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from depthcli.batch import record
from depthcli.batch.command import ConfigT, SceneT
from depthcli.batch.making import RunOptions, Task, Work
from depthcli.batch.runner import Inspector
from depthcli.batch.tables import aligned
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import InputError
from depthcli.core.memory import show_bytes
from depthcli.data.formats.headers import image_size

DONE, TO_DO, BROKEN = "done, kept", "to do", "cannot be used"


def plan(
    work: Work[ConfigT, SceneT],
    config: ConfigT,
    scenes: Sequence[SceneT],
    output: Path,
    memory: Callable[[ConfigT, SceneT], int | None],
    options: RunOptions,
) -> dict[str, Any]:
    """What :func:`~depthcli.batch.runner.run_scenes` would do with the same arguments; nothing is written.

    Parameters
    ----------
    memory : gives the estimate of an item's peak working memory, bytes, or None

    Returns
    -------
    ``config``, ``refused`` (why the folder would be refused, or empty) and ``scenes``: a row an scene
    """
    text = record.run_text(work.name, config)
    run = record.digest(text.encode())
    other = record.holds_another(output, text)
    look = Inspector(work, config, output, run, options.keep)
    rows = []
    own = scenes if options.shard is None else options.shard.of(scenes, lambda scene: work.effort(config, scene))
    for scene in own:
        row: dict[str, Any] = {"scene": scene.name, "status": BROKEN, "memory": None, "problem": scene.problem}
        if not scene.problem:
            task = Task(scene, output, output, 0, run, *look.inputs(scene))
            row["status"] = TO_DO if look.finished(task, {})[0] is None else DONE
            try:
                row["memory"] = memory(config, scene)
            except InputError as error:
                row |= {"status": BROKEN, "problem": str(error)}
        rows.append(row)
    refused = f"{output}: holds a run made with another config; it would want --overwrite" if other else ""
    values = config.model_dump(mode="json", by_alias=True) if isinstance(config, BaseModel) else dict(config)
    about = {"command": work.name, "config": values, "output": str(output), "refused": refused}
    return {**about, "scenes": rows}


def plan_text(document: dict[str, Any], config: BaseModel | Mapping[str, object]) -> str:
    """The same for people."""
    rows = document["scenes"]
    lines = [("scene", "status", "memory", "")]
    for row in rows:
        memory = show_bytes(row["memory"]) if row["memory"] is not None else "-"
        lines.append((row["scene"], row["status"], memory, row["problem"]))
    counts = ", ".join(
        f"{sum(row['status'] == status for row in rows)} {status}"
        for status in (DONE, TO_DO, BROKEN)
        if any(row["status"] == status for row in rows)
    )
    notes = [f"{len(rows)} scenes: {counts}", *filter(None, [document["refused"]]), "nothing was computed"]
    text = dump_config(config) if isinstance(config, BaseModel) else to_yaml(dict(config))
    return "\n".join([text, aligned(lines), "", *notes]) + "\n"


def shape_of(file: Path) -> tuple[int, int]:
    """(height, width) of an image, from its header."""
    size = image_size(file)
    return size.height, size.width
