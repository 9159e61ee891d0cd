"""Scenes for a Kinect-like sensor, single and in sequences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import typical_intrinsics
from depthcli.core.frames import RgbdFrame
from depthcli.simulate import textures
from depthcli.simulate.depth_sensor import Disparity, KinectSample, discs, simulate_kinect
from depthcli.simulate.stereo_scenes import make_scene

SceneKind = Literal["planes", "foreground", "curved", "camouflage"]
SCENE_KINDS: tuple[SceneKind, ...] = get_args(SceneKind)
SequenceKind = Literal["static", "moving", "camera"]
SEQUENCE_KINDS: tuple[SequenceKind, ...] = get_args(SequenceKind)

_COLOR_NOISE = 2.0  # grey levels, of every frame of a sequence
Shot = tuple[NDArray[np.uint8], Disparity, NDArray[np.float64] | None]
"""Color (H, W, 3), true disparity (H, W), and the camera's pose (4, 4): from its coordinates to the world's, meters."""


def make_kinect_scene(
    kind: SceneKind, seed: int = 0, width: int = 400, height: int = 300, max_disparity: int = 48
) -> tuple[NDArray[np.uint8], Disparity]:
    """Return color (H, W, 3) uint8 RGB and exact disparity (H, W) float32, pixels, the same for the same arguments.

    Parameters
    ----------
    kind : ``planes``, ``foreground``, ``curved`` as in :func:`depthcli.simulate.stereo_scenes.make_scene`;
        ``camouflage``: boards before a wall, every other one painted like it, so that only the depth shows the edge
    width, height, max_disparity : pixels; at least 16, 16, and 4, at most ``width / 2``
    """
    if kind not in SCENE_KINDS:
        raise ValueError(f"kind must be one of {', '.join(SCENE_KINDS)}, got {kind!r}")
    if kind != "camouflage":
        scene = make_scene(kind, seed, width, height, max_disparity)
        return scene.left, scene.disparity_left
    if width < 16 or height < 16 or not 4 <= max_disparity <= width / 2:
        raise ValueError(f"want at least 16 x 16 pixels and 4 <= max_disparity <= width / 2, got {width} x {height}")
    rng = np.random.Generator(np.random.PCG64([seed, 0xCA3]))
    paint = textures.color(rng)
    canvas = Canvas(rng, width, height, paint, far=0.3 * max_disparity)
    for index, nearness in enumerate(np.linspace(0.45, 0.85, 4)):
        own = paint if index % 2 == 0 else textures.color(rng)
        center = ((index + rng.uniform(0.35, 0.65)) * width / 4, rng.uniform(0.3, 0.7) * height)
        size = (rng.uniform(0.07, 0.11) * width, rng.uniform(0.15, 0.3) * height)
        canvas.put(canvas.board(center, size, nearness * max_disparity, own))
    return canvas.photograph()


def make_kinect_sequence(
    kind: SequenceKind,
    frames: int = 10,
    seed: int = 0,
    width: int = 320,
    height: int = 240,
    max_disparity: int = 40,
    *,
    speed: int = 4,
    fattening: int = 4,
    noise: float = 0.3,
) -> list[KinectSample]:
    """Return a sequence as a Kinect records it: new noise in color and depth in every frame, exact truth.

    Parameters
    ----------
    kind : ``static`` (on a tripod, nothing moves), ``moving`` (a board crosses the scene) or ``camera`` (the camera
        moves along boards, sideways and forward, and turns; with intrinsics and poses)
    seed : chooses the scene, discs and noise; specular discs stay where they are
    speed : pixels per frame that the board moves to the right, or that the camera moves the nearest one to the left
    """
    if kind not in SEQUENCE_KINDS:
        raise ValueError(f"kind must be one of {', '.join(SEQUENCE_KINDS)}, got {kind!r}")
    if frames < 1:
        raise ValueError(f"want at least one frame, got {frames}")
    rng = np.random.Generator(np.random.PCG64([seed, 0x5E0]))
    if kind == "camera":
        shots = along_boards(rng, frames, width, height, max_disparity, speed)
    else:
        still, truth = make_kinect_scene("foreground", seed, width, height, max_disparity)
        canvas = Canvas(rng, width, height, textures.color(rng), far=1.0)
        canvas.color, canvas.truth = still.astype(np.float32) / np.float32(255), truth
        at, size = (0.2 * width, 0.55 * height), (0.09 * width, 0.2 * height)
        mover = canvas.board(at, size, 0.85 * max_disparity, textures.color(rng), flat=True)
        shots = [(still, truth, None)] * frames
        if kind == "moving":
            shots = [(*canvas.photograph(moved(mover, index * speed)), None) for index in range(frames)]
    spots = discs(rng, (height, width), 8, (8.0, 22.0))
    samples = []
    for color, truth, pose in shots:
        grain = _COLOR_NOISE * rng.standard_normal(color.shape, np.float32)
        noisy = np.clip(np.rint(color + grain), 0, 255).astype(np.uint8)
        sample = simulate_kinect(noisy, truth, int(rng.integers(2**31)), fattening=fattening, noise=noise, discs=0)
        samples.append(
            replace(
                sample,
                disparity=np.where(spots, np.float32(np.nan), sample.disparity),
                specular=np.isfinite(sample.truth) & spots & ~sample.occluded,
                mismatch=sample.mismatch & ~spots,
                measured=sample.measured & ~spots,
                intrinsics=None if pose is None else typical_intrinsics(width, height),
                pose=pose,
            )
        )
    return samples


@dataclass(frozen=True)
class CutOut:
    """A board, cut out and painted."""

    cover: NDArray[np.float32]  # (H, W), share of each pixel that it covers
    color: NDArray[np.float32]  # (H, W, 3) RGB in [0, 1]
    disparity: Disparity  # its plane


def moved(board: CutOut, columns: int) -> CutOut:
    """Return the board ``columns`` pixels to the right, out of the picture where that ends."""
    cover = np.roll(board.cover, columns, axis=1)
    cover[:, : min(columns, cover.shape[1])] = 0
    color, disparity = np.roll(board.color, columns, axis=1), np.roll(board.disparity, columns, axis=1)
    return CutOut(cover, color, disparity)


def seen_from(board: CutOut, motion: NDArray[np.float64], camera: NDArray[np.float64], fb: float) -> CutOut:
    """Return the board as a moved camera sees it: its plane of disparity, and its picture by that plane's homography.

    ``motion`` (4, 4) brings coordinates of the camera that sees ``board`` to those of the moved one, meters; ``camera``
    is the matrix (3, 3) of both, ``fb`` is in pixel meters.
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
    return CutOut(cover.astype(np.float32), color.astype(np.float32), disparity.astype(np.float32))


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
        """Return a plane, tilted by at most ``max_tilt`` pixels of disparity over a quarter of the picture."""
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
    ) -> CutOut:
        """Return a wavy disc; ``size`` = half its width and height in pixels, ``flat``: of one disparity."""
        x, y = (self._columns - center[0]) / size[0], (self._rows - center[1]) / size[1]
        angle = np.arctan2(y, x)
        waves = sum(self._rng.uniform(0.02, 0.12) * np.cos(k * angle + self._rng.uniform(0, 6.3)) for k in (2, 3, 5))
        inside = (0.9 * (1 + waves) - np.hypot(x, y)) * min(size)
        cover = np.clip(inside + 0.5, 0, 1).astype(np.float32)
        return CutOut(cover, self._plaster(paint), self._plane(center, disparity, 0.0 if flat else 0.1 * disparity))

    def put(self, board: CutOut) -> None:
        """Draw a board over the picture and keep it there."""
        self.color, self.truth = self._over(board)

    def _over(self, board: CutOut) -> tuple[NDArray[np.float32], Disparity]:
        share = board.cover[:, :, None]
        color = share * board.color + (1 - share) * self.color
        return color, np.where(board.cover >= 0.5, np.maximum(board.disparity, self.truth), self.truth)

    def photograph(self, board: CutOut | None = None) -> tuple[NDArray[np.uint8], Disparity]:
        """Return color, (H, W, 3) uint8, blurred as by a lens, and disparity; ``board`` is on top only here."""
        color, truth = (self.color, self.truth) if board is None else self._over(board)
        shown = cv2.GaussianBlur(color, (0, 0), 0.6) * 255
        return np.clip(np.rint(shown), 0, 255).astype(np.uint8), truth


def along_boards(
    rng: np.random.Generator, frames: int, width: int, height: int, max_disparity: int, speed: int
) -> list[Shot]:
    """Return five boards before a wall, seen by a camera that moves to the right and a little forward, and turns."""
    fb, camera = RgbdFrame.fb, typical_intrinsics(width, height).matrix
    canvas = Canvas(rng, width, height, textures.color(rng), far=0.3 * max_disparity)
    boards = [CutOut(np.ones((height, width), np.float32), canvas.color, canvas.truth)]
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
