"""Check that a network finds a known shift, before a batch relies on its sign and scale."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.errors import InputError
from depthcli.core.frames import StereoPair

_SHIFTS = (4, 12)  # pixels
_SIZE = (192, 320)  # where the network takes any size
_OCTAVES = (1, 2, 4, 8, 16)  # pixels, of the texture


def check_shifts(network: Callable[[StereoPair], NDArray[np.float32]], size: tuple[int, int] | None, name: str) -> None:
    """Raise InputError where ``network`` does not find by how many pixels a textured plane is shifted.

    Parameters
    ----------
    size : (H, W) of the pairs; None: any
    name : of the network, for the message
    """
    found = []
    for shift in _SHIFTS:
        disparity = network(_plane(size or _SIZE, shift))
        rows, columns = (slice(side // 4, 3 * side // 4) for side in disparity.shape)
        inner = disparity[rows, columns]
        found.append(float(np.median(inner)) if np.isfinite(inner).all() else np.nan)
    if _fits(found, 1.0):
        return
    text = f"{name}: self-check: for pairs shifted by {_SHIFTS[0]} and {_SHIFTS[1]} pixels the network gives "
    text += " and ".join(f"{value:.4g}" for value in found)
    if _fits(found, -1.0):
        raise InputError(f"{text}: the sign is wrong; set sign to the other one (positive, negative)")
    scale = found[1] / _SHIFTS[1]
    if abs(scale) > 0.01 and _fits([value / scale for value in found], 1.0):
        raise InputError(f"{text}: the scale is wrong, {scale:.3g} for each pixel; want pixels of the full size")
    raise InputError(
        f"{text}: it does not find them; see profile, normalization, color_order; self_check: false leaves this out"
    )


def _fits(found: list[float], sign: float) -> bool:
    return all(abs(sign * value - shift) <= 1 + 0.1 * shift for value, shift in zip(found, _SHIFTS, strict=True))


def _plane(size: tuple[int, int], shift: int) -> StereoPair:
    # Noise of several scales: networks trained with photographs find little in that of single pixels.
    rng = np.random.default_rng(0)
    height, width = size[0], size[1] + shift
    total = np.zeros((height, width, 3), np.float32)
    for octave in _OCTAVES:
        noise = rng.standard_normal((-(-height // octave), -(-width // octave), 3)).astype(np.float32)
        total += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    image = np.clip(total * np.float32(40 / len(_OCTAVES) ** 0.5) + np.float32(128), 0, 255).astype(np.uint8)
    left, right = (np.ascontiguousarray(part) for part in (image[:, : size[1]], image[:, shift:]))
    return StereoPair(left, right)
