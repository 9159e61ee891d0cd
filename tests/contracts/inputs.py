"""Small inputs that methods are tested on: volumes, pictures of blobs, frames with gaps and with glass, proposals."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.commands import config_model
from depthcli.core.config_file import find_config, load_config
from depthcli.core.frames import RgbdFrame, SparseFrame, StereoPair
from depthcli.core.method import Family
from depthcli.methods.fusion.choice import Proposals
from depthcli.methods.stereo.volume import StereoResult
from depthcli.simulate.stereo_scenes import SyntheticScene
from depthcli.testing.inputs import blocky_pair, random_volume

KINDS = ("median", "own", "local", "felzenszwalb")
COMBINED = {"method": "combined", "parts": [
    {"cost": name, "lambda": scale} for name, scale in (("absolute_difference", 10), ("census", 30), ("gradient", 4))
]}  # fmt: skip
"""A combined cost, which has no default parts."""
NOISE = 0.004
"""Standard deviation of the samples of :func:`glass`, meters."""


def preset(command: str, name: str, *settings: str) -> Any:
    """Return the config of a preset of a command, with settings such as ``max_age=3``."""
    return load_config(config_model(command), find_config(command, name), settings)


def part(package: str, name: str, **fields: Any) -> Any:
    """Return a method of a package below ``depthcli``, as a config names it."""
    family = Family.of(f"depthcli.{package}")
    return family.parse({family.key: name, **fields}, None)


def views(scene: SyntheticScene) -> StereoPair:
    """Return the pair of a generated scene."""
    return StereoPair(scene.left, scene.right)


def wrong(found: StereoResult, scene: SyntheticScene) -> float:
    """Return the share of the visible pixels of a generated scene that are off by more than a pixel."""
    return float(np.mean(~(np.abs(found.disparity.values - scene.disparity_left) <= 1)[scene.nonocc]))


def soft_volume(seed: int, shape: tuple[int, int, int] = (20, 20, 20)) -> NDArray[np.float32]:
    """Return a (Z, Y, X) float32 volume of soft random values around 0."""
    values = np.random.default_rng(seed).standard_normal(shape).astype(np.float32)
    for axis in range(3):
        values += np.roll(values, 1, axis) + np.roll(values, -1, axis)
    return values * np.float32(100 / 27)


def blobs(height: int = 120, width: int = 160, seed: int = 0) -> NDArray[np.uint8]:
    """Return an (H, W) picture of soft blobs of several sizes, 0 .. 255."""
    rng = np.random.default_rng(seed)
    picture = sum(cv2.GaussianBlur(rng.random((height, width)), (0, 0), s) * s for s in (1.5, 3, 6))
    picture = np.asarray(picture - np.min(picture))
    return np.asarray(picture / (picture.max() or 1) * 255, np.uint8)


def gaps(seed: int = 0, shape: tuple[int, int] = (60, 80)) -> tuple[RgbdFrame, NDArray[np.float32]]:
    """Return a frame of a box 1 m away before a wall at 2 m, with gaps of the sensor, and its (H, W) true depth."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    box = (abs(x - 0.5 * shape[1]) < 0.25 * shape[1]) & (abs(y - 0.5 * shape[0]) < 0.25 * shape[0])
    truth = np.where(box, 1, 2).astype(np.float32)
    color = np.where(box[..., None], (200, 150, 60), (60, 90, 140)) + rng.normal(0, 3, (*shape, 3))
    depth = np.where(rng.random(shape) < 0.15, np.nan, truth + 0.002 * rng.standard_normal(shape)).astype(np.float32)
    depth[:, shape[1] // 8 : shape[1] // 5] = np.nan
    return RgbdFrame(np.clip(color, 0, 255).astype(np.uint8), depth), truth


def glass(
    seed: int = 0, outliers: float = 0.1, shape: tuple[int, int] = (72, 96)
) -> tuple[SparseFrame, NDArray[np.float32], NDArray[np.bool_]]:
    """Return a frame, its true depth and the mask of the glass, (H, W).

    A table at 1 m, slightly slanted; a disk at 0.8 m of another color that the sensor sees through, and 40 % of which
    it does not see at all. A tenth of the pixels has a sample; a share ``outliers`` of these is wrong.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    mask = (x - 0.5 * shape[1]) ** 2 + (y - 0.5 * shape[0]) ** 2 < (0.28 * shape[0]) ** 2
    table = 1 / (1.0 + 0.0005 * (x - 0.5 * shape[1]))
    truth = np.where(mask, 0.8, table).astype(np.float32)
    color = np.where(mask[..., None], (90, 160, 170), (70, 110, 60)) + rng.normal(0, 3, (*shape, 3))
    sensor = table + 0.001 * rng.standard_normal(shape)
    spots = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), 3)
    sensor[mask & (spots < np.quantile(spots[mask], 0.4))] = np.nan
    sparse = np.where(rng.random(shape) < 0.1, truth + NOISE * rng.standard_normal(shape), np.nan)
    wrong = np.isfinite(sparse) & (rng.random(shape) < outliers)
    sparse[wrong] = rng.uniform(0.6, 1.4, wrong.sum())
    color8, depth = np.clip(color, 0, 255).astype(np.uint8), sensor.astype(np.float32)
    return SparseFrame(color8, depth, sparse=sparse.astype(np.float32)), truth, mask


def random_proposals(
    height: int = 9, width: int = 21, n_disparities: int = 12, count: int = 4, seed: int = 0
) -> Proposals:
    """Return ``count`` noisy versions of one random map, called by the names in ``KINDS``, at most 16."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(0, n_disparities - 1, (height, width))
    values = np.clip(base + rng.normal(0, 1.5, (count, height, width)), 0, n_disparities - 1).astype(np.float32)
    return Proposals(
        (KINDS * 4)[:count], values, rng.integers(0, 3, values.shape).astype(np.uint8), np.ones(count, np.float32),
        blocky_pair(height, width, True, seed), random_volume(height, width, n_disparities),
        rng.integers(0, n_disparities, (height, width)).astype(np.uint16),
    )  # fmt: skip
