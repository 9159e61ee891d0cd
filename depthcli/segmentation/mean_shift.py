"""Mean-shift segmentation (Comaniciu and Meer, PAMI 2002)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.labelling.regions import connected_components, merge_small_regions
from depthcli.segmentation import Segmenter


class MeanShift(Segmenter):
    """Moves every pixel to its mode in the joint space of position and color; modes that touch are a region.

    Small radii over-segment, which stereo matching wants: a region must not cross a depth edge.
    """

    aliases = ("MS",)

    spatial_radius: float = Field(5.0, gt=0, le=50, description="hs, radius of the window, pixels")
    color_radius: float = Field(6.0, gt=0, le=255, description="hr, radius of the window in color, grey levels")
    join_distance: float = Field(
        4.0, ge=0, le=442, description="neighbors whose filtered colors are nearer than this are one region"
    )
    min_size: int = Field(
        20, ge=1, le=10**8, description="smaller regions join the neighbor of the nearest color, pixels"
    )

    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        filtered = cv2.pyrMeanShiftFiltering(
            np.ascontiguousarray(image), self.spatial_radius, self.color_radius, maxLevel=0
        )
        labels = connected_components(np.asarray(filtered, dtype=np.uint8), self.join_distance)
        return merge_small_regions(labels, image, self.min_size)
