"""Distance of the features that a network computes for each pixel."""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from depthcli.core import memory
from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair
from depthcli.core.maps import Floats
from depthcli.kernels.jit import jit, run_bands, zeros
from depthcli.methods.stereo.cost import CostMeasure
from depthcli.methods.stereo.networks import (
    ColorOrder,
    ImageInput,
    Network,
    Normalization,
    Session,
    normalized,
    padded,
    samples,
)
from depthcli.methods.stereo.volume import CostVolume, fill_outside

_PROBE = 64  # side of the test image that shows how much smaller the output is, pixels


class NetworkCost(Network, CostMeasure):
    """Distance of the features of a network in an ONNX file, such as the fast network of MC-CNN (Zbontar, LeCun 2016).

    The network takes one image of any size, (H, W), (C, H, W), (H, W, C) or a batch of one of these, grey or in color,
    and gives a vector for each pixel. If its output is smaller because its convolutions do not pad, the image's border
    is repeated first. Networks of CNES MCCNN take ``normalization: image``.
    """

    normalization: Normalization = Field("0-255", description="range of the values that the network takes")
    color_order: ColorOrder = Field("rgb", description="order of the channels that the network takes")
    multiple: int = Field(1, ge=1, le=1024, description="divisor of the images' sides, pixels")
    distance: Literal["dot", "l1"] = Field(
        "dot", description="dot: 1 - dot product of the vectors scaled to length 1; l1: mean absolute difference"
    )
    truncation: float = Field(1.0, gt=0, le=1e6, description="largest cost; larger ones are set to it")
    outside: float = Field(0.5, ge=0, le=1, description="cost of a match outside the right image, part of truncation")

    LEVELS: ClassVar[int] = 250

    def check(self) -> None:
        _input_of(self.session, self.multiple)

    def pixel_bytes(self) -> int:
        return 4096  # features of 64 channels of both images, and temporary memory of convolutions

    def __call__(self, pair: StereoPair, n_disparities: int) -> CostVolume:
        session = self.session
        target, margin = _input_of(session, self.multiple)
        height, width = pair.shape
        views = []
        for view in (0, 1):
            image = normalized(samples(pair, view, target.channels or 3), self.normalization, self.color_order)
            features = _features(session, target, padded(image, self.multiple, margin))[:, :height, :width]
            if features.shape[1:] != (height, width) or not np.isfinite(features).all():
                raise InputError(f"{session.model}: no finite features of {width} x {height} pixels; see multiple")
            # Scaled so that sums over the channels, padded to a multiple of 4, are the dot product or the mean.
            if self.distance == "dot":
                features = features / np.maximum(np.sqrt(np.square(features).sum(axis=0)), np.float32(1e-6))
            else:
                features = features / np.float32(len(features))
            views.append(np.pad(features.transpose(1, 0, 2), ((0, 0), (0, -len(features) % 4), (0, 0))))
        costs = memory.empty((*pair.shape, n_disparities), np.uint8)
        scale = self.LEVELS / self.truncation
        left, right = views
        run_bands(
            _compare, height, left, right, self.distance == "dot", np.float32(scale), np.float32(self.LEVELS), costs
        )
        fill_outside(costs, np.uint8(round(self.outside * self.LEVELS)))
        return CostVolume(costs, scale)


@lru_cache(maxsize=4)
def _input_of(session: Session, multiple: int) -> tuple[ImageInput, int]:
    """Return a network's input, and by how many pixels its output is smaller on every side for a small image.

    InputError if the network does not give a vector for each pixel of one image of any size.
    """
    if session.counts or len(session.images) != 1 or session.images[0].channels not in (None, 1, 3):
        raise InputError(f"{session.model}: expected a network with one image as its input, grey or in color")
    (target,) = session.images
    if target.size != (None, None):
        raise InputError(f"{session.model}: takes images of one size; expected a network for any size")
    side = -(-_PROBE // multiple) * multiple
    features = _features(session, target, np.zeros((side, side, target.channels or 3), np.float32))
    missing = side - features.shape[1]
    if features.shape[1] != features.shape[2] or missing % 2 or not 0 <= missing < side // 2:
        shown = f"{features.shape[2]} x {features.shape[1]} for an image of {side} x {side}"
        raise InputError(f"{session.model}: gives features of {shown} pixels; expected a vector for each pixel")
    return target, missing // 2


def _features(session: Session, target: ImageInput, image: Floats) -> Floats:
    # (C, H, W) features of an (H, W, 1 or 3) image.
    output = next(iter(session.run({target.name: target.array(image)}).values()))
    if output.ndim != 3:
        raise InputError(
            f"{session.model}: its first output has shape {output.shape}; expected channels, rows, columns"
        )
    return np.asarray(output.transpose(2, 0, 1) if target.channels_last else output, np.float32)


@jit
def _compare(begin, end, left, right, products, scale, largest, costs):
    _, width, n_disparities = costs.shape
    channels = left.shape[1]
    half, zero = np.float32(0.5), np.float32(0.0)
    for y in range(begin, end):
        mirror = zeros((channels, width + n_disparities), np.float32)
        for c in range(channels):
            for x in range(width):
                mirror[c, width - 1 - x] = right[y, c, x]
        sums = zeros(n_disparities, np.float32)
        for x in range(width):
            at = width - 1 - x
            sums[:] = 0
            for c in range(0, channels, 4):
                a0, a1, a2, a3 = left[y, c, x], left[y, c + 1, x], left[y, c + 2, x], left[y, c + 3, x]
                b0, b1 = mirror[c, at : at + n_disparities], mirror[c + 1, at : at + n_disparities]
                b2, b3 = mirror[c + 2, at : at + n_disparities], mirror[c + 3, at : at + n_disparities]
                if products:
                    for i in range(sums.size):
                        sums[i] += (a0 * b0[i] + a1 * b1[i]) + (a2 * b2[i] + a3 * b3[i])
                else:
                    for i in range(sums.size):
                        sums[i] += (abs(a0 - b0[i]) + abs(a1 - b1[i])) + (abs(a2 - b2[i]) + abs(a3 - b3[i]))
            out = costs[y, x]
            for i in range(out.size):
                cost = scale * (np.float32(1.0) - sums[i] if products else sums[i])
                out[i] = np.uint8(np.int32(min(max(cost, zero), largest) + half))
