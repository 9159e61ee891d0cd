"""Bad files: pixels or an InputError in one printable line, silence on stderr, and no hang."""

import json
import os
import re
import socket
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import DepthcliError, InputError
from depthcli.io.formats.calibrations import read_geometry, read_rig
from depthcli.io.formats.disparity import map_npy, read_plane
from depthcli.io.formats.files import read_bytes, short_path, shown
from depthcli.io.formats.images import image_size, read_image
from depthcli.io.formats.networks import network_path, read_network
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.io.scenes.pairs import scenes_of_table
from tests import boards, damage
from tests.files import laid
from tests.golden import refused, saying

FILES = {name: data for name, data in damage.originals().items() if not name.endswith((".pfm", ".npy"))}
ROUNDS = 60
ODD_VALUES = (
    "[" * 3000 + "]" * 3000, "9" * 400, "-" + "9" * 5000, "1e400", "-99999999999", "NaN", "null", '"x"', "[]", "{}",
    "[1, [2]]", "0", "-1", "[" + "1, " * 20_000 + "1]", '{"a": {"b": {}}}', "1e-320", "2147483648",
)  # fmt: skip


@pytest.mark.parametrize("name", [name for name in FILES if name != "plain.pgm"])  # whose last number may lose a digit
def test_truncated_images_are_never_accepted(tmp_path: Path, capfd, name):
    data, path = FILES[name], tmp_path / name
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
    data, path, accepted = damage.originals()[name], tmp_path / name, 0
    for number in range(ROUNDS):
        way = (damage.truncated, damage.holed, damage.flipped)[number % 3]
        path.write_bytes(way(data, np.random.default_rng(number)))
        try:
            read_image(path) if name in FILES else read_plane(path)
            accepted += 1
        except InputError as error:
            assert str(path) in str(error) and "\n" not in str(error)
    assert capfd.readouterr().err == ""
    if name.endswith(".png"):  # every byte of a PNG is under a checksum
        assert accepted <= 2


@pytest.mark.parametrize("value", ODD_VALUES, ids=lambda value: value[:9])
def test_odd_values_in_calibrations_are_refused_in_a_line(tmp_path: Path, value):
    """Numbers of thousands of digits, lists that multiply, deep ones: in every place, and soon."""
    path = boards.opencv(tmp_path / "rig.yaml", boards.rig())
    text = path.read_text()
    for place in ("!!opencv-matrix", re.search(r"\[.*?\]", text, re.DOTALL)[0], "rows: 3", "%YAML:1.0"):
        path.write_text(text.replace(place, value, 1), "utf-8")
        try:
            read_rig([path])
        except InputError as error:
            assert str(path) in str(error) and str(error).isprintable() and len(str(error)) < 600


READERS = [read_bytes, read_image, map_npy, image_size]


def told(read, path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert message.isprintable() and len(message) < 700  # and on one line
    message.encode("utf-8")
    return message


@pytest.mark.parametrize("read", READERS)
def test_only_regular_files_are_opened(tmp_path: Path, read):
    os.mkfifo(tmp_path / "pipe.png")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(tmp_path / "socket.png"))
        assert "socket" in told(read, tmp_path / "socket.png")
    assert "pipe" in told(read, tmp_path / "pipe.png")
    assert "folder" in told(read, tmp_path)
    for device in ("/dev/zero", "/dev/full", "/dev/null"):
        assert "device" in told(read, device)
    (tmp_path / "link.png").symlink_to("/dev/zero")
    assert "device" in told(read, tmp_path / "link.png")
    (tmp_path / "loop.png").symlink_to("loop.png")
    assert "loop.png" in told(read, tmp_path / "loop.png")


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("name", [
    os.fsdecode(b"caf\xe9.png"), "\ud800.png", "a\0b.png", "n" * 300, "d/" * 3000, "two\nlines\x1b[31m.png",
    "\u202ex.png", "",
])  # fmt: skip
def test_names_that_cannot_be_are_told_in_printable_words(tmp_path: Path, read, name):
    told(read, f"{tmp_path}/{name}/x.png")


