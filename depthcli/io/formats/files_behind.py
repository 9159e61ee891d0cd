"""Find files that another file needs: the values of a volume, a chain of transforms."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.io.formats.files import open_regular, read_bytes
from depthcli.io.formats.plain_text import text_of

MAX_TRANSFORM_BYTES = 1 << 30
"""Largest size of a transform file; B-spline parameters as text may be long."""

MAX_CHAIN = 100
"""Largest number of chained elastix transforms; a registration has two or three."""

_HEADER_BYTES = 1 << 20  # start of a MetaImage or NRRD file to search for the name of its data file
_DATA_FILE = re.compile(rb"^(?:ElementDataFile\s*[=:]|data ?file:)[ \t]*([^\r\n]+)\r?\n?((?:[^\r\n]+\r?\n?)*)", re.M)
_INITIAL = re.compile(r'^\s*\(InitialTransformParameters?FileName\s+("[^"\n]*"|[^\s)]+)', re.MULTILINE)


def nifti_header(path: Path) -> bytes:
    """Return the NIfTI header (``.hdr``) of a volume's values (``.img``), or empty bytes.

    Raise InputError for an Analyze 7.5 header without ``meta.json``, since it has no directions.
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
    """Return the files that a volume needs: its data files, its header or ``meta.json``, or all files of a folder."""
    if os.path.isdir(path):  # a DICOM series
        return tuple(sorted(file for file in path.glob("*") if os.path.isfile(file)))
    kind = path.suffix.lower()
    if kind == ".hdr":
        return (path.with_suffix(".img"),)
    if kind == ".img":
        with contextlib.suppress(InputError):  # reading the volume reports the problem
            return (path.with_suffix(".hdr") if nifti_header(path) else path.with_name("meta.json"),)
        return ()
    if kind not in (".mha", ".mhd", ".nrrd", ".nhdr"):
        return ()
    found = None
    with contextlib.suppress(InputError), open_regular(path) as file:  # reading the volume reports the problem
        found = _DATA_FILE.search(file.read(_HEADER_BYTES))
    name = os.fsdecode(found[1]).strip() if found else "LOCAL"
    if found and name.split()[0] == "LIST":
        return tuple(path.parent / each.strip() for each in os.fsdecode(found[2]).splitlines() if each.strip())
    if "%" in name:  # a pattern of numbered files
        return tuple(sorted(path.parent.glob(re.sub(r"%\d*d", "*", name.split()[0]))))
    return () if name in ("LOCAL", "Local", "local") else (path.parent / name,)


def transform_files(path: Path) -> tuple[Path, ...]:
    """Return the further files of a chain of elastix parameter files, without ``path``."""
    files: list[Path] = []
    with contextlib.suppress(InputError):  # reading the transform reports the problem
        while path.suffix.lower() == ".txt" and len(files) < MAX_CHAIN:
            text = text_of(read_bytes(path, MAX_TRANSFORM_BYTES))
            below = initial_transform(path, text) if "(Transform " in text else None
            if below is None or below in files:
                break
            files.append(below)
            path = below
    return tuple(files)


def initial_transform(path: Path, text: str) -> Path | None:
    """Return an elastix transform's initial transform, in the same folder or at its stored path, or None."""
    found = _INITIAL.findall(text)
    name = found[-1].strip('"') if found else ""
    if name in ("", "NoInitialTransform"):
        return None
    sibling, elsewhere = path.parent / Path(name).name, Path(name)
    return elsewhere if not sibling.is_file() and elsewhere.is_file() else sibling
