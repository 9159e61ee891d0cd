"""Pictures of cut-out boards, some of them painted like the wall behind: color and exact disparity."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.simulate.arrays import textures

Disparity = NDArray[np.float32]
"""(H, W) float32, pixels, NaN = unknown."""


@dataclass(frozen=True)
class Board:
    """A cut-out.

    Attributes
    ----------
    cover : (H, W) float32, share of each pixel that it covers
    color : (H, W, 3) float32 RGB in [0, 1]
    disparity : (H, W) float32, its plane, pixels
    """

    cover: NDArray[np.float32]
    color: NDArray[np.float32]
    disparity: Disparity


def moved(board: Board, columns: int) -> Board:
    """Return the board ``columns`` pixels to the right, out of the picture where that ends."""
    cover = np.roll(board.cover, columns, axis=1)
    cover[:, : min(columns, cover.shape[1])] = 0
    color, disparity = np.roll(board.color, columns, axis=1), np.roll(board.disparity, columns, axis=1)
    return Board(cover, color, disparity)


def seen_from(board: Board, motion: NDArray[np.float64], camera: NDArray[np.float64], fb: float) -> Board:
    """Return the board as a moved camera sees it: its plane of disparity, and its picture by that plane's homography.

    Parameters
    ----------
    motion : (4, 4), from the coordinates of the camera that sees ``board`` to those of the moved one, meters
    camera : (3, 3) camera matrix of both, pixels
    fb : focal length x baseline, pixel meters
    """
    height, width = board.disparity.shape
    rotation, shift = motion[:3, :3], motion[:3, 3]
    rows, columns = np.mgrid[:height, :width]
    pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
    plane = np.linalg.lstsq(pixels, board.disparity.ravel().astype(np.float64), rcond=None)[0]  # disparity = plane . p
    normal = camera.T @ plane  # normal . X = fb on the plane
    homography = camera @ (rotation + np.outer(shift, normal) / fb) @ np.linalg.inv(camera)
    turned = rotation @ normal
    moved_plane = np.linalg.inv(camera).T @ turned * fb / (fb + turned @ shift)
    cover = cv2.warpPerspective(board.cover, homography, (width, height), borderMode=cv2.BORDER_REPLICATE)
    color = cv2.warpPerspective(board.color, homography, (width, height), borderMode=cv2.BORDER_REFLECT_101)
    disparity = (pixels @ moved_plane).reshape(height, width)
    return Board(cover.astype(np.float32), color.astype(np.float32), disparity.astype(np.float32))


class Canvas:
    """A picture and its disparity, onto which boards are put from far to near."""

    def __init__(self, rng: np.random.Generator, width: int, height: int, paint: NDArray[np.float32], far: float):
        self._rng = rng
        self._rows, self._columns = np.mgrid[:height, :width].astype(np.float32)
        self.color = self._plaster(paint)
        self.truth = self._plane((width / 2, height / 2), far, 0.06 * far)

    def _plaster(self, paint: NDArray[np.float32]) -> NDArray[np.float32]:
        height, width = self._rows.shape
        relief = textures.noise(self._rng, height, width, 6.0, 3) + textures.noise(self._rng, height, width, 60.0, 2)
        painted: NDArray[np.float32] = np.clip(paint * (1 + 0.03 * relief[:, :, None]), 0, 1).astype(np.float32)
        return painted

    def _plane(self, center: tuple[float, float], disparity: float, max_tilt: float) -> Disparity:
        """Plane, tilted by at most ``max_tilt`` pixels of disparity over a quarter of the picture."""
        height, width = self._rows.shape
        tilt_x, tilt_y = self._rng.uniform(-max_tilt, max_tilt, 2) * (4 / width, 4 / height)
        plane = disparity + tilt_x * (self._columns - center[0]) + tilt_y * (self._rows - center[1])
        positive: Disparity = np.maximum(plane, 0.5).astype(np.float32)
        return positive

    def board(
        self,
        center: tuple[float, float],
        size: tuple[float, float],
        disparity: float,
        paint: NDArray[np.float32],
        flat: bool = False,
    ) -> Board:
        """Return a wavy disc; ``size`` = half its width and height in pixels, ``flat``: of one disparity."""
        x, y = (self._columns - center[0]) / size[0], (self._rows - center[1]) / size[1]
        angle = np.arctan2(y, x)
        waves = sum(self._rng.uniform(0.02, 0.12) * np.cos(k * angle + self._rng.uniform(0, 6.3)) for k in (2, 3, 5))
        inside = (0.9 * (1 + waves) - np.hypot(x, y)) * min(size)
        cover = np.clip(inside + 0.5, 0, 1).astype(np.float32)
        return Board(cover, self._plaster(paint), self._plane(center, disparity, 0.0 if flat else 0.1 * disparity))

    def put(self, board: Board) -> None:
        """Draw a board over the picture and keep it there."""
        self.color, self.truth = self._over(board)

    def _over(self, board: Board) -> tuple[NDArray[np.float32], Disparity]:
        share = board.cover[:, :, None]
        color = share * board.color + (1 - share) * self.color
        return color, np.where(board.cover >= 0.5, np.maximum(board.disparity, self.truth), self.truth)

    def photograph(self, board: Board | None = None) -> tuple[NDArray[np.uint8], Disparity]:
        """Return color, (H, W, 3) uint8, blurred as by a lens, and disparity; ``board`` is on top only here."""
        color, truth = (self.color, self.truth) if board is None else self._over(board)
        shown = cv2.GaussianBlur(color, (0, 0), 0.6) * 255
        return np.clip(np.rint(shown), 0, 255).astype(np.uint8), truth
