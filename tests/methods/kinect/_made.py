"""Images, maps and surfaces for the tests of frames, and what two views of a scene share."""

import functools

import numpy as np

from depthcli.algorithms.plane_fitting.polynomials import Surfaces
from depthcli.core.frames import RgbdFrame
from depthcli.simulate.depth_sensor import KinectSample, simulate_kinect
from depthcli.simulate.kinect_scenes import make_kinect_scene
from tests.contracts.inputs import part

pipeline = functools.partial(part, "methods.kinect.pipeline")


@functools.cache
def sample_of(kind="foreground", seed=1, size=(240, 180), top=40, **options) -> KinectSample:
    """What a simulated sensor measures of a generated scene; made once, never write into it."""
    return simulate_kinect(*make_kinect_scene(kind, seed, *size, top), seed, **options)


def off(result, sample: KinectSample):
    """Errors of refined depth in every pixel, in disparity."""
    return np.abs(RgbdFrame.fb / result.depth.values - sample.truth)


def blocks(height, width, seed=0, noise=12):
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height // 5 + 1, width // 5 + 1, 3))
    image = coarse.repeat(5, axis=0).repeat(5, axis=1)[:height, :width]
    return np.clip(image + rng.integers(-noise, noise + 1, image.shape), 0, 255).astype(np.uint8)


def labels_of(height, width, size=7):
    rows, columns = np.mgrid[:height, :width]
    return (rows // size * (width // size + 1) + columns // size).astype(np.int32)


def noisy(height, width, seed=0, unknown=0.3):
    rng = np.random.default_rng(seed)
    values = (20 + 5 * rng.random((height, width))).astype(np.float32)
    values[rng.random((height, width)) < unknown] = np.nan
    return values


def random_planes(coefficients, scale):
    """Surfaces of 1, x / 50, y / 50, and their value (surface, y, x)."""
    count = len(scale)
    bounds = np.full((count, 2), (0, 99), np.float32)
    surfaces = Surfaces(np.zeros((count, 6)), np.zeros((count, 2)), bounds, scale, 50.0)
    surfaces.coefficients[:, :3] = coefficients
    return surfaces, lambda s, y, x: float(coefficients[s] @ [1, x / 50, y / 50])


def same_points(first, other, within: float = 0.5):
    """Index in ``other`` of what each pixel of ``first`` shows, and whether it is seen there; by truth and poses."""
    height, width = first.truth.shape
    motion = np.linalg.inv(other.pose) @ first.pose
    points = first.intrinsics.points(first.depth_true(), np.isfinite(first.truth))
    x, y, w = first.intrinsics.matrix @ (motion[:3, :3] @ points.T + motion[:3, 3:])
    columns, rows = np.rint(x / w).astype(int), np.rint(y / w).astype(int)
    seen = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    index = np.where(seen, rows * width + columns, 0)
    return index, seen & (np.abs(other.truth.ravel()[index] - 43.5 / w) < within)
