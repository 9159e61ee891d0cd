"""Text headers of MetaImage and NRRD volumes: the files that they point to, and whether these hold what is announced.

The libraries that decode such files trust the numbers of the header and open whatever it names.
"""

from __future__ import annotations

import gzip
import math
import os
import re
import zlib
from pathlib import Path
from typing import NamedTuple

from depthcli.core.errors import InputError
from depthcli.io.formats.files import open_regular
from depthcli.io.formats.nifti import MAX_VOLUME_BYTES

META_SUFFIXES, NRRD_SUFFIXES = (".mha", ".mhd"), (".nrrd", ".nhdr")

_HEADER_BYTES = 1 << 20  # first part of a file that is searched for its header
_MAX_LINE = 2000  # characters
# MetaIO copies texts into arrays of 255 characters, and NRRD's library into those of its messages, without a check.
_MAX_TEXT = 250
_NUMBER = r"[-+]?[0-9.]{1,25}(?:[eE][-+]?[0-9]{1,3})?"
_NUMBERS = rf"{_NUMBER}(?: +{_NUMBER}){{0,24}}"
_VECTOR = rf"(?:none|\({_NUMBER}(?:,{_NUMBER}){{0,4}}\))"
_VECTORS = rf"{_VECTOR}(?: +{_VECTOR}){{0,4}}"
# Fields that may be longer, and what they look like then: matrices with all digits.
_LONG = {
    "TransformMatrix": _NUMBERS, "Rotation": _NUMBERS, "Orientation": _NUMBERS, "spacedirections": _VECTORS,
    "measurementframe": _VECTORS,
}  # fmt: skip
_MAX_DIMENSIONS = 5  # three of space, one of time, one of components
_MAX_FILES = 1 << 16  # of one volume
# Bytes of a volume a stored byte: deflate's limit is 1032, bzip2's about a million.
_MAX_EXPANSION = {"gzip": 1100, "bzip2": 1 << 20}
_META_BYTES = {
    "CHAR": 1, "UCHAR": 1, "SHORT": 2, "USHORT": 2, "INT": 4, "UINT": 4, "LONG": 4, "ULONG": 4, "LONG_LONG": 8,
    "ULONG_LONG": 8, "FLOAT": 4, "DOUBLE": 8,
}  # fmt: skip
_NRRD_BYTES = {
    "signed char": 1, "int8": 1, "int8_t": 1, "uchar": 1, "unsigned char": 1, "uint8": 1, "uint8_t": 1, "char": 1,
    "short": 2, "short int": 2, "signed short": 2, "signed short int": 2, "int16": 2, "int16_t": 2, "ushort": 2,
    "unsigned short": 2, "unsigned short int": 2, "uint16": 2, "uint16_t": 2, "int": 4, "signed int": 4, "int32": 4,
    "int32_t": 4, "uint": 4, "unsigned int": 4, "uint32": 4, "uint32_t": 4, "longlong": 8, "long long": 8,
    "long long int": 8, "signed long long": 8, "signed long long int": 8, "int64": 8, "int64_t": 8, "ulonglong": 8,
    "unsigned long long": 8, "unsigned long long int": 8, "uint64": 8, "uint64_t": 8, "float": 4, "double": 8,
}  # fmt: skip
_NRRD_ENCODINGS = {
    "raw": "raw", "txt": "text", "text": "text", "ascii": "text", "hex": "hex", "gz": "gzip", "gzip": "gzip",
    "bz2": "bzip2", "bzip2": "bzip2",
}  # fmt: skip


class _Header(NamedTuple):
    """What matters of a header: ``files`` is empty where the values follow it, from byte ``start`` on."""

    sizes: tuple[int, ...]
    value_bytes: int  # of one value
    encoding: str  # raw, text, hex, gzip, bzip2
    files: tuple[Path, ...]
    start: int


def files_behind(path: Path) -> tuple[Path, ...]:
    """Return the files with the values of a volume; none where they are in ``path`` itself, or it cannot be used."""
    try:
        return _header(path).files if _is_text_header(path) else ()
    except InputError:
        return ()


