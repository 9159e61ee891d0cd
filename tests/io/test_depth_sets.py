"""Data sets of depth with conventions of their own, on miniatures that follow the sets' documents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.images import write_png
from depthcli.io.layouts import own_layouts
from depthcli.io.scenes.rgbd import RgbdScene
from depthcli.io.walk import discover_scenes
from tests.contracts.layouts import check_layout

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


def diode(folder: Path, name: str = "00019_00183_indoors_000_010") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    depth, mask = DEPTH.copy(), np.ones((HEIGHT, WIDTH), np.float32)
    depth[0, 0], mask[0, 1] = 0, 0
    write_png(folder / f"{name}.png", COLOR)
    np.save(folder / f"{name}_depth.npy", depth[..., None])
    np.save(folder / f"{name}_depth_mask.npy", mask)
    return folder


def test_diode(tmp_path: Path):
    folder = diode(tmp_path / "scene_00019" / "scan_00183")
    (scene,) = find(tmp_path)
    assert (scene.name, scene.layout) == ("scene_00019/scan_00183/00019_00183_indoors_000_010", "diode")
    frame, truth = scene.load(), scene.truth()
    assert np.isnan(frame.depth[0, :2]).all()
    np.testing.assert_array_equal(frame.depth[1:], DEPTH[1:])
    np.testing.assert_array_equal(truth.depth, frame.depth)
    assert frame.intrinsics is not None
    assert (frame.intrinsics.fx, frame.intrinsics.fy, frame.intrinsics.cx) == (886.81, 927.06, 512)
    check("diode", folder.parent)


def test_broken_frames_of_diode(tmp_path: Path):
    diode(tmp_path, "a")
    np.save(tmp_path / "a_depth_mask.npy", np.ones((2, 2), np.float32))
    with pytest.raises(InputError, match=r"a_depth_mask\.npy: 2 x 2, but a_depth\.npy is 8 x 6"):
        find(tmp_path)[0].load()
    np.save(tmp_path / "a_depth.npy", DEPTH)
    with pytest.raises(InputError, match=r"a_depth\.npy: want an \(H, W, D\) array"):
        find(tmp_path)[0].load()
    (tmp_path / "a.png").unlink()
    with pytest.raises(InputError, match=r"a_depth\.npy: a frame without its color, a\.png"):
        find(tmp_path)[0].load()


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
    frame = first.load()
    assert frame.depth.shape == (24, 32)
    np.testing.assert_allclose(frame.depth[8:16, 8:24], 1.5)
    check("scannet", tmp_path)
    (folder / "depth" / "10.png").unlink()
    with pytest.raises(InputError, match=r"10\.jpg: a frame without its depth"):
        find(tmp_path)[1].load()


@pytest.mark.parametrize(
    ("text", "said"), [("1 2 3", "4 x 4"), ("a", "finite numbers"), (_MATRIX.format(-1, 2, 3), "4 x 4")]
)
def test_broken_cameras_of_scannet(tmp_path: Path, text: str, said: str):
    folder = scannet(tmp_path / "a", "intrinsic/intrinsic_{}.txt")
    (folder / "intrinsic" / "intrinsic_color.txt").write_text(text)
    with pytest.raises(InputError, match=rf"intrinsic_color\.txt: [^\n]*{said}"):
        find(folder)
    (folder / "intrinsic" / "intrinsic_color.txt").unlink()
    with pytest.raises(InputError, match=r"no intrinsic/intrinsic_color\.txt"):
        find(folder)
