"""Masks are read by one rule: above half of the largest value is inside, whatever that is."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_mask, write_pfm
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import write_png
from depthcli.io.rgbd_frames import load_frame, load_masked_frame, true_depth
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.frames import FRAMES
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import true_disparity
from tests.golden import refused, saying, warned

INSIDE = np.zeros((24, 32), bool)
INSIDE[6:18, 8:24] = True
DEPTH = np.full(INSIDE.shape, 2000, np.uint16)


@pytest.mark.parametrize("top", [1, 2, 128, 200, 255, 1000, 65535])
def test_any_largest_value(tmp_path: Path, top: int):
    write_png(tmp_path / "m.png", (INSIDE * top).astype(np.uint8 if top < 256 else np.uint16))
    with collected_warnings() as lines:
        np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), INSIDE)
    assert not lines


def test_masks_of_middlebury_jpeg_and_labels(tmp_path: Path):
    three = np.where(INSIDE, 255, 0).astype(np.uint8)
    three[:3] = 128
    write_png(tmp_path / "m.png", three)
    with collected_warnings() as lines:
        np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), INSIDE)
    assert not lines
    cv2.imwrite(str(tmp_path / "m.jpg"), cv2.GaussianBlur(INSIDE.astype(np.uint8) * 255, (3, 3), 0))
    labels = INSIDE.astype(np.uint8) * 5
    labels[0, :4] = 2
    write_png(tmp_path / "l.png", labels)
    with collected_warnings() as lines:
        np.testing.assert_array_equal(read_mask(tmp_path / "m.jpg"), INSIDE)
        np.testing.assert_array_equal(read_mask(tmp_path / "l.png"), INSIDE)
    assert ["m.jpg" in lines[0], "l.png" in lines[1]] == [True, True]


def frame(folder: Path, mask: np.ndarray):
    write_png(folder / "color.png", np.full((*INSIDE.shape, 3), 90, np.uint8))
    write_png(folder / "depth.png", DEPTH)
    write_png(folder / "depth_true.png", DEPTH)
    write_png(folder / "mask_transparent.png", mask)
    (scene,) = discover_scenes(folder, FRAMES)
    return scene


@pytest.mark.parametrize("top", [1, 128, 255])
def test_glass_and_evaluation_read_masks_alike(tmp_path: Path, top: int):
    scene = frame(tmp_path / "a", INSIDE.astype(np.uint8) * np.uint8(top))
    np.testing.assert_array_equal(load_masked_frame(scene).objects, INSIDE)
    np.testing.assert_array_equal(true_depth(scene).masks["transparent"], INSIDE)
    for name in ("left", "right"):
        write_png(tmp_path / "s" / f"{name}.png", np.zeros(INSIDE.shape, np.uint8))
    write_pfm(tmp_path / "s" / "disp_left.pfm", np.full(INSIDE.shape, 3, np.float32))
    write_png(tmp_path / "s" / "mask_nonocc.png", INSIDE.astype(np.uint8) * np.uint8(top))
    (pair,) = discover_scenes(tmp_path / "s", PAIRS)
    np.testing.assert_array_equal(true_disparity(pair).masks["nonocc"], INSIDE)


def test_an_empty_mask_fails_the_glass_and_is_said_in_evaluation(tmp_path: Path):
    scene = frame(tmp_path / "a", np.zeros(INSIDE.shape, np.uint8))
    refused(InputError, load_masked_frame, scene)
    _, lines = warned(true_depth, scene)
    assert "mask_transparent.png: no pixel is inside" in lines[0]
    with saying(InputError):
        depthcli.complete_transparent(np.zeros((24, 32, 3), np.uint8), DEPTH, objects=np.zeros((24, 32), bool))


def test_the_mask_of_what_is_hidden(tmp_path: Path):
    write_png(tmp_path / "rgb.png", np.full((*INSIDE.shape, 3), 90, np.uint8))
    write_png(tmp_path / "depth_gt_mm.png", DEPTH)
    write_png(tmp_path / "mask_transparent.png", INSIDE.astype(np.uint8))
    (tmp_path / "meta.json").write_text(json.dumps({}))
    (scene,) = discover_scenes(tmp_path, FRAMES)
    np.testing.assert_array_equal(np.isnan(load_frame(scene).depth), INSIDE)
