"""``DepthProgram``: what programs that refine or complete a depth map share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.core.frames import RgbdFrame
from depthcli.core.result import Clock
from depthcli.io.formats.depth import MILLIMETERS, write_depth_png
from depthcli.io.formats.disparity import write_pfm
from depthcli.programs.maps import MapProgram, write_input
from depthcli.programs.process import ProgramError
from depthcli.programs.program import scratch_folder

MAP_BYTES = 200  # of this process, per pixel, while a program runs and its map is read


class DepthProgram(MapProgram):
    """A program that gets a color image and depth maps, and writes a depth map of the same size."""

    placeholders: ClassVar[tuple[str, ...]] = ("color", "depth", *MapProgram.placeholders)

    depth_images: Literal["png", "pfm"] = Field(
        "png", description="depth maps for the program: png, codes of 16 bit with 0 unknown; pfm, meters, inf unknown"
    )
    codes_per_meter: float = Field(MILLIMETERS, gt=0, le=1e6, description="codes per meter of these png files")

    def new_depth(
        self, frame: RgbdFrame, others: Mapping[str, NDArray[np.float32]], clock: Clock
    ) -> NDArray[np.float32]:
        """Run the program on a frame; return its map, (H, W) float32, meters, NaN = no value.

        Parameters
        ----------
        others : further placeholder -> depth map, (H, W) float32, meters, NaN = unknown
        clock : books ``write``, ``program`` and ``read``

        Raises
        ------
        ProgramError
            It failed, in any way.
        """
        clock.start("write")
        with scratch_folder() as folder:
            inputs = {"color": write_input(folder, "color", frame.color, "png")}
            for name, depth in {"depth": frame.depth, **others}.items():
                inputs[name] = folder / f"{name}.{self.depth_images}"
                if self.depth_images == "pfm":
                    write_pfm(inputs[name], depth)
                else:
                    write_depth_png(inputs[name], depth, self.codes_per_meter)
            path = self.write_map(folder, inputs, clock)
            depth = self.read_map(path, frame.shape, MILLIMETERS)
            with np.errstate(invalid="ignore"):
                depth[~(depth > 0)] = np.nan
            if np.isnan(depth).all():
                raise ProgramError(f"no pixel of the program's {path.name} has a depth above 0")
        return depth
