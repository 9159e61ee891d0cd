"""Selection of reliable color-infrared matches, given the sensor's measurements."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from depthcli.algorithms.filters import local_moments
from depthcli.core.frames import Image, StereoPair
from depthcli.core.maps import DisparityMap, Floats
from depthcli.core.method import ConfigModel
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.volume import CostVolume, RefinementContext


class MatchSelection(ConfigModel):
    """Selection of reliable matches.

    A match is compared with the sensor's disparity at its pixel:

    - If they differ by more than ``tolerance``, the match contradicts the sensor. It is kept if it is cheaper than the
      sensor's disparity by more than ``margin``, and if the sensor does not have its disparity within ``widening``
      pixels: windows widen the foreground by half their size.
    - If the sensor has no value, the match is kept if it is cheaper than the mean of the pixel's costs by more than
      ``blind_margin``, and if the sensor does not have its disparity within ``widening`` pixels.
    - Otherwise the match confirms the sensor. It is kept if it has a share ``consensus`` of the votes around, and the
      left image has enough ``texture``.

    Regions of kept matches smaller than ``speckle`` are removed.
    """

    margin: float = Field(
        0.15,
        ge=0,
        description="how much cheaper than the sensor's disparity a contradicting match must be, units of one measure",
    )
    blind_margin: float = Field(
        0.1,
        ge=0,
        description="how much cheaper than the pixel's mean a match must be if the sensor has no depth",
    )
    consensus: float = Field(0.3, ge=0, le=1, description="share of votes that a match confirming the sensor needs")
    texture: float = Field(
        4.0, ge=0, description="standard deviation in 9 x 9 that a match confirming the sensor needs, grey levels"
    )
    speckle: int = Field(50, ge=0, description="regions of similar disparity with fewer pixels are removed")
    widening: int = Field(5, ge=0, le=64, description="distance by which stereo may make a surface too wide, pixels")
    tolerance: float = Field(1.5, ge=0, description="largest difference that confirms the sensor, pixels")

    def __call__(
        self, dense: Floats, votes: Floats, sensor: Floats, volume: CostVolume, pair: StereoPair
    ) -> tuple[Floats, Floats]:
        """Return the kept matches, (H, W), NaN = none, and the share of the margin by which they are cheaper, 0 .. 1.

        ``dense`` and ``sensor`` are the disparities of the matches and of the sensor, pixels. ``votes`` is the share of
        the votes around. ``volume`` has the costs of the matches. The images of ``pair`` are (H, W).
        """
        known, agrees = np.isfinite(sensor), np.abs(dense - sensor) <= self.tolerance
        mean_cost = volume.costs.mean(axis=2, dtype=np.float32) / np.float32(volume.scale)
        gain = np.where(known, cost_at(volume, sensor), mean_cost) - cost_at(volume, dense)
        margin = np.where(known, self.margin, self.blind_margin)
        confirmed = agrees & (votes >= self.consensus) & (local_deviation(pair.left) >= self.texture)
        # near: the sensor has the match's disparity within ``widening`` pixels
        height, width = dense.shape
        padded = np.pad(sensor, self.widening, constant_values=np.nan)
        near = np.zeros(dense.shape, np.bool_)
        for y in range(2 * self.widening + 1):
            for x in range(2 * self.widening + 1):
                near |= np.abs(padded[y : y + height, x : x + width] - dense) <= self.tolerance
        keep = confirmed | (~agrees & (gain > margin) & ~near)
        chosen = DisparityMap(np.where(keep, dense, np.float32(np.nan)), np.zeros(dense.shape, np.uint8))
        if self.speckle:
            context = RefinementContext(pair, volume, np.zeros(dense.shape, np.uint16))
            chosen = SpeckleFilter(size=self.speckle)(chosen, context)
        margin_share = np.where(agrees, 0, np.clip(gain / np.maximum(margin, 1e-6), 0, 1))
        return chosen.values, margin_share.astype(np.float32)


def local_deviation(image: Image) -> Floats:
    """Compute the standard deviation of grey levels in 9 x 9, (H, W) float32."""
    return np.asarray(np.sqrt(local_moments(image.astype(np.float32), 9)[1]), np.float32)


def cost_at(volume: CostVolume, disparity: Floats) -> Floats:
    """Return the lower cost of the two integers around a disparity, (H, W) float32, in units of the measure.

    NaN = unknown disparity. Disparities are clipped to the volume's range.
    """
    max_disparity = np.float32(volume.n_disparities - 1)
    low = np.floor(np.clip(np.nan_to_num(disparity), 0, max_disparity)).astype(np.int64)
    rows, columns = np.ogrid[: low.shape[0], : low.shape[1]]
    around = [volume.costs[rows, columns, np.minimum(low + step, volume.n_disparities - 1)] for step in (0, 1)]
    costs = np.minimum(*around).astype(np.float32) / np.float32(volume.scale)
    return np.where(np.isfinite(disparity), costs, np.float32(np.nan))
