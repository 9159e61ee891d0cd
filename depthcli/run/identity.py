"""Whether a folder holds the run that a ``run.yaml`` describes, or another one."""

from __future__ import annotations

import os
from pathlib import Path

from depthcli.io.formats.files import RUN_FILE
from depthcli.run.records import RECORD_FILE, read_record, read_text

TITLE = "# Written by depthcli: the resolved config of this run."
"""How a run.yaml begins; a file of that name without it is not ours."""


def saved_config(folder: Path) -> str:
    """Return the text of a run folder's ``run.yaml``; empty where it is missing or cannot be read."""
    return read_text(folder / RUN_FILE)


def refusal(folder: Path, text: str) -> str:
    """Return why a folder holds another run than ``text``, which only ``--overwrite`` replaces; or empty."""
    known = saved_config(folder)
    if not os.path.lexists(folder / RUN_FILE) or known == text or not holds_results(folder):
        return ""
    if not known:
        return f"holds a run made with another config (its {RUN_FILE} cannot be read)"
    old, new = known.splitlines(), text.splitlines()
    removed = [line.strip() for line in old if line not in new and not line.startswith("#")]
    added = [line.strip() for line in new if line not in old and not line.startswith("#")]
    changes = f"it says {'; '.join(removed[:3])!r}, this run {'; '.join(added[:3])!r}"
    return f"holds a run made with another config ({changes})"


def holds_results(folder: Path) -> bool:
    """Return whether a scene of the run is done, or its record is damaged; evaluations and runs below do not count."""
    deeper = (path for path in folder.glob(f"*/*/{RECORD_FILE}") if not (path.parents[1] / RUN_FILE).exists())
    records = (read_record(path.parent) for paths in (folder.glob(f"*/{RECORD_FILE}"), deeper) for path in paths)
    return any(record is None or (record.scene and record.row.get("status") == "done") for record in records)
