"""Maps in EXR files: one channel of values, or one clear line."""

import sys
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.disparity import read_plane
from depthcli.io.formats.images import image_size, read_image
from tests.golden import refused, warned

OpenEXR = pytest.importorskip("OpenEXR")

VALUES = np.random.default_rng(0).uniform(0.5, 3, (5, 7)).astype(np.float32)


def stored(folder: Path, **channels: np.ndarray) -> Path:
    path = folder / "a.exr"
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name.replace("_", "."): values for name, values in channels.items()}).write(str(path))
    return path


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("names", [("Z",), ("V",), ("R", "G", "B"), ("R", "G", "B", "A"), ("Depth_V",)])
def test_one_channel_of_values(tmp_path: Path, dtype, names):
    values = VALUES.astype(dtype)
    channels = {name: np.ones_like(values) if name == "A" else values for name in names}
    path = stored(tmp_path, **channels)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, values)
    assert not lines and image_size(path) == (5, 7)


def test_the_channels_that_are_left_out_are_named_and_guesses_refused(tmp_path: Path):
    path = stored(tmp_path, R=VALUES, G=VALUES + 1, B=VALUES + 2, Z=VALUES + 3)
    found, lines = warned(read_plane, path)
    np.testing.assert_array_equal(found, VALUES + 3)
    assert "a.exr: its channel 'Z' is read" in lines[0] and "G" in lines[0]
    refused(InputError, read_plane, stored(tmp_path, R=VALUES, G=VALUES + 1, B=VALUES))
    refused(InputError, read_image, path)
    path.write_bytes(path.read_bytes()[:200])
    refused(InputError, read_plane, path)


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = stored(tmp_path, Z=VALUES)
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    refused(InputError, read_plane, path)