def check_volume(path: Path) -> None:
    """Refuse a MetaImage or NRRD volume whose header makes no sense, or announces more than its files hold.

    Raises
    ------
    InputError
        One line that says which field is wrong, or which file is no regular one or too short.
    """
    if not _is_text_header(path):
        return
    header = _header(path)
    stored = 0
    for file in header.files or (path,):
        with open_regular(file) as opened:
            stored += os.fstat(opened.fileno()).st_size
    stored -= header.start
    count = math.prod(header.sizes)
    wanted = count * header.value_bytes
    if header.encoding == "text":
        short = stored < 2 * count - 1  # a digit each, and a blank between them
    elif header.encoding == "hex":
        short = stored < 2 * wanted
    else:
        short = wanted > stored * _MAX_EXPANSION.get(header.encoding, 1)
    if short:
        size = " x ".join(map(str, header.sizes))
        raise InputError(f"cut off: {max(stored, 0)} bytes of values ({header.encoding}), want {wanted} for {size}")
    if header.encoding == "gzip" and path.suffix.lower() in NRRD_SUFFIXES:
        for file in header.files:
            _check_packed(file)


def _check_packed(path: Path) -> None:
    """Refuse damaged values: ITK's reader leaves their file open, and a long run would have no more to open."""
    try:
        with open_regular(path) as file, gzip.GzipFile(fileobj=file) as unpacked:
            while unpacked.read(1 << 20):
                pass
    except (InputError, EOFError, zlib.error) as error:
        raise InputError(f"{path.name}: damaged values, packed with gzip ({error})") from None


def _is_text_header(path: Path) -> bool:
    return path.suffix.lower() in META_SUFFIXES + NRRD_SUFFIXES


def _header(path: Path) -> _Header:
    with open_regular(path) as file:
        data = file.read(_HEADER_BYTES)
    header = _meta(data, path.parent) if path.suffix.lower() in META_SUFFIXES else _nrrd(data, path.parent)
    if not 2 <= len(header.sizes) <= _MAX_DIMENSIONS:
        raise InputError(f"{len(header.sizes)} dimensions, want 2 to {_MAX_DIMENSIONS}")
    if math.prod(header.sizes) * header.value_bytes > MAX_VOLUME_BYTES:
        raise InputError(f"a size of {' x '.join(map(str, header.sizes))} voxels, which no memory holds")
    return header


def _meta(data: bytes, folder: Path) -> _Header:
    fields: dict[str, str] = {}
    start = 0
    while "ElementDataFile" not in fields:
        line, start = _line(data, start)
        found = re.match(r"([^=:]*)[=:](.*)", line)
        if found is None:
            if start >= len(data):
                raise InputError("no ElementDataFile in its header: cut off, or no MetaImage file")
            continue
        _add(fields, found[1].strip(), found[2].strip())
    (dimensions,) = _counts(fields, "NDims", 1)
    sizes = _counts(fields, "DimSize", dimensions)
    channels = _counts(fields, "ElementNumberOfChannels", 1) if "ElementNumberOfChannels" in fields else ()
    name = fields.get("ElementType", "").removeprefix("MET_").removesuffix("_ARRAY")
    if name not in _META_BYTES:
        raise InputError(f"ElementType: not one that is read ({name[:40]!r})")
    encoding = "raw"
    if fields.get("CompressedData", "False")[:1] in ("T", "t", "1"):
        encoding = "gzip"
    elif fields.get("BinaryData", "True")[:1] not in ("T", "t", "1"):
        encoding = "text"
    skipped = _skipped(fields, "HeaderSize")
    words = fields["ElementDataFile"].split()
    if fields["ElementDataFile"].upper() == "LOCAL":
        return _Header((*sizes, *channels), _META_BYTES[name], encoding, (), start)
    files = _named(words, fields["ElementDataFile"], data[start:], folder)
    return _Header((*sizes, *channels), _META_BYTES[name], encoding, files, skipped * len(files))


