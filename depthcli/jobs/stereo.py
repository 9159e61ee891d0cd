"""``depthcli stereo``: a folder of rectified pairs in, a run folder of disparity maps out."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.batch.config import JobConfig
from depthcli.batch.record import to_csv
from depthcli.batch.resources import show_bytes
from depthcli.batch.runner import Outcome
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.io.atomic import write_text
from depthcli.io.disparity import write_disparity_png, write_pfm
from depthcli.io.images import write_png
from depthcli.io.scenes import Scene
from depthcli.stereo.pipeline import Pipeline
from depthcli.stereo.volume import StereoResult

# The largest disparity a KITTI file can hold: its scenes come without a range of their own.
_KITTI_RANGE = 255


class StereoConfig(JobConfig):
    """Root of a ``stereo`` config: a pipeline and its parameters, side by side."""

    flattened: ClassVar[str] = "pipeline"

    pipeline: Pipeline = Field(description="the data flow from image pair to map")
    max_disparity: int | None = Field(
        None, ge=1, le=16383, description="largest disparity searched, pixels; null: what the scene says"
    )


class PairWork(ABC):
    """Matches one scene: what ``stereo`` and ``fuse`` have in common."""

    def __call__(self, scene: Scene, folder: Path, memory: int) -> Outcome:
        """Read the pair, match it, write the maps into ``folder``.

        Raises
        ------
        InputError
            The images cannot be used, the search range is unknown, or ``memory`` bytes do not suffice.
        """
        start = time.perf_counter()
        try:
            pair = StereoPair(*scene.load_pair())
        except (ValueError, TypeError) as error:
            raise InputError(f"{scene.left}: {error}") from error
        top = self._range(scene)
        if top is None:
            raise InputError(f"{scene.left.parent}: the search range is not known; say it with --max-disparity")
        self._check_memory(pair, top, memory)
        loaded = time.perf_counter()
        result = self._match(scene, pair, top)
        matched = time.perf_counter()
        facts = {
            "width": pair.shape[1],
            "height": pair.shape[0],
            "max_disparity": top,
            "density": round(result.disparity.density, 6),
            **{name: float(value) for name, value in result.figures.items()},
        }
        save_result(result, folder, top)
        other = matched - loaded - sum(result.seconds.values())
        seconds = {"load": loaded - start, **result.seconds, "other": max(other, 0.0)}
        return Outcome(facts, {**seconds, "save": time.perf_counter() - matched})

    def settings(self, scene: Scene) -> dict[str, str]:
        """The search range, which may come from a file beside the images."""
        return {"max_disparity": str(self._range(scene))}

    def _range(self, scene: Scene) -> int | None:
        top = self._wanted_range() or scene.max_disparity
        return _KITTI_RANGE if top is None and scene.layout.startswith("kitti") else top

    @abstractmethod
    def _match(self, scene: Scene, pair: StereoPair, top: int) -> StereoResult: ...

    @abstractmethod
    def _peak_bytes(self, shape: tuple[int, int], top: int) -> int: ...

    @abstractmethod
    def _wanted_range(self) -> int | None: ...

    def _check_memory(self, pair: StereoPair, top: int, memory: int) -> None:
        try:
            need = self._peak_bytes(pair.shape, top)
        except NotImplementedError:
            return
        if need > memory:
            raise InputError(
                f"needs about {show_bytes(need)} of memory ({pair.shape[1]} x {pair.shape[0]} pixels, "
                f"{top + 1} disparities), {show_bytes(memory)} may be used; see --max-memory, --jobs, --max-disparity"
            )


@dataclass(frozen=True)
class StereoWork(PairWork):
    """Matches one scene; picklable, for worker processes."""

    config: StereoConfig

    def _match(self, scene: Scene, pair: StereoPair, top: int) -> StereoResult:
        return self.config.pipeline(pair, top)

    def _peak_bytes(self, shape: tuple[int, int], top: int) -> int:
        return self.config.pipeline.peak_bytes(shape, top)

    def _wanted_range(self) -> int | None:
        return self.config.max_disparity


def save_result(result: StereoResult, folder: Path, max_disparity: int) -> None:
    """Write everything a stereo pipeline gave into the existing ``folder``."""
    values = result.disparity.values
    write_pfm(folder / "disp_left.pfm", values)
    write_disparity_png(folder / "disp_left.png", values)
    write_png(folder / "status.png", result.disparity.status)
    write_png(folder / "preview.png", preview(values, max_disparity))
    for name, confidence in result.confidence.items():
        write_pfm(folder / f"confidence_{name}.pfm", confidence)
    for name, rows in result.tables.items():
        write_text(folder / f"{name}.csv", to_csv(rows))
    for name, picture in result.pictures.items():
        write_png(folder / f"{name}.png", picture)


def preview(values: NDArray[np.float32], top: float) -> NDArray[np.uint8]:
    """(H, W, 3) RGB picture of a map for eyes: blue = 0 to red = ``top``, black = no value."""
    known = ~np.isnan(values)
    grey = np.zeros(values.shape, np.uint8)
    grey[known] = np.clip(np.rint(values[known] * (255.0 / max(top, 1e-6))), 0, 255).astype(np.uint8)
    picture: NDArray[Any] = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[..., ::-1].copy()
    picture[~known] = 0
    return picture
