"""Images are read as they were written, whatever the container; damage is refused; pictures for people."""

import itertools
import resource
import struct
import zlib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import PIL.ImageOps
import pytest
import tifffile

from depthcli.core.errors import InputError, OutputError
from depthcli.core.frames import color8
from depthcli.core.maps import DepthStatus, Status
from depthcli.io.formats import images
from depthcli.io.formats.disparity import read_mask, read_plane, read_status, write_codes, write_status
from depthcli.io.formats.files import PARTIAL_SUFFIX, atomic_path, collected_warnings, flush, made, write_text
from depthcli.io.formats.images import (
    bits_said,
    image_size,
    read_color8,
    read_grey,
    read_image,
    read_pair,
    read_two_frames,
    write_png,
)
from depthcli.problems.inputs import as_color8
from depthcli.show.view import DEPTH_STATUS_PALETTE, MEASURED_CODE, STATUS_PALETTE, status_colors, status_words
from tests import damage
from tests.files import laid
from tests.golden import refused, warned


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
    path = tmp_path / "a.png"  # the kind is told by the content
    if suffix == ".png":
        write_png(path, array)
    else:
        grey = len(shape) == 2
        coded = cv2.imencode(".pgm" if grey and suffix == ".ppm" else suffix, array if grey else array[..., ::-1])
        path.write_bytes(coded[1].tobytes())
    read = read_image(path)
    assert read.dtype == dtype and read.flags.c_contiguous
    np.testing.assert_array_equal(read, array)


def test_transparency_is_dropped_and_palettes_are_resolved(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(damage.encoded(".jpg", np.full((16, 16, 3), (0, 0, 250), np.uint8)))  # BGR
    assert read_image(path)[8, 8, 0] > 240
    path.write_bytes(png(2, 1, 8, 4, bytes([0, 10, 0, 20, 255])))  # grey + alpha
    np.testing.assert_array_equal(read_image(path), [[10, 20]])
    path.write_bytes(png(1, 1, 8, 6, bytes([0, 1, 2, 3, 0])))  # RGBA, fully transparent
    np.testing.assert_array_equal(read_image(path), [[[1, 2, 3]]])
    palette = [(b"PLTE", bytes([9, 8, 7, 4, 5, 6])), (b"tRNS", bytes([0]))]
    path.write_bytes(png(2, 1, 8, 3, bytes([0, 1, 0]), *palette))
    np.testing.assert_array_equal(read_image(path), [[[4, 5, 6], [9, 8, 7]]])
    path.write_bytes(png(2, 1, 8, 0, bytes([0, 1, 2]), (b"tRNS", bytes([0, 1]))))
    np.testing.assert_array_equal(read_image(path), [[1, 2]])


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["jpeg", "png", "tiff"])
def test_exif_orientation_is_applied_and_said(kind: str, orientation: int, tmp_path: Path):
    path = tmp_path / f"a.{kind}"
    blocks = np.kron(np.arange(10, 250, 40, dtype=np.uint8).reshape(2, 3), np.ones((8, 8), np.uint8))
    stored = PIL.Image.fromarray(blocks)
    stored.getexif()[274] = orientation
    stored.save(path, exif=stored.getexif())
    image, lines = warned(read_image, path)
    upright = np.asarray(PIL.ImageOps.exif_transpose(stored), int)
    assert np.abs(image.astype(int) - upright).max() <= 6  # JPEG loses a little
    assert image_size(path) == image.shape == ((16, 24) if orientation < 5 else (24, 16))
    assert [f"({orientation})" in line for line in lines] == ([] if orientation == 1 else [True])


def test_netpbm_plain_comments_and_big_endian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P2 # made by hand\n2 2\n# more\n300\n1 2\n3 300\n")
    np.testing.assert_array_equal(read_image(path), np.array([[1, 2], [3, 300]], np.uint16))
    path.write_bytes(b"P5\n2 1\n65535\n\x01\x02\x03\x04")
    np.testing.assert_array_equal(read_image(path), np.array([[258, 772]], np.uint16))
    monkeypatch.setattr(images, "_MAX_TEXT_BYTES", 21)
    for broken in (b"P5\n2 2\n255\nabc", b"P5\n0 2\n255\n", b"P5\n2 2\n99999\nabcd", b"P5 2", b"P2\n1 1\n9\nx",
                   b"P2\n2 2\n255\n100 100 1 2",
                   b"P4\n1 1\n\0", b"hello", b"\x76\x2f\x31\x01" + bytes(100)):  # fmt: skip
        path.write_bytes(broken)
        refused(InputError, read_image, path)


