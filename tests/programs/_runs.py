"""Runs of programs: their rows, and what a scene leaves whose program failed."""

from __future__ import annotations

import json
from pathlib import Path


def rows(run: Path) -> dict[str, dict]:
    """Return scene -> its row of the report."""
    return {row["scene"]: row for row in json.loads((run / "report.json").read_text())["scenes"]}


def assert_one_failed(here: Path, scene: str, statuses: list[str], why: str, image: str) -> None:
    """Assert that in ``here/run`` only ``scene`` failed, for a reason that says ``why`` and where its files are kept.

    Parameters
    ----------
    statuses : of all scenes, in their order
    image : name of a file that the program was given
    """
    found = rows(here / "run")
    assert [row["status"] for row in found.values()] == statuses
    assert why in found[scene]["error"]
    (kept,) = (here / "scratch").iterdir()
    assert str(kept) in found[scene]["error"]
    assert (kept / image).is_file()
    assert not list((here / "run").glob("traceback*"))
