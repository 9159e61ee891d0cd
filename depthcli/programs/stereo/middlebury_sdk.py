"""Programs in the form of the Middlebury SDK: ``alg-NAME/run im0 im1 ndisp outdir``."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field, ValidationInfo, field_validator

from depthcli.core.errors import ConfigError
from depthcli.core.frames import StereoPair
from depthcli.core.result import Clock
from depthcli.io.formats.disparity import KITTI_SCALE
from depthcli.methods.stereo.pipeline import StereoPipeline
from depthcli.methods.stereo.volume import StereoResult
from depthcli.programs.maps import read_map, write_input
from depthcli.programs.process import ProgramError
from depthcli.programs.program import ProgramRun, beside_config, scratch_folder
from depthcli.programs.stereo.command import MAP_BYTES, disparity_map

_PREFIX = "alg-"


class MiddleburySdk(ProgramRun, StereoPipeline):
    """A method as the Middlebury SDK (MiddEval3) has it: a folder ``alg-NAME`` with a program ``run``.

    It gets ``im0.png``, ``im1.png``, the number of disparities and a folder into which it writes ``disp0.pfm`` (which
    ``runalg`` then renames), or ``disp0NAME.pfm``; a sparse map ``disp0_s.pfm`` and ``time.txt`` beside it are not
    read. It runs in the folder that holds ``alg-NAME``. All files in ``alg-NAME`` that can be executed are part of the
    run: scenes are computed again where they change.
    """

    program: str = Field(
        description="the folder alg-NAME, seen from that of the config file or from the current one", min_length=1
    )

    @field_validator("program")
    @classmethod
    def _beside_config(cls, program: str, info: ValidationInfo) -> str:
        return beside_config(program, info)

    def __call__(self, pair: StereoPair, max_disparity: int) -> StereoResult:
        """Write the images, run the program, read its map; ProgramError where it failed."""
        clock = Clock()
        clock.start("write")
        with scratch_folder() as scratch:
            views = zip(("im0", "im1"), pair.full_range, strict=True)
            im0, im1 = (str(write_input(scratch, name, image, "png")) for name, image in views)
            algorithm = Path(os.path.abspath(self.program))
            words = [str(algorithm / "run"), im0, im1, str(max_disparity + 1), str(scratch)]
            self.run(words, algorithm.parent, scratch, clock)
            values = read_map(_map_in(scratch, algorithm.name.removeprefix(_PREFIX)), pair.shape, None, KITTI_SCALE)
            disparity = disparity_map(values, max_disparity)
        return StereoResult(disparity, seconds=clock.seconds)

    def peak_bytes(self, shape: tuple[int, int], max_disparity: int) -> int:
        """Return the memory of the images and maps, bytes; what the program takes is not known before."""
        return MAP_BYTES * shape[0] * shape[1]

    def tile_halo(self) -> int | None:
        """Return None: such programs match whole pairs."""
        return None

    def used_files(self) -> dict[str, Path]:
        """Return role -> file, of the files in the folder that can be executed.

        Raises
        ------
        ConfigError
            There is no such folder, or no program ``run`` in it.
        """
        folder = Path(self.program)
        if not os.access(folder / "run", os.X_OK):
            raise ConfigError(f"program: {folder}: want a folder {_PREFIX}NAME that holds a program called run")
        files = (path for path in sorted(folder.rglob("*")) if path.is_file() and os.access(path, os.X_OK))
        return {f"program/{path.relative_to(folder)}": path for path in files}


def _map_in(folder: Path, name: str) -> Path:
    """Return the map that a program called ``name`` wrote; the only one there where it has another name."""
    expected = [folder / f"disp0{name}.pfm", folder / "disp0.pfm"]
    others = sorted(folder.glob("disp0*.pfm"))
    found = next((path for path in expected if path.is_file()), None)
    if found is None and len(others) > 1:
        raise ProgramError(f"the program wrote {len(others)} maps, but neither {expected[0].name} nor disp0.pfm")
    return found or (others[0] if others else expected[1])
