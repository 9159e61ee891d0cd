"""The part of a config that says which program to run, and the folder that it runs in."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
import shlex
import shutil
import string
import tempfile
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator

from depthcli.core.errors import ConfigError
from depthcli.core.result import Clock
from depthcli.io.formats.files import write_text
from depthcli.kernels.jit import n_threads
from depthcli.programs.process import ProgramError, run_program
from depthcli.programs.scene import current_scene

_UNITS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_LOGS = ("stdout.txt", "stderr.txt")


def _seconds(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{0,6})?)\s*([a-z]*)\s*", value)
    if match is None or match[2] not in _UNITS:
        raise ValueError("want a time such as 30 s, 10 min or 2 h")
    return float(match[1]) * _UNITS[match[2]]


Seconds = Annotated[float, BeforeValidator(_seconds)]
"""A time in seconds; in a config with its unit, such as ``10 min``."""

_Integer = Annotated[int, Field(ge=-(10**15), le=10**15)]
Number = Annotated[float, Field(ge=-1e300, le=1e300)]


class ProgramRun(BaseModel):
    """How a program is run; subclasses say which program."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    timeout: Seconds = Field(600.0, gt=0, le=1e7, description="time for a scene, such as 90 s, 10 min or 2 h")
    version: str = Field("", coerce_numbers_to_str=True, description="any text: with another one it is another run")

    def run(self, words: Sequence[str], folder: Path, scratch: Path, clock: Clock) -> None:
        """Run a program in ``folder`` for the current scene; the ends of its output stay in ``scratch``.

        Raises
        ------
        ProgramError
            It failed, in any way.
        """
        scene = current_scene()
        clock.start("program")
        finished = run_program(words, folder, self.timeout, scene.memory, {"OMP_NUM_THREADS": str(n_threads())})
        scene.add(finished.cpu_seconds, finished.peak_memory)
        clock.start("read")
        for name, text in zip(_LOGS, (finished.stdout, finished.stderr), strict=True):
            if text:
                write_text(scratch / name, text)


