"""Any program that writes the disparity map of a pair."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import shlex
import shutil
import signal
import string
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import AliasChoices, BeforeValidator, Field, ValidationInfo, field_validator

from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.core.scene import current_scene
from depthcli.core.text import one_line, show_bytes
from depthcli.io.formats.disparity import read_plane
from depthcli.kernels.jit import n_threads
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.volume import StereoResult

_PLACEHOLDERS = ["left", "right", "max_disparity", "min_disparity", "output", "scratch", "name", "threads", "cwd"]
_SUFFIXES = {"pfm": ".pfm", "kitti": ".png", "npy": ".npy", "tiff": ".tiff", "png": ".png"}
_KITTI_SCALE = 256.0  # codes per pixel
_MAP_BYTES = 200  # of this process, per pixel, while a program runs and its map is read
_BYTES_PER_CELL = 8  # a guess of what programs that match tiles take
_LOOK_SECONDS = 0.05  # between two looks at a running program
_MAX_REASON = 300  # characters of a program's output in a message


def _seconds(value: Any) -> Any:
    match = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{0,6})?)\s*(s|min|h|)\s*", str(value))
    if isinstance(value, str) and match is None:
        raise ValueError("want a time such as 30 s, 10 min or 2 h")
    return float(match[1]) * {"min": 60, "h": 3600}.get(match[2], 1) if match else value


_Seconds = Annotated[float, BeforeValidator(_seconds)]
_Integer = Annotated[int, Field(ge=-(10**15), le=10**15)]
_Number = Annotated[float, Field(ge=-1e300, le=1e300)]


class ProgramError(InputError):
    """A program failed: it cannot be started, was ended, or its result cannot be used."""


class Program(StereoPipeline):
    """A program of others: two images and a range in, a disparity map out.

    The program runs for every scene, in a scratch folder of its own, which is kept where the scene fails. The first
    word is looked up in ``PATH``, or where it has a slash from the folder of the config file, and then from the
    current folder. Other words that name a file, seen from one of these two, become its whole path. The content of
    all these files is part of the run: scenes are computed again where it changes. The variable ``OMP_NUM_THREADS``
    has the number of threads. All processes of the program's group end with it.

    The pair is as the toolkit matches it: rectified where a calibration is given, and shifted so that the range begins
    at 0. Pixels without a value, or with a negative one, are ``MISMATCH``: programs do not say why; those beyond the
    range are ``OUT_OF_RANGE``.
    """

    timeout: _Seconds = Field(600.0, gt=0, le=1e7, description="time for a scene, such as 90 s, 10 min or 2 h")
    version: str = Field("", coerce_numbers_to_str=True, description="any text: with another one it is another run")
    parameters: dict[str, str | bool | _Integer | _Number] = Field(
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
    format: Literal["pfm", "kitti", "npy", "tiff", "png"] = Field(
        "pfm",
        description="of the map: pfm, npy and tiff hold floats; png, and npy and tiff of integers, codes (see scale); "
        "kitti: png of 256 codes a unit",
    )
    scale: float | None = Field(
        None, gt=0, le=1e9, description="codes per unit of the map; null: floats 1, codes 256 a pixel"
    )
    invalid: tuple[_Number, ...] = Field(
        (), description="values of the file that mean no value, beside inf, nan, code 0"
    )
    images: Literal["png", "pgm", "ppm", "original"] = Field(
        "png",
        description="what the program reads: png, grey or color as the pair is, 8 or 16 bit; pgm: grey, ppm: RGB; "
        "original: the scene's own files, for pairs that are matched as these are",
    )
    halo: int | None = Field(
        None, ge=0, le=4096, description="pixels around a tile that its map depends on; null: pairs are never tiled"
    )

    @field_validator("parameters")
    @classmethod
    def _new_names(cls, parameters: dict[str, Any]) -> dict[str, Any]:
        for name in parameters:
            if not name.isidentifier() or name in _PLACEHOLDERS:
                raise ValueError(f"{name!r} cannot be the name of a parameter; want letters, none of {_PLACEHOLDERS}")
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
        known = [*_PLACEHOLDERS, *info.data.get("parameters", ())]
        for word in words:
            try:
                fields = [field[1:] for field in string.Formatter().parse(word) if field[1] is not None]
            except ValueError as error:
                raise ValueError(f"{error} in {word!r}; a brace is written {{{{ or }}}}") from None
            for name, spec, conversion in fields:
                if name not in known or spec or conversion:
                    raise ValueError(f"no placeholder {{{name}}}; there are: {', '.join(known)}")
        folder = (info.context or {}).get("folder")
        if shell or folder is None:
            return program

        def beside_config(name: str) -> str:
            path = os.path.abspath(os.path.join(folder, name))
            return path if path != os.path.abspath(name) and "\0" not in name and os.path.exists(path) else name

        first = beside_config(words[0]) if "/" in words[0] else words[0]
        found = (first, *map(beside_config, words[1:]))
        return program if found == words else found

    def used_files(self) -> dict[str, Path]:
        """Return role -> file, of the words that are files; none for a shell. ConfigError without the program."""
        if self.shell:
            return {}
        first, *others = _words(self.program, False)
        found = shutil.which(first)
        if found is None:
            places = f"neither beside the config file nor in {os.getcwd()} is such a program"
            raise ConfigError(f"program: {first}: {places if '/' in first else 'not in PATH; here write ./ before it'}")
        files = [Path(found), *(Path(word) for word in others if os.path.isfile(word))]
        return {f"program_{number}" if number else "program": file for number, file in enumerate(files)}

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Write the images, run the program, read its map; ProgramError where it failed."""
        clock = Clock()
        clock.start("write")
        with _scratch_folder() as scratch:
            left, right = self._image_files(pair, scratch)
            path = scratch / (self.output or f"output{_SUFFIXES[self.format]}")
            values = {"left": left, "right": right, "max_disparity": max_disparity, "min_disparity": 0, "output": path}
            values |= {"scratch": scratch, "name": current_scene().name, "threads": n_threads(), "cwd": os.getcwd()}
            texts = {
                name: str(value).lower() if isinstance(value, bool) else str(value)
                for name, value in (values | self.parameters).items()
            }
            first, *others = _words(self.program, self.shell)
            if self.shell:
                line = first.format_map({name: shlex.quote(text) for name, text in texts.items()})
                words = ["/bin/sh", "-c", line]
            else:
                others = [os.path.abspath(word) if os.path.isfile(word) else word.format_map(texts) for word in others]
                words = [os.path.abspath(shutil.which(first) or first), *others]
            clock.start("program")
            run_program(words, scratch, self.timeout)
            clock.start("read")
            disparity = self._read_map(path, pair.shape)
            status = np.zeros(pair.shape, np.uint8)
            with np.errstate(invalid="ignore"):
                status[~(disparity >= 0)] = Status.MISMATCH
                status[disparity >= max_disparity + 1] = Status.OUT_OF_RANGE
            if status.all():
                raise ProgramError(f"no pixel of the program's map has a disparity from 0 to {max_disparity}")
        disparity[status != 0] = np.nan
        return StereoResult(DisparityMap(disparity, status), seconds=clock.seconds)

    def _image_files(self, pair: StereoPair, folder: Path) -> Sequence[Path]:
        """Return the left and the right image as files: the scene's own, or written into ``folder``."""
        if self.images == "original":
            originals = current_scene().originals
            if originals is None or originals[0] is not pair:
                raise InputError(
                    "images: original: no image files hold this pair as it is matched (rectified, shifted by "
                    "min_disparity, a tile, frames of a video, arrays); take images: png"
                )
            return [file.absolute() for file in originals[1]]
        views = {"png": pair.full_range, "pgm": pair.grey8, "ppm": pair.color8}[self.images]
        files = [folder / f"{name}.{self.images}" for name in ("left", "right")]
        for file, image in zip(files, views, strict=True):
            _, data = cv2.imencode(file.suffix, np.ascontiguousarray(image if image.ndim == 2 else image[..., ::-1]))
            file.write_bytes(data.tobytes())
        return files

    def _read_map(self, path: Path, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Return the map that the program wrote, (H, W) float32, NaN = no value; ProgramError: none of this size."""
        if not path.is_file():
            raise ProgramError(f"the program wrote no {path.name}")
        try:
            stored = read_plane(path)
        except InputError as error:
            raise ProgramError(f"the program's map cannot be read: {error}") from error
        if stored.shape != shape:
            size = f"{stored.shape[1]} x {stored.shape[0]}, want {shape[1]} x {shape[0]}"
            raise ProgramError(f"the program's {path.name} has another size than the images: {size}")
        scale = self.scale or (_KITTI_SCALE if stored.dtype.kind in "iu" else 1.0)
        with np.errstate(all="ignore"):
            values = np.asarray(stored / np.float64(scale), np.float32)
        values[np.isin(stored, self.invalid) | ((stored == 0) & (stored.dtype.kind == "u"))] = np.nan
        values[~np.isfinite(values)] = np.nan
        return values

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Return the bytes of images and maps, and where pairs may be tiled a guess of those of the program."""
        cells = 0 if self.halo is None else shape[0] * shape[1] * (max_disparity + 1)
        return _MAP_BYTES * shape[0] * shape[1] + _BYTES_PER_CELL * cells

    def tile_halo(self) -> int | None:
        return self.halo


def run_program(words: Sequence[str], folder: Path, timeout: float) -> None:
    """Run a program in ``folder`` and end its process group; its output goes to files there.

    Processor time and memory are added to those of the current scene. ProgramError, with the end of the program's
    output, where it fails, runs for more than ``timeout`` seconds, or takes more memory than the scene may.
    """
    scene, name = current_scene(), os.path.basename(words[0])
    logs = [folder / "stderr.txt", folder / "stdout.txt"]
    until, peak, problem = time.monotonic() + timeout, 0, ""
    try:
        with logs[0].open("wb") as errors, logs[1].open("wb") as printed:
            program = subprocess.Popen(
                words,
                cwd=folder,
                env=os.environ | {"OMP_NUM_THREADS": str(n_threads())},
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=errors,
            )
    except OSError as error:
        raise ProgramError(f"{name} cannot be started: {error.strerror or error}") from error
    with _ended_group(program.pid):
        # The program stays a zombie until its group has ended, so that no other process gets its number.
        while os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            peak = max(peak, _resident_bytes(program.pid))
            if time.monotonic() > until:
                problem = f"was ended after {timeout:g} s; see timeout"
            elif scene.memory is not None and peak > scene.memory:
                problem = f"was ended: it took more than the {show_bytes(scene.memory)} that may be used; "
                problem += "see --max-memory, --jobs"
            if problem:
                break
            time.sleep(_LOOK_SECONDS)
    _, status, used = os.wait4(program.pid, 0)
    program.returncode = code = os.waitstatus_to_exitcode(status)
    if not problem and code:
        names = {int(each): each.name for each in signal.Signals}
        problem = f"was ended by {names.get(-code, -code)}" if code < 0 else f"ended with exit code {code}"
    if problem:
        raise ProgramError(f"{name} {problem}{_end_of(logs)}")
    scene.used["program_cpu"] = round(scene.used.get("program_cpu", 0.0) + used.ru_utime + used.ru_stime, 6)
    if used.ru_maxrss > resource.getrusage(resource.RUSAGE_SELF).ru_maxrss:  # what it has from us when it starts counts
        peak = max(peak, used.ru_maxrss * (1 if sys.platform == "darwin" else 1024))
    scene.used["program_memory"] = max(scene.used.get("program_memory", 0), peak)


@contextlib.contextmanager
def _ended_group(group: int) -> Iterator[None]:
    """End a group of processes after the block, also where this process is killed within it."""
    line = ["/bin/sh", "-c", 'read -r _; kill -s KILL -- "-$0"', str(group)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True):
        yield  # then the pipe is closed, as it is where this process ends


def _resident_bytes(session: int) -> int:
    """Return the resident memory of the processes of a session, bytes; 0 where there is no ``/proc``."""
    pages = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError):  # it has ended
            facts = stat.read_bytes().rpartition(b")")[2].split()
            pages += int(facts[21]) if int(facts[3]) == session else 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _end_of(logs: Sequence[Path]) -> str:
    """Return the last lines of the first of these files that has any, as the end of a message."""
    for log in logs:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4 * _MAX_REASON))
            lines = [line.strip() for line in file.read().decode("utf-8", "backslashreplace").splitlines()]
        if text := one_line(" | ".join(filter(None, lines))):
            return f": {text}" if len(text) <= _MAX_REASON else f": ...{text[-_MAX_REASON:]}"
    return ""


@contextlib.contextmanager
def _scratch_folder() -> Iterator[Path]:
    """Give an empty folder; it is deleted at the end, but kept where a program fails, whose message then names it."""
    name = re.sub(r"[^\w.-]", "_", current_scene().name)[:40]
    folder, kept = Path(tempfile.mkdtemp(prefix=f"depthcli-{name}-")), False
    try:
        yield folder
    except ProgramError as error:
        kept = True
        raise ProgramError(f"{error}; its files are in {folder}") from error
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)


def _words(program: str | tuple[str, ...], shell: bool) -> tuple[str, ...]:
    if isinstance(program, str):
        return (program,) if shell else tuple(shlex.split(program))
    return program
