"""Textures of generated surfaces: (H, W, 3) float32 RGB in [0, 1].

Every maker takes a numpy ``Generator``, the size in texels and the size of a typical feature in
texels, and draws its randomness from that generator alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from depthcli.core.maps import Floats

TextureMaker = Callable[[np.random.Generator, int, int, float], Floats]

_LETTERS = "ABCDEFGHKLMNPQRSTUVWXYZ23456789"  # on posters and newspapers


def color(rng: np.random.Generator, value: tuple[float, float] = (0.35, 0.9)) -> Floats:
    """Return one random paint, (3,) float32: any hue, moderate saturation."""
    hsv = np.array([[[rng.uniform(0, 360), rng.uniform(0.1, 0.55), rng.uniform(*value)]]], np.float32)
    rgb: Floats = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0]
    return rgb


def noise(
    rng: np.random.Generator, height: int, width: int, feature: float, octaves: int = 4, stretch: float = 1.0
) -> Floats:
    """Return fractal noise, (H, W) float32, zero mean, unit deviation; ``stretch`` lengthens it along x."""
    total = np.zeros((height, width), np.float32)
    for octave in range(octaves):
        cell = max(feature / 2**octave, 1.0)
        rows, columns = int(height / cell) + 4, int(width / (cell * stretch)) + 4
        grid = rng.standard_normal((rows, columns)).astype(np.float32)
        size = (int(columns * cell * stretch) + 1, int(rows * cell) + 1)
        grown = cv2.resize(grid, size, interpolation=cv2.INTER_CUBIC)
        total += grown[:height, :width] * 0.6**octave
    total -= total.mean()
    return np.asarray(total / (total.std() + 1e-6), np.float32)


def _soft(picture: NDArray[Any], sigma: float) -> Floats:
    # Blurred as by a lens and ink; 8-bit drawings come to [0, 1].
    scale = 255 if picture.dtype == np.uint8 else 1
    return np.asarray(cv2.GaussianBlur(picture.astype(np.float32) / np.float32(scale), (0, 0), sigma), np.float32)


def _tint(rng: np.random.Generator, base: NDArray[Any], relief: NDArray[Any], amount: float) -> Floats:
    hue = (1.0 + rng.uniform(-0.35, 0.35, 3)).astype(np.float32)
    return np.clip(base * (1.0 + amount * relief[:, :, None] * hue), 0.02, 0.98).astype(np.float32)


def plaster(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return a rough painted wall: low-contrast noise with stains."""
    relief = 0.7 * noise(rng, height, width, feature / 2, 3) + 0.7 * noise(rng, height, width, feature * 3, 2)
    return _tint(rng, color(rng, (0.6, 0.85)), relief, 0.075)