def _nrrd(data: bytes, folder: Path) -> _Header:
    line, start = _line(data, 0)
    if not re.fullmatch(r"NRRD000\d", line.strip()):
        raise InputError("cut off, or no NRRD file")
    fields: dict[str, str] = {}
    while start < len(data):
        line, start = _line(data, start)
        if not line.strip():
            break
        key, separator, value = line.partition(":")
        if line.startswith("#") or not separator or value.startswith("="):
            continue
        key = key.strip().lower().replace(" ", "")
        _add(fields, key, value.strip())
        if key == "datafile" and value.split()[:1] == ["LIST"]:
            break  # the names follow up to the end
    (dimensions,) = _counts(fields, "dimension", 1)
    sizes = _counts(fields, "sizes", dimensions)
    kind, encoding = fields.get("type", "").lower(), fields.get("encoding", "").lower()
    if kind not in _NRRD_BYTES:
        raise InputError(f"type: not one that is read ({kind[:40]!r})")
    if encoding not in _NRRD_ENCODINGS:
        raise InputError(f"encoding: not one that is read ({encoding[:40]!r})")
    encoding = _NRRD_ENCODINGS[encoding]
    skipped = _skipped(fields, "byteskip") if encoding == "raw" else 0
    named = fields.get("datafile")
    if named is None:
        return _Header(sizes, _NRRD_BYTES[kind], encoding, (), start + skipped)
    files = _named(named.split(), named, data[start:], folder)
    return _Header(sizes, _NRRD_BYTES[kind], encoding, files, skipped * len(files))


def _add(fields: dict[str, str], key: str, value: str) -> None:
    if key in fields:
        raise InputError(f"{key[:40]} stands twice in its header")
    if len(key) + len(value) > _MAX_TEXT and not re.fullmatch(_LONG.get(key, ""), value):
        raise InputError(f"{key[:40]}: more than {_MAX_TEXT} characters in its header")
    fields[key] = value


def _line(data: bytes, start: int) -> tuple[str, int]:
    """The line from byte ``start`` on, and where the next one begins."""
    end = data.find(b"\n", start, start + _MAX_LINE)
    if end < 0:
        if len(data) - start >= _MAX_LINE:
            raise InputError(f"a line of more than {_MAX_LINE} characters in its header")
        end = len(data)
    return os.fsdecode(data[start:end]), end + 1


def _counts(fields: dict[str, str], key: str, count: int) -> tuple[int, ...]:
    """Positive whole numbers of a field."""
    words = fields.get(key, "").split()
    numbers = tuple(int(word) for word in words if re.fullmatch(r"[0-9]{1,15}", word))
    if count > _MAX_DIMENSIONS or len(words) != count or len(numbers) != count or min(numbers, default=0) < 1:
        wanted = "a positive whole number" if count == 1 else f"{count} positive whole numbers"
        raise InputError(f"{key}: want {wanted} (got {fields.get(key, '')[:40]!r})")
    return numbers


def _skipped(fields: dict[str, str], key: str) -> int:
    """Bytes before the values of a file; -1 in the header means that the values are its end."""
    text = fields.get(key, "0")
    if not re.fullmatch(r"-1|[0-9]{1,15}", text):
        raise InputError(f"{key}: want a number of bytes or -1 (got {text[:40]!r})")
    return max(int(text), 0)


def _named(words: list[str], whole: str, rest: bytes, folder: Path) -> tuple[Path, ...]:
    """Files that a header names: one, a list that follows, or a pattern with first, last and step."""
    if words[:1] == ["LIST"]:
        names = [os.fsdecode(line).strip() for line in rest.splitlines()]
        names = [name for name in names if name]
    elif len(words) >= 3 and re.fullmatch(r"[^%]*%0?[0-9]{0,2}d[^%]*", words[0]):
        numbers = [int(word) for word in words[1:4] if re.fullmatch(r"[0-9]{1,9}", word)]
        first, last, step = (*numbers, 1)[:3] if len(numbers) == len(words[1:4]) else (0, 0, 0)
        if step < 1 or (last - first) // step >= _MAX_FILES:
            raise InputError(f"a pattern of files that makes no sense ({whole[:60]!r})")
        names = [words[0] % number for number in range(first, last + 1, step)]
    else:
        names = [whole]
    if not names or not all(names) or len(names) > _MAX_FILES:
        raise InputError("names no file with its values, or too many")
    return tuple(folder / name for name in names)