class Program(ProgramRun):
    """A program that is run for every scene, in a scratch folder of its own.

    The first word is looked up in ``PATH``, or where it has a slash from the folder of the config file, and then from
    the current folder. Other words that name a file, seen from one of these two, become its whole path. The
    content of all these files is part of the run: scenes are computed again where it changes. The variable
    ``OMP_NUM_THREADS`` has the number of threads. A scratch folder is kept where the scene fails; the message names it.
    """

    placeholders: ClassVar[tuple[str, ...]] = ("output", "scratch", "name", "threads", "cwd")
    """Names of the file to write, the folder that the program runs in, the scene, the number of threads, and the folder
    that depthcli was started in; subclasses add the inputs."""

    parameters: dict[str, str | bool | _Integer | Number] = Field(
        default_factory=dict, description="further placeholders and their values"
    )
    shell: bool = Field(False, description="whether the program is a line for /bin/sh; values are quoted for it")
    program: str | tuple[str, ...] = Field(
        validation_alias=AliasChoices("program", "run"),
        description="program and arguments with placeholders, such as {left}, or {{ for a brace; run is the same key",
    )
    output: str | None = Field(
        None, min_length=1, description="name of the map in the program's folder; null: that which {output} says"
    )

    @property
    @abstractmethod
    def suffix(self) -> str:
        """Ending of the name of the file that ``{output}`` stands for."""

    @field_validator("parameters")
    @classmethod
    def _new_names(cls, parameters: dict[str, Any]) -> dict[str, Any]:
        for name in parameters:
            if not name.isidentifier() or name in cls.placeholders:
                raise ValueError(
                    f"{name!r} cannot be the name of a parameter; want letters, and none of {cls.placeholders}"
                )
        return parameters

    @field_validator("program")
    @classmethod
    def _known_placeholders(cls, program: str | tuple[str, ...], info: ValidationInfo) -> str | tuple[str, ...]:
        shell = info.data.get("shell", False)
        if shell and not isinstance(program, str):
            raise ValueError("want one text with shell: true, not a list")
        words = _words(program, shell)
        if not words or not words[0].strip():
            raise ValueError("want a program")
        known = [*cls.placeholders, *info.data.get("parameters", ())]
        for name in (name for word in words for name in _placeholders_in(word)):
            if name not in known:
                near = difflib.get_close_matches(name, known, 1)
                hint = f"did you mean {{{near[0]}}}?" if near else f"there are: {', '.join(known)}"
                raise ValueError(f"no placeholder {{{name}}}; {hint}")
        if shell:
            return program
        first = beside_config(words[0], info) if "/" in words[0] else words[0]
        found = (first, *(beside_config(word, info) for word in words[1:]))
        return program if found == words else found

    def used_files(self) -> dict[str, Path]:
        """Return role -> file, of the words that are files; none for a shell.

        Raises
        ------
        ConfigError
            There is no such program.
        """
        if self.shell:
            return {}
        first, *others = _words(self.program, False)
        found = shutil.which(first)
        if found is None:
            where = (
                f"no such file, or it cannot be run, neither seen from the config file nor from {os.getcwd()}"
                if "/" in first
                else "not in PATH; for a file here write ./ before"
            )
            raise ConfigError(f"program: {first}: {where}")
        files = [Path(found), *(Path(word) for word in others if os.path.isfile(word))]
        return {f"program_{number}" if number else "program": file for number, file in enumerate(files)}

    def write_map(self, scratch: Path, inputs: Mapping[str, object], clock: Clock) -> Path:
        """Run the program in the folder ``scratch``; return the file that its map should be in.

        Parameters
        ----------
        inputs : values of the placeholders of the subclass
        clock : books ``program``, and then ``read``

        Raises
        ------
        ProgramError
            It failed, in any way.
        """
        path = scratch / (self.output or f"output{self.suffix}")
        values = {
            "output": path, "scratch": scratch, "name": current_scene().name, "threads": n_threads(),
            "cwd": os.getcwd(), **self.parameters, **inputs,
        }  # fmt: skip
        texts = {name: str(value).lower() if isinstance(value, bool) else str(value) for name, value in values.items()}
        words = _words(self.program, self.shell)
        if self.shell:
            line = words[0].format_map({name: shlex.quote(text) for name, text in texts.items()})
            self.run(["/bin/sh", "-c", line], scratch, scratch, clock)
        else:
            first = os.path.abspath(shutil.which(words[0]) or words[0])
            others = [os.path.abspath(word) if os.path.isfile(word) else word.format_map(texts) for word in words[1:]]
            self.run([first, *others], scratch, scratch, clock)
        return path


def beside_config(name: str, info: ValidationInfo) -> str:
    """Return the whole path of a file or folder that lies beside the config file; ``name`` as it is where none does.

    A name that means the same seen from the current folder stays as it is, too.
    """
    folder = (info.context or {}).get("folder")
    path = os.path.abspath(os.path.join(folder or "", name))
    is_here = path == os.path.abspath(name)
    return name if folder is None or is_here or "\0" in name or not os.path.exists(path) else path


def check_written(path: Path) -> None:
    """Raise ProgramError unless a program wrote this file, and something into it."""
    if not path.is_file() or path.stat().st_size == 0:
        raise ProgramError(f"the program wrote {'an empty' if path.is_file() else 'no'} {path.name}")


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give an empty folder; it is deleted at the end, but kept where a program fails, whose message then names it."""
    name = re.sub(r"[^\w.-]", "_", current_scene().name)[:40]
    folder = Path(tempfile.mkdtemp(prefix=f"depthcli-{name}-"))
    try:
        yield folder
    except ProgramError as error:
        raise ProgramError(f"{error}; its files are in {folder}") from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)


def _words(program: str | tuple[str, ...], shell: bool) -> tuple[str, ...]:
    if isinstance(program, str):
        return (program,) if shell else tuple(shlex.split(program))
    return program


def _placeholders_in(word: str) -> Iterator[str]:
    try:
        for _, name, spec, conversion in string.Formatter().parse(word):
            if name is not None:
                if spec or conversion or not name.isidentifier():
                    raise ValueError("want names in braces")
                yield name
    except ValueError as error:
        raise ValueError(f"{error} in {word!r}; a brace is written {{{{ or }}}}") from None
