"""Graph-based segmentation (Felzenszwalb and Huttenlocher, IJCV 2004)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from depthcli.algorithms.regions import connected_components_of_labels, merge_small_regions
from depthcli.algorithms.segmentation import Segmenter


class Felzenszwalb(Segmenter):
    """Join regions that differ little compared with the differences inside both; textured regions grow larger."""

    aliases = ("FH",)

    scale: float = Field(20.0, gt=0, le=1e6, description="larger values give larger regions, grey levels x pixels")
    sigma: float = Field(
        0.8, ge=0, le=10, description="standard deviation of the smoothing before segmentation, pixels"
    )
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions join a neighbor, pixels")

    def __call__(self, image: NDArray[np.uint8]) -> NDArray[np.int32]:
        from skimage.segmentation import felzenszwalb

        labels = felzenszwalb(
            np.ascontiguousarray(image), scale=self.scale, sigma=self.sigma, min_size=self.min_size, channel_axis=-1
        )
        pieces = connected_components_of_labels(np.asarray(labels, dtype=np.int32))
        return merge_small_regions(pieces, image, self.min_size)
