"""What decoders give is compared with the header: values of every layout of samples, or one clear line."""

import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
import tifffile

from depthcli.core.errors import InputError
from depthcli.core.frames import color8
from depthcli.io.formats.disparity import read_mask, read_plane
from depthcli.io.formats.files import collected_warnings
from depthcli.io.formats.images import (
    image_size,
    read_color8,
    read_grey,
    read_image,
    read_pair,
    read_two_frames,
    write_png,
)
from depthcli.problems.inputs import as_color8
from tests.golden import refused, warned

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


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8", "i1", "i2", "i4", "u4", ">i2", ">f4", ">f2", ">f8"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_maps_of_every_kind_of_number(tmp_path: Path, dtype, compression):
    values = RNG.integers(-100, 100, (40, 50)) if "u" not in dtype else RNG.integers(0, 1 << 31, (40, 50))
    values = (values.astype(dtype) / (8 if "f" in dtype else 1)).astype(dtype)
    if "f" in dtype:
        values[0, 0], values[5, 3], values[9, 9] = np.nan, np.inf, np.finfo(dtype).max
    order = {"byteorder": ">"} if dtype.startswith(">") else {}
    path = stored(tmp_path, values, compression=compression, rowsperstrip=6, **order)
    data, read = path.read_bytes(), read_plane(path)
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(read, values.astype(read.dtype))
    assert read.dtype == np.float32 if "f4" in dtype or "f8" in dtype else read.dtype.kind == values.dtype.kind
    for size in range(0, len(data) - 4, len(data) // 25):
        path.write_bytes(data[:size])
        with pytest.raises(InputError):
            read_plane(path)


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


VALUES = np.random.default_rng(0).uniform(0.5, 3, (5, 7)).astype(np.float32)


def exr(folder: Path, **channels: np.ndarray) -> Path:
    OpenEXR = pytest.importorskip("OpenEXR")
    path = folder / "a.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name.replace("_", "."): values for name, values in channels.items()}).write(str(path))
    return path


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("names", [("Z",), ("V",), ("R", "G", "B"), ("R", "G", "B", "A"), ("Depth_V",)])
def test_one_channel_of_values_of_an_exr(tmp_path: Path, dtype, names):
    values = VALUES.astype(dtype)
    channels = {name: np.ones_like(values) if name == "A" else values for name in names}
    path = exr(tmp_path, **channels)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, values)
    assert not lines and image_size(path) == (5, 7)


def test_the_channels_that_are_left_out_are_named_and_guesses_refused(tmp_path: Path, monkeypatch, capfd):
    path = exr(tmp_path, R=VALUES, G=VALUES + 1, B=VALUES + 2, Z=VALUES + 3)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, VALUES + 3)
    assert "a.exr: its channel 'Z' is read" in lines[0] and "G" in lines[0]
    refused(InputError, read_plane, exr(tmp_path, R=VALUES, G=VALUES + 1, B=VALUES))
    refused(InputError, read_image, path)
    OpenEXR = pytest.importorskip("OpenEXR")
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, {"Z": VALUES}, name=name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(path))
    refused(InputError, read_plane, path)
    whole = exr(tmp_path, Z=VALUES).read_bytes()
    start = whole.index(b"dataWindow") + 21  # behind "dataWindow", "box2i" and a size
    box, huge = struct.pack("<4i", 0, 0, 6, 4), struct.pack("<4i", 0, 0, 1 << 20, 1 << 20)
    shown = whole.rindex(box)
    assert whole[start : start + 16] == box and shown != start
    for data in (
        whole[:200], whole[:-20], whole[:start] + huge + whole[start + 16 :],
        whole[:shown] + struct.pack("<4i", 0, 0, 9, 9) + whole[shown + 16 :],  # a part of a larger image
    ):  # fmt: skip
        path.write_bytes(data)
        refused(InputError, read_plane, path)
    halved = OpenEXR.Channel(VALUES[:4, :6].copy(), 2, 2)  # a value for each four pixels
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": halved}).write(str(path))
    refused(InputError, read_plane, path)
    assert capfd.readouterr() == ("", "")  # of the library
    path = exr(tmp_path, Z=VALUES)  # without the library the extra is named
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    refused(InputError, read_plane, path)
