"""What every case needs: running a command, and comparing what it left."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

REPORTS = {"report.json", "report.csv", "legend.png"}  # of measured times, paths, and that a scene was done


class Fault(Exception):  # noqa: N818
    """A case whose outcome is not allowed."""


def run(*arguments: str | Path) -> tuple[int, str]:
    """Return the exit code and the output of one command."""
    from depthcli.cli import main as depthcli

    output_text = io.StringIO()
    with contextlib.redirect_stdout(output_text), contextlib.redirect_stderr(output_text):
        try:
            code = depthcli([str(argument) for argument in arguments])
        except SystemExit as error:
            code = int(error.code or 0)
    return code, output_text.getvalue()


def checked(allowed: Sequence[int], what: str, *arguments: str | Path) -> tuple[int, str]:
    """Return exit code and outcome of a command; Fault where it ends otherwise, by a bug, or with a traceback."""
    code, text = run(*arguments, "-q")
    outcome = f"{what}: {arguments[0]}: exit code {code}: {' / '.join(text.splitlines()[-4:])}"
    if code not in allowed or "Traceback" in text or "a bug in depthcli" in text or "Warning" in text:
        raise Fault(outcome)
    if not text.replace("\n", "").isprintable():
        raise Fault(f"{what}: {arguments[0]}: exit code {code}: not printable: {text[-300:]!r}")
    return code, outcome


def content(folder: Path, without: str = "") -> dict[str, str]:
    """Return relative path -> digest of every regular file, mode of everything else, but for those of one beginning."""
    found = {}
    for parent, folders, files in os.walk(folder):
        for path in (Path(parent, name) for name in (*folders, *files)):
            regular = path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 30
            text = hashlib.sha256(path.read_bytes()).hexdigest() if regular else oct(path.lstat().st_mode)
            found[str(path.relative_to(folder))] = text
    return {name: text for name, text in found.items() if not without or not name.startswith(without)}


def results(folder: Path) -> dict[str, str]:
    """Return the content of a run folder, but for its reports."""
    return {name: text for name, text in content(folder).items() if name not in REPORTS}


def made_base(folder: Path) -> None:
    """Write two scenes, a run over them, and a scene of every other kind."""
    sizes, larger = ("--width", "64", "--height", "48"), ("--width", "128", "--height", "96")
    for arguments in (
        ("sample", "-o", folder / "in", "-n", "2", *sizes, "--max-disparity", "8"),
        ("sample", "-o", folder / "other", "-n", "2", "--noise", "3", *sizes, "--max-disparity", "8"),
        ("sample", "-o", folder / "kinect", "--kinect", "--frames", "0", *larger),
        ("sample", "-o", folder / "transparent", "--transparent", *larger),
        ("stereo", "opencv-bm", "-i", folder / "in", "-o", folder / "run"),
    ):
        code, output_text = run(*arguments, "-q")
        if code:
            raise SystemExit(f"{arguments[0]} of intact scenes failed: {output_text}")


def chosen(rng: np.random.Generator, values: Sequence[str]) -> str:
    return values[int(rng.integers(len(values)))]
