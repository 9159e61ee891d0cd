"""Scenes for a Kinect-like sensor, single and in sequences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import cv2
import numpy as np

from depthcli.core.cameras.camera import typical_intrinsics
from depthcli.core.frames import RgbdFrame
from depthcli.core.maps import Doubles, Floats, Image8
from depthcli.simulate import textures
from depthcli.simulate.depth_sensor import KinectSample, discs, simulate_kinect
from depthcli.simulate.rendering import levels8
from depthcli.simulate.stereo_scenes import make_scene

SceneKind = Literal["planes", "foreground", "curved", "camouflage"]
SequenceKind = Literal["static", "moving", "camera"]
SEQUENCE_KINDS: tuple[SequenceKind, ...] = get_args(SequenceKind)

_COLOR_NOISE = 2.0  # grey levels, of every frame of a sequence
Shot = tuple[Image8, Floats, Doubles | None]
"""Color (H, W, 3), true disparity (H, W), and the camera's pose (4, 4): from its coordinates to the world's, meters."""


def make_kinect_scene(
    kind: SceneKind, seed: int = 0, width: int = 400, height: int = 300, max_disparity: int = 48
) -> tuple[Image8, Floats]:
    """Return color (H, W, 3) uint8 RGB and exact disparity (H, W) float32, pixels, the same for the same arguments.

    Kinds are ``planes``, ``foreground``, ``curved`` as in :func:`depthcli.simulate.stereo_scenes.make_scene`, and
    ``camouflage``: boards before a wall, half of them painted like the wall, so that only the depth shows their edges.
    """
    if kind != "camouflage":
        scene = make_scene(kind, seed, width, height, max_disparity)
        return scene.left, scene.disparity_left
    rng = np.random.Generator(np.random.PCG64([seed, 0xCA3]))
    paint = textures.color(rng)
    workshop = Workshop(rng, width, height, paint, far=0.3 * max_disparity)
    boards = []
    for index, nearness in enumerate(np.linspace(0.45, 0.85, 4)):
        own = paint if index % 2 == 0 else textures.color(rng)
        center = ((index + rng.uniform(0.35, 0.65)) * width / 4, rng.uniform(0.3, 0.7) * height)
        size = (rng.uniform(0.07, 0.11) * width, rng.uniform(0.15, 0.3) * height)
        boards.append(workshop.board(center, size, nearness * max_disparity, own))
    return photograph(workshop.wall, *boards)


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
) -> list[KinectSample]:
    """Return a simulated recording of a Kinect; each frame has new noise in color and depth, and exact ground truth.

    Parameters
    ----------
    kind : ``static`` (on a tripod, nothing moves), ``moving`` (a board crosses the scene) or ``camera`` (the camera
        moves along boards, sideways and forward, and turns; with intrinsics and poses)
    seed : chooses the scene, discs and noise; specular discs stay where they are
    speed : pixels per frame that the board moves to the right, or that the camera moves the nearest one to the left
    """
    rng = np.random.Generator(np.random.PCG64([seed, 0x5E0]))
    if kind == "camera":
        shots = along_boards(rng, frames, width, height, max_disparity, speed)
    else:
        still, truth = make_kinect_scene("foreground", seed, width, height, max_disparity)
        workshop = Workshop(rng, width, height, textures.color(rng), far=1.0)
        behind = replace(workshop.wall, color=still.astype(np.float32) / np.float32(255), disparity=truth)
        at, size = (0.2 * width, 0.55 * height), (0.09 * width, 0.2 * height)
        mover = workshop.board(at, size, 0.85 * max_disparity, textures.color(rng), max_tilt=0.0)
        shots = [(still, truth, None)] * frames
        if kind == "moving":
            shots = [(*photograph(behind, mover.moved(index * speed)), None) for index in range(frames)]
    spots = discs(rng, (height, width), 8, (8.0, 22.0))
    samples = []
    for color, truth, pose in shots:
        noisy = levels8(color + _COLOR_NOISE * rng.standard_normal(color.shape, np.float32))
        sample = simulate_kinect(noisy, truth, int(rng.integers(2**31)), fattening=fattening, discs=0)
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

    cover: Floats  # (H, W), share of each pixel that it covers
    color: Floats  # (H, W, 3) RGB in [0, 1]
    disparity: Floats  # its plane

    def moved(self, columns: int) -> CutOut:
        """Return the board moved by ``columns`` pixels to the right; parts outside the picture are cut off."""
        cover, color, disparity = (np.roll(each, columns, axis=1) for each in (self.cover, self.color, self.disparity))
        cover[:, :columns] = 0
        return CutOut(cover, color, disparity)

    def seen_after(self, motion: Doubles, camera: Doubles, fb: float) -> CutOut:
        """Return the board as a moved camera sees it: its plane of disparity, and its picture by the homography.

        ``motion`` (4, 4) transforms coordinates of the original camera to coordinates of the moved one, meters;
        ``camera`` is the matrix (3, 3) of both, ``fb`` is in pixel meters.
        """
        height, width = size = self.disparity.shape
        rotation, shift, inverse = motion[:3, :3], motion[:3, 3], np.linalg.inv(camera)
        rows, columns = np.mgrid[:height, :width]
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).reshape(-1, 3)
        plane = np.linalg.lstsq(pixels, self.disparity.ravel().astype(np.float64), rcond=None)[0]
        normal = camera.T @ plane  # disparity = plane . pixel, and normal . X = fb on the plane
        homography, turned = camera @ (rotation + np.outer(shift, normal) / fb) @ inverse, rotation @ normal
        disparity = (pixels @ (inverse.T @ turned * fb / (fb + turned @ shift))).reshape(height, width)
        cover = cv2.warpPerspective(self.cover, homography, size[::-1], borderMode=cv2.BORDER_REPLICATE)
        color = cv2.warpPerspective(self.color, homography, size[::-1], borderMode=cv2.BORDER_REFLECT_101)
        return CutOut(*(np.asarray(each, np.float32) for each in (cover, color, disparity)))


class Workshop:
    """Generator of a wall with boards in front of it, for pictures of one size."""

    def __init__(self, rng: np.random.Generator, width: int, height: int, paint: Floats, far: float):
        self._rng = rng
        self._rows, self._columns = np.mgrid[:height, :width].astype(np.float32)
        self.wall = self._cut_out(np.ones_like(self._rows), paint, (width / 2, height / 2), far, 0.06 * far)

    def board(
        self,
        center: tuple[float, float],
        size: tuple[float, float],
        disparity: float,
        paint: Floats,
        max_tilt: float = 0.1,
    ) -> CutOut:
        """Return a wavy disc; ``size`` = half its width and height, pixels, ``max_tilt`` = share of its disparity."""
        x, y = (self._columns - center[0]) / size[0], (self._rows - center[1]) / size[1]
        angle = np.arctan2(y, x)
        waves = sum(self._rng.uniform(0.02, 0.12) * np.cos(k * angle + self._rng.uniform(0, 6.3)) for k in (2, 3, 5))
        inside = (0.9 * (1 + waves) - np.hypot(x, y)) * min(size)
        cover = np.clip(inside + 0.5, 0, 1).astype(np.float32)
        return self._cut_out(cover, paint, center, disparity, max_tilt * disparity)

    def _cut_out(
        self, cover: Floats, paint: Floats, center: tuple[float, float], disparity: float, max_tilt: float
    ) -> CutOut:
        """Return a plane, tilted by at most ``max_tilt`` pixels of disparity over a quarter of the picture."""
        height, width = self._rows.shape
        relief = textures.noise(self._rng, height, width, 6.0, 3) + textures.noise(self._rng, height, width, 60.0, 2)
        color = np.clip(paint * (1 + 0.03 * relief[:, :, None]), 0, 1).astype(np.float32)
        tilt_x, tilt_y = self._rng.uniform(-max_tilt, max_tilt, 2) * (4 / width, 4 / height)
        plane = disparity + tilt_x * (self._columns - center[0]) + tilt_y * (self._rows - center[1])
        return CutOut(cover, color, np.maximum(plane, 0.5).astype(np.float32))


def photograph(wall: CutOut, *boards: CutOut) -> tuple[Image8, Floats]:
    """Return color, (H, W, 3) uint8, blurred as by a lens, and disparity of a wall with boards, from far to near."""
    color, truth = wall.color, wall.disparity
    for board in boards:
        share = board.cover[:, :, None]
        color = share * board.color + (1 - share) * color
        truth = np.where(board.cover >= 0.5, np.maximum(board.disparity, truth), truth)
    return levels8(cv2.GaussianBlur(color, (0, 0), 0.6) * 255), truth


def along_boards(
    rng: np.random.Generator, frames: int, width: int, height: int, max_disparity: int, speed: int
) -> list[Shot]:
    """Return five boards before a wall, seen by a camera that moves to the right and a little forward, and turns."""
    fb, camera = RgbdFrame.fb, typical_intrinsics(width, height).matrix
    workshop = Workshop(rng, width, height, textures.color(rng), far=0.3 * max_disparity)
    layers = [workshop.wall]
    for index, nearness in enumerate(np.linspace(0.45, 0.85, 5)):
        center = (((2 * index) % 5 + rng.uniform(0.3, 0.7)) * width / 5, rng.uniform(0.3, 0.7) * height)
        size = (rng.uniform(0.07, 0.11) * width, rng.uniform(0.15, 0.3) * height)
        layers.append(workshop.board(center, size, nearness * max_disparity, textures.color(rng)))
    step = speed * fb / (0.85 * max_disparity) / camera[0, 0]  # meters
    shots: list[Shot] = []
    for index in range(frames):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0005, 0.001, 0.001]) * index)[0]
        pose[:3, 3] = index * step * np.array([1.0, 0.1, 0.3])
        motion = np.asarray(np.linalg.inv(pose), np.float64)
        shots.append((*photograph(*(layer.seen_after(motion, camera, fb) for layer in layers)), pose))
    return shots