def wood(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return planks along x, each with its own grain and tone."""
    base = np.array([0.62, 0.42, 0.25], np.float32) * rng.uniform(0.75, 1.3)
    grain = noise(rng, height, width, feature / 4, 3, stretch=9.0)
    rings = np.sin(2.2 * noise(rng, height, width, feature, 2, stretch=6.0) + 0.5 * grain)
    picture = _tint(rng, base, 0.6 * grain + 0.5 * rings, 0.16)
    top = 0
    while top < height:
        bottom = min(height, top + max(3, int(feature * rng.uniform(1.3, 2.0))))
        left = -int(rng.uniform(0, 6 * feature))
        while left < width:
            right = left + int(feature * rng.uniform(6, 11))
            plank = picture[top:bottom, max(left, 0) : max(right, 0)]
            plank *= np.float32(rng.uniform(0.78, 1.15))
            plank[:, -1:] *= 0.6
            left = right
        picture[bottom - 1 : bottom] *= 0.55
        top = bottom
    return np.clip(picture, 0.02, 0.98).astype(np.float32)


def floorboards(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return planks along y: running away from the viewer, a floor has contrast along the rows of the image."""
    return np.ascontiguousarray(wood(rng, width, height, feature).transpose(1, 0, 2))


def bricks(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return a brick wall: every brick has its own tone, so that the courses do not repeat exactly."""
    picture = _tint(rng, np.array([0.72, 0.69, 0.64], np.float32), noise(rng, height, width, feature / 4, 2), 0.05)
    base = np.array([0.62, 0.33, 0.25], np.float32) * rng.uniform(0.8, 1.25)
    rough = noise(rng, height, width, feature / 2, 4)
    tall, gap = max(4, round(feature * 0.75)), max(1, round(feature * 0.09))
    for row, top in enumerate(range(0, height, tall)):
        left = -int((row % 2) * feature * 0.9) - int(rng.uniform(0, 3))
        while left < width:
            right = left + max(4, int(feature * rng.uniform(1.6, 2.0)))
            area = (slice(top, max(top + tall - gap, top + 1)), slice(max(left, 0), max(right - gap, 0)))
            paint = base * (1 + rng.uniform(-0.28, 0.28)) + rng.uniform(-0.04, 0.04, 3)
            picture[area] = paint * (1 + 0.09 * rough[area][:, :, None])
            left = right
    return _soft(np.clip(picture, 0.02, 0.98), 0.6)


def cloth(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return woven stripes of random widths in a few colors."""
    picture = np.empty((height, width, 3), np.float32)
    paints = [color(rng) for _ in range(4)]
    left = 0
    while left < width:
        right = left + max(2, int(feature * rng.uniform(0.2, 1.1)))
        picture[:, left:right] = paints[int(rng.integers(4))]
        left = right
    top = 0
    while top < height:
        bottom = top + max(2, int(feature * rng.uniform(0.2, 1.5)))
        picture[top:bottom] = 0.6 * picture[top:bottom] + 0.4 * paints[int(rng.integers(4))]
        top = bottom
    weave = noise(rng, height, width, 2.5, 1) + 0.5 * noise(rng, height, width, feature, 3)
    return _tint(rng, _soft(picture, 0.7), weave, 0.04)


def checker(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return tiles in two colors, every tile with its own tone."""
    size = max(3, round(feature))
    rows, columns = height // size + 1, width // size + 1
    paints = np.stack([color(rng, (0.25, 0.5)), color(rng, (0.7, 0.95))])
    which = np.add.outer(np.arange(rows), np.arange(columns)) % 2
    tiles = paints[which] * (1 + rng.uniform(-0.16, 0.16, (rows, columns, 1))).astype(np.float32)
    grown = np.repeat(np.repeat(tiles, size, 0), size, 1)[:height, :width].astype(np.float32)
    veins = noise(rng, height, width, feature * 1.5, 4)
    return _tint(rng, _soft(grown, 0.6), veins, 0.08)


def poster(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return a printed poster: colored shapes and big letters on paper."""
    # OpenCV anti-aliases drawings in 8 bits only.
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = 255 * color(rng, (0.55, 0.95))
    area = height * width / feature**2
    for _ in range(int(np.clip(area * 0.5, 8, 200))):
        at = (int(rng.integers(width)), int(rng.integers(height)))
        radius = feature * rng.uniform(0.2, 1.0)
        paint = tuple(255.0 * float(c) for c in color(rng, (0.1, 0.98)))
        match int(rng.integers(4)):
            case 0:
                cv2.circle(picture, at, max(1, int(radius)), paint, -1, cv2.LINE_AA)
            case 1:
                angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
                corners = np.stack([np.cos(angles), np.sin(angles)], 1) * radius * 1.2 + at
                cv2.fillPoly(picture, [corners.astype(np.int32)], paint, cv2.LINE_AA)
            case 2:
                axes = (max(1, int(radius)), max(1, int(radius * rng.uniform(0.3, 0.8))))
                line = max(1, int(feature / 8))
                cv2.ellipse(picture, at, axes, rng.uniform(0, 180), 0, 360, paint, line, cv2.LINE_AA)
            case _:
                letters = "".join(_LETTERS[int(i)] for i in rng.integers(0, len(_LETTERS), int(rng.integers(1, 4))))
                font, thick = (
                    int(rng.choice([cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX])),
                    max(1, int(feature / 9)),
                )
                cv2.putText(picture, letters, at, font, max(radius, 5.0) / 18, paint, thick, cv2.LINE_AA)
    paper = noise(rng, height, width, feature / 3, 3)
    return _tint(rng, _soft(picture, 0.5), paper, 0.04)


def newspaper(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return columns of small print with headlines and a grey picture or two."""
    picture = np.empty((height, width, 3), np.uint8)
    picture[:] = 255 * np.array([0.86, 0.84, 0.78]) * rng.uniform(0.9, 1.05)
    ink = (38.0, 36.0, 38.0)
    y = feature * 0.8
    while y < height + feature:
        headline = rng.random() < 0.18
        size = feature * (0.55 if headline else rng.uniform(0.26, 0.32))
        letters = "".join(
            " " if rng.random() < 0.17 else _LETTERS[int(rng.integers(len(_LETTERS)))]
            for _ in range(int(width / size * 1.6) + 4)
        )
        font = cv2.FONT_HERSHEY_TRIPLEX if headline else cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(picture, letters, (int(-rng.uniform(0, size)), int(y)), font, size / 20, ink, 1, cv2.LINE_AA)
        y += size * 1.7
    for _ in range(1 + int(height * width / feature**2 / 90)):
        tall, wide = int(min(height, feature * 2.2)), int(min(width, feature * 3.0))
        top, left = int(rng.integers(height - tall + 1)), int(rng.integers(width - wide + 1))
        tone = np.clip(115 + 41 * noise(rng, tall, wide, feature, 4), 5, 250)
        picture[top : top + tall, left : left + wide] = tone[:, :, None]
    return _tint(rng, _soft(picture, 0.6), noise(rng, height, width, feature, 3), 0.04)


def marble(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return veined stone."""
    cloud = noise(rng, height, width, feature * 1.2, 5)
    veins = np.abs(noise(rng, height, width, feature * 1.5, 4))
    return _tint(rng, color(rng, (0.5, 0.85)), 0.5 * cloud - 1.2 * np.exp(-6 * veins), 0.22)


def camouflage(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return patches in four paints with soft outlines."""
    level = noise(rng, height, width, feature, 4) + 0.12 * noise(rng, height, width, 3.0, 1)
    paints = np.stack([color(rng, (0.25, 0.9)) for _ in range(4)])
    picture = paints[np.digitize(level, [-0.7, 0.0, 0.7])]
    return _tint(rng, _soft(picture, 0.7), noise(rng, height, width, feature / 2, 3), 0.06)


def asphalt(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return asphalt: grey with fine grain and wide stains, here and there a bright line along y."""
    relief = 0.5 * noise(rng, height, width, 3.0, 2) + 0.8 * noise(rng, height, width, feature * 4, 3)
    picture = _tint(rng, np.full(3, rng.uniform(0.25, 0.5), np.float32), relief, rng.uniform(0.03, 0.1))
    for _ in range(int(rng.integers(1, 4))):
        left, wide = int(rng.uniform(0, width)), max(2, int(feature * rng.uniform(0.1, 0.4)))
        picture[:, left : left + wide] = rng.uniform(0.6, 0.9)
    return _soft(picture, 0.6)


def bodywork(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return the side of a car: bare paint, dark panes with a sheen, a few seams."""
    shade = np.linspace(1.1, 0.75, height, dtype=np.float32)[:, None, None]
    picture = np.ones((height, width, 1), np.float32) * shade * color(rng, (0.15, 0.9))
    for k in range(2):
        left, right = (int(width * (0.08 + 0.44 * k + share)) for share in (0.0, 0.4))
        pane = picture[int(0.12 * height) : int(0.42 * height), left:right]
        pane[:] = rng.uniform(0.05, 0.2) + 0.15 * np.linspace(0, 1, pane.shape[1], dtype=np.float32)[None, :, None]
    for share in (0.1, 0.5, 0.9):
        picture[int(0.45 * height) :, int(share * width) : int(share * width) + 1] *= 0.6
    picture[int(0.9 * height) :] = 0.06
    return np.clip(_soft(picture, 0.8) * (1 + 0.01 * noise(rng, height, width, feature, 2)[:, :, None]), 0.02, 0.98)


def surroundings(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return the surroundings that paint and panes reflect: bright sky, dark shapes."""
    level = noise(rng, height, width, feature * 2, 3, rng.uniform(1, 3))
    bright = (level > rng.uniform(-0.5, 0.8)).astype(np.float32) + np.float32(0.2) * level
    return np.repeat(cv2.GaussianBlur(np.clip(bright, 0, 1), (0, 0), 1.0)[:, :, None], 3, axis=2)


def windows(rng: np.random.Generator, height: int, width: int, feature: float) -> Floats:
    """Return a house front: plaster with rows of windows that are all the same."""
    picture = plaster(rng, height, width, feature)
    wide, tall = (max(8, int(feature * rng.uniform(1.2, 2.5))) for _ in range(2))
    pane = np.full((max(3, int(0.6 * tall)), max(3, int(0.5 * wide)), 3), rng.uniform(0.08, 0.3), np.float32)
    pane[:, [0, pane.shape[1] // 2, -1]] = pane[[0, pane.shape[0] // 2, -1]] = rng.uniform(0.6, 0.95)
    for top in range(tall // 4, height - pane.shape[0], tall):
        for left in range(wide // 4, width - pane.shape[1], wide):
            picture[top : top + pane.shape[0], left : left + pane.shape[1]] = pane
    return _soft(picture, 0.6)


def repeated(rng: np.random.Generator, height: int, width: int, tile: int, landmarks: int, feature: float) -> Floats:
    """Return a pattern that repeats exactly every ``tile`` texels along x (and y), with unique stickers on it.

    The stickers, ``landmarks`` in number, distinguish the repetitions.
    """
    half = tile / 2
    motif = np.empty((tile, tile, 3), np.float32)
    motif[:] = color(rng, (0.65, 0.9))
    paint = [tuple(float(c) for c in color(rng, (0.15, 0.5))) for _ in range(2)]
    match int(rng.integers(3)):
        case 0:
            cv2.rectangle(motif, (int(tile * 0.2), int(tile * 0.15)), (int(tile * 0.75), int(tile * 0.8)), paint[0], -1)
            cv2.circle(motif, (int(half), int(half)), max(1, int(tile * 0.18)), paint[1], -1, cv2.LINE_AA)
        case 1:
            corners = np.array([[half, tile * 0.08], [tile * 0.9, half], [half, tile * 0.92], [tile * 0.1, half]])
            cv2.fillPoly(motif, [corners.astype(np.int32)], paint[0], cv2.LINE_AA)
            cv2.circle(motif, (int(half), int(half)), max(1, int(tile * 0.15)), paint[1], -1, cv2.LINE_AA)
        case _:
            motif[:, : int(tile * 0.45)] = paint[0]
            cv2.rectangle(motif, (int(tile * 0.6), int(half)), (int(tile * 0.85), int(tile * 0.8)), paint[1], -1)
    soft = _soft(np.tile(motif, (3, 3, 1)), max(0.6, tile / 24))[tile : 2 * tile, tile : 2 * tile]
    picture = np.tile(soft, (height // tile + 1, width // tile + 1, 1))[:height, :width].copy()
    columns = max(1, round((landmarks * width / height) ** 0.5))
    for index in range(landmarks):
        cell = (index % columns + rng.uniform(0.25, 0.75)) / columns
        row = (index // columns + rng.uniform(0.25, 0.75)) / max(1, -(-landmarks // columns))
        tall, wide = (max(4, int(feature * rng.uniform(0.5, 1.0))) for _ in range(2))
        top, left = int(row * (height - tall)), int(cell * (width - wide))
        if top >= 0 and left >= 0:
            picture[top : top + tall, left : left + wide] = poster(rng, tall, wide, max(feature / 4, 3.0))
    return picture


OBJECT_TEXTURES: tuple[TextureMaker, ...] = (poster, newspaper, cloth, camouflage, marble, wood, checker)
WALL_TEXTURES: tuple[TextureMaker, ...] = (bricks, plaster, cloth, marble)
FLOOR_TEXTURES: tuple[TextureMaker, ...] = (floorboards, checker, marble)
