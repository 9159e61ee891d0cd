"""What a run is: the text of its ``run.yaml``, and whether a folder holds the run of another one."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core.config_file import dump_config
from depthcli.core.registry import Plugin, versions_here
from depthcli.core.yaml_source import to_yaml
from depthcli.io.formats.files import RUN_FILE
from depthcli.run.records import RECORD_FILE, read_record, read_text

TITLE = "# Written by depthcli: the resolved config of this run."
"""How a run.yaml begins; a file of that name without it is not ours."""

# Packages whose versions decide what a run computes; part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")


def run_text(command: str, config: BaseModel | Mapping[str, object], plugins: Iterable[Plugin] = ()) -> str:
    """Return the text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions."""
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    run = to_yaml({"run": {"command": command, "versions": versions | versions_here(plugins)}})
    if isinstance(config, BaseModel):
        return f"{TITLE} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
    return f"{TITLE}\n{to_yaml(dict(config))}{run}"


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
