"""What every command promises."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path

from depthcli.cli import main
from depthcli.run.records import RECORD_FILE
from depthcli.run.reports import REPORT_FILES

_WIDTH = 79


def check_command(command: Callable[..., int], arguments: Sequence[str | Path], folder: Path) -> None:
    """Raise AssertionError unless a command has a help that fits, and its runs give the same bytes again.

    The command must be known by its name: ours, of an installed package, or of a file that was read.

    Parameters
    ----------
    command : what is tested
    arguments : of a call that succeeds, without ``--output``
    folder : an empty folder to write into
    """
    name = command.__name__.replace("_", "-")
    code, text = _run([name, "--help"])
    assert code == 0, f"--help exits with {code}"
    long = [line for line in text.splitlines() if len(line) > _WIDTH]
    assert not long, f"a line of the help has more than {_WIDTH} characters: {long[0]}"
    if "--output" not in text:
        code, _ = _run([name, *arguments])
        assert code == 0, f"{name} exits with {code}"
        return
    once, twice = folder / "once", folder / "twice"
    for output in (once, twice):
        code, _ = _run([name, *arguments, "--output", output, "--quiet"])
        assert code == 0, f"{name} exits with {code}"
    first, times = _files(once), _times(once)
    assert first == _files(twice), f"the same run gives other files: {_different(first, _files(twice))}"
    assert any(path.name == RECORD_FILE for path in once.rglob("*")), "no scene was computed"
    code, _ = _run([name, *arguments, "--output", once, "--quiet"])
    assert code == 0, f"{name}, resumed, exits with {code}"
    assert _times(once) == times, "a run that is resumed writes scenes again that are done"


def _run(words: Sequence[str | Path]) -> tuple[int, str]:
    """Exit code and standard output of one call."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = main([str(word) for word in words])
    return code, out.getvalue()


def _results(folder: Path) -> list[Path]:
    """The files of scenes; records and reports also hold measured times."""
    others = (RECORD_FILE, *REPORT_FILES)
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in others)


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in _results(folder)}


def _times(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in _results(folder) if path.parent != folder}


def _different(a: dict[str, bytes], b: dict[str, bytes]) -> str:
    return ", ".join(sorted(name for name in {*a, *b} if a.get(name) != b.get(name)))
