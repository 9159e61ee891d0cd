"""Networks that map an image to features, one vector per pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.methods.stereo.networks.images import ColorOrder, ImageInput, Normalization, padded, planes
from depthcli.methods.stereo.networks.runtime import Session

_PROBE = 64  # pixels, side of the image that shows how much smaller the output is


@dataclass(frozen=True)
class FeatureNetwork:
    """A network that maps an image to features.

    Attributes
    ----------
    target : its input
    margin : pixels by which its output is smaller on every side (convolutions without padding)
    """

    session: Session
    target: ImageInput
    margin: int

    @property
    def channels(self) -> int:
        """Channels of the image that it takes: 1 or 3."""
        return self.target.channels or 3

    def __call__(
        self, image: NDArray[np.float32], normalization: Normalization, order: ColorOrder, multiple: int
    ) -> NDArray[np.float32]:
        """Return (C, H, W) features of an (H, W, 1) or (H, W, 3) image whose values are from 0 to 255.

        Parameters
        ----------
        normalization, order : of the values that the network takes; moments are those of the image without its margin
        multiple : of the sides of images that it takes

        Raises
        ------
        InputError
            The network fails, or gives something else than finite features of this size.
        """
        height, width = image.shape[:2]
        normal = planes(image, normalization, order).transpose(1, 2, 0)
        given = self.target.array(padded(normal, multiple, self.margin).transpose(2, 0, 1))
        features = _features(self.session, self.target, given)[:, :height, :width]
        if features.shape[1:] != (height, width) or not np.isfinite(features).all():
            raise InputError(f"{self.session.model}: no finite features of {width} x {height} pixels; see multiple")
        return features


@lru_cache(maxsize=4)
def feature_network(session: Session, multiple: int) -> FeatureNetwork:
    """Find out what a network takes, and how much smaller its output is, by running it on a small image.

    Raises
    ------
    InputError
        It is no network that gives a vector for each pixel of one image of any size.
    """
    targets = [ImageInput.of(port, session.model) for port in session.inputs]
    if len(targets) != 1 or targets[0].channels not in (None, 1, 3):
        raise InputError(f"{session.model}: want a network with one image as its input, grey or in color")
    target = targets[0]
    if target.size != (None, None):
        raise InputError(f"{session.model}: takes images of one size; want a network that gives features at any size")
    side = -(-_PROBE // multiple) * multiple
    probe = np.zeros((target.channels or 3, side, side), np.float32)
    features = _features(session, target, target.array(probe))
    missing = side - features.shape[1]
    if features.shape[1] != features.shape[2] or missing % 2 or not 0 <= missing < side // 2:
        shown = f"{features.shape[2]} x {features.shape[1]} for an image of {side} x {side}"
        raise InputError(f"{session.model}: gives features of {shown} pixels; want a vector for each pixel")
    return FeatureNetwork(session, target, missing // 2)


def _features(session: Session, target: ImageInput, given: NDArray[np.generic]) -> NDArray[np.float32]:
    output = next(iter(session.run({target.port.name: given}).values()))
    if output.ndim == 4 and output.shape[0] == 1:
        output = output[0]
    if output.ndim != 3:
        raise InputError(f"{session.model}: its first output has shape {output.shape}; want channels, rows, columns")
    return np.asarray(output.transpose(2, 0, 1) if target.channels_last else output, np.float32)
