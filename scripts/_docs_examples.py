"""Code blocks of the documentation's Markdown pages: run in order, and what they print compared or written.

A page runs from top to bottom in an empty folder of its own. If docs/examples has a shell script of the page's name
(docs/examples/rig.sh for docs/rig.md), it runs first, and makes what the page supposes to be there.
What follows the language of a block says how it is run:

| block | what happens |
|---|---|
| ``console`` | lines behind ``$ `` are run by bash, one after the other; below each stands what it prints |
| ``sh`` | run by bash; what it prints is not shown |
| ``python`` | run in one interpreter for the whole page; what it prints stands in a ``text`` block right below |
| any, with ``file=NAME`` | written into the folder, not run |
| ``text``, ``bibtex``, ``math`` | shown |

``exit=N`` expects that exit code, and ``lines=N`` shows at most so many lines of each output. What needs a device or a
cluster is shown as ``text``: the pages are built without.
"""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

BLOCK = re.compile(
    r"^(?P<fence>```+)(?P<head>[a-z]\w*)(?P<settings>[^\n`]*)\n(?P<text>.*?)^(?P=fence)[ ]*$"
    r"(?P<output>\n\n```text\n.*?^```$)?",
    re.M | re.S,
)
SHOWN_ONLY = ("text", "bibtex", "math")
SETTINGS = {"file", "exit", "lines"}
_NOISE = re.compile(r"first use of these settings here: compiling|compiled \d+ kernels in ")
_MEASURED = re.compile(r"\b\d+(?:\.\d+)? (?:s|ms|min|kB|MB|MiB|GiB)\b|\d{4}-\d\d-\d\d[T ][\d:.]+")
_NUMBER = re.compile(r"\d+(?:\.\d+)?|\.\d+")
_VOLATILE = {"seconds", "memory"}  # headings of columns that differ from run to run
_INTERPRETER = """
import contextlib, io, json, sys, traceback
names = {"__name__": "__main__"}
for line in sys.stdin:
    printed, failed = io.StringIO(), False
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        try:
            exec(compile(json.loads(line), "page", "exec"), names)
        except BaseException:
            failed = True
            traceback.print_exc()
    print(json.dumps([failed, printed.getvalue()]), flush=True)
"""


class ExampleError(Exception):
    """An example of a page that fails, or a block that nothing would run."""


def environment(folder: Path) -> dict[str, str]:
    """Return the environment of examples: this checkout's code, and its program, which is written into a folder."""
    root, program = Path(__file__).resolve().parent.parent, folder / "bin" / "depthcli"
    program.parent.mkdir(parents=True, exist_ok=True)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m depthcli "$@"\n', "utf-8")
    program.chmod(0o755)
    path = os.pathsep.join([*map(str, (program.parent, Path(sys.executable).parent)), os.environ["PATH"]])
    return os.environ | {"PATH": path, "PYTHONPATH": os.pathsep.join(map(str, (root, root / "docs" / "examples")))}


def same_output(shown: str, printed: str) -> bool:
    """Return whether two outputs agree up to seconds, memory, and 2 % of other numbers."""
    first, second = (list(_comparable(text.splitlines())) for text in (shown, printed))
    return len(first) == len(second) and all(map(_same_line, first, second))


def _comparable(lines: Sequence[str]) -> Iterator[str]:
    """Yield lines without the cells of volatile columns."""
    columns: list[int] = []
    for line in lines:
        cells = re.split(r" {2,}", line.strip())
        if _VOLATILE & set(cells):
            columns = [len(cells) - k for k, cell in enumerate(cells) if cell in _VOLATILE]
        elif len(cells) < 2:
            columns = []
        kept = [cell for k, cell in enumerate(cells) if len(cells) - k not in columns]
        yield _MEASURED.sub("", " ".join(kept))


def _same_line(first: str, second: str) -> bool:
    pairs = zip(_NUMBER.findall(first), _NUMBER.findall(second), strict=False)
    close = all(math.isclose(float(a), float(b), rel_tol=0.02, abs_tol=0.021) for a, b in pairs)
    return _NUMBER.sub("#", first) == _NUMBER.sub("#", second) and close


