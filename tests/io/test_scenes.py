"""Scene folders in every layout, and what is said about broken ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import InputError
from depthcli.io.disparity import write_disparity_png, write_pfm
from depthcli.io.images import write_png
from depthcli.io.scenes import derive_masks, find_scenes

DATA = Path(__file__).parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the real scenes of ../shared/data are not here")

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8)
COLOR = np.dstack([GREY, GREY + 1, GREY + 2]).astype(np.uint8)
TRUTH = np.full((6, 8), 2, np.float32)
TRUTH[0] = np.nan


def own(folder: Path, meta: object = None, masks: bool = True) -> Path:
    write_png(folder / "left.png", COLOR)
    write_png(folder / "right.png", COLOR)
    write_png(folder / "disp_left.png", np.where(np.isnan(TRUTH), 0, TRUTH * 4).astype(np.uint8))
    if masks:
        mask = np.zeros((6, 8), np.uint8)
        mask[3:] = 255
        mask[0] = 128
        write_png(folder / "mask_nonocc.png", np.dstack([mask] * 3))
        write_png(folder / "mask_nonocc_right.png", mask)
    (folder / "meta.json").write_text(json.dumps({"disp_scale": 4, "max_disparity": 5} if meta is None else meta))
    return folder


def v3(folder: Path, calib: str) -> Path:
    write_png(folder / "im0.png", COLOR)
    write_png(folder / "im1.png", COLOR)
    write_pfm(folder / "disp0GT.pfm", TRUTH)
    write_png(folder / "mask0nocc.png", np.full((6, 8), 255, np.uint8))
    (folder / "calib.txt").write_text(calib)
    return folder


def kitti(folder: Path, views: tuple[str, str], occ: str, noc: str) -> Path:
    for frame in ("000000", "000001"):
        for view in views:
            write_png(folder / view / f"{frame}_10.png", COLOR)
            write_png(folder / view / f"{frame}_11.png", COLOR)
        write_disparity_png(folder / occ / f"{frame}_10.png", TRUTH)
        visible = TRUTH.copy()
        visible[1] = np.nan
        write_disparity_png(folder / noc / f"{frame}_10.png", visible)
    return folder


def test_own_layout(tmp_path: Path):
    folder = tmp_path / "set"
    own(folder / "b")
    own(folder / "a")
    (folder / "notes").mkdir()
    scenes = find_scenes(folder)
    assert [s.name for s in scenes] == ["a", "b"]
    assert (scenes[0].layout, scenes[0].metric, scenes[0].max_disparity) == ("scenes", "v2", 5)
    left, right = scenes[0].load_pair()
    np.testing.assert_array_equal(left, COLOR)
    assert right.shape == COLOR.shape
    truth = scenes[0].load_truth()
    np.testing.assert_array_equal(truth.disparity, TRUTH)
    assert list(truth.masks) == ["nonocc", "all"]
    assert truth.masks["nonocc"].sum() == 24  # 128 does not count
    assert truth.masks["all"].sum() == 40
    assert [s.name for s in find_scenes(folder, pattern="b*")] == ["b"]
    assert [s.name for s in find_scenes(folder / "a")] == ["a"]
    assert [s.name for s in find_scenes(tmp_path, pattern="a")] == ["set/a"]


def test_single_view_with_truth_is_a_scene_without_a_pair(tmp_path: Path):
    (own(tmp_path / "a") / "right.png").unlink()
    (scene,) = find_scenes(tmp_path)
    assert scene.right is None
    with pytest.raises(InputError, match="no right image"):
        scene.load_pair()


def test_which_measures_apply(tmp_path: Path):
    own(tmp_path / "v2")
    own(tmp_path / "sparse", {"disp_scale": 1, "masks": "none (sparse GT)"}, masks=False)
    own(tmp_path / "float")
    (tmp_path / "float" / "disp_left.png").unlink()
    write_pfm(tmp_path / "float" / "disp_left.pfm", TRUTH)
    own(tmp_path / "kitti", {"disp_scale": 256}, masks=False)
    write_disparity_png(tmp_path / "kitti" / "disp_left_noc.png", TRUTH)
    scenes = {s.name: s for s in find_scenes(tmp_path)}
    assert {n: s.metric for n, s in scenes.items()} == {"v2": "v2", "sparse": "kitti", "float": "v3", "kitti": "kitti"}
    assert list(scenes["kitti"].load_truth().masks) == ["noc", "occ"]


@pytest.mark.parametrize(("stems", "truth"), [
    (("im2", "im6"), ("disp2", "disp6")),
    (("imL", "imR"), ("groundtruth", None)),
    (("view1", "view5"), ("disp1", "disp5")),
])  # fmt: skip
def test_middlebury_v2(tmp_path: Path, stems, truth):
    folder = tmp_path / "Teddy"
    for stem in stems:
        write_png(folder / f"{stem}.png", COLOR)
    for stem in filter(None, truth):
        write_png(folder / f"{stem}.png", np.full((6, 8), 12, np.uint8))
    (scene,) = find_scenes(tmp_path)
    assert scene.layout == "middlebury-v2"
    third = stems[0] == "view1"  # 2005/2006 sets: a narrow image is third size
    assert scene.max_disparity == (None if third else 59)
    loaded = scene.load_truth()
    assert np.all(loaded.disparity == (4 if third else 3))
    assert list(loaded.masks) == (["all"] if truth[1] is None else ["nonocc", "all", "disc"])


def test_middlebury_v3_and_eth3d(tmp_path: Path):
    v3(tmp_path / "A", "cam0=[1 0 2; 0 1 2; 0 0 1]\ndoffs=0\nbaseline=100\nwidth=8\nheight=6\nndisp=7\nisint=1\n")
    folder = v3(tmp_path / "B", "baseline=1\nwidth=8\nndisp=8\n")
    (folder / "cameras.txt").write_text("")
    (folder / "images.txt").write_text("")
    a, b = find_scenes(tmp_path)
    assert (a.layout, a.max_disparity, a.round_disparity, a.metric) == ("middlebury-v3", 7, True, "v3")
    assert (b.layout, b.max_disparity, b.round_disparity, b.metric) == ("eth3d", None, False, "v3")
    assert list(a.load_truth().masks) == ["nonocc", "all"]
    assert [s.name for s in find_scenes(tmp_path, "eth3d")] == ["B"]


def test_kitti(tmp_path: Path):
    kitti(tmp_path / "k12", ("colored_0", "colored_1"), "disp_occ", "disp_noc")
    kitti(tmp_path / "k15", ("image_2", "image_3"), "disp_occ_0", "disp_noc_0")
    write_png(tmp_path / "k15" / "obj_map" / "000000_10.png", np.eye(6, 8, dtype=np.uint8))
    scenes = find_scenes(tmp_path)
    assert [s.name for s in scenes] == ["k12/000000_10", "k12/000001_10", "k15/000000_10", "k15/000001_10"]
    assert [s.layout for s in scenes[1:3]] == ["kitti-2012", "kitti-2015"]
    truth = scenes[2].load_truth()
    assert {n: int(m.sum()) for n, m in truth.masks.items()} == {"noc": 32, "occ": 40, "bg": 35, "fg": 5}
    assert [s.name for s in find_scenes(tmp_path / "k15")] == ["000000_10", "000001_10"]
    assert len(find_scenes(tmp_path, pattern="000001_10")) == 2


def test_derived_masks_by_hand():
    # A square 4 px nearer than its background hides what lies to its left in the right view.
    left = np.full((20, 40), 2, np.float32)
    left[:, 20:30] = 6
    right = np.full((20, 40), 2, np.float32)
    right[:, 14:24] = 6
    masks = derive_masks(left, right)
    hidden = np.flatnonzero(~masks["nonocc"][0])
    np.testing.assert_array_equal(hidden, [0, 1, 16, 17, 18, 19])
    np.testing.assert_array_equal(np.flatnonzero(masks["disc"][0]), [2, 3, 4, 5, *range(12, 16), *range(20, 35)])


@pytest.mark.parametrize(("meta", "said"), [
    ([1], "object"), ({"disp_scale": "4"}, "disp_scale"), ({"disp_scale": 0}, "disp_scale"),
    ({"max_disparity": -3}, "max_disparity"), ({"max_disparity": 2.5}, "whole"), ({"disp_scale": True}, "disp_scale"),
])  # fmt: skip
def test_broken_meta(tmp_path: Path, meta, said):
    own(tmp_path / "a", meta)
    with pytest.raises(InputError, match=rf"meta\.json: .*{said}"):
        find_scenes(tmp_path / "a")
    (tmp_path / "a" / "meta.json").write_bytes(b"{\xff")
    with pytest.raises(InputError, match="not valid JSON"):
        find_scenes(tmp_path / "a")


def test_a_broken_scene_spoils_no_other(tmp_path: Path):
    own(tmp_path / "a", {"disp_scale": 0})
    own(tmp_path / "b")
    broken, good = find_scenes(tmp_path)
    assert (broken.name, good.name, good.problem) == ("a", "b", "")
    with pytest.raises(InputError, match=r"meta\.json: .*disp_scale"):
        broken.load_pair()
    good.load_pair()


def test_what_is_said_where_nothing_fits(tmp_path: Path):
    with pytest.raises(InputError, match="no such folder"):
        find_scenes(tmp_path / "absent")
    with pytest.raises(InputError, match=r"no scenes found.*left/right.*image_2"):
        find_scenes(tmp_path)
    own(tmp_path / "a")
    with pytest.raises(InputError, match=r"no scene matches 'x\*'; there are: a"):
        find_scenes(tmp_path, pattern="x*")
    with pytest.raises(InputError, match="one of: scenes"):
        find_scenes(tmp_path, "foo")
    with pytest.raises(InputError, match="layout eth3d"):
        find_scenes(tmp_path, "eth3d")
    v3(tmp_path / "a", "ndisp=3")
    with pytest.raises(InputError, match="middlebury-v3 and scenes; say which"):
        find_scenes(tmp_path / "a")
    assert len(find_scenes(tmp_path, "scenes")) == 1
    write_png(tmp_path / "a" / "left.jpg", GREY)
    with pytest.raises(InputError, match=r"both left\.jpg and left\.png"):
        find_scenes(tmp_path / "a", "scenes")


def test_sizes_must_agree(tmp_path: Path):
    folder = own(tmp_path / "a")
    write_png(folder / "right.png", COLOR[:5])
    write_png(folder / "mask_nonocc.png", GREY[:5])
    (scene,) = find_scenes(tmp_path)
    with pytest.raises(InputError, match="8 x 5"):
        scene.load_pair()
    with pytest.raises(InputError, match=r"mask_nonocc\.png: 8 x 5"):
        scene.load_truth()


@needs_data
def test_every_stereo_scene_of_the_shared_data_loads():
    scenes = find_scenes(DATA)
    metas = [p for p in DATA.rglob("meta.json") if any(p.parent.glob("disp_left.*"))]
    assert len(scenes) == len(metas) == 29
    for scene in scenes:
        facts = json.loads((scene.left.parent / "meta.json").read_text())
        truth = scene.load_truth()
        assert truth.disparity.shape == (facts["height"], facts["width"])
        assert scene.max_disparity == facts["max_disparity"]
        assert np.nanmin(truth.disparity) > 0
        assert np.nanmax(truth.disparity) <= facts["max_disparity"] + 1
        wanted = "kitti" if "kitti" in scene.name else "v3" if "2014" in scene.name else "v2"
        assert scene.metric == wanted
        if scene.right is not None:
            assert scene.load_pair()[0].shape[:2] == truth.disparity.shape


@needs_data
@pytest.mark.parametrize("name", ["Teddy", "Cones"])
def test_derived_masks_are_close_to_the_official_ones(name):
    """Intersection over union that DATA.md gives for its own derivation: nonocc 0.99 and 0.985."""
    (scene,) = find_scenes(DATA / "middlebury_v2", pattern=name)
    truth = scene.load_truth()
    assert truth.right is not None
    derived = derive_masks(truth.disparity, truth.right)
    for mask, least in (("nonocc", 0.98), ("disc", 0.9)):
        a, b = derived[mask], truth.masks[mask]
        assert np.count_nonzero(a & b) / np.count_nonzero(a | b) > least


@needs_data
def test_derived_masks_equal_those_of_the_data_set():
    (scene,) = find_scenes(DATA / "middlebury_2005", pattern="Art")
    truth = scene.load_truth()
    assert truth.right is not None
    for name, mask in derive_masks(truth.disparity, truth.right).items():
        np.testing.assert_array_equal(mask, truth.masks[name], err_msg=name)
