"""What a Kinect-like sensor measures of a scene whose disparity is known, and scenes to show it.

The sensor looks through the color camera's pixels. Its two systematic faults are those of all triangulating
sensors: surfaces in front look wider than they are, since a matching window that sees both takes the
better textured or nearer one (mismatch), and the far side of every left edge lies in the projector's shadow (gap).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import Intrinsics, typical_intrinsics
from depthcli.core.cameras.triangulation import depth_of_disparity
from depthcli.core.frames import RgbdFrame
from depthcli.data.generated.arrays import textures
from depthcli.data.generated.arrays.boards import Canvas, Disparity, moved
from depthcli.data.generated.arrays.camera_path import Shot, along_boards
from depthcli.data.generated.arrays.stereo_scenes import make_scene

Mask = NDArray[np.bool_]

SceneKind = Literal["planes", "foreground", "curved", "camouflage"]
SCENE_KINDS: tuple[SceneKind, ...] = get_args(SceneKind)
SequenceKind = Literal["static", "moving", "camera"]
SEQUENCE_KINDS: tuple[SequenceKind, ...] = get_args(SequenceKind)

_COLOR_NOISE = 2.0  # grey levels, of every frame of a sequence


@dataclass(frozen=True)
class KinectSample:
    """A simulated frame and what is known about it. Every mask is (H, W) bool and keeps to pixels with known truth.

    Attributes
    ----------
    color : (H, W, 3) uint8 RGB
    disparity : (H, W) float32, what the sensor measured; pixels, NaN = unknown
    truth : (H, W) float32 true disparity; pixels, NaN = unknown
    occluded : in the shadow of something nearer, without a measurement
    specular : in a disc without a measurement, and not in shadow
    mismatch : measured, but the value of the surface in front
    measured : measured rightly, up to noise
    intrinsics : of the camera, or None where it has none
    pose : (4, 4) float64, from the camera's coordinates to the world's, meters; or None where the camera has none
    """

    color: NDArray[np.uint8]
    disparity: Disparity
    truth: Disparity
    occluded: Mask
    specular: Mask
    mismatch: Mask
    measured: Mask
    intrinsics: Intrinsics | None = None
    pose: NDArray[np.float64] | None = None

    @property
    def gap(self) -> Mask:
        """Pixels without a measurement whose truth is known."""
        return self.occluded | self.specular

    def frame(self, fb: float = RgbdFrame.fb) -> RgbdFrame:
        """The measurement as a frame in meters; ``fb`` in pixel meters."""
        return RgbdFrame(self.color, depth_of_disparity(self.disparity, fb), fb, self.intrinsics, pose=self.pose)

    def depth_true(self, fb: float = RgbdFrame.fb) -> NDArray[np.float32]:
        """(H, W) float32, meters, NaN = unknown."""
        return depth_of_disparity(self.truth, fb)


def simulate_kinect(
    color: NDArray[np.uint8],
    truth: NDArray[np.floating[Any]],
    seed: int = 0,
    *,
    fattening: int = 4,
    noise: float = 0.3,
    discs: int = 8,
    disc_radius: tuple[float, float] = (8.0, 22.0),
    jump: float = 1.0,
) -> KinectSample:
    """Return a Kinect-like measurement of a scene.

    At every step of more than ``jump`` between neighbors of a row, the nearer surface's edge value is written over
    ``fattening`` pixels of the farther one. Then what lies in shadow is taken out: left of every such edge, as many
    pixels as the disparity jumps (a pixel x whose ``x - d`` is not left of every nearer pixel's on its right), and
    some random discs. What is left gets Gaussian noise. Where the truth is unknown nothing is measured.

    Parameters
    ----------
    color : (H, W, 3) uint8 RGB
    truth : (H, W) float, pixels of disparity, NaN or infinite = unknown
    seed : of discs and noise
    fattening : pixels
    noise : standard deviation, pixels of disparity
    discs : how many specular spots
    disc_radius : smallest and largest radius, pixels
    jump : pixels of disparity; smaller steps are slopes

    Raises
    ------
    ValueError
        For sizes that differ, nothing known, or negative amounts.
    """
    if color.shape[:2] != truth.shape or truth.ndim != 2:
        raise ValueError(f"color {color.shape} and truth {truth.shape} differ in size")
    if fattening < 0 or noise < 0 or discs < 0 or jump <= 0 or not 0 <= disc_radius[0] <= disc_radius[1]:
        raise ValueError("want fattening, noise, discs >= 0, jump > 0 and a range of radii")
    known = np.isfinite(truth)
    if not known.any():
        raise ValueError("no pixel has a true disparity")
    surface = _behind(np.where(known, truth, np.nan).astype(np.float32))
    fattened = _fattened(surface, fattening, jump)
    shadow = _shadow(fattened, jump)
    rng = np.random.Generator(np.random.PCG64([seed, 0x4B1]))
    spots = _discs(rng, (truth.shape[0], truth.shape[1]), discs, disc_radius)
    values = fattened + noise * rng.standard_normal(truth.shape, np.float32)
    wrong = np.abs(fattened - surface) > jump
    missing = shadow | spots
    return KinectSample(
        color=color,
        disparity=np.where(known & ~missing, values, np.nan).astype(np.float32),
        truth=np.where(known, truth, np.nan).astype(np.float32),
        occluded=known & shadow,
        specular=known & spots & ~shadow,
        mismatch=known & wrong & ~missing,
        measured=known & ~wrong & ~missing,
    )


def _behind(truth: Disparity) -> Disparity:
    """Unknown runs of each row take the smaller of the values at their ends; rows without any, the row above's."""
    left, right = truth.copy(), truth.copy()
    for x in range(1, truth.shape[1]):
        left[:, x] = np.where(np.isnan(left[:, x]), left[:, x - 1], left[:, x])
        right[:, -x - 1] = np.where(np.isnan(right[:, -x - 1]), right[:, -x], right[:, -x - 1])
    filled: Disparity = np.fmin(left, right)
    empty = np.isnan(filled[:, 0])
    if empty.any():
        given = np.flatnonzero(~empty)
        filled = filled[given[np.abs(np.arange(len(filled))[:, None] - given).argmin(axis=1)]]
    return filled


def _fattened(surface: Disparity, width: int, jump: float) -> Disparity:
    """Surfaces in front, spread over ``width`` pixels on both sides along the rows."""
    step = np.diff(surface, axis=1)
    faces_left, faces_right = np.full_like(surface, -np.inf), np.full_like(surface, -np.inf)
    faces_left[:, 1:] = np.where(step > jump, surface[:, 1:], -np.inf)
    faces_right[:, :-1] = np.where(step < -jump, surface[:, :-1], -np.inf)
    result = surface.copy()
    for k in range(1, min(width, surface.shape[1] - 1) + 1):
        np.maximum(result[:, :-k], faces_left[:, k:], out=result[:, :-k])
        np.maximum(result[:, k:], faces_right[:, :-k], out=result[:, k:])
    return result


def _shadow(fattened: Disparity, jump: float) -> Mask:
    """Pixels whose projected position ``x - d`` is hidden behind a surface to their right, nearer by over ``jump``."""
    position = np.arange(fattened.shape[1], dtype=np.float32) - fattened
    shadow = np.zeros(fattened.shape, bool)
    front = position[:, -1].copy()
    front_value = fattened[:, -1].copy()
    for x in range(fattened.shape[1] - 2, -1, -1):
        shadow[:, x] = (position[:, x] >= front) & (front_value - fattened[:, x] > jump)
        ahead = position[:, x] < front
        front = np.where(ahead, position[:, x], front)
        front_value = np.where(ahead, fattened[:, x], front_value)
    return shadow


def _discs(rng: np.random.Generator, shape: tuple[int, int], count: int, radius: tuple[float, float]) -> Mask:
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    spots = np.zeros(shape, bool)
    for _ in range(count):
        y, x, r = rng.uniform(0, shape[0]), rng.uniform(0, shape[1]), rng.uniform(*radius)
        spots |= (rows - y) ** 2 + (columns - x) ** 2 <= r * r
    return spots


# ---------------------------------------------------------------------------------------------------------
# Scenes from nothing


def make_kinect_scene(
    kind: SceneKind, seed: int = 0, width: int = 400, height: int = 300, max_disparity: int = 48
) -> tuple[NDArray[np.uint8], Disparity]:
    """Return color (H, W, 3) uint8 RGB and exact disparity (H, W) float32, pixels, the same for the same arguments.

    Parameters
    ----------
    kind : ``planes``, ``foreground``, ``curved`` as in :func:`depthcli.data.generated.arrays.stereo_scenes.make_scene`;
        ``camouflage``: boards before a wall, every other one painted like it, so that only the depth shows the edge
    seed : chooses the scene
    width, height : pixels, at least 16
    max_disparity : pixels, at least 4 and at most ``width / 2``

    Raises
    ------
    ValueError
        For an unknown kind or an impossible size or range.
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
    frames : how many
    seed : chooses the scene, discs and noise; specular discs stay where they are
    width, height, max_disparity : pixels
    speed : pixels per frame that the board moves to the right, or that the camera moves the nearest one to the left
    fattening, noise : as in :func:`simulate_kinect`

    Raises
    ------
    ValueError
        For an unknown kind, fewer than one frame, or an impossible size or range.
    """
    if kind not in SEQUENCE_KINDS:
        raise ValueError(f"kind must be one of {', '.join(SEQUENCE_KINDS)}, got {kind!r}")
    if frames < 1:
        raise ValueError(f"want at least one frame, got {frames}")
    rng = np.random.Generator(np.random.PCG64([seed, 0x5E0]))
    shots = _shots(kind, rng, frames, seed, width, height, max_disparity, speed)
    spots = _discs(rng, (height, width), 8, (8.0, 22.0))
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


def _shots(
    kind: SequenceKind,
    rng: np.random.Generator,
    frames: int,
    seed: int,
    width: int,
    height: int,
    max_disparity: int,
    speed: int,
) -> list[Shot]:
    """Color, true disparity and pose of every frame, without noise."""
    if kind == "camera":
        return along_boards(rng, frames, width, height, max_disparity, speed)
    color, truth = make_kinect_scene("foreground", seed, width, height, max_disparity)
    canvas = Canvas(rng, width, height, textures.color(rng), far=1.0)
    canvas.color, canvas.truth = color.astype(np.float32) / np.float32(255), truth
    size = (0.09 * width, 0.2 * height)
    mover = canvas.board((0.2 * width, 0.55 * height), size, 0.85 * max_disparity, textures.color(rng), flat=True)
    if kind == "static":
        return [(color, truth, None)] * frames
    return [(*canvas.photograph(moved(mover, index * speed)), None) for index in range(frames)]
