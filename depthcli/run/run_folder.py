"""The folder of a run: ``run.yaml``, which says what the run is, and whether a run may be written into a folder.

The bytes in a run folder do not depend on interruptions or on the number of threads; only ``report.json`` and
``report.csv`` differ from run to run, by measured seconds and memory and by the paths of the inputs.
"""

from __future__ import annotations

import contextlib
import os
import platform
import re
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path

from pydantic import BaseModel

from depthcli import __version__
from depthcli.core.config_file import dump_config, to_yaml
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.registry import Plugin, versions_here
from depthcli.run.install import not_ours
from depthcli.run.records import RECORD_FILE, RUN_FILE, digest, read_record, read_text
from depthcli.run.reports import REPORT_FILES, read_report

LEGEND_FILE = "legend.png"
# Packages whose versions decide what a run computes; part of the run's identity.
_LIBRARIES = ("numpy", "numba", "opencv-contrib-python-headless", "scikit-image", "PyMaxflow")
# The first line of a run.yaml begins with this; a file of that name without it is not ours.
_TITLE = "# Written by depthcli: the resolved config of this run."


def run_text(command: str, config: BaseModel | Mapping[str, object], plugins: Iterable[Plugin] = ()) -> str:
    """Return the text of ``run.yaml``: the resolved config, which can be used as CONFIG again, and all versions.

    The versions of ``plugins`` are those of this process.
    """
    versions = {"depthcli": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    run = to_yaml({"run": {"command": command, "versions": versions | versions_here(plugins)}})
    if isinstance(config, BaseModel):
        return f"{_TITLE} Repeat it with: depthcli {command} run.yaml ...\n{dump_config(config)}{run}"
    return f"{_TITLE}\n{to_yaml(dict(config))}{run}"


def check_folder(folder: Path, text: str, overwrite: bool) -> None:
    """Raise ConfigError where a folder cannot become that of the run whose ``run.yaml`` has this text.

    It holds results of another config, and ``overwrite`` is not set; or files that no run wrote have the names of a
    run's.
    """
    if (reason := refusal(folder, text)) and not overwrite:
        raise ConfigError(f"{folder}: {reason}; choose another --output, or --overwrite it")
    if not saved_config(folder).startswith(_TITLE) and not _holds_results(folder):
        names = (RUN_FILE, *REPORT_FILES, LEGEND_FILE)
        foreign = [name for name in names if os.path.lexists(folder / name)]
        foreign += sorted(path.name for path in folder.glob("traceback-*.txt"))
        if foreign:
            raise ConfigError(f"{folder}: {not_ours(foreign)}")


def refusal(folder: Path, text: str) -> str:
    """Return why a folder holds another run than ``text``, which only ``--overwrite`` replaces; or empty."""
    known = saved_config(folder)
    if not os.path.lexists(folder / RUN_FILE) or known == text or not _holds_results(folder):
        return ""
    if not known:
        return f"holds a run made with another config (its {RUN_FILE} cannot be read)"
    old, new = known.splitlines(), text.splitlines()
    removed = [line.strip() for line in old if line not in new and not line.startswith("#")]
    added = [line.strip() for line in new if line not in old and not line.startswith("#")]
    changes = f"it says {'; '.join(removed[:3])!r}, this run {'; '.join(added[:3])!r}"
    return f"holds a run made with another config ({changes})"


def _holds_results(folder: Path) -> bool:
    if any(row["status"] == "done" for row in read_report(folder).values()):
        return True
    records = (read_record(path.parent) for path in folder.glob(f"*/{RECORD_FILE}"))
    if any(record is None or record.scene for record in records):  # without a scene it is an evaluation's
        return True
    deeper = (path.parents[1] for path in folder.glob(f"*/*/{RECORD_FILE}"))
    return any(not (group / RUN_FILE).exists() for group in deeper)  # with a run.yaml it is a run of its own


def opened_run(folder: Path) -> tuple[str, str]:
    """Return identity and command of the run that a folder holds; InputError where it holds none."""
    text = saved_config(folder)
    command = re.search(r"^run:\n  command: (\S+)$", text, re.MULTILINE)
    if command is None:
        raise InputError(f"{folder}: no run there ({RUN_FILE})")
    return digest(text.encode()), command[1]


def saved_config(folder: Path) -> str:
    """Return the text of a run folder's ``run.yaml``; empty where it is missing or cannot be read."""
    return read_text(folder / RUN_FILE)
