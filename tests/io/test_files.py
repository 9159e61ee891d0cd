"""Opening files: regular ones only, no hang, and a message that can be printed whatever the name."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from depthcli.core.errors import DepthcliError, InputError
from depthcli.io.formats.disparity import map_npy
from depthcli.io.formats.files import read_bytes, shown
from depthcli.io.formats.images import image_size, read_image


def map_costs(path):
    """Costs of a volume made elsewhere."""
    return map_npy(path, 3)


READERS = [read_bytes, read_image, map_costs, image_size]


def refused(read, path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert message.isprintable()  # and on one line
    message.encode("utf-8")
    assert len(message) < 700
    return message


@pytest.mark.parametrize("read", READERS)
def test_only_regular_files_are_opened(tmp_path: Path, read):
    os.mkfifo(tmp_path / "pipe.png")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(tmp_path / "socket.png"))
        assert "socket" in refused(read, tmp_path / "socket.png")
    assert "pipe" in refused(read, tmp_path / "pipe.png")
    assert "folder" in refused(read, tmp_path)
    for device in ("/dev/zero", "/dev/full", "/dev/null"):
        assert "device" in refused(read, device)
    (tmp_path / "link.png").symlink_to("/dev/zero")
    assert "device" in refused(read, tmp_path / "link.png")
    (tmp_path / "loop.png").symlink_to("loop.png")
    assert "loop.png" in refused(read, tmp_path / "loop.png")


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("name", [
    os.fsdecode(b"caf\xe9.png"), "\ud800.png", "a\0b.png", "n" * 300, "d/" * 3000, "two\nlines\x1b[31m.png",
    "\u202ex.png", "",
])  # fmt: skip
def test_names_that_cannot_be_are_told_in_printable_words(tmp_path: Path, read, name):
    refused(read, f"{tmp_path}/{name}/x.png")


def test_a_name_that_is_not_utf8_is_read(tmp_path: Path):
    path = tmp_path / os.fsdecode(b"caf\xe9\n.bin")
    path.write_bytes(b"abc")
    assert read_bytes(path) == b"abc"
    assert shown(path) == f"{tmp_path}/caf\\xe9\\n.bin"
    assert shown("\xfcber/日本.png") == "\xfcber/日本.png"
    assert str(DepthcliError(f"{path}\n\ud800")) == f"{tmp_path}/caf\\xe9\n.bin\n\\ud800"


@pytest.mark.skipif(hasattr(os, "getuid") and os.getuid() == 0, reason="root reads everything")
def test_what_may_not_be_read(tmp_path: Path):
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o000)
    assert "Permission" in refused(read_bytes, folder / "x.png")
    folder.chmod(0o700)


def test_size_is_limited_before_reading(tmp_path: Path):
    path = tmp_path / "huge.png"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # sparse
    assert "want at most" in refused(read_bytes, path)
    (tmp_path / "small").write_bytes(bytes(11))
    with pytest.raises(InputError, match="11 bytes, want at most 10"):
        read_bytes(tmp_path / "small", max_bytes=10)
    assert len(read_bytes(tmp_path / "small", max_bytes=11)) == 11
    if Path("/proc/self/pagemap").exists():  # a regular file of size 0 that never ends
        assert "grew" in refused(read_bytes, "/proc/self/pagemap")
