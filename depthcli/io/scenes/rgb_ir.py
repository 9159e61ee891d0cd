"""Frames of a color camera, an infrared camera and a depth sensor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from depthcli.core.errors import InputError
from depthcli.io.scenes import check_same_size
from depthcli.io.scenes.rgbd import RgbdScene

if TYPE_CHECKING:
    from depthcli.core.frames import RgbIrFrame


@dataclass(frozen=True, kw_only=True)
class RgbIrScene(RgbdScene):
    """A frame with an infrared image; ``calibration`` holds both cameras, or says that the pair is rectified.

    Attributes
    ----------
    infrared : image file, 8 or 16 bit
    infrared_plain : the same view with the projector covered, which is used instead, or None
    max_disparity : largest disparity to search, or None
    """

    infrared: Path
    infrared_plain: Path | None = None
    max_disparity: int | None = None

    @property
    def input_files(self) -> dict[str, Path]:
        """Role -> file that a method may look at, with the infrared image that is used."""
        return {**super().input_files, "infrared": self.infrared_plain or self.infrared}

    def load_pair(self) -> RgbIrFrame:
        """Return the frame with its infrared image and calibration.

        Raises
        ------
        InputError
            As for :meth:`load`; no calibration, or one that does not fit the images.
        """
        from depthcli.core.frames import RgbIrFrame, infrared_image
        from depthcli.io.formats.calibrations import read_color_infrared_rig
        from depthcli.io.formats.depth import check_fb
        from depthcli.io.formats.images import read_image

        frame = self.load()
        if self.calibration is None:
            raise InputError(f"{self.folder}: no calibration of the color and the infrared camera (calib.json)")
        infrared = infrared_image(read_image(self.infrared_plain or self.infrared))
        height, width = infrared.shape
        rig = read_color_infrared_rig(self.calibration, (frame.shape[1], frame.shape[0]), (width, height))
        if not isinstance(rig, float):
            return RgbIrFrame(frame.color, infrared, frame.depth, rig)
        check_same_size(self.infrared, infrared.shape, self.image, frame.shape, "; a rectified pair has one size")
        check_fb(self.calibration, rig, frame.depth)
        return RgbIrFrame(frame.color, infrared, frame.depth, None, rig)
