"""Any program that writes the disparity map of a pair."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import string
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import cv2
import numpy as np
from pydantic import AliasChoices, BeforeValidator, Field, ValidationInfo, field_validator

from depthcli.core.context import Clock, Context
from depthcli.core.errors import ConfigError, InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Floats, Status
from depthcli.io.formats.disparity import read_plane
from depthcli.kernels.jit import n_threads
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.pipeline._process import ProgramError, run_program, scratch_folder
from depthcli.methods.stereo.volume import StereoResult

_PLACEHOLDERS = ["left", "right", "max_disparity", "min_disparity", "output", "scratch", "name", "threads", "cwd"]
_VARIABLE = "DEPTHCLI_"  # prefix of the environment variables with the values of placeholders
_SHELLS = ("sh", "bash", "dash", "ksh", "zsh")
_SUFFIXES = {"pfm": ".pfm", "kitti": ".png", "npy": ".npy", "tiff": ".tiff", "png": ".png"}
_KITTI_SCALE = 256.0  # codes per pixel
_MAP_BYTES = 200  # of this process, per pixel, while a program runs and its map is read
_BYTES_PER_CELL = 8  # a guess for programs that match tiles


def _seconds(value: Any) -> Any:
    match = re.fullmatch(r"\s*(\d{1,9}(?:\.\d{0,6})?)\s*(s|min|h|)\s*", str(value))
    if isinstance(value, str) and match is None:
        raise ValueError("expected a time such as 30 s, 10 min or 2 h")
    return float(match[1]) * {"min": 60, "h": 3600}.get(match[2], 1) if match else value


_Seconds = Annotated[float, BeforeValidator(_seconds)]
_Integer = Annotated[int, Field(ge=-(10**15), le=10**15)]
_Number = Annotated[float, Field(ge=-1e300, le=1e300)]


class Program(StereoPipeline):
    """An external program that computes a disparity map from two images and a range.

    The program runs for every scene in a scratch folder of its own, which is kept if the scene fails. The first word is
    looked up in ``PATH``. If it has a slash, it is looked up in the folder of the config file, and then in the current
    folder. Other words that name a file in one of these two folders become its whole path. The content of all these
    files is part of the run: if it changes, scenes are computed again. The variable ``OMP_NUM_THREADS`` has the number
    of threads; ``DEPTHCLI_LEFT`` and so on have the values of the placeholders. No shell reads the words, because the
    name of a scene could be a command. A shell can itself be the program and read the variables:
    ``[sh, -c, 'tool "$DEPTHCLI_LEFT"']``. All processes of the program's group end with it.

    The program gets the pair as it is matched: rectified if a calibration is given, and shifted so that the range
    begins at 0. Pixels without a value, or with a negative one, are ``MISMATCH``, because programs give no reason.
    Pixels beyond the range are ``OUT_OF_RANGE``.
    """

    renamed: ClassVar[dict[str, str]] = {"shell": "program: [sh, -c, 'LINE'], with \"$DEPTHCLI_LEFT\" for {left}"}

    timeout: _Seconds = Field(600.0, gt=0, le=1e7, description="time for a scene, such as 90 s, 10 min or 2 h")
    version: str = Field("", coerce_numbers_to_str=True, description="any text; a run with another text is another run")
    parameters: dict[str, str | bool | _Integer | _Number] = Field(
        default_factory=dict, description="further placeholders and their values"
    )
    program: str | tuple[str, ...] = Field(
        validation_alias=AliasChoices("program", "run"),
        description="program and arguments with placeholders, such as {left}; {{ is a brace. run is the same key. "
        "A shell reads variables instead, such as $DEPTHCLI_LEFT",
    )
    output: str | None = Field(
        None, min_length=1, description="name of the map in the program's folder; null: the name of {output}"
    )
    format: Literal["pfm", "kitti", "npy", "tiff", "png"] = Field(
        "pfm",
        description="format of the map: floats in pfm, npy and tiff; codes (see scale) in png, and in npy and tiff of "
        "integers; kitti: png with 256 codes per pixel",
    )
    scale: float | None = Field(
        None, gt=0, le=1e9, description="codes per pixel of the map; null: 1 for floats, 256 for integers"
    )
    invalid: tuple[_Number, ...] = Field(
        (), description="values of the file that mean no value, besides inf, nan, code 0"
    )
    images: Literal["png", "pgm", "ppm", "original"] = Field(
        "png",
        description="images that the program reads: png, grey or color as the pair is, 8 or 16 bit; pgm: grey; "
        "ppm: RGB; original: the files of the scene, if the pair is neither rectified nor changed",
    )
    halo: int | None = Field(
        None, ge=0, le=4096, description="pixels around a tile that its map depends on; null: pairs are never tiled"
    )

    @field_validator("parameters")
    @classmethod
    def _new_names(cls, parameters: dict[str, Any]) -> dict[str, Any]:
        for name in parameters:
            if not name.isidentifier() or name in _PLACEHOLDERS:
                raise ValueError(
                    f"{name!r} cannot be the name of a parameter; expected letters, none of {_PLACEHOLDERS}"
                )
        return parameters

    @field_validator("program")
    @classmethod
    def _known_placeholders(cls, program: str | tuple[str, ...], info: ValidationInfo) -> str | tuple[str, ...]:
        words = _words(program)
        if not words or not words[0].strip():
            raise ValueError("expected a program")
        known = [*_PLACEHOLDERS, *info.data.get("parameters", ())]
        for word in words:
            try:
                fields = [
                    (name, spec or conversion)
                    for _, name, spec, conversion in string.Formatter().parse(word)
                    if name is not None
                ]
            except ValueError as error:
                raise ValueError(f"{error} in {word!r}; a brace is written {{{{ or }}}}") from None
            for name, how in fields:
                if name not in known or how:
                    raise ValueError(f"no placeholder {{{name}}}; there are: {', '.join(known)}")
            if fields and word is _script(words):  # the name of a scene could be a command there
                name = fields[0][0]
                raise ValueError(f'in the line of a shell write "${_VARIABLE}{name.upper()}", not {{{name}}}')
        folder = (info.context or {}).get("folder")
        if folder is None:
            return program

        def beside_config(name: str) -> str:
            path = os.path.abspath(os.path.join(folder, name))
            return path if path != os.path.abspath(name) and "\0" not in name and os.path.exists(path) else name

        first = beside_config(words[0]) if "/" in words[0] else words[0]
        found = (first, *map(beside_config, words[1:]))
        return program if found == words else found

    def used_files(self) -> dict[str, Path]:
        """Return role -> file for all words that are files. Raise ConfigError if the program is not found."""
        first, *others = _words(self.program)
        found = shutil.which(first)
        if found is None:
            places = f"no such program in the config file's folder or in {os.getcwd()}"
            raise ConfigError(f"program: {first}: {places if '/' in first else 'not in PATH; here write ./ before it'}")
        files = [Path(found), *(Path(word) for word in others if os.path.isfile(word))]
        return {f"program_{number}" if number else "program": file for number, file in enumerate(files)}

    def __call__(self, pair: StereoPair, max_disparity: int, context: Context | None = None) -> StereoResult:
        """Write the images, run the program, and read its map; ProgramError if it fails."""
        context, clock = context or Context(), Clock()
        clock.start("write")
        with scratch_folder(context) as scratch:
            left, right = self._image_files(pair, scratch, context)
            path = scratch / (self.output or f"output{_SUFFIXES[self.format]}")
            values = {"left": left, "right": right, "max_disparity": max_disparity, "min_disparity": 0, "output": path}
            values |= {"scratch": scratch, "name": context.name, "threads": n_threads(), "cwd": os.getcwd()}
            clock.start("program")
            texts = {
                name: str(value).lower() if isinstance(value, bool) else str(value)
                for name, value in (values | self.parameters).items()
            }
            variables = {f"{_VARIABLE}{name.upper()}": text for name, text in texts.items()}
            run_program(self._command_line(texts), scratch, self.timeout, context, variables)
            clock.start("read")
            disparity = self._read_map(path, pair.shape)
            status = np.zeros(pair.shape, np.uint8)
            status[~(disparity >= 0)] = Status.MISMATCH
            status[disparity >= max_disparity + 1] = Status.OUT_OF_RANGE
            if status.all():
                raise ProgramError(f"no pixel of the program's map has a disparity from 0 to {max_disparity}")
        disparity[status != 0] = np.nan
        return StereoResult(DisparityMap(disparity, status), seconds=clock.seconds)

    def _command_line(self, texts: Mapping[str, str]) -> list[str]:
        """Return the program and its arguments, with the values of placeholders and whole paths of files."""
        first, *others = _words(self.program)
        others = [os.path.abspath(word) if os.path.isfile(word) else word.format_map(texts) for word in others]
        return [os.path.abspath(shutil.which(first) or first), *others]

    def _image_files(self, pair: StereoPair, folder: Path, context: Context) -> Sequence[Path]:
        """Return the left and the right image as files: the scene's own, or written into ``folder``."""
        if self.images == "original":
            originals = context.originals
            if originals is None or originals[0] is not pair:
                raise InputError(
                    "images: original: no image files contain this pair as it is matched (rectified, shifted by "
                    "min_disparity, a tile, frames of a video, arrays); take images: png"
                )
            return [file.absolute() for file in originals[1]]
        views = {"png": pair.full_range, "pgm": pair.grey8, "ppm": pair.color8}[self.images]
        files = [folder / f"{name}.{self.images}" for name in ("left", "right")]
        for file, image in zip(files, views, strict=True):
            _, data = cv2.imencode(file.suffix, np.ascontiguousarray(image if image.ndim == 2 else image[..., ::-1]))
            file.write_bytes(data.tobytes())
        return files

    def _read_map(self, path: Path, shape: tuple[int, int]) -> Floats:
        """Return the program's map, (H, W) float32, NaN = no value; ProgramError if there is none of this size."""
        if not path.is_file():
            raise ProgramError(f"the program wrote no {path.name}")
        try:
            stored = read_plane(path)
        except InputError as error:
            raise ProgramError(f"the program's map cannot be read: {error}") from error
        if stored.shape != shape:
            size = f"{stored.shape[1]} x {stored.shape[0]}, expected {shape[1]} x {shape[0]}"
            raise ProgramError(f"the program's {path.name} has another size than the images: {size}")
        scale = self.scale or (_KITTI_SCALE if stored.dtype.kind in "iu" else 1.0)
        with np.errstate(all="ignore"):
            values = np.asarray(stored / np.float64(scale), np.float32)
        values[np.isin(stored, self.invalid) | ((stored == 0) & (stored.dtype.kind == "u"))] = np.nan
        values[~np.isfinite(values)] = np.nan
        return values

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Return the bytes of images and maps and, if pairs may be tiled, a guess for the program."""
        cells = 0 if self.halo is None else shape[0] * shape[1] * (max_disparity + 1)
        return _MAP_BYTES * shape[0] * shape[1] + _BYTES_PER_CELL * cells

    def tile_halo(self) -> int | None:
        return self.halo


def _words(program: str | tuple[str, ...]) -> tuple[str, ...]:
    return tuple(shlex.split(program)) if isinstance(program, str) else program


def _script(words: Sequence[str]) -> str | None:
    """Return the word that a shell runs as commands (``sh -c WORD``); None for other programs."""
    options = [word for word in words[1:] if re.fullmatch(r"-\w*c", word)]
    if os.path.basename(words[0]) not in _SHELLS or not options:
        return None
    return next(iter(words[words.index(options[0]) + 1 :]), None)
