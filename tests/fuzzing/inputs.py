"""Intact files other than images, small, and documents of JSON with one odd part."""

from __future__ import annotations

import gzip
import json
import re
from functools import cache
from pathlib import Path

import numpy as np

from depthcli.core.volumes import Grid
from depthcli.io.formats.volumes import _nifti_header, write_array

SHAPE = (9, 12, 14)  # slices, rows, columns of the volumes
GRID = Grid(SHAPE[::-1], (1.0, 1.5, 2.0), (-3.0, 4.0, 5.0))
ROOT = Path(__file__).resolve().parent.parent.parent
_SIZE = " ".join(map(str, GRID.size))

# A list of 10 billion numbers in YAML, each level ten times the one before.
_LEVELS = [f"&{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 10)}]" for k in range(9)]
_BOMB = f"[&a [{', '.join('0' * 10)}], {', '.join(_LEVELS)}]"

# Values where something else stands: of other kinds, nested, too long, too large, of another shape.
ODD_VALUES = (
    _BOMB, "0x" + "f" * 5000,
    "[" * 3000 + "]" * 3000, "[" * 100_000, "9" * 400, "-" + "9" * 5000, "1e400", "1e305", "-99999999999", "NaN",
    "-Infinity", "null", "true", '"x"', '""', "[]", "{}", "[[[[1]]]]", "[1, [2]]", "0", "-1", "0.5", '"\\u0000"',
    '"\\ud800"', "[0, 0, 0]", "300000000", "[" + "1, " * 70_000 + "1]", '{"a": {"b": {}}}', "1e-320", "2147483648",
)  # fmt: skip


def odd_json(text: str, rng: np.random.Generator) -> tuple[str, str]:
    """Return the kind of value and the document, in which it stands for one chosen value, key, or for all of it."""
    places = [match.span() for match in re.finditer(r'"[^"]*"|-?\d+(\.\d+)?(e-?\d+)?|\[[^][]*\]|\btrue\b', text)]
    first, last = places[rng.integers(len(places))] if places and rng.random() < 0.95 else (0, len(text))
    value = ODD_VALUES[rng.integers(len(ODD_VALUES))]
    return f"odd value {value[:12]}", text[:first] + value + text[last:]


def network() -> str:
    """Return the text of the network of the package."""
    return (ROOT / "depthcli" / "io" / "networks" / "accurate.json").read_text("utf-8")


def blob(seed: int, vector: bool = False) -> np.ndarray:
    """Return a smooth volume, or a field of small shifts."""
    rng = np.random.default_rng(seed)
    shape = (*SHAPE, 3) if vector else SHAPE
    values = rng.normal(size=shape)
    for axis in range(3):
        values = values + np.roll(values, 1, axis) + np.roll(values, -1, axis)
    return (values if vector else 100 + 10 * values).astype(np.float32)


def elastix(kind: str, parameters: str, initial: str = "NoInitialTransform", more: str = "") -> bytes:
    """Return a parameter file of elastix."""
    return (
        f'(Transform "{kind}")\n(NumberOfParameters {len(parameters.split())})\n(TransformParameters {parameters})\n'
        f'(InitialTransformParametersFileName "{initial}")\n(HowToCombineTransforms "Compose")\n'
        f"(FixedImageDimension 3)\n(CenterOfRotationPoint 5 5 5)\n{more}"
    ).encode()


_BSPLINE = "(GridSize 4 4 4)\n(GridSpacing 6 6 6)\n(GridOrigin -6 -6 -6)\n(GridIndex 0 0 0)\n"
_TFM = (
    b"#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
    b"Parameters: 1 0 0 0 1 0 0 0 1 0.5 0.25 0\nFixedParameters: 5 5 5\n"
)
_CALIB = b"cam0=[80 0 31.5; 0 80 23.5; 0 0 1]\ncam1=[80 0 31.5; 0 80 23.5; 0 0 1]\ndoffs=0\nbaseline=120\nwidth=64\nheight=48\nndisp=8\n"  # noqa: E501
_RIG = (
    "%YAML:1.0\n---\n"
    + "".join(
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [{data}]\n"
        for name, rows, columns, data in (
            ("K1", 3, 3, "60, 0, 31.5, 0, 60, 23.5, 0, 0, 1"), ("D1", 1, 5, "-0.05, 0.01, 0, 0, 0"),
            ("K2", 3, 3, "61, 0, 31, 0, 61, 24, 0, 0, 1"), ("D2", 1, 5, "-0.04, 0.01, 0, 0, 0"),
            ("R", 3, 3, "1, 0, 0, 0, 1, 0, 0, 0, 1"), ("T", 3, 1, "-0.12, 0.001, 0"),
        )
    )
).encode()  # fmt: skip


