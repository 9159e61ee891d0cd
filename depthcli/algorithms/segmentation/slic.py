"""Superpixels by k-means in color and position (Achanta et al., PAMI 2012)."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.regions import connected_components_of_labels, merge_small_regions
from depthcli.algorithms.segmentation import Segmenter
from depthcli.core.maps import Image8, Ints


class Slic(Segmenter):
    """Compute compact superpixels of similar size: k-means in color and position, started from a grid."""

    size: float = Field(200.0, ge=4, le=1e6, description="approximate size of a region, pixels")
    compactness: float = Field(10.0, gt=0, le=1000, description="weight of distance against color: larger is squarer")
    iterations: int = Field(10, ge=1, le=100, description="number of k-means iterations")
    min_size: int = Field(20, ge=1, le=10**8, description="smaller regions join a neighbor, pixels")

    def __call__(self, image: Image8) -> Ints:
        from skimage.segmentation import slic

        labels = slic(
            np.ascontiguousarray(image),
            n_segments=max(1, round(image.shape[0] * image.shape[1] / self.size)),
            compactness=self.compactness,
            max_num_iter=self.iterations,
            start_label=0,
            enforce_connectivity=False,
            channel_axis=-1,
        )
        pieces = connected_components_of_labels(np.asarray(labels, dtype=np.int32))
        return merge_small_regions(pieces, image, self.min_size)