def test_names_that_are_not_utf8_are_read_and_long_ones_keep_their_ends(tmp_path: Path):
    path = tmp_path / os.fsdecode(b"caf\xe9\n.bin")
    path.write_bytes(b"abc")
    assert read_bytes(path) == b"abc"
    assert shown(path) == f"{tmp_path}/caf\\xe9\\n.bin"
    assert shown("\xfcber/日本.png") == "\xfcber/日本.png"
    assert str(DepthcliError(f"{path}\n\ud800")) == f"{tmp_path}/caf\\xe9\n.bin\n\\ud800"
    first, second = (short_path(f"a/{'é' * 200}{middle}{'x' * 300}.png/b") for middle in "12")
    parts = first.split("/")
    assert first != second and [parts[0], parts[2]] == ["a", "b"]
    assert parts[1].startswith("éé") and parts[1].endswith("x.png") and len(parts[1].encode()) <= 255
    assert short_path(f"{'x' * 200}/é.png") == f"{'x' * 200}/é.png"


@pytest.mark.skipif(hasattr(os, "getuid") and os.getuid() == 0, reason="root reads everything")
def test_what_may_not_be_read(tmp_path: Path):
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o000)
    assert "Permission" in told(read_bytes, folder / "x.png")
    folder.chmod(0o700)


def test_size_is_limited_before_reading(tmp_path: Path):
    path = tmp_path / "huge.png"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # sparse
    assert "expected at most" in told(read_bytes, path)
    (tmp_path / "small").write_bytes(bytes(11))
    with saying(InputError):
        read_bytes(tmp_path / "small", max_bytes=10)
    assert len(read_bytes(tmp_path / "small", max_bytes=11)) == 11
    if Path("/proc/self/pagemap").exists():  # a regular file of size 0 that never ends
        assert "grew" in told(read_bytes, "/proc/self/pagemap")
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (20000, 20000, 10000), }".ljust(117) + "\n"
    start = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little")
    (tmp_path / "a.npy").write_bytes(start + header.encode() + bytes(64))
    refused(InputError, map_npy, tmp_path / "a.npy")


IMAGE = np.arange(48, dtype=np.uint8).reshape(6, 8)
HUGE = ["1e305", "1e999", "9" * 400, "9" * 5000]
CALIB = "cam0=[9 0 4; 0 9 3; 0 0 1]\ncam1=[9 0 4; 0 9 3; 0 0 1]\ndoffs=0\nbaseline=100\n"


@pytest.mark.parametrize("number", [*HUGE, "-99999999999", "1.5", "nan", "0x10", "1_0"])
def test_numbers_too_large_in_text(tmp_path: Path, number: str):
    (tmp_path / "pairs.csv").write_text(f"left,right,max_disparity\na.png,b.png,{number}\n")
    (scene,) = scenes_of_table(tmp_path / "pairs.csv")
    assert "max_disparity" in scene.problem and len(scene.problem) < 400
    if number in HUGE:
        laid(tmp_path, {"im0.png": IMAGE, "im1.png": IMAGE, "calib.txt": f"{CALIB}ndisp={number}\n"})
        refused(InputError, discover_scenes, tmp_path, ALL_KINDS)
        (tmp_path / "calib.txt").write_text(f"{CALIB}width={number}\nheight=6\n")
        refused(InputError, read_geometry, tmp_path / "calib.txt")


@pytest.mark.parametrize("number", [float("nan"), 1e99])
def test_a_network_with_a_number_that_is_none(tmp_path: Path, number: float):
    content = json.loads(network_path("accurate").read_text())
    content["layers"][1]["offsets"][0] = number
    refused(InputError, read_network, laid(tmp_path, {"a.json": content}) / "a.json")
