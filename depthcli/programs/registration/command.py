"""Any program that writes the expected errors of a registration."""

from __future__ import annotations

import math
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.errors import InputError
from depthcli.core.result import Clock
from depthcli.core.volumes import Grid, RegisteredPair
from depthcli.io.formats.volumes import read_volume, write_array
from depthcli.methods.registration.pipeline import RegistrationPipeline, RegistrationResult
from depthcli.programs.process import ProgramError
from depthcli.programs.program import Program, check_written, scratch_folder

_VOXEL_BYTES = 36  # of this process, per voxel, until the maps are written; measured


class Command(Program, RegistrationPipeline):
    """A program of others: two volumes on one grid in, a volume of expected errors in mm out.

    It gets the fixed volume and the registered moving one, float32 on the fixed grid, whole, and writes a volume on
    this grid without NaN, infinite or negative values. It says nothing of matches: there is no ``shift.*``.
    """

    placeholders: ClassVar[tuple[str, ...]] = ("fixed", "warped", *Program.placeholders)

    format: Literal["nii.gz", "nii", "mha", "nrrd"] = Field(
        "nii.gz", description="of the volumes that the program reads and writes"
    )

    @property
    def suffix(self) -> str:
        return f".{self.format}"

    def __call__(self, pair: RegisteredPair) -> RegistrationResult:
        """Write the volumes, run the program, read its volume; ProgramError where it failed."""
        clock = Clock()
        clock.start("write")
        z, y, x = pair.shape
        grid = pair.grid or Grid((x, y, z), pair.spacing[::-1])
        with scratch_folder() as folder:
            inputs = {}
            for name, values in (("fixed", pair.fixed), ("warped", pair.warped)):
                inputs[name] = folder / f"{name}{self.suffix}"
                write_array(inputs[name], grid, values)
            error = _read_errors(self.write_map(folder, inputs, clock), grid)
        inside = error if pair.mask is None else error[pair.mask]
        return RegistrationResult(
            expected_error=error, step=(1.0, 1.0, 1.0), start=(0.0, 0.0, 0.0), seconds=clock.seconds,
            figures={"mean_error": round(float(inside.mean(dtype=np.float64)), 6)},
        )  # fmt: skip

    def peak_bytes(self, shape: tuple[int, int, int], spacing: tuple[float, float, float]) -> int:
        """Return the memory of the volumes, bytes; what the program takes is not known before."""
        return _VOXEL_BYTES * math.prod(shape)


def _read_errors(path: Path, grid: Grid) -> NDArray[np.float32]:
    """Return the expected errors that a program wrote, (Z, Y, X) float32, mm.

    Raises
    ------
    ProgramError
        The file is missing, empty, damaged, on another grid, or has values that are no errors.
    """
    check_written(path)
    try:
        volume = read_volume(path)
    except InputError as error:
        raise ProgramError(f"the program's volume cannot be read: {error}") from error
    if not volume.grid.same_as(grid):
        difference = volume.grid.describe_difference(grid)
        raise ProgramError(f"the program's {path.name} lies on another grid than the fixed volume ({difference})")
    values = volume.values
    for what, wrong in (("NaN or infinite", ~np.isfinite(values)), ("negative", values < 0)):
        if wrong.any():
            raise ProgramError(f"{np.count_nonzero(wrong)} voxels of the program's {path.name} are {what}; want mm")
    return values