def test_png_of_codes_and_what_png_cannot_hold(tmp_path: Path):
    array = np.arange(12, dtype=np.uint8).reshape(3, 4)
    write_png(tmp_path / "a.png", np.dstack([array] * 3))
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), array)
    write_png(tmp_path / "a.png", np.dstack([array, array, array + np.uint8(1)]))
    refused(InputError, read_grey, tmp_path / "a.png")
    write_png(tmp_path / "a.png", np.array([[True, False]]))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), [[255, 0]])
    for impossible in (array.astype(np.float32), np.dstack([array] * 4), array[0], np.zeros((1, 1_000_001), np.uint8)):
        refused(ValueError, write_png, tmp_path / "a.png", impossible)


def tiff(width: int, height: int, samples: int, bits: int, strip: bytes, compression: int, **tags: int) -> bytes:
    """A TIFF file of one strip; ``tags`` t322=... add others."""
    values = {256: width, 257: height, 258: bits, 259: compression, 262: 2 if samples == 3 else 1, 273: 8, 277: samples}
    values |= {278: height, 279: len(strip)} | {int(name[1:]): value for name, value in tags.items()}
    wide = {256, 257, 273, 278, 279, 322, 323}
    entries = b""
    for tag, value in sorted(values.items()):
        repeated = samples if tag == 258 and samples == 1 else 1
        entries += struct.pack("<HHI", tag, 4 if tag in wide else 3, repeated) + struct.pack("<I", value)
    return b"II*\0" + struct.pack("<I", 8 + len(strip)) + strip + struct.pack("<H", len(values)) + entries + bytes(4)


