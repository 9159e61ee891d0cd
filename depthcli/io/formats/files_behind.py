"""Files that are read with another one: the values of a volume, a chain of transforms, the map of a calibration."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import open_regular, read_bytes
from depthcli.io.formats.plain_text import text_of

MAX_TRANSFORM_BYTES = 1 << 30
"""Size of the largest file of a transform: a text of B-spline parameters may be long."""

MAX_CHAIN = 100
"""Transforms of elastix that begin with one another; a registration has two or three."""

_HEADER_BYTES = 1 << 20  # first part of a MetaImage or NRRD file that is searched for the file with its values
_DATA_FILE = re.compile(rb"^(?:ElementDataFile\s*[=:]|data ?file:)[ \t]*([^\r\n]+)\r?\n?((?:[^\r\n]+\r?\n?)*)", re.M)
_INITIAL = re.compile(r'^\s*\(InitialTransformParameters?FileName\s+("[^"\n]*"|[^\s)]+)', re.MULTILINE)


def kinect_files(path: Path) -> tuple[Path, ...]:
    """Return the files that are read with a Kinect calibration: ``dc_beta.npy``, where it is there."""
    beta = path.with_name("dc_beta.npy")
    return (beta,) if beta.is_file() else ()


def nifti_header(path: Path) -> bytes:
    """Return the NIfTI header beside the values of a volume (``.hdr`` beside ``.img``), or nothing.

    InputError for a header of Analyze 7.5 without a ``meta.json``, since it does not tell the directions.
    """
    header = path.with_suffix(".hdr")
    if not header.is_file():
        return b""
    data = read_bytes(header)
    if data[344:347] == b"ni1":
        return data
    if path.with_name("meta.json").is_file():
        return b""
    raise InputError(f"{header}: a header of Analyze 7.5, which has no directions; convert it to NIfTI")


def volume_files(path: Path) -> tuple[Path, ...]:
    """Return the files that are read with a volume: those with its values, of a folder all, or its ``meta.json``."""
    if os.path.isdir(path):  # a DICOM series
        return tuple(sorted(file for file in path.glob("*") if os.path.isfile(file)))
    kind = path.suffix.lower()
    if kind == ".hdr":
        return (path.with_suffix(".img"),)
    if kind == ".img":
        with contextlib.suppress(InputError):  # reading the volume tells the problem
            return (path.with_suffix(".hdr") if nifti_header(path) else path.with_name("meta.json"),)
        return ()
    if kind not in (".mha", ".mhd", ".nrrd", ".nhdr"):
        return ()
    found = None
    with contextlib.suppress(InputError), open_regular(path) as file:  # reading the volume tells the problem
        found = _DATA_FILE.search(file.read(_HEADER_BYTES))
    name = os.fsdecode(found[1]).strip() if found else "LOCAL"
    if found and name.split()[0] == "LIST":
        return tuple(path.parent / each.strip() for each in os.fsdecode(found[2]).splitlines() if each.strip())
    if "%" in name:  # a pattern of numbered files
        return tuple(sorted(path.parent.glob(re.sub(r"%\d*d", "*", name.split()[0]))))
    return () if name in ("LOCAL", "Local", "local") else (path.parent / name,)


def transform_files(path: Path) -> tuple[Path, ...]:
    """Return the files that a chain of elastix parameter files leads to, ``path`` not among them."""
    files: list[Path] = []
    with contextlib.suppress(InputError):  # reading the transform tells the problem
        while path.suffix.lower() == ".txt" and len(files) < MAX_CHAIN:
            text = text_of(read_bytes(path, MAX_TRANSFORM_BYTES))
            below = initial_transform(path, text) if "(Transform " in text else None
            if below is None or below in files:
                break
            files.append(below)
            path = below
    return tuple(files)


def initial_transform(path: Path, text: str) -> Path | None:
    """Return the file that an elastix transform starts from, in its folder or at its path; or None."""
    found = _INITIAL.findall(text)
    name = found[-1].strip('"') if found else ""
    if name in ("", "NoInitialTransform"):
        return None
    beside, elsewhere = path.parent / Path(name).name, Path(name)
    return elsewhere if not beside.is_file() and elsewhere.is_file() else beside
