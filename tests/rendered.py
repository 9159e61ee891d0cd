"""A room of planes as two cameras see it: a wall, the floor, and a slanted board before the wall; exact depth."""

import cv2
import numpy as np

from depthcli.core.cameras.camera import Camera, Intrinsics

COLOR_SHAPE, DEPTH_SHAPE = (360, 480), (48, 64)
COLOR = Intrinsics(362.0, 360.0, 238.5, 180.0)
DEPTH = Intrinsics(49.0, 48.5, 31.0, 24.0)  # 1 / 7.4 of the size
ROTATION = np.asarray(cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))[0], np.float64)
TRANSLATION = np.array([0.03, 0.005, -0.002])
# Normal and distance in the color camera's frame, and half the width and height of the middle.
_PLANES = (([0, 0, 1.0], 3.0, None), ([0, 1.0, 0.1], 1.1, None), ([0.5, 0, 1.0], 1.5, (0.35, 0.3)))


def rendered(camera: Intrinsics, shape: tuple[int, int], rotation=None, translation=None):
    """Depth (H, W) float64, meters, and the number of the plane that each pixel shows.

    ``rotation`` and ``translation`` lead from the camera's frame to the color camera's; None: it is that one.
    """
    turn = np.eye(3) if rotation is None else rotation
    eye = np.zeros(3) if translation is None else translation
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    rays = Camera(camera.matrix).rays(np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float64))
    directions = np.column_stack([rays, np.ones(len(rays))]) @ turn.T
    depth, plane = np.full(len(rays), np.inf), np.zeros(len(rays), np.uint8)
    for number, (normal, distance, half) in enumerate(_PLANES):
        with np.errstate(divide="ignore"):
            z = (distance - np.dot(normal, eye)) / (directions @ np.array(normal))
        hit = (z > 0) & (z < depth)
        if half is not None:
            hit &= np.all(np.abs(eye[:2] + z[:, None] * directions[:, :2]) < half, axis=1)
        depth[hit], plane[hit] = z[hit], number
    return depth.reshape(shape), plane.reshape(shape)


def near_edges(plane, reach):
    """Pixels within ``reach`` of another plane."""
    edges = cv2.morphologyEx(plane, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    return cv2.dilate(edges, np.ones((2 * reach + 1,) * 2, np.uint8)) > 0


def noisy(depth, sigma, seed=0):
    """The depth with relative noise of its inverse, float32."""
    rng = np.random.Generator(np.random.PCG64(seed))
    return (depth / (1 + sigma * rng.standard_normal(depth.shape))).astype(np.float32)
