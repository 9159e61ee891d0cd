"""Scenes for a Kinect-like sensor, single and in sequences."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from depthcli.core.cameras.camera import typical_intrinsics
from depthcli.simulate.arrays import textures
from depthcli.simulate.arrays.boards import Canvas, Disparity, moved
from depthcli.simulate.arrays.camera_path import Shot, along_boards
from depthcli.simulate.arrays.depth_sensor import KinectSample, discs, simulate_kinect
from depthcli.simulate.arrays.stereo_scenes import make_scene

SceneKind = Literal["planes", "foreground", "curved", "camouflage"]
SCENE_KINDS: tuple[SceneKind, ...] = get_args(SceneKind)
SequenceKind = Literal["static", "moving", "camera"]
SEQUENCE_KINDS: tuple[SequenceKind, ...] = get_args(SequenceKind)

_COLOR_NOISE = 2.0  # grey levels, of every frame of a sequence


def make_kinect_scene(
    kind: SceneKind, seed: int = 0, width: int = 400, height: int = 300, max_disparity: int = 48
) -> tuple[NDArray[np.uint8], Disparity]:
    """Return color (H, W, 3) uint8 RGB and exact disparity (H, W) float32, pixels, the same for the same arguments.

    Parameters
    ----------
    kind : ``planes``, ``foreground``, ``curved`` as in :func:`depthcli.simulate.arrays.stereo_scenes.make_scene`;
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