@dataclass
class Page:
    """One Markdown page and the folder that its blocks run in."""

    name: str  # for messages
    text: str
    folder: Path  # empty, or not there yet
    setup: Path | None = None  # shell script that is run first, if it exists
    _interpreter: subprocess.Popen[str] | None = field(default=None, init=False)

    def run(self) -> str:
        """Run all blocks and return the page with their output; ExampleError where one ends as it should not."""
        indented = re.search(r"^ +```+[a-z]", BLOCK.sub("", self.text), re.M)
        if indented is not None:
            raise ExampleError(f"{self.name}: a block is indented, {indented[0].strip()}: it would not be run")
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        try:
            if self.setup is not None and self.setup.is_file():
                self._shell(str(self.setup), self.setup.read_text("utf-8"), 0)
            return BLOCK.sub(self._block, self.text)
        finally:
            if self._interpreter is not None:
                self._interpreter.communicate()

    def _block(self, found: re.Match[str]) -> str:
        language, text, place = found["head"], found["text"], self._place(found)
        settings = dict(word.partition("=")[::2] for word in found["settings"].split())
        output = found["output"] or ""
        if unknown := settings.keys() - SETTINGS:
            raise ExampleError(f"{place}: unknown setting {', '.join(sorted(unknown))}")
        if "file" in settings:
            file = self.folder / settings["file"]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, "utf-8")
        elif language not in SHOWN_ONLY:
            text, output = self._run(language, text, place, settings, output)
        return f"{found['fence']}{language}{found['settings']}\n{text}{found['fence']}{output}"

    def _run(self, language: str, text: str, place: str, settings: dict[str, str], output: str) -> tuple[str, str]:
        """Run a block; return its text and the block of output below it."""
        most, code = int(settings.get("lines", 40)), int(settings.get("exit", 0))
        if language == "console":
            return "".join(self._console(place, text, most, code)), output
        if language == "sh":
            self._shell(place, text, code)
            return text, output
        if language != "python":
            raise ExampleError(f"{place}: a block of {language} is neither run nor written to a file=NAME")
        printed = self._clean(self._python(place, text), most)
        return text, f"\n\n```text\n{printed}```" if printed else output

    def _console(self, place: str, text: str, most: int, code: int) -> Iterator[str]:
        commands = re.findall(r"^\$ ((?:.*\\\n)*.*)\n", text, re.M)
        if not commands:
            raise ExampleError(f"{place}: no line begins with '$ '")
        for number, command in enumerate(commands):
            wanted = code if number == len(commands) - 1 else 0
            yield f"$ {command}\n{self._clean(self._shell(place, command, wanted), most)}"

    def _shell(self, place: str, text: str, wanted: int) -> str:
        done = subprocess.run(
            ["bash", "-eu", "-o", "pipefail", "-c", text], cwd=self.folder, env=self._environment(), text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, errors="replace", check=False,
        )  # fmt: skip
        if done.returncode != wanted:
            raise ExampleError(f"{place}: exit code {done.returncode}, not {wanted}:\n{text}\n{done.stdout}")
        return done.stdout

    def _python(self, place: str, text: str) -> str:
        if self._interpreter is None:
            self._interpreter = subprocess.Popen(
                [sys.executable, "-c", _INTERPRETER], cwd=self.folder, env=self._environment(), text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        assert self._interpreter.stdin is not None and self._interpreter.stdout is not None
        self._interpreter.stdin.write(json.dumps(text) + "\n")
        self._interpreter.stdin.flush()
        answer = self._interpreter.stdout.readline()
        failed, printed = json.loads(answer) if answer else (True, "the interpreter ended")
        if failed:
            raise ExampleError(f"{place}:\n{text}\n{printed}")
        return str(printed)

    def _environment(self) -> dict[str, str]:
        return os.environ | {"COLUMNS": "100", "MPLBACKEND": "agg", "NO_COLOR": "1", "TERM": "dumb"}

    def _clean(self, output: str, most: int) -> str:
        """What a command printed, without the folder's place and what is printed on the first run only."""
        lines = [line.rstrip() for line in output.splitlines() if not _NOISE.match(line)]
        if len(lines) > most:
            lines = [*lines[:most], "..."]
        text = "\n".join(lines).replace(str(self.folder), "/home/you/depth")
        return f"{text}\n" if text.strip() else ""

    def _place(self, found: re.Match[str]) -> str:
        return f"{self.name}:{self.text.count(chr(10), 0, found.start()) + 1}"


def outputs(text: str) -> list[str]:
    """Return the blocks of a page with what is below them, in order."""
    return [found[0] for found in BLOCK.finditer(text)]
