"""Code blocks of the documentation's Markdown pages: run in order, with what they print and draw put into the page.

A page runs from top to bottom in an empty folder of its own. What follows the language of a block says how:

| block | what happens |
|---|---|
| ``console`` | lines behind ``$ `` are run by bash, one after the other; the page shows them with what they print |
| ``sh`` | run by bash; the page shows the commands alone |
| ``python`` | run in one interpreter for the whole page; what it prints is shown below |
| any, with ``file=NAME`` | written into the folder, not run |
| ``text``, ``bibtex``, ``math`` | shown |

``hidden`` runs a block without showing it, ``exit=N`` expects that exit code, ``lines=N`` shows at most so many lines
of each output, ``needs=opencl`` runs it only where such a device works. An image of the page whose file the blocks
wrote is taken from the folder.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.device import devices, why_no_device

BLOCK = re.compile(
    r"^(?P<fence>```+)(?P<head>[a-z]\w*)(?P<settings>[^\n`]*)\n(?P<text>.*?)^(?P=fence)[ ]*$", re.M | re.S
)
IMAGE = re.compile(r"(!\[[^\]]*\]\()([^)\s]+\.(?:png|svg))(\))")
SHOWN_ONLY = ("text", "bibtex", "math")
_NOISE = re.compile(r"first use of these settings here: compiling|compiled \d+ kernels in ")
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


@dataclass
class Page:
    """One Markdown page and the folder that its blocks run in."""

    name: str  # for messages
    text: str
    folder: Path  # empty, or not there yet
    pictures: Path  # where images that the blocks write are copied to
    link: str  # the same folder as the page's text has to name it
    _interpreter: subprocess.Popen[str] | None = field(default=None, init=False)

    def run(self) -> str:
        """Run all blocks and return the page with their output; ExampleError where one ends as it should not."""
        indented = re.search(r"^ +```+[a-z]", BLOCK.sub("", self.text), re.M)
        if indented is not None:
            raise ExampleError(f"{self.name}: a block is indented, {indented[0].strip()}: it would not be run")
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        try:
            text = BLOCK.sub(self._block, self.text)
        finally:
            if self._interpreter is not None:
                self._interpreter.communicate()
        return IMAGE.sub(self._image, text)

    def _block(self, found: re.Match[str]) -> str:
        language, text = found["head"], found["text"]
        settings = dict(word.partition("=")[::2] for word in found["settings"].split())
        unknown = settings.keys() - {"file", "hidden", "exit", "lines", "needs"}
        if unknown:
            raise ExampleError(f"{self._place(found)}: unknown setting {', '.join(sorted(unknown))}")
        if "file" in settings:
            file = self.folder / settings["file"]
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, "utf-8")
            shown = f"```{{code-block}} {language}\n:caption: {settings['file']}\n\n{text}```"
        elif language in SHOWN_ONLY:
            return found[0]
        elif "needs" in settings and not any(info.address.startswith(settings["needs"]) for info in devices()):
            print(f"  {self._place(found)}: not run, {why_no_device()}", file=sys.stderr)
            shown = f"```{language}\n{text}```"
        elif language == "console":
            lines = "".join(self._console(found, text, settings))
            shown = f"```console\n{lines}```"
        elif language == "sh":
            self._shell(found, text, int(settings.get("exit", 0)))
            shown = f"```sh\n{text}```"
        elif language == "python":
            output = self._clean(self._python(found, text), settings)
            shown = f"```python\n{text}```" + (f"\n\n```text\n{output}```" if output else "")
        else:
            raise ExampleError(f"{self._place(found)}: a block of {language} is neither run nor written to a file=NAME")
        return "" if "hidden" in settings else shown

    def _console(self, found: re.Match[str], text: str, settings: dict[str, str]) -> Iterator[str]:
        commands = re.findall(r"^\$ ((?:.*\\\n)*.*)\n", text, re.M)
        if not commands:
            raise ExampleError(f"{self._place(found)}: no line begins with '$ '")
        for number, command in enumerate(commands):
            wanted = int(settings.get("exit", 0)) if number == len(commands) - 1 else 0
            yield f"$ {command}\n{self._clean(self._shell(found, command, wanted), settings)}"

    def _shell(self, found: re.Match[str], text: str, wanted: int) -> str:
        done = subprocess.run(
            ["bash", "-eu", "-o", "pipefail", "-c", text], cwd=self.folder, env=self._environment(), text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, errors="replace", check=False,
        )  # fmt: skip
        if done.returncode != wanted:
            problem = f"exit code {done.returncode}, not {wanted}:\n{text}\n{done.stdout}"
            raise ExampleError(f"{self._place(found)}: {problem}")
        return done.stdout

    def _python(self, found: re.Match[str], text: str) -> str:
        if self._interpreter is None:
            self._interpreter = subprocess.Popen(
                [sys.executable, "-c", _INTERPRETER], cwd=self.folder, env=self._environment(), text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        self._interpreter.stdin.write(json.dumps(text) + "\n")
        self._interpreter.stdin.flush()
        answer = self._interpreter.stdout.readline()
        failed, printed = json.loads(answer) if answer else (True, "the interpreter ended")
        if failed:
            raise ExampleError(f"{self._place(found)}:\n{text}\n{printed}")
        return str(printed)

    def _environment(self) -> dict[str, str]:
        return os.environ | {"COLUMNS": "100", "MPLBACKEND": "agg", "NO_COLOR": "1", "TERM": "dumb"}

    def _clean(self, output: str, settings: dict[str, str]) -> str:
        """What a command printed, without the folder's place and what is printed on the first run only."""
        lines = [line for line in output.splitlines() if not _NOISE.match(line)]
        most = int(settings.get("lines", 40))
        if len(lines) > most:
            lines = [*lines[:most], "..."]
        text = "\n".join(lines).replace(str(self.folder), "/home/you/depth")
        return f"{text}\n" if text.strip() else ""

    def _image(self, found: re.Match[str]) -> str:
        made = self.folder / found[2]
        if not made.is_file():
            return found[0]
        copy = found[2].replace("/", "_")
        self.pictures.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(made, self.pictures / copy)
        return f"{found[1]}{self.link}/{copy}{found[3]}"

    def _place(self, found: re.Match[str]) -> str:
        return f"{self.name}:{self.text.count(chr(10), 0, found.start()) + 1}"
