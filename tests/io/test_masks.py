"""Masks are read by one rule: above half of the largest value is inside, whatever that is."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_mask
from depthcli.io.rgbd_frames import load_masked_frame
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from tests.files import laid
from tests.golden import refused, saying, warned
from tests.scenes import true

INSIDE = np.zeros((24, 32), bool)
INSIDE[6:18, 8:24] = True
DEPTH = np.full(INSIDE.shape, 2000, np.uint16)
COLOR = np.full((*INSIDE.shape, 3), 90, np.uint8)
VIEWS = {"left.png": COLOR, "right.png": COLOR, "disp_left.pfm": np.full(INSIDE.shape, 3, np.float32)}


def frame(folder: Path, mask: np.ndarray):
    images = {"color.png": COLOR, "depth.png": DEPTH, "depth_true.png": DEPTH, "mask_transparent.png": mask}
    (scene,) = discover_scenes(laid(folder, images), FRAMES)
    return scene


@pytest.mark.parametrize("top", [1, 2, 128, 200, 255, 1000, 65535])
def test_any_largest_value(tmp_path: Path, top: int):
    """In every reader, that of glass and those of an evaluation."""
    mask = (INSIDE * top).astype(np.uint8 if top < 256 else np.uint16)
    scene = frame(tmp_path / "a", mask)
    found, lines = warned(read_mask, tmp_path / "a/mask_transparent.png")
    assert not lines
    (pair,) = discover_scenes(laid(tmp_path / "s", VIEWS | {"mask_nonocc.png": mask}), PAIRS)
    of_truth = true(scene).masks["transparent"], true(pair).masks["nonocc"]
    for read in (found, load_masked_frame(scene).objects, *of_truth):
        np.testing.assert_array_equal(read, INSIDE)


def test_masks_of_middlebury_jpeg_and_labels(tmp_path: Path):
    three, labels = INSIDE.astype(np.uint8) * 255, INSIDE.astype(np.uint8) * 5
    three[:3], labels[0, :4] = 128, 2
    laid(tmp_path, {"m.png": three, "l.png": labels})
    cv2.imwrite(str(tmp_path / "m.jpg"), cv2.GaussianBlur(INSIDE.astype(np.uint8) * 255, (3, 3), 0))
    for name, is_said in (("m.png", False), ("m.jpg", True), ("l.png", True)):
        found, lines = warned(read_mask, tmp_path / name)
        np.testing.assert_array_equal(found, INSIDE)
        assert [name in line for line in lines] == [True] * is_said
    for value in (-1, np.nan, np.inf):
        laid(tmp_path, {"m.npy": np.where(INSIDE, 1, value)})
        refused(InputError, read_mask, tmp_path / "m.npy")


def test_an_empty_mask_fails_the_glass_and_is_said_in_evaluation(tmp_path: Path):
    scene = frame(tmp_path / "a", np.zeros(INSIDE.shape, np.uint8))
    refused(InputError, load_masked_frame, scene)
    refused(InputError, load_masked_frame, frame(tmp_path / "full", np.full(INSIDE.shape, 255, np.uint8)))
    _, lines = warned(true, scene)
    assert "mask_transparent.png: no pixel is inside" in lines[0]
    with saying(InputError):
        depthcli.complete_transparent(np.zeros((24, 32, 3), np.uint8), DEPTH, objects=np.zeros((24, 32), bool))
