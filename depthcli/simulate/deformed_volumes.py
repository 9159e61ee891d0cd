"""Registered volumes whose registration error is known everywhere."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from depthcli.core.maps import Floats, Mask


class DeformedPair(NamedTuple):
    """A misregistered pair: the match of fixed x is warped x + residual(x), up to noise."""

    fixed: Floats  # (Z, Y, X)
    warped: Floats
    residual: Floats  # (Z, Y, X, 3), x, y, z, the registration error in voxels
    mask: Mask  # the body


def make_deformed_pair(
    seed: int, shape: tuple[int, int, int] = (40, 56, 56), largest: float = 4.0, noise: float = 10.0
) -> DeformedPair:
    """Return an ellipsoid body with textured organs, and a smooth residual up to ``largest`` voxels.

    The fixed volume is the warped one sampled at x + residual(x), so that the residual is exact. ``shape`` is
    (Z, Y, X), ``noise`` the standard deviation in both volumes, where the body's range is about 600.
    """
    rng = np.random.default_rng([seed, 0x3D])
    place = np.stack(np.meshgrid(*(np.linspace(-1, 1, n, dtype=np.float32) for n in shape), indexing="ij"))
    body = (place**2).sum(axis=0) <= 0.92
    volume = np.where(body, 200 + 90 * smooth_noise(rng, shape, 2.0), np.float32(0))
    for _ in range(7):
        center, radii = rng.uniform(-0.5, 0.5, (3, 1, 1, 1)), rng.uniform(0.15, 0.4, (3, 1, 1, 1))
        inside = (((place - center) / radii) ** 2).sum(axis=0) <= 1
        texture = rng.uniform(50, 500) + 80 * smooth_noise(rng, shape, float(rng.uniform(1.0, 2.5)))
        volume = np.where(inside & body, texture, volume)
    clean = blurred(volume.astype(np.float32), 0.6)
    residual = np.stack([smooth_noise(rng, shape, max(shape) / 8) for _ in range(3)])
    length = np.sqrt((residual**2).sum(axis=0))
    residual *= np.float32(largest) / length[body].max()
    fixed = _sampled(clean, residual)
    fixed, warped = (v + noise * rng.standard_normal(shape).astype(np.float32) for v in (fixed, clean))
    vectors = np.ascontiguousarray(residual[::-1].transpose(1, 2, 3, 0))
    return DeformedPair(fixed.astype(np.float32), warped.astype(np.float32), vectors, body)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int, int], sigma: float) -> Floats:
    """Return Gaussian noise with this correlation length and standard deviation 1."""
    margin = int(3 * sigma) + 1
    wide = rng.standard_normal([n + 2 * margin for n in shape]).astype(np.float32)
    smooth = blurred(wide, sigma)[(slice(margin, -margin),) * 3]
    return np.asarray((smooth - smooth.mean()) / smooth.std(), np.float32)


def blurred(volume: Floats, sigma: float) -> Floats:
    """Return a volume filtered by a Gaussian along all three axes, borders repeated."""
    for axis in range(3):
        lines = np.ascontiguousarray(np.moveaxis(volume, axis, -1))
        flat = lines.reshape(-1, lines.shape[-1])
        smooth = cv2.GaussianBlur(flat, (0, 0), sigmaX=sigma, sigmaY=1e-3, borderType=cv2.BORDER_REPLICATE)
        volume = np.moveaxis(np.asarray(smooth, np.float32).reshape(lines.shape), -1, axis)
    return np.ascontiguousarray(volume, np.float32)


def _sampled(volume: Floats, field: Floats) -> Floats:
    """Return trilinear values at x + field(x), borders repeated."""
    top = np.array(volume.shape).reshape(3, 1, 1, 1) - 1
    grid = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in volume.shape), indexing="ij"))
    place = np.clip(grid + field, 0, top)
    low = np.minimum(place.astype(np.int64), top - 1)
    weight = place - low
    total = np.zeros(volume.shape, np.float32)
    for corner in np.ndindex(2, 2, 2):
        share = np.ones(volume.shape, np.float32)
        for axis, side in enumerate(corner):
            share *= weight[axis] if side else 1 - weight[axis]
        total += share * volume[low[0] + corner[0], low[1] + corner[1], low[2] + corner[2]]
    return total
