"""Pictures for people: bits survive the palette, colors differ, nothing trips over NaN."""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.core.maps import DepthStatus, Status
from depthcli.io.formats.images import read_image, write_png
from depthcli.io.formats.pictures import (
    DEPTH_STATUS_PALETTE,
    STATUS_PALETTE,
    confidence_picture,
    preview,
    preview_depth,
    read_status,
    status_color,
    status_words,
    write_legend,
    write_status,
)

OCCURRING = [reason | extra for reason in (0, 1, 2, 4, 8) for extra in (0, 16, 32, 48)]
PALETTES = pytest.mark.parametrize(("palette", "flag"), [(STATUS_PALETTE, Status), (DEPTH_STATUS_PALETTE, DepthStatus)])


@PALETTES
def test_bits_survive_and_are_in_color(tmp_path: Path, palette, flag):
    bits = np.random.default_rng(0).permutation(np.arange(256, dtype=np.uint8)).reshape(8, 32)
    write_status(tmp_path / "status.png", bits, palette)
    np.testing.assert_array_equal(read_status(tmp_path / "status.png"), bits)
    seen = read_image(tmp_path / "status.png")
    np.testing.assert_array_equal(seen[bits == 0][0], palette[0][1])
    np.testing.assert_array_equal(seen[bits == 17][0], status_color(17, palette))
    assert all(bit in palette for bit in [0, *map(int, flag)])
    with pytest.raises(ValueError, match="uint8"):
        write_status(tmp_path / "status.png", bits.astype(int), palette)


def test_few_and_many_values_keep_their_numbers(tmp_path: Path):
    for values in ([[0]], [[32, 0]], [[255, 17, 3]]):
        write_status(tmp_path / "s.png", np.array(values, np.uint8), STATUS_PALETTE)
        np.testing.assert_array_equal(read_status(tmp_path / "s.png"), values)
    write_png(tmp_path / "grey.png", np.array([[0, 17]], np.uint8))  # as earlier runs wrote them
    np.testing.assert_array_equal(read_status(tmp_path / "grey.png"), [[0, 17]])
    write_png(tmp_path / "color.png", np.zeros((1, 1, 3), np.uint8))
    (tmp_path / "cut.png").write_bytes((tmp_path / "s.png").read_bytes()[:-9])
    cv2.imwrite(str(tmp_path / "a.jpg"), np.zeros((8, 8), np.uint8))
    for name in ("color.png", "cut.png", "a.jpg"):
        with pytest.raises(InputError, match=name):
            read_status(tmp_path / name)


@PALETTES
def test_single_bits_differ_clearly_and_combinations_at_all(palette, flag):
    one = [np.array(status_color(int(bit), palette), float) for bit in [0, *flag]]
    assert min(np.abs(a - b).sum() for a, b in itertools.combinations(one, 2)) > 60
    # That a value was smoothed as well is not shown beside anything else.
    told_apart = {value if value == int(Status.SMOOTHED) else value & ~int(Status.SMOOTHED) for value in OCCURRING}
    assert len({status_color(value, palette) for value in OCCURRING}) >= len(told_apart) - 2


def test_words(tmp_path: Path):
    assert status_words(0, STATUS_PALETTE) == "measured"
    assert status_words(Status.OCCLUDED | Status.FILLED, STATUS_PALETTE) == "occluded, filled"
    assert status_words(128, STATUS_PALETTE) == "128"
    write_legend(tmp_path / "all.png", DEPTH_STATUS_PALETTE)
    write_legend(tmp_path / "legend.png", STATUS_PALETTE, [17, 0])
    legend = read_image(tmp_path / "legend.png")
    assert legend.shape[0] < read_image(tmp_path / "all.png").shape[0]
    for row, value in enumerate((0, 17)):
        np.testing.assert_array_equal(legend[8 + 26 * row + 12, 20], status_color(value, STATUS_PALETTE))
    assert (legend[:, 60:] < 100).any()  # words


def test_confidence_is_spread_robustly():
    values = np.linspace(-2, 3, 1000, dtype=np.float32).reshape(20, 50)
    values[0, 0], values[0, 1], values[0, 2] = np.nan, np.inf, -np.inf
    picture = confidence_picture(values)
    assert picture[0, 0] == 0 and picture[0, 1] == 255 and picture[0, 2] == 0
    assert picture[10, 0] in (127, 128)
    assert np.all(np.diff(picture.ravel()[3:].astype(int)) >= 0)
    assert confidence_picture(np.full((2, 2), 7.0)).tolist() == [[255, 255]] * 2
    assert confidence_picture(np.full((2, 2), np.nan)).tolist() == [[0, 0]] * 2


def test_previews():
    near, far = preview_depth(np.array([[1, 2, 4, np.nan, 0]], np.float32))[0, [0, 2]].astype(int)
    assert near[0] > near[2] and far[2] > far[0]
    assert preview_depth(np.full((1, 2), np.nan, np.float32)).max() == 0
    picture = preview(np.array([[0, 5, 10, np.nan]], np.float32), 10)
    assert picture.dtype == np.uint8 and picture.shape == (1, 4, 3)
    assert picture[0, 3].tolist() == [0, 0, 0]
    assert len({tuple(color) for color in picture[0].tolist()}) == 4
