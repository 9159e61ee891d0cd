"""The tool, called in the process of the tests, and what its report says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from depthcli.cli import main


def run(*arguments: str | Path) -> int:
    return main([str(a) for a in arguments])


def rows(output: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a run's report by the names of their scenes."""
    return {row["scene"]: row for row in json.loads((output / "report.json").read_text())["scenes"]}


def statuses(output: Path) -> dict[str, str]:
    """Return what became of each scene of a run, by its name."""
    return {name: row["status"] for name, row in rows(output).items()}
