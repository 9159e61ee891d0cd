"""Cases of readers: one file is damaged or odd, and each reader gives what it holds or an InputError that names it."""

from __future__ import annotations

import gzip
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.errors import InputError
from depthcli.io import pairs
from depthcli.io.formats import depth, disparity, fields, pictures, volumes
from depthcli.io.formats.calibrations import read_color_infrared_rig, read_geometry, read_rig
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.fields import read_landmarks
from depthcli.io.formats.files import read_bytes, shown
from depthcli.io.formats.images import image_size, read_grey, read_image, read_pair
from depthcli.io.formats.networks import read_network
from tests.damage import NAMES, bomb, damaged, originals, put_special
from tests.fuzzing.common import Fault
from tests.fuzzing.inputs import GRID, odd_json, others, write_behind


def read_volume(path: Path) -> np.ndarray:
    return np.array(map_npy(path, 3))


def read_and_write(path: Path) -> np.ndarray:
    """Read a map and write it in every format; return the map."""
    values = disparity.read_disparity(path, scale_8bit=4)
    with tempfile.TemporaryDirectory() as folder:
        disparity.write_disparity_png(Path(folder, "a.png"), values)
        depth.write_depth_png(Path(folder, "b.png"), values)
        disparity.write_pfm(Path(folder, "a.pfm"), values)
    pictures.preview(values, 64)
    pictures.preview_depth(values)
    pictures.confidence_picture(values)
    return values


READERS: tuple[Callable[[Path], Any], ...] = (
    read_image, read_grey, read_and_write, depth.read_depth, depth.read_codes, pictures.read_status, read_volume,
    image_size, read_bytes, lambda path: read_pair(path, path).grey8,
)  # fmt: skip

SUITED: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "volumes": (volumes.read_volume, volumes.read_grid, lambda path: volumes.read_volume(path, True),
                lambda path: fields.read_field(path, GRID)),
    ".csv": (pairs.read_table, lambda path: read_landmarks(path, GRID)),
    ".txt": (lambda path: read_landmarks(path, GRID, True), read_geometry),
    "transforms": (fields.read_transform,),
    ".yaml": (lambda path: read_rig([path]), lambda path: read_color_infrared_rig(path, (9, 9), (9, 9))),
    ".json": (read_network, lambda path: read_color_infrared_rig(path, (9, 9), (9, 9))),
}  # fmt: skip


def reader_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Damage one file and read it by two readers; return the kind of damage and the outcome."""
    pool = others() if rng.random() < 0.4 else originals()
    name = list(pool)[rng.integers(len(pool))]
    path = folder / (NAMES[rng.integers(len(NAMES))] + Path(name).suffix if rng.random() < 0.1 else name)
    if pool is others():
        write_behind(folder)
    suffix = volumes.suffix_of(Path(name))
    kind = "transforms" if name.startswith(("affine", "bspline")) else suffix
    readers = SUITED.get("volumes" if suffix in volumes.VOLUME_SUFFIXES else kind, READERS)
    chance = rng.random()
    if chance < 0.06:
        path.unlink(missing_ok=True)
        what, made = "special", put_special(path, rng)
    elif chance < 0.09 and pool is not others():
        what, (made, data) = "bomb", bomb(rng)
        path.write_bytes(data)
    elif name.endswith((".json", ".yaml")) and rng.random() < 0.7:
        what, text = odd_json(pool[name].decode(), rng)
        what, made = "odd value", f"{name}, {what}"
        path.write_text(text, "utf-8")
    else:
        made, data, packed = name, pool[name], name.endswith(".gz") and rng.random() < 0.7
        what, data = damaged(gzip.decompress(data) if packed else data, rng, list(pool.values()))
        path.write_bytes(gzip.compress(data, 1) if packed else data)
    accepted = 0
    for reader in rng.choice(np.array((*readers, *READERS[: len(readers) < 2]), object), 2, replace=False):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                reader(path)
                accepted += 1
            except InputError as error:
                message = str(error)
                named = any(shown(each) in message for each in (path, *folder.iterdir()))
                if not message.isprintable() or not named or len(message) > 900:
                    raise Fault(f"{what} of {made}: message {message!r}") from error
            except Exception as error:
                raise Fault(f"{what} of {made}: {type(error).__name__}: {error}") from error
    return f"{what}: {'read' if accepted == 2 else 'refused' if accepted == 0 else 'read by one'}"
