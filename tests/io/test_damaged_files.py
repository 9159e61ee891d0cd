"""Damaged files: pixels or an InputError in one line, and silence on stderr."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.calibrations import read_rig
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.images import image_size, read_image
from tests import damage

FILES = {name: data for name, data in damage.originals().items() if not name.endswith((".pfm", ".npy"))}
ROUNDS = 60
ODD_VALUES = (
    "[" * 3000 + "]" * 3000, "9" * 400, "-" + "9" * 5000, "1e400", "-99999999999", "NaN", "null", '"x"', "[]", "{}",
    "[1, [2]]", "0", "-1", "[" + "1, " * 20_000 + "1]", '{"a": {"b": {}}}', "1e-320", "2147483648",
)  # fmt: skip
_RIG = (
    "%YAML:1.0\n---\n"
    + "".join(
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [{data}]\n"
        for name, rows, columns, data in (
            ("K1", 3, 3, "60, 0, 31.5, 0, 60, 23.5, 0, 0, 1"), ("D1", 1, 5, "-0.05, 0.01, 0, 0, 0"),
            ("K2", 3, 3, "61, 0, 31, 0, 61, 24, 0, 0, 1"), ("D2", 1, 5, "-0.04, 0.01, 0, 0, 0"),
            ("R", 3, 3, "1, 0, 0, 0, 1, 0, 0, 0, 1"), ("T", 3, 1, "-0.12, 0.001, 0"),
        )
    )
).encode()  # fmt: skip


@pytest.mark.parametrize("name", [name for name in FILES if name != "plain.pgm"])  # whose last number may lose a digit
def test_truncated_images_are_never_accepted(tmp_path: Path, capfd, name):
    data = FILES[name]
    path = tmp_path / name
    path.write_bytes(data)
    whole = read_image(path)
    assert image_size(path) == whole.shape[:2]
    for size in [*range(40), *range(40, len(data) - 12, max(1, len(data) // 60))]:  # behind are marks of the end
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_image(path)
    if not name.endswith(".tiff"):  # libtiff writes what it finds, whoever calls it
        assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", [name for name in damage.originals() if not name.endswith((".tiff", "cube.npy"))])
def test_damage_is_told_by_us_alone(tmp_path: Path, capfd, name):
    data = damage.originals()[name]
    path = tmp_path / name
    accepted = 0
    for number in range(ROUNDS):
        rng = np.random.default_rng(number)
        way = (damage.truncated, damage.holed, damage.flipped)[number % 3]
        path.write_bytes(way(data, rng))
        try:
            read_image(path) if name in FILES else read_plane(path)
            accepted += 1
        except InputError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
    assert capfd.readouterr().err == ""
    if name.endswith(".png"):  # every byte of a PNG is under a checksum
        assert accepted <= 2


@pytest.mark.parametrize("value", ODD_VALUES, ids=lambda value: value[:9])
def test_odd_values_in_calibrations_are_refused_in_a_line(tmp_path: Path, value):
    """Numbers of thousands of digits, lists that multiply, deep ones: in every place, and soon."""
    text = _RIG.decode()
    for place in ("K1: !!opencv-matrix", "[60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]", "rows: 3", "%YAML:1.0"):
        path = tmp_path / "rig.yaml"
        path.write_text(text.replace(place, f"K1: {value}" if place.startswith("K1") else value, 1), "utf-8")
        try:
            read_rig([path])
        except InputError as error:
            assert str(path) in str(error)
            assert str(error).isprintable()
            assert len(str(error)) < 600
