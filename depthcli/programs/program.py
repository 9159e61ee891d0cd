"""The part of a config that says which program to run, and how a scene gets to it and its map back."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
import shlex
import shutil
import string
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import Image
from depthcli.core.result import Clock
from depthcli.data.formats.disparity import read_plane
from depthcli.data.formats.files import write_bytes, write_text
from depthcli.data.formats.images import write_png
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
_Number = Annotated[float, Field(ge=-1e300, le=1e300)]

Format = Literal["pfm", "kitti", "npy", "tiff", "png"]

_SUFFIXES: dict[Format, str] = {"pfm": ".pfm", "kitti": ".png", "npy": ".npy", "tiff": ".tiff", "png": ".png"}


class ProgramRun(BaseModel):
    """How a program is run and its map is read; subclasses say which program."""

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

    parameters: dict[str, str | bool | _Integer | _Number] = Field(
        default_factory=dict, description="further placeholders and their values"
    )
    shell: bool = Field(False, description="whether the program is a line for /bin/sh; values are quoted for it")
    program: str | tuple[str, ...] = Field(
        validation_alias=AliasChoices("program", "run"),
        description="program and arguments with placeholders, such as {left}, or {{ for a brace; run is the same key",
    )
    format: Format = Field(
        "pfm",
        description="of the map: pfm, npy and tiff hold floats; png, and npy and tiff of integers, codes (see scale); "
        "kitti: png of 256 codes a unit",
    )
    output: str | None = Field(
        None, min_length=1, description="name of the map in the program's folder; null: that which {output} says"
    )
    scale: float | None = Field(
        None,
        gt=0,
        le=1e9,
        description="codes per unit of the map; null: floats 1, codes 256 a pixel or 1000 a meter",
    )
    invalid: tuple[_Number, ...] = Field(
        (), description="values of the file that mean no value, beside inf, nan, code 0"
    )

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
        path = scratch / (self.output or f"output{_SUFFIXES[self.format]}")
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

    def read_map(self, path: Path, shape: tuple[int, int], codes_per_unit: float) -> NDArray[np.float32]:
        """Return the map that the program wrote, as :func:`read_map`, by the format and scale of the config."""
        return read_map(path, shape, self.scale, 256.0 if self.format == "kitti" else codes_per_unit, self.invalid)


def beside_config(name: str, info: ValidationInfo) -> str:
    """Return the whole path of a file or folder that lies beside the config file; ``name`` as it is where none does.

    A name that means the same seen from the current folder stays as it is, too.
    """
    folder = (info.context or {}).get("folder")
    path = os.path.abspath(os.path.join(folder or "", name))
    is_here = path == os.path.abspath(name)
    return name if folder is None or is_here or "\0" in name or not os.path.exists(path) else path


def read_map(
    path: Path, shape: tuple[int, int], scale: float | None, codes_per_unit: float, invalid: Sequence[float] = ()
) -> NDArray[np.float32]:
    """Return a map that a program wrote, (H, W) float32, NaN = no value.

    Parameters
    ----------
    shape : (H, W) that it must have
    scale : stored numbers per unit of the map; None: 1 for floats and ``codes_per_unit`` for integers
    invalid : stored numbers that stand for no value, beside infinite ones, NaN, and 0 of unsigned integers

    Raises
    ------
    ProgramError
        It is missing, empty, damaged, of another size, or has no value at all.
    """
    if not path.is_file() or path.stat().st_size == 0:
        raise ProgramError(f"the program wrote {'an empty' if path.is_file() else 'no'} {path.name}")
    try:
        stored = read_plane(path)
    except InputError as error:
        raise ProgramError(f"the program's map cannot be read: {error}") from error
    if stored.shape != shape:
        (height, width), (wanted_height, wanted_width) = stored.shape, shape
        size = f"{width} x {height}, want {wanted_width} x {wanted_height}"
        raise ProgramError(f"the program's {path.name} has another size than the images: {size}")
    if scale is None:
        scale = codes_per_unit if stored.dtype.kind in "iu" else 1.0
    with np.errstate(all="ignore"):
        values = np.asarray(stored / np.float64(scale), np.float32)
        unknown = ~np.isfinite(values) | np.isin(stored, invalid)
    if stored.dtype.kind == "u":
        unknown |= stored == 0
    values[unknown] = np.nan
    if unknown.all():
        raise ProgramError(f"no pixel of the program's {path.name} has a value")
    return values


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


def write_input(folder: Path, name: str, image: Image, kind: str) -> Path:
    """Write an image as ``folder/name.kind``: png; pgm, of (H, W) uint8; ppm, of (H, W, 3) uint8 RGB."""
    path = folder / f"{name}.{kind}"
    if kind == "png":
        write_png(path, image)
    else:
        header = f"P{5 if image.ndim == 2 else 6}\n{image.shape[1]} {image.shape[0]}\n255\n".encode()
        write_bytes(path, header + image.tobytes())
    return path


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
