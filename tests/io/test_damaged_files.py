"""Hundreds of damaged files: pixels or an InputError in one line, and silence on stderr."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.disparity import read_disparity, write_pfm
from depthcli.io.images import read_image

ROUNDS = 150


def originals() -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8), (0, 0), 2)
    made = {s: cv2.imencode(s, smooth)[1].tobytes() for s in (".png", ".jpg", ".ppm", ".tiff", ".bmp")}
    made[".pgm"] = cv2.imencode(".pgm", smooth[..., 0])[1].tobytes()
    return made


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    broken = bytearray(data)
    kind = rng.integers(4)
    if kind == 0:
        return bytes(broken[: rng.integers(0, len(broken))])
    if kind == 1:  # a piece is missing in the middle
        a, b = sorted(rng.integers(0, len(broken), 2))
        return bytes(broken[:a] + broken[b:])
    # Headers are short and break in more ways than pixels: half of the flips go there.
    end = len(broken) if kind == 2 else min(len(broken), 700)
    for _ in range(rng.integers(1, 6)):
        broken[rng.integers(end)] ^= 1 << rng.integers(8)
    return bytes(broken)


def read_or_refuse(read, path: Path) -> bool:
    try:
        result = read(path)
    except InputError as error:
        message = str(error)
    else:
        assert result.ndim in (2, 3)
        return True
    assert str(path) in message
    assert "\n" not in message
    return False


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".ppm", ".pgm", ".tiff", ".bmp"])
def test_damaged_images(tmp_path: Path, capfd, suffix):
    data = originals()[suffix]
    rng = np.random.default_rng(1)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    assert read_or_refuse(read_image, path)
    accepted = 0
    for _ in range(ROUNDS):
        path.write_bytes(damaged(data, rng))
        accepted += read_or_refuse(read_image, path)
    if suffix != ".tiff":  # libtiff writes what it finds, whoever calls it
        assert capfd.readouterr().err == ""
    if suffix == ".png":  # every byte of a PNG is under a checksum
        assert accepted <= 2


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".ppm", ".pgm", ".tiff", ".bmp"])
def test_truncated_images_are_never_accepted(tmp_path: Path, capfd, suffix):
    data = originals()[suffix]
    path = tmp_path / f"a{suffix}"
    for size in [*range(40), *range(40, len(data), max(1, len(data) // 60)), len(data) - 1]:
        path.write_bytes(data[:size])
        if size == len(data) - 1 and suffix == ".tiff":
            continue  # the last byte of this file may be padding
        with pytest.raises(InputError):
            read_image(path)
    if suffix != ".tiff":
        assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", [".pfm", ".npy", ".png"])
def test_damaged_maps(tmp_path: Path, capfd, suffix):
    path = tmp_path / f"a{suffix}"
    values = np.random.default_rng(0).uniform(0, 60, (11, 13)).astype(np.float32)
    if suffix == ".pfm":
        write_pfm(path, values)
    elif suffix == ".npy":
        np.save(path, values)
    else:
        cv2.imwrite(str(path), (values * 256).astype(np.uint16))
    data = path.read_bytes()
    rng = np.random.default_rng(2)
    for _ in range(ROUNDS):
        path.write_bytes(damaged(data, rng))
        read_or_refuse(read_disparity, path)
    assert capfd.readouterr().err == ""
