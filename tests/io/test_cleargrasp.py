"""Sparse depth beside frames, and ClearGrasp's folders."""

from __future__ import annotations

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.formats.depth import write_depth_png
from depthcli.io.formats.disparity import write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.rgbd_frames import load_sparse_frame
from depthcli.io.scenes import RgbdScene
from depthcli.io.walk import discover_scenes
from tests.scenes import DATA, load, true


def only(folder):
    (scene,) = discover_scenes(folder, (RgbdScene,))
    assert isinstance(scene, RgbdScene)
    return scene


@pytest.fixture
def depth():
    return np.full((4, 6), 0.75, np.float32)


def test_sparse_depth_has_the_codes_of_the_depth(tmp_path, depth):
    sparse = np.where(np.eye(4, 6, dtype=bool), np.float32(0.5), np.float32(np.nan))
    write_png(tmp_path / "color.png", np.zeros((4, 6, 3), np.uint8))
    write_depth_png(tmp_path / "depth.png", depth)
    write_depth_png(tmp_path / "sparse.png", sparse)
    frame = load_sparse_frame(only(tmp_path))
    np.testing.assert_allclose(frame.depth, depth)
    np.testing.assert_allclose(frame.sparse, sparse)
    assert frame.sparse_confidence is None
    write_png(tmp_path / "sparse_confidence.png", np.full((4, 6), 51, np.uint8))
    np.testing.assert_allclose(load_sparse_frame(only(tmp_path)).sparse_confidence, 0.2)


def test_sparse_depth_that_cannot_be_used(tmp_path, depth):
    write_png(tmp_path / "color.png", np.zeros((4, 6, 3), np.uint8))
    write_pfm(tmp_path / "depth.pfm", depth)
    for sparse, said in ((None, "no sparse depth"), (np.full((4, 6), np.nan, np.float32), "no pixel has a depth"),
                         (np.ones((4, 5), np.float32), "5 x 4, but color.png is 6 x 4")):  # fmt: skip
        if sparse is not None:
            write_pfm(tmp_path / "sparse.pfm", sparse)
        with pytest.raises(InputError, match=said):
            load_sparse_frame(only(tmp_path))


@pytest.mark.parametrize("real", [True, False])
def test_cleargrasp(tmp_path, depth, real):
    mask = np.zeros((4, 6), bool)
    mask[1:3, 2:4] = True
    write_png(tmp_path / "mask_transparent.png", mask)
    write_png(tmp_path / ("rgb_transparent.png" if real else "rgb.png"), np.zeros((4, 6, 3), np.uint8))
    write_depth_png(tmp_path / ("depth_opaque_gt_mm.png" if real else "depth_gt_mm.png"), depth)
    if real:
        write_depth_png(tmp_path / "depth_sensor_mm.png", 2 * depth)
    scene = only(tmp_path)
    assert (scene.layout, scene.protocol, scene.has_truth) == ("cleargrasp", "depth", True)
    np.testing.assert_allclose(load(scene).depth, 2 * depth if real else np.where(mask, np.nan, depth))
    np.testing.assert_allclose(true(scene).depth, depth)
    np.testing.assert_array_equal(true(scene).masks["transparent"], mask)


def test_the_shared_folders_are_recognized_as_they_lie_there():
    if not (DATA / "transparent").is_dir():
        pytest.skip("transparent is not in ../shared/data")
    scenes = discover_scenes(DATA / "transparent", (RgbdScene,))
    assert [scene.layout for scene in scenes] == ["cleargrasp"] * 5
    for scene in scenes:
        frame, truth = load(scene), true(scene)
        inside = truth.masks["transparent"]
        assert np.isfinite(frame.depth[~inside]).mean() > 0.5
        assert np.isfinite(frame.depth[inside]).mean() < (0.75 if "real" in scene.name else 1e-9)