def resized_jpeg(width: int, height: int) -> bytes:
    code = bytearray(damage.encoded(".jpg", np.zeros((8, 8), np.uint8)))
    at = code.index(b"\xff\xc0")
    code[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(code)


@pytest.mark.parametrize("name", ["png", "png16", "jpg", "tiff", "tiff-deflate", "tiff-tiles", "pgm", "bmp"])
def test_bombs_are_refused_by_their_header(tmp_path: Path, name):
    """Each would take 3 GiB or more to decode."""
    size, zeros = 60_000, zlib.compress(bytes(4_000_000))
    bombs = {
        "png": lambda: png(size, size, 8, 0, bytes(1_000_000)),
        "png16": lambda: png(size, size, 16, 6, bytes(4_000_000)),
        "jpg": lambda: resized_jpeg(size, size),
        "tiff": lambda: tiff(size, size, 3, 8, bytes(120_000), 1),
        "tiff-deflate": lambda: tiff(size, size, 1, 8, zeros, 8),
        "tiff-tiles": lambda: tiff(64, 64, 1, 8, zeros, 8, t322=size, t323=size, t324=8, t325=len(zeros)),
        "pgm": lambda: b"P5 60000 60000 65535\n" + bytes(4_000_000),
        "bmp": lambda: b"BM" + struct.pack("<IIIIiiHHIIIIII", 0, 0, 54, 40, size, size, 1, 24, 0, 0, 0, 0, 0, 0),
    }
    path = tmp_path / "a.png"
    path.write_bytes(bombs[name]())
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(InputError, read_image, path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def test_memory_that_may_be_used_is_compared_with_the_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.png"
    write_png(path, np.zeros((100, 200, 3), np.uint16))
    monkeypatch.setattr(images, "_MAX_DECODED_BYTES", 120_000)
    assert read_image(path).shape == (100, 200, 3)
    monkeypatch.setattr(images, "_MAX_DECODED_BYTES", 119_999)
    refused(InputError, read_image, path)
    refused(InputError, read_pair, path, path)


def test_views_of_different_numbers_of_bits_are_named(tmp_path: Path):
    full = np.random.default_rng(0).integers(0, 1 << 16, (20, 30), np.uint16)
    laid(tmp_path, {"full.png": full, "twelve.png": full >> 4, "dim.png": full // 2})
    for pair in (("full.png", "twelve.png"), ("twelve.png", "full.png")):
        _, lines = warned(read_pair, *(tmp_path / name for name in pair))
        assert any(pair[1] in line and "number of bits" in line for line in lines)
    assert not warned(read_pair, tmp_path / "full.png", tmp_path / "dim.png")[1]  # another exposure
    for top in (1023, 4095):
        (tmp_path / f"{top}.pgm").write_bytes(b"P5 30 20 %d\n" % top + (full % (top + 1)).astype(">u2").tobytes())
    _, lines = warned(read_pair, tmp_path / "1023.pgm", tmp_path / "4095.pgm")
    assert "number of bits" in lines[0]


def test_samples_of_ten_and_twelve_bits(tmp_path: Path):
    dark = np.array([[0, 1000]], np.uint16)
    for samples, said, bits in (
        ([dark], None, 10), ([dark, dark + np.uint16(24)], None, 12), ([dark, dark + np.uint16(4000)], None, 16),
        ([dark], 14, 14), ([dark.astype(np.uint8)], None, 8),
        ([dark * np.uint16(60)], 14, 16),  # the file is wrong: its samples fill more
    ):  # fmt: skip
        assert bits_said(samples, "a", said) == bits
    left, right = tmp_path / "l.pgm", tmp_path / "r.png"
    left.write_bytes(b"P5 2 1 4095\n" + dark.astype(">u2").tobytes())
    assert read_pair(left, left).bits == 12
    rows = b"\0" + np.repeat(dark, 3).astype(">u2").tobytes()
    right.write_bytes(png(2, 1, 16, 2, rows, (b"sBIT", bytes([13, 14, 13]))))
    assert read_pair(right, right).bits == 14
    assert read_pair(left, right).bits == 10  # the files disagree: what is found counts
    write_png(tmp_path / "c.png", np.zeros((1, 3, 3), np.uint16))
    refused(InputError, read_pair, left, tmp_path / "c.png")


def test_a_grey_and_a_color_image_become_two_grey_ones(tmp_path: Path):
    color = np.random.default_rng(0).integers(0, 256, (6, 7, 3)).astype(np.uint8)
    dark = (color.astype(np.uint16) << 2) | 3  # 10 bits
    for image, bits in ((color, 8), (dark, 10)):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        laid(tmp_path, {"c.png": image, "g.png": grey})
        for names in (("c.png", "g.png"), ("g.png", "c.png")):
            pair = read_pair(*(tmp_path / name for name in names))
            assert pair.bits == bits
            np.testing.assert_array_equal(pair.left, pair.right)
            assert bits == 10 or np.array_equal(pair.left, grey)


def test_jpeg_with_fill_bytes_is_read(tmp_path: Path):
    smooth = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8), (0, 0), 2)
    path = tmp_path / "a.jpg"
    for options in ([], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 4]):
        data = damage.encoded(".jpg", smooth, *options)
        path.write_bytes(data)
        intact = read_image(path)
        path.write_bytes(data[:-2] + b"\xff\xff\xff" + data[-2:] + b"after the end")
        np.testing.assert_array_equal(read_image(path), intact)


def test_atomic_write_keeps_the_old_file_on_failure(tmp_path: Path):
    path = tmp_path / "deep" / "a.txt"
    write_text(path, "old")
    with pytest.raises(KeyboardInterrupt), atomic_path(path) as temporary:  # noqa: PT012
        temporary.write_text("half")
        assert temporary.parent == path.parent and temporary.name.endswith(PARTIAL_SUFFIX)
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == ["a.txt"]
    for write in (partial(write_text, text="x"), made):
        refused(OutputError, write, path / "below")
    with pytest.raises(FileNotFoundError):
        flush(path.with_name("none"))


def test_every_reader_gives_the_codes_of_a_status_map(tmp_path: Path):
    codes = np.arange(256, dtype=np.uint8)
    codes = np.random.default_rng(0).permutation(codes[codes & 32 == 0]).reshape(8, 16)
    write_status(tmp_path / "status.png", codes)
    for read in (lambda path: cv2.imread(path, cv2.IMREAD_UNCHANGED), lambda path: np.asarray(PIL.Image.open(path))):
        seen = read(str(tmp_path / "status.png"))
        np.testing.assert_array_equal(seen, codes, strict=True)
    status = read_status(tmp_path / "status.png")
    np.testing.assert_array_equal(status, codes)
    np.testing.assert_array_equal(status.measured, codes == 0)
    refused(ValueError, write_status, tmp_path / "status.png", codes.astype(int))
    picture = PIL.Image.fromarray(np.array([[0, 32, 49, 17]], np.uint8), "P")  # as version 0.2.0 wrote them
    picture.putpalette(status_colors(STATUS_PALETTE).tobytes())
    picture.save(tmp_path / "s.png")
    status = read_status(tmp_path / "s.png")
    np.testing.assert_array_equal(status, [[0, 0, 17, 17]])
    np.testing.assert_array_equal(status.measured, [[True, True, False, False]])
    jpeg, cut = damage.encoded(".jpg", np.zeros((8, 8), np.uint8)), (tmp_path / "s.png").read_bytes()[:-9]
    laid(tmp_path, {"color.png": np.zeros((1, 1, 3), np.uint8), "cut.png": cut, "a.jpg": jpeg})
    for name in ("color.png", "cut.png", "a.jpg"):
        refused(InputError, read_status, tmp_path / name)


@pytest.mark.parametrize(("palette", "flag"), [(STATUS_PALETTE, Status), (DEPTH_STATUS_PALETTE, DepthStatus)])
def test_single_bits_differ_clearly_and_combinations_at_all(palette, flag):
    assert set(palette) == {0, *flag} - {flag.SMOOTHED}
    one = [status_colors(palette)[int(bit)].astype(float) for bit in palette]
    assert min(np.abs(a - b).sum() for a, b in itertools.combinations(one, 2)) > 60
    occurring = [reason | extra for reason in (0, 1, 2, 4, 8) for extra in (0, 16)]
    assert len({tuple(status_colors(palette)[value]) for value in occurring}) >= len(occurring) - 2


def test_words_of_codes(tmp_path: Path):
    assert status_words(0, STATUS_PALETTE) == "measured"
    assert status_words(Status.OCCLUDED | Status.FILLED, STATUS_PALETTE) == "occluded, filled"
    assert status_words(128, STATUS_PALETTE) == "128"
    write_codes(tmp_path / "status.txt", STATUS_PALETTE, [17, 0])
    rows = (tmp_path / "status.txt").read_text("utf-8").splitlines()
    assert [row.split(maxsplit=1) for row in rows[1:3]] == [["0", "measured"], ["17", "occluded, filled"]]
    assert MEASURED_CODE in rows
    write_codes(tmp_path / "all.txt", DEPTH_STATUS_PALETTE)
    assert "64  from stereo" in (tmp_path / "all.txt").read_text("utf-8")


# Of what decoders give, compared with the header: every layout of samples.

RNG = np.random.default_rng(0)
WIDE = RNG.integers(0, 65536, (40, 50, 4)).astype(np.uint16)
RGB, GREY = WIDE[..., :3], WIDE[..., 0]


def stored(tmp_path: Path, values: np.ndarray, **options) -> Path:
    tifffile.imwrite(tmp_path / "a.tif", values, **options)
    return tmp_path / "a.tif"


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_separate_planes_and_big_tiff(tmp_path: Path, dtype, compression):
    values = (RGB >> (0 if dtype == np.uint16 else 8)).astype(dtype)
    options = {"photometric": "rgb", "planarconfig": "separate", "compression": compression}
    read = read_image(stored(tmp_path, np.moveaxis(values, -1, 0), **options))
    np.testing.assert_array_equal(read, values, strict=True)
    options["bigtiff"] = True
    np.testing.assert_array_equal(read_image(stored(tmp_path, np.moveaxis(values, -1, 0), **options)), values)
    refused(InputError, read_image, stored(tmp_path, np.moveaxis(values, -1, 0), **options, byteorder=">"))


def test_transparency_and_inverse_grey_of_sixteen_bits(tmp_path: Path):
    grey_alpha = {"photometric": "minisblack", "planarconfig": "contig", "extrasamples": ["unassalpha"]}
    np.testing.assert_array_equal(read_image(stored(tmp_path, WIDE[..., :2], **grey_alpha)), GREY)
    np.testing.assert_array_equal(read_image(stored(tmp_path, GREY, photometric="miniswhite")), 65535 - GREY)
    np.testing.assert_array_equal(read_image(stored(tmp_path, WIDE, photometric="rgb")), RGB)
    found, lines = warned(read_image, stored(tmp_path, WIDE, photometric="rgb", extrasamples=["unspecified"]))
    np.testing.assert_array_equal(found, RGB)
    assert "a.tif" in lines[0] and "channel" in lines[0]
    for values in (GREY > 30000, GREY):  # codes of which zero is white are refused
        path = stored(tmp_path, values, photometric="miniswhite")
        for read in (read_grey, read_mask):
            refused(InputError, read, path)


def test_what_is_no_image_is_said_with_what_is_expected(tmp_path: Path):
    several = {"photometric": "minisblack", "planarconfig": "contig"}
    for values, options in (
        (WIDE, several), ((WIDE >> 8).astype(np.uint8), several), ((GREY >> 8).astype(np.float16), {}),
        (RGB.astype(np.float32), {"photometric": "rgb"}), (GREY.astype(np.int16), {}),
        (np.moveaxis(WIDE, -1, 0), {"photometric": "separated", "planarconfig": "separate"}),  # CMYK
    ):  # fmt: skip
        refused(InputError, read_image, stored(tmp_path, values, **options))
    refused(InputError, read_plane, stored(tmp_path, RGB.astype(np.float32), photometric="rgb"))


def test_values_of_eight_bits_in_files_of_sixteen(tmp_path: Path):
    image = RNG.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    write_png(tmp_path / "l8.png", image)
    write_png(tmp_path / "l.png", image.astype(np.uint16))
    with collected_warnings() as lines:
        pair = read_pair(tmp_path / "l.png", tmp_path / "l.png")
        np.testing.assert_array_equal(pair.left, image)
        np.testing.assert_array_equal(read_color8(tmp_path / "l.png"), image)
        np.testing.assert_array_equal(as_color8(image.astype(np.uint16), "color"), image)
    assert pair.left.dtype == np.uint8
    assert all("taken as 8-bit" in line for line in lines) and len(lines) == 2
    write_png(tmp_path / "r.png", image.astype(np.uint16) * 4)  # of 10 bits: the views count together
    pair = read_pair(tmp_path / "l.png", tmp_path / "r.png")
    assert (pair.left.dtype, pair.bits) == (np.uint16, 10)
    np.testing.assert_array_equal(read_color8(tmp_path / "r.png"), color8(image.astype(np.uint16) * 4, 10))


def test_a_mosaic_is_named_and_textures_are_not(tmp_path: Path):
    small = RNG.integers(0, 256, (30, 40, 3)).astype(np.uint8)
    scene = cv2.resize(small, (160, 120), interpolation=cv2.INTER_CUBIC)
    mosaic = np.zeros((120, 160), np.uint8)
    for y, x, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[y::2, x::2] = scene[y::2, x::2, channel]
    images = {
        "mosaic": mosaic, "mosaic16": mosaic.astype(np.uint16) * 16, "grey": cv2.cvtColor(scene, cv2.COLOR_RGB2GRAY),
        "noise": RNG.integers(0, 256, (120, 160)).astype(np.uint8), "flat": np.full((120, 160), 7, np.uint8),
        "stripes": np.tile(np.array([0, 200], np.uint8), (120, 80)),
    }  # fmt: skip
    for name, image in images.items():
        write_png(tmp_path / "a.png", image)
        _, lines = warned(read_image, tmp_path / "a.png")
        assert any("Bayer" in line for line in lines) == name.startswith("mosaic"), name


def test_the_rest_of_a_file_of_several_images_is_refused_or_named(tmp_path: Path):
    grey = (GREY >> 8).astype(np.uint8)
    pages = np.stack([grey] * 3)
    for read in (read_image, read_grey, read_plane):
        refused(InputError, read, stored(tmp_path, pages, photometric="minisblack"))
    refused(InputError, read_plane, stored(tmp_path, pages.astype(np.float32), photometric="minisblack"))
    with tifffile.TiffWriter(tmp_path / "b.tif") as file:  # a pyramid has one image
        file.write(grey, photometric="minisblack")
        file.write(grey[::2, ::2], photometric="minisblack", subfiletype=1)
    np.testing.assert_array_equal(read_image(tmp_path / "b.tif"), grey)
    frames = [PIL.Image.fromarray(np.roll(grey, k)) for k in range(3)]
    frames[0].save(tmp_path / "a.png", save_all=True, append_images=frames[1:])
    refused(InputError, read_image, tmp_path / "a.png")
    for kind in ("GIF", "WEBP"):
        frames[0].save(tmp_path / "g.png", kind, save_all=True, append_images=frames[1:])
        refused(InputError, read_image, tmp_path / "g.png")
    frames[0].save(tmp_path / "m.jpg", "MPO", save_all=True, append_images=frames[1:])
    (tmp_path / "n.pgm").write_bytes(2 * (b"P5 2 1 255\n" + bytes([7, 9])))
    frames[0].save(tmp_path / "one.jpg")
    data = (tmp_path / "one.jpg").read_bytes()
    (tmp_path / "index.jpg").write_bytes(data[:2] + b"\xff\xe2\0\x0aMPF\0II*\0" + data[2:])  # damaged, and no matter
    for read, name, words in (
        (read_image, "m.jpg", "3 images"), (read_image, "n.pgm", "bytes follow"), (read_grey, "n.pgm", "bytes follow"),
        (read_two_frames, "m.jpg", "3 images"), (read_image, "index.jpg", ""),
    ):  # fmt: skip
        found, lines = warned(read, tmp_path / name)
        assert [f"{name}: " in line and words in line for line in lines] == [True] * bool(words)
        if read == read_two_frames:
            for k in (0, 1):
                assert np.abs(found[k][..., 0].astype(int) - np.roll(grey, k)).mean() < 20  # JPEG loses a little
    refused(InputError, read_two_frames, tmp_path / "one.jpg")