@cache
def others() -> dict[str, bytes]:
    """Return file name -> bytes of one intact file of every kind that is read and is no image."""
    fixed, field = blob(1).tobytes(), blob(2, True).tobytes()
    meta = f"ObjectType = Image\nNDims = 3\nBinaryData = True\nElementSpacing = 1 1.5 2\nDimSize = {_SIZE}\n"
    nrrd = f"NRRD0004\ntype: float\ndimension: 3\nsizes: {_SIZE}\nspacings: 1 1.5 2\nendian: little\nencoding: raw\n"
    json_rig = {"rectified": True, "fb": 40.0, "min_disparity": 0, "max_disparity": 8, "disp_scale": 1}
    return {
        "local.mha": f"{meta}ElementType = MET_FLOAT\nElementDataFile = LOCAL\n".encode() + fixed,
        "behind.mhd": f"{meta}ElementType = MET_FLOAT\nElementDataFile = behind.raw\n".encode(),
        "local.nrrd": f"{nrrd}\n".encode() + fixed,
        "behind.nhdr": f"{nrrd}data file: behind.raw\n\n".encode(),
        "volume.nii": _nifti_header(GRID, False) + fixed,
        "packed.nii.gz": gzip.compress(_nifti_header(GRID, False) + fixed, 1, mtime=0),
        "field.nii": _nifti_header(GRID, True) + field,
        "affine.txt": elastix("AffineTransform", "1 0 0 0 1 0 0 0 1 0.5 0.25 0", "initial.txt"),
        "bspline.txt": elastix("BSplineTransform", " ".join(["0.1"] * 192), more=_BSPLINE),
        "affine.tfm": _TFM,
        "points.csv": b"x,y,z\n1,5,7\n3,6,9.5\n2,8,11\n",
        "points.txt": b"point\n3\n1 5 7\n3 6 9.5\n2 8 11\n",
        "calib.txt": _CALIB,
        "rig.yaml": _RIG,
        "meta.json": json.dumps(json_rig, indent=1).encode(),
        "network.json": network().encode(),
        "pairs.csv": b"left,right,name,min_disparity,max_disparity\na.png,b.png,one,0,8\nb.png,a.png,two,-8,0\n",
    }


def write_behind(folder: Path) -> None:
    """Write what the files of :func:`others` point to."""
    (folder / "behind.raw").write_bytes(blob(1).tobytes())
    (folder / "initial.txt").write_bytes(elastix("TranslationTransform", "0.5 -0.5 1"))


def write_pair(folder: Path, rng: np.random.Generator) -> None:
    """Write a registered pair of volumes whose files point to further files, in one of several ways."""
    folder.mkdir(parents=True)
    _write_volume(folder, "fixed", rng, blob(1))
    moving = np.roll(blob(1), 1, axis=2) + blob(3) / 50
    kind = rng.integers(4)
    if kind == 0:
        _write_volume(folder, "moving_warped", rng, moving)
        return
    _write_volume(folder, "moving", rng, moving)
    if kind == 1:
        _write_volume(folder, "displacement", rng, blob(2, True) / 20)
        return
    names = ["transform.txt", *(f"step{k}.txt" for k in range(rng.integers(1, 4)))]
    for name, initial in zip(names, [*names[1:], "NoInitialTransform"], strict=True):
        kinds = {
            "TranslationTransform": "0.5 -0.25 0.75",
            "EulerTransform": "0.01 0.02 -0.01 0.5 0.25 0",
            "AffineTransform": "1 0.01 0 0 1 0 0 0.01 1 0.5 0.25 0",
        }
        chosen = list(kinds)[rng.integers(3)]
        target = str(folder / initial) if initial in names and rng.random() < 0.3 else initial
        (folder / name).write_bytes(elastix(chosen, kinds[chosen], target))


def _write_volume(folder: Path, stem: str, rng: np.random.Generator, values: np.ndarray) -> None:
    ending = str(rng.choice([".mhd", ".nhdr", ".nii.gz", ".mha"], p=[0.4, 0.4, 0.1, 0.1]))
    vector = values.ndim == 4
    if ending in (".nii.gz", ".mha"):
        write_array(folder / f"{stem}{ending}", GRID, np.ascontiguousarray(values))
        return
    behind, packed = f"{stem}_data.{rng.choice(['raw', 'bin'])}", ending == ".nhdr" and rng.random() < 0.5
    behind += ".gz" if packed else ""
    data = np.ascontiguousarray(values, "<f4").tobytes()
    (folder / behind).write_bytes(gzip.compress(data, 1, mtime=0) if packed else data)
    if ending == ".mhd":
        channels = "ElementNumberOfChannels = 3\n" if vector else ""
        text = (
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n"
            f"Offset = -3 4 5\nElementSpacing = 1 1.5 2\nDimSize = {_SIZE}\n{channels}"
            f"ElementType = MET_FLOAT\nElementDataFile = {behind}\n"
        )
    else:
        # With the vector's components first, as NRRD has them.
        kinds, none = ("kinds: vector domain domain domain\n", "none ") if vector else ("", "")
        text = (
            f"NRRD0004\ntype: float\ndimension: {4 if vector else 3}\nspace: left-posterior-superior\n"
            f"sizes: {'3 ' if vector else ''}{_SIZE}\nspace directions: {none}(1,0,0) (0,1.5,0) (0,0,2)\n{kinds}"
            f"endian: little\nencoding: {'gzip' if packed else 'raw'}\nspace origin: (-3,4,5)\ndata file: {behind}\n\n"
        )
    (folder / f"{stem}{ending}").write_text(text)
