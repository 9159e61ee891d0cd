"""``depthcli sample``: write scenes with known disparity in our own layout."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from depthcli.core.errors import DepthcliError, OutputError
from depthcli.io.atomic import PARTIAL_SUFFIX, write_text
from depthcli.io.disparity import write_pfm
from depthcli.io.images import Image, write_png
from depthcli.io.scenes import Scene, find_scenes
from depthcli.synthetic.cross_modal import cross_modal_pair
from depthcli.synthetic.stereo_scenes import KINDS, Kind, Radiometry, make_scene

_META = "meta.json"


class SampleOptions(BaseModel):
    """What to generate; the same options give the same bytes."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    kinds: tuple[Kind, ...] = Field(
        KINDS, min_length=1, description="Kinds of scene, taken in turn: planes, foreground, repetitive, curved."
    )
    count: int = Field(6, ge=1, le=10000, description="Number of scenes.")
    seed: int = Field(0, ge=0, description="Seed of the first round of kinds; every further round takes the next.")
    width: int = Field(400, ge=16, le=8192, description="Width of the images, pixels.")
    height: int = Field(300, ge=16, le=8192, description="Height of the images, pixels.")
    max_disparity: int = Field(48, ge=4, description="Largest disparity to search, pixels; at most width / 2.")
    noise: float = Field(0.0, ge=0, le=100, description="Standard deviation of the cameras' noise, grey levels of 255.")
    radiometric: float = Field(
        0.0,
        ge=0,
        le=1,
        description="How differently the right camera sees the light (gain, offset, gamma, dark corners): 0 = alike.",
    )
    wall_contrast: float = Field(1.0, ge=0, le=1, description="Contrast of the walls' texture: 0 = bare walls.")
    cross_modal: bool = Field(False, description="Left image grey, right image as an infrared camera sees it.")
    speckles: float = Field(
        0.0, ge=0, le=1, description="With cross_modal: share of the right image's pixels with a projected dot."
    )

    @model_validator(mode="after")
    def _consistent(self) -> SampleOptions:
        if self.max_disparity > self.width // 2:
            raise ValueError(f"max_disparity is at most width / 2 = {self.width // 2}, got {self.max_disparity}")
        if self.speckles and not self.cross_modal:
            raise ValueError("speckles needs cross_modal")
        return self

    def scenes(self) -> list[tuple[str, Kind, int]]:
        """(name, kind, seed) of every scene."""
        kinds = tuple(dict.fromkeys(self.kinds))
        chosen = [(kinds[i % len(kinds)], self.seed + i // len(kinds)) for i in range(self.count)]
        return [(f"{kind}_{seed}", kind, seed) for kind, seed in chosen]


@dataclass(frozen=True)
class SampleRow:
    """One scene of the result.

    Attributes
    ----------
    scene : name, the folder below the output folder
    status : ``written``, ``kept`` (was there already, made with the same options) or ``failed``
    width, height, max_disparity : pixels; None where it failed
    nonocc : share of the pixels seen by both cameras; None where it is not known
    reason : why it failed, or empty
    """

    scene: str
    status: str
    width: int | None = None
    height: int | None = None
    max_disparity: int | None = None
    nonocc: float | None = None
    reason: str = ""


def write_samples(output: Path, options: SampleOptions | None = None, *, overwrite: bool = False) -> list[SampleRow]:
    """Generate scenes into ``output/<kind>_<seed>/``.

    A scene that is there already with the same options is kept, so that a run that was stopped can be
    started again.

    Raises
    ------
    OutputError
        A scene folder made with other options is in the way and ``overwrite`` is off (found before
        anything is written), or a file cannot be written.
    """
    options = options or SampleOptions()
    planned = [(name, kind, seed, _source(options, kind, seed)) for name, kind, seed in options.scenes()]
    kept = _kept(output, {name: source for name, _, _, source in planned}, overwrite)
    rows = []
    for name, kind, seed, source in planned:
        if name in kept:
            rows.append(kept[name])
            continue
        scene = make_scene(
            kind, seed, options.width, options.height, options.max_disparity,
            noise=options.noise, radiometry=Radiometry.of_strength(options.radiometric),
            wall_contrast=options.wall_contrast,
        )  # fmt: skip
        left: Image = scene.left
        right: Image = scene.right
        if options.cross_modal:
            left, right = cross_modal_pair(left, right, seed, options.speckles)
        rows.append(
            _write(
                output, name, left, right, scene.disparity_left, scene.disparity_right,
                {"nonocc": scene.nonocc, "all": np.ones_like(scene.nonocc), "disc": scene.disc},
                options.max_disparity, "exact", source, _notes(kind, scene.repetition),
            )
        )  # fmt: skip
    return rows


def write_cross_modal(
    input_folder: Path, output: Path, *, seed: int = 0, speckles: float = 0.0, overwrite: bool = False
) -> list[SampleRow]:
    """Turn every scene of a folder into a cross-modal one, ``output/<scene>/``, with the same truth and masks.

    A scene that cannot be read becomes a row with its reason; the others are written.

    Raises
    ------
    InputError
        ``input_folder`` holds no scene.
    OutputError
        As for :func:`write_samples`.
    """
    scenes = find_scenes(input_folder)
    source = f"generated by depthcli sample: cross-modal, seed {seed}, speckles {speckles:g}, from "
    kept = _kept(output, {scene.name: source + scene.name for scene in scenes}, overwrite)
    rows = []
    for scene in scenes:
        if scene.name in kept:
            rows.append(kept[scene.name])
            continue
        try:
            rows.append(_convert(scene, output, seed, speckles, source + scene.name))
        except OutputError:
            raise
        except DepthcliError as error:
            rows.append(SampleRow(scene.name, "failed", reason=str(error)))
    return rows


def _convert(scene: Scene, output: Path, seed: int, speckles: float, source: str) -> SampleRow:
    left, right = cross_modal_pair(*scene.load_pair(), seed, speckles)
    disparity = disparity_right = None
    masks: dict[str, NDArray[np.bool_]] = {}
    if scene.disparity_left is not None:
        truth = scene.load_truth()
        disparity, disparity_right, masks = truth.disparity, truth.right, truth.masks
    notes = "left: grey of the scene's left image; right: infrared-like picture of its right image."
    return _write(
        output, scene.name, left, right, disparity, disparity_right, masks, scene.max_disparity,
        "as in the source", source, notes,
    )  # fmt: skip


def _write(
    output: Path,
    name: str,
    left: Image,
    right: Image,
    disparity: NDArray[np.float32] | None,
    disparity_right: NDArray[np.float32] | None,
    masks: dict[str, NDArray[np.bool_]],
    max_disparity: int | None,
    exactness: str,
    source: str,
    notes: str,
) -> SampleRow:
    """Write one scene into a folder of a temporary name, then rename it: a scene is whole or not there."""
    final = output / name
    folder = final.with_name(f".{final.name}{PARTIAL_SUFFIX}")
    files = ["left.png", "right.png"]
    _remove(folder)
    write_png(folder / "left.png", left)
    write_png(folder / "right.png", right)
    for stem, values in (("disp_left", disparity), ("disp_right", disparity_right)):
        if values is not None:
            write_pfm(folder / f"{stem}.pfm", values)
            files.append(f"{stem}.pfm")
    for mask, inside in masks.items():
        write_png(folder / f"mask_{mask}.png", inside)
        files.append(f"mask_{mask}.png")
    height, width = left.shape[:2]
    meta: dict[str, Any] = {
        "files": sorted(files),
        "disp_scale": 1,
        "max_disparity": max_disparity,
        "width": width,
        "height": height,
        "unknown_value": "inf",
        "masks": exactness,
        "source": source,
        "notes": notes,
    }
    if max_disparity is None:
        del meta["max_disparity"]
    write_text(folder / _META, json.dumps(meta, indent=1) + "\n")
    _remove(final)
    try:
        folder.rename(final)
    except OSError as error:
        raise OutputError(f"{final}: cannot be written ({error.strerror or error})") from error
    seen = float(masks["nonocc"].mean()) if "nonocc" in masks else None
    return SampleRow(name, "written", width, height, max_disparity, seen)


def _kept(output: Path, sources: dict[str, str], overwrite: bool) -> dict[str, SampleRow]:
    """Rows of the scenes that are there already; OutputError for a folder that must not be touched."""
    kept = {}
    for name, source in sources.items():
        folder = output / name
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{folder}: is in the way and not a folder")
        if not folder.is_dir():
            continue
        meta = _meta(folder)
        if meta is not None and meta.get("source") == source and _whole(folder, meta):
            kept[name] = SampleRow(name, "kept", meta["width"], meta["height"], meta.get("max_disparity"))
        elif meta is None or not str(meta.get("source")).startswith("generated by depthcli sample"):
            raise OutputError(f"{folder}: holds files that depthcli sample did not make; choose another output folder")
        elif meta.get("source") != source and not overwrite:
            raise OutputError(f"{folder}: was made with other options; use --overwrite to replace it")
    return kept


def _remove(folder: Path) -> None:
    try:
        if folder.is_dir():
            shutil.rmtree(folder)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be replaced ({error.strerror or error})") from error


def _whole(folder: Path, meta: dict[str, Any]) -> bool:
    """Every file that the record names is there."""
    files = meta.get("files")
    return isinstance(files, list) and all((folder / str(file)).is_file() for file in files)


def _meta(folder: Path) -> dict[str, Any] | None:
    try:
        meta = json.loads((folder / _META).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return meta if isinstance(meta, dict) else None


def _source(options: SampleOptions, kind: Kind, seed: int) -> str:
    words = [f"kind {kind}", f"seed {seed}", f"{options.width}x{options.height}", f"range {options.max_disparity}"]
    words += [f"noise {options.noise!r}", f"radiometric {options.radiometric!r}"]
    words += [f"wall contrast {options.wall_contrast!r}"]
    if options.cross_modal:
        words.append(f"cross-modal, speckles {options.speckles!r}")
    return "generated by depthcli sample: " + ", ".join(words)


def _notes(kind: Kind, repetition: NDArray[np.float32]) -> str:
    notes = "Disparity at pixel centers and masks are exact; no pixel is unknown."
    if kind == "repetitive":
        notes += f" The wall's pattern repeats after {np.nanmin(repetition):.2f} to {np.nanmax(repetition):.2f} pixels."
    return notes
