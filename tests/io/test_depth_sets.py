"""Data sets of depth with conventions of their own, on miniatures that follow the sets' documents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.images import write_png
from depthcli.io.layouts import own_layouts
from depthcli.io.scenes import RgbdScene
from depthcli.io.walk import discover_scenes
from tests.contracts.layouts import check_layout
from tests.scenes import load

HEIGHT, WIDTH = 6, 8
COLOR = np.dstack([np.arange(48, dtype=np.uint8).reshape(HEIGHT, WIDTH) + k for k in range(3)]).astype(np.uint8)
DEPTH = np.linspace(1, 3, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)


def find(folder: Path) -> list[RgbdScene]:
    scenes = discover_scenes(folder, (RgbdScene,))
    assert all(isinstance(scene, RgbdScene) for scene in scenes)
    return scenes  # type: ignore[return-value]


def check(name: str, folder: Path) -> None:
    (layout,) = (each for each in own_layouts() if each.name == name)
    check_layout(layout, folder)


_MATRIX = "{0} 0 {1} 0\n0 {0} {2} 0\n0 0 1 0\n0 0 0 1\n"


def scannet(folder: Path, names: str) -> Path:
    color = np.dstack([np.full((24, 32), 100, np.uint8)] * 3)
    for number in (0, 10):
        write_png(folder / "color" / f"{number}.jpg", color)
        write_png(folder / "depth" / f"{number}.png", np.full((12, 16), 1500, np.uint16))
    for kind, values in (("color", (40, 15.5, 11.5)), ("depth", (20, 7.5, 5.5))):
        path = folder / names.format(kind)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_MATRIX.format(*values))
    return folder


@pytest.mark.parametrize("names", ["intrinsic/intrinsic_{}.txt", "intrinsics_{}.txt"])
def test_scannet(tmp_path: Path, names: str):
    folder = scannet(tmp_path / "scene0000_00", names)
    first, second = find(tmp_path)
    assert [scene.name for scene in (first, second)] == ["scene0000_00/0", "scene0000_00/10"]
    assert (first.layout, second.number, second.sequence) == ("scannet", 10, "scene0000_00")
    assert first.intrinsics == (40, 40, 15.5, 11.5)
    assert first.depth_intrinsics == (20, 20, 7.5, 5.5)
    frame = load(first)
    assert frame.depth.shape == (24, 32)
    np.testing.assert_allclose(frame.depth[8:16, 8:24], 1.5)
    check("scannet", tmp_path)
    (folder / "depth" / "10.png").unlink()
    with pytest.raises(InputError, match=r"10\.jpg: a frame without its depth"):
        load(find(tmp_path)[1])


@pytest.mark.parametrize(
    ("text", "said"), [("1 2 3", "4 x 4"), ("a", "finite numbers"), (_MATRIX.format(-1, 2, 3), "4 x 4")]
)
def test_broken_cameras_of_scannet(tmp_path: Path, text: str, said: str):
    folder = scannet(tmp_path / "a", "intrinsic/intrinsic_{}.txt")
    (folder / "intrinsic" / "intrinsic_color.txt").write_text(text)
    with pytest.raises(InputError, match=rf"intrinsic_color\.txt: [^\n]*{said}"):
        find(folder)
    (folder / "intrinsic" / "intrinsic_color.txt").unlink()
    with pytest.raises(InputError, match=r"intrinsic_color\.txt: no such file"):
        find(folder)
