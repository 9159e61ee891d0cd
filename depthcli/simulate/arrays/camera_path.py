"""Boards before a wall, seen along the path of a camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import typical_intrinsics
from depthcli.core.frames import RgbdFrame
from depthcli.simulate.arrays import textures
from depthcli.simulate.arrays.boards import Board, Canvas, Disparity, seen_from

Shot = tuple[NDArray[np.uint8], Disparity, NDArray[np.float64] | None]
"""Color (H, W, 3), true disparity (H, W), and the camera's pose (4, 4): from its coordinates to the world's, meters."""


def along_boards(
    rng: np.random.Generator, frames: int, width: int, height: int, max_disparity: int, speed: int
) -> list[Shot]:
    """Return five boards before a wall, seen by a camera that moves to the right and a little forward, and turns.

    Parameters
    ----------
    speed : pixels that the nearest board moves to the left per frame
    """
    fb, camera = RgbdFrame.fb, typical_intrinsics(width, height).matrix
    canvas = Canvas(rng, width, height, textures.color(rng), far=0.3 * max_disparity)
    boards = [Board(np.ones((height, width), np.float32), canvas.color, canvas.truth)]
    for index, nearness in enumerate(np.linspace(0.45, 0.85, 5)):
        center = (((2 * index) % 5 + rng.uniform(0.3, 0.7)) * width / 5, rng.uniform(0.3, 0.7) * height)
        size = (rng.uniform(0.07, 0.11) * width, rng.uniform(0.15, 0.3) * height)
        boards.append(canvas.board(center, size, nearness * max_disparity, textures.color(rng)))
    step = speed * fb / (0.85 * max_disparity) / camera[0, 0]  # meters
    shots: list[Shot] = []
    for index in range(frames):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0005, 0.001, 0.001]) * index)[0]
        pose[:3, 3] = index * step * np.array([1.0, 0.1, 0.3])
        wall, *others = (seen_from(board, np.asarray(np.linalg.inv(pose), np.float64), camera, fb) for board in boards)
        canvas.color, canvas.truth = wall.color, wall.disparity
        for board in others:
            canvas.put(board)
        shots.append((*canvas.photograph(), pose))
    return shots
