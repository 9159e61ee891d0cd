"""Images: what is read is what was written, whatever the container; damage is refused."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from depthcli.core.errors import InputError, OutputError
from depthcli.io.atomic import PARTIAL_SUFFIX, atomic_path, write_text
from depthcli.io.images import read_grey, read_image, write_png


def png(width: int, height: int, depth: int, color: int, rows: bytes, *extra: tuple[bytes, bytes]) -> bytes:
    """A PNG file made by hand: what other programs write and OpenCV's encoder does not."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    middle = b"".join(chunk(*e) for e in extra)
    body = chunk(b"IDAT", zlib.compress(rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + middle + body + chunk(b"IEND", b"")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (5, 7, 3)])
@pytest.mark.parametrize("suffix", [".png", ".tiff", ".ppm"])
def test_lossless_round_trip(tmp_path: Path, dtype, shape, suffix):
    array = np.random.default_rng(0).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)
    path = tmp_path / f"a{suffix}"
    if suffix == ".png":
        write_png(path, array)
    else:
        name = str(path if len(shape) == 3 or suffix != ".ppm" else path.with_suffix(".pgm"))
        cv2.imwrite(name, array if len(shape) == 2 else np.ascontiguousarray(array[..., ::-1]))
        path = Path(name)
    read = read_image(path)
    assert read.dtype == dtype
    assert read.flags.c_contiguous
    np.testing.assert_array_equal(read, array)


def test_kind_is_told_by_content_and_color_is_rgb(tmp_path: Path):
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 2] = 250  # BGR
    cv2.imwrite(str(tmp_path / "a.jpg"), red)
    (tmp_path / "a.jpg").rename(tmp_path / "a.png")
    assert read_image(tmp_path / "a.png")[8, 8, 0] > 240


def test_transparency_is_dropped_and_palettes_are_resolved(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(png(2, 1, 8, 4, bytes([0, 10, 0, 20, 255])))  # grey + alpha
    np.testing.assert_array_equal(read_image(path), [[10, 20]])
    path.write_bytes(png(1, 1, 8, 6, bytes([0, 1, 2, 3, 0])))  # RGBA, fully transparent
    np.testing.assert_array_equal(read_image(path), [[[1, 2, 3]]])
    palette = [(b"PLTE", bytes([9, 8, 7, 4, 5, 6])), (b"tRNS", bytes([0]))]
    path.write_bytes(png(2, 1, 8, 3, bytes([0, 1, 0]), *palette))
    np.testing.assert_array_equal(read_image(path), [[[4, 5, 6], [9, 8, 7]]])
    path.write_bytes(png(2, 1, 8, 0, bytes([0, 1, 2]), (b"tRNS", bytes([0, 1]))))
    np.testing.assert_array_equal(read_image(path), [[1, 2]])


def test_useless_chunks_make_no_noise(tmp_path: Path, capfd):
    path = tmp_path / "a.png"
    path.write_bytes(png(2, 1, 8, 0, bytes([0, 1, 2]), (b"iCCP", b"broken"), (b"gAMA", bytes(3))))
    np.testing.assert_array_equal(read_image(path), [[1, 2]])
    assert capfd.readouterr().err == ""


def test_netpbm_plain_comments_and_big_endian(tmp_path: Path):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P2 # made by hand\n2 2\n# more\n300\n1 2\n3 300\n")
    np.testing.assert_array_equal(read_image(path), np.array([[1, 2], [3, 300]], np.uint16))
    path.write_bytes(b"P5\n2 1\n65535\n\x01\x02\x03\x04")
    np.testing.assert_array_equal(read_image(path), np.array([[258, 772]], np.uint16))
    for broken in (
        b"P5\n2 2\n255\nabc",
        b"P5\n0 2\n255\n",
        b"P5\n2 2\n99999\nabcd",
        b"P5 2",
        b"P2\n1 1\n9\nx",
        b"P4\n1 1\n\0",
    ):
        path.write_bytes(broken)
        with pytest.raises(InputError, match=r"a\.pgm"):
            read_image(path)


def test_equal_channels_are_one_channel_of_codes(tmp_path: Path):
    array = np.arange(12, dtype=np.uint8).reshape(3, 4)
    write_png(tmp_path / "a.png", np.dstack([array] * 3))
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), array)
    write_png(tmp_path / "a.png", np.dstack([array, array, array + np.uint8(1)]))
    with pytest.raises(InputError, match="colour"):
        read_grey(tmp_path / "a.png")


def test_what_is_no_image_is_said_in_one_line(tmp_path: Path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").write_bytes(b"")
    cv2.imwrite(str(tmp_path / "float.tiff"), np.ones((4, 4), np.float32))
    for name in ("text.png", "empty.png", "float.tiff", "absent.png", "."):
        with pytest.raises(InputError) as caught:
            read_image(tmp_path / name)
        assert str(tmp_path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_bomb_headers_are_refused_before_decoding(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(png(2**31 - 1, 2**31 - 1, 8, 0, b"\0"))
    with pytest.raises(InputError, match="too large"):
        read_image(path)
    code = bytearray(cv2.imencode(".jpg", np.zeros((8, 8), np.uint8))[1].tobytes())
    at = code.index(b"\xff\xc0")
    code[at + 5 : at + 9] = struct.pack(">HH", 65000, 65000)
    path.write_bytes(code)
    with pytest.raises(InputError, match="65000 x 65000"):
        read_image(path)


def test_atomic_write_keeps_the_old_file_on_failure(tmp_path: Path):
    path = tmp_path / "deep" / "a.txt"
    write_text(path, "old")

    def fail() -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            assert temporary.parent == path.parent
            assert temporary.name.endswith(PARTIAL_SUFFIX)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]
    with pytest.raises(OutputError, match=r"a\.txt"):
        write_text(path / "below", "x")


def test_write_png_refuses_what_png_cannot_hold(tmp_path: Path):
    for array in (np.zeros((2, 2), np.float32), np.zeros((2, 2, 4), np.uint8), np.zeros(3, np.uint8)):
        with pytest.raises(ValueError, match="uint8"):
            write_png(tmp_path / "a.png", array)
    write_png(tmp_path / "a.png", np.array([[True, False]]))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), [[255, 0]])
