"""Any program that writes the disparity map of a pair."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import DisparityMap, Status
from depthcli.core.result import Clock
from depthcli.io.formats.disparity import KITTI_SCALE
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.volume import StereoResult
from depthcli.programs.maps import MapProgram, write_input
from depthcli.programs.process import ProgramError
from depthcli.programs.program import scratch_folder
from depthcli.programs.scene import current_scene

MAP_BYTES = 200  # of this process, per pixel, while a program runs and its map is read
_BYTES_PER_CELL = 8  # a guess, for programs of which nothing is known


class Command(MapProgram, StereoPipeline):
    """A program of others: two images and a range in, a disparity map out.

    The pair is as the toolkit matches it: rectified where a calibration is given, and shifted so that the range begins
    at 0. Pixels without a value, or with a negative one, are ``MISMATCH``: programs do not say why; those beyond the
    range are ``OUT_OF_RANGE``.
    """

    placeholders: ClassVar[tuple[str, ...]] = (
        "left", "right", "max_disparity", "min_disparity", *MapProgram.placeholders,
    )  # fmt: skip

    images: Literal["png", "pgm", "ppm", "original"] = Field(
        "png",
        description="what the program reads: png, grey or color as the pair is, 8 or 16 bit; pgm: grey, ppm: RGB; "
        "original: the scene's own files, for pairs that are matched as these are",
    )
    halo: int | None = Field(
        None, ge=0, le=4096, description="pixels around a tile that its map depends on; null: pairs are never tiled"
    )

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Write the images, run the program, read its map; ProgramError where it failed."""
        clock = Clock()
        clock.start("write")
        with scratch_folder() as folder:
            left, right = self._image_files(pair, folder)
            inputs = {"left": left, "right": right, "max_disparity": max_disparity, "min_disparity": 0}
            values = self.read_map(self.write_map(folder, inputs, clock), pair.shape, KITTI_SCALE)
            disparity = disparity_map(values, max_disparity)
        return StereoResult(disparity, seconds=clock.seconds)

    def _image_files(self, pair: StereoPair, folder: Path) -> tuple[Path, ...]:
        """Return the left and the right image as files: the scene's own, or written into ``folder``."""
        if self.images == "original":
            if (files := current_scene().files_of(pair)) is None:
                raise InputError(
                    "images: original: no image files hold this pair as it is matched (rectified, shifted by "
                    "min_disparity, a tile, frames of a video, arrays); take images: png"
                )
            return files
        views = {"png": pair.full_range, "pgm": pair.grey8, "ppm": pair.color8}[self.images]
        names = zip(("left", "right"), views, strict=True)
        return tuple(write_input(folder, name, image, self.images) for name, image in names)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Return the memory of the images and maps, bytes, and where pairs may be tiled a guess of the program's.

        What the program takes is not known before; it is ended where that is too much.
        """
        cells = 0 if self.halo is None else shape[0] * shape[1] * (max_disparity + 1)
        return MAP_BYTES * shape[0] * shape[1] + _BYTES_PER_CELL * cells

    def tile_halo(self) -> int | None:
        return self.halo


def disparity_map(values: NDArray[np.float32], max_disparity: int) -> DisparityMap:
    """Return what a program wrote, (H, W) float32, NaN = no value, as a map of disparities 0 .. ``max_disparity``.

    ProgramError where no value is within this range.
    """
    status = np.zeros(values.shape, np.uint8)
    with np.errstate(invalid="ignore"):
        status[~(values >= 0)] = Status.MISMATCH
        status[values >= max_disparity + 1] = Status.OUT_OF_RANGE
    if status.all():
        raise ProgramError(f"no pixel of the program's map has a disparity from 0 to {max_disparity}")
    return DisparityMap(np.where(status == 0, values, np.float32(np.nan)).astype(np.float32), status)
