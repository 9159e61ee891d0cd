"""Scene folders in every layout, and what is said about broken ones."""

import json
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import Scene, StereoScene
from depthcli.io.scenes.find import ALL_KINDS, discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.scenes.volumes import VOLUMES
from tests.golden import refused
from tests.scenes import DATA, load, needs_data, true

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8)
COLOR = np.dstack([GREY, GREY + 1, GREY + 2]).astype(np.uint8)
TRUTH = np.full((6, 8), 2, np.float32)
TRUTH[0] = np.nan


def find(folder: Path, layout: str | None = None, pattern: str = "*", warn=lambda line: None) -> list[StereoScene]:
    return discover_scenes(folder, PAIRS, layout, [pattern], warn)


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
    scenes = find(folder)
    assert [s.name for s in scenes] == ["a", "b"]
    assert (scenes[0].layout, scenes[0].protocol, scenes[0].max_disparity) == ("scenes", "middlebury_v2", 5)
    pair = load(scenes[0])
    np.testing.assert_array_equal(pair.left, COLOR)
    assert pair.right.shape == COLOR.shape
    truth = true(scenes[0])
    np.testing.assert_array_equal(truth.disparity, TRUTH)
    assert list(truth.masks) == ["nonocc"]
    assert truth.masks["nonocc"].sum() == 24  # 128 does not count
    assert [s.name for s in find(folder, pattern="b*")] == ["b"]
    assert [s.name for s in find(folder / "a")] == ["a"]
    assert [s.name for s in find(tmp_path, pattern="a")] == ["set/a"]


def test_single_view_with_truth_is_a_scene_without_a_pair(tmp_path: Path):
    (own(tmp_path / "a") / "right.png").unlink()
    (scene,) = find(tmp_path)
    assert scene.right is None
    refused(InputError, load, scene)


def test_the_protocol_is_said_never_guessed(tmp_path: Path):
    own(tmp_path / "a")
    (tmp_path / "a" / "disp_left.png").unlink()
    write_pfm(tmp_path / "a" / "disp_left.pfm", TRUTH)
    own(tmp_path / "b", {"disp_scale": 256, "masks": "none (sparse GT)"}, masks=False)
    own(tmp_path / "c", {"protocol": "kitti_2015", "disp_scale": 256}, masks=False)
    write_disparity_png(tmp_path / "c" / "disp_left_noc.png", TRUTH)
    scenes = find(tmp_path)
    assert [s.protocol for s in scenes] == ["middlebury_v2", "middlebury_v2", "kitti_2015"]
    assert true(scenes[2]).noc is not None


def test_half_a_pair_is_an_item_with_a_problem(tmp_path: Path):
    for name, file in (("a", "right.png"), ("b", "left.png")):
        own(tmp_path / name)
        (tmp_path / name / file).unlink()
    (tmp_path / "a" / "disp_left.png").unlink()
    v3(tmp_path / "c", "ndisp=3")
    (tmp_path / "c" / "im1.png").unlink()
    for scene in find(tmp_path):
        refused(InputError, load, scene)
        with pytest.raises(InputError):
            true(scene)


def test_a_folder_named_as_an_image_is_none(tmp_path: Path):
    own(tmp_path / "left.png")
    own(tmp_path / "other")
    (tmp_path / "other" / "right.pgm").mkdir()
    assert [scene.name for scene in find(tmp_path) if not scene.problem] == ["left.png", "other"]


def test_a_scene_too_deep_is_told(tmp_path: Path):
    own(tmp_path / "set" / "a")
    own(tmp_path / "x" / "y" / "z" / "deep")
    own(tmp_path / "x" / "y" / "deep")
    lines: list[str] = []
    assert [s.name for s in find(tmp_path, warn=lines.append)] == ["set/a"]
    assert len(lines) == 1
    assert str(tmp_path / "x" / "y" / "deep") in lines[0]
    assert "lies too deep" in lines[0]


def test_scenes_below_scenes_are_told(tmp_path: Path):
    for folder in (tmp_path, tmp_path / "later"):
        for view in "LR":
            write_png(folder / f"a_{view}.png", COLOR)
    own(tmp_path / "two" / "levels")
    lines: list[str] = []
    assert [s.name for s in find(tmp_path, warn=lines.append)] == ["a"]
    assert len(lines) == 1 and str(tmp_path / "later") in lines[0] and "not used" in lines[0]
    for view in ("left", "right"):
        write_png(tmp_path / "views" / view / "7.png", COLOR)
    assert len(find(tmp_path / "views", warn=lines.append)) == len(lines) == 1


def test_several_patterns(tmp_path: Path):
    for name in ("a", "b", "c"):
        own(tmp_path / name)
    assert [s.name for s in discover_scenes(tmp_path, PAIRS, None, ["c", "a"])] == ["a", "c"]
    refused(InputError, discover_scenes, tmp_path, PAIRS, None, ["a", "x"])


def test_listing_opens_no_image(tmp_path: Path):
    for stem in ("view1", "view5"):
        write_png(tmp_path / "a" / f"{stem}.png", COLOR)
    (tmp_path / "a" / "disp1.png").write_bytes(b"damaged")
    (scene,) = find(tmp_path)
    load(scene)
    refused(InputError, true, scene)


def test_every_layout_says_what_it_wants():
    assert [each.name for each in ALL_KINDS.rows] == sorted(each.name for each in ALL_KINDS.rows)
    assert all(each.about and issubclass(each.kind, Scene) for each in ALL_KINDS.rows)


@pytest.mark.parametrize(("stems", "truth", "width", "codes"), [
    (("im2", "im6"), ("disp2", "disp6"), 8, 4),
    (("imL", "imR"), ("groundtruth", None), 8, 4),
    (("view1", "view5"), ("disp1", "disp5"), 413, 3),  # 2005/2006 sets: third, half, or full size by the width
    (("view1", "view5"), ("disp1", "disp5"), 620, 2),
    (("view1", "view5"), ("disp1", "disp5"), 1240, 1),
])  # fmt: skip
def test_middlebury_v2(tmp_path: Path, stems, truth, width, codes):
    folder = tmp_path / "Teddy"
    for stem in stems:
        write_png(folder / f"{stem}.png", np.resize(COLOR, (6, width, 3)))
    for stem in filter(None, truth):
        write_png(folder / f"{stem}.png", np.full((6, width), 12, np.uint8))
    (scene,) = find(tmp_path)
    assert scene.layout == "middlebury-v2"
    assert scene.max_disparity == (None if stems[0] == "view1" else 59)
    loaded = true(scene)
    assert np.all(loaded.disparity == 12 / codes)
    assert (loaded.right is None) == (truth[1] is None)
    assert scene.protocol == "middlebury_v2"


def test_middlebury_v3_and_eth3d(tmp_path: Path):
    v3(tmp_path / "A", "cam0=[1 0 2; 0 1 2; 0 0 1]\ndoffs=0\nbaseline=100\nwidth=8\nheight=6\nndisp=7\nisint=1\n")
    folder = v3(tmp_path / "B", "baseline=1\nwidth=8\nndisp=8\n")
    (folder / "cameras.txt").write_text("")
    (folder / "images.txt").write_text("")
    a, b = find(tmp_path)
    assert (a.layout, a.max_disparity, a.round_disparity, a.protocol) == ("middlebury-v3", 7, True, "middlebury_v3")
    assert (b.layout, b.max_disparity, b.round_disparity, b.protocol) == ("eth3d", None, False, "eth3d")
    assert list(true(a).masks) == ["nonocc"]
    assert [s.name for s in find(tmp_path, "eth3d")] == ["B"]
    assert [s.name for s in find(tmp_path, "Middlebury_V3")] == ["A"]


def test_kitti(tmp_path: Path):
    kitti(tmp_path / "k12", ("colored_0", "colored_1"), "disp_occ", "disp_noc")
    kitti(tmp_path / "k15", ("image_2", "image_3"), "disp_occ_0", "disp_noc_0")
    write_png(tmp_path / "k15" / "obj_map" / "000000_10.png", np.eye(6, 8, dtype=np.uint8))
    scenes = find(tmp_path)
    assert [s.name for s in scenes] == ["k12/000000_10", "k12/000001_10", "k15/000000_10", "k15/000001_10"]
    assert [s.layout for s in scenes[1:3]] == ["kitti-2012", "kitti-2015"]
    truth = true(scenes[2])
    assert truth.objects is not None
    assert truth.noc is not None
    assert (truth.objects.sum(), np.isfinite(truth.noc).sum(), np.isfinite(truth.disparity).sum()) == (6, 32, 40)
    assert scenes[2].protocol == "kitti_2015"
    assert [s.name for s in find(tmp_path / "k15")] == ["000000_10", "000001_10"]
    assert len(find(tmp_path, pattern="000001_10")) == 2


@pytest.mark.parametrize("meta", [
    [1], {"disp_scale": "4"}, {"disp_scale": 0},
    {"max_disparity": -3}, {"max_disparity": 2.5}, {"disp_scale": True},
    {"min_disparity": 4, "max_disparity": 4},
])  # fmt: skip
def test_broken_meta(tmp_path: Path, meta):
    own(tmp_path / "a", meta)
    refused(InputError, find, tmp_path / "a")


@pytest.mark.parametrize("labels", [
    '{"liver": 1, "lung": 1}', '{"=": 1}',
    '{"liver": 1.5}',
])  # fmt: skip
def test_broken_names_of_labels(tmp_path: Path, labels: str):
    for name in ("fixed.mha", "warped.mha", "mask_organs.mha"):
        (tmp_path / name).write_text("")
    (tmp_path / "meta.json").write_text(f'{{"labels": {{"organs": {labels}}}}}')
    refused(InputError, discover_scenes, tmp_path, VOLUMES)


def test_what_is_said_where_nothing_fits(tmp_path: Path):
    refused(InputError, find, tmp_path / "absent")
    refused(InputError, find, tmp_path)
    refused(InputError, find, tmp_path, "kitti-2015")
    own(tmp_path / "a")
    refused(InputError, find, tmp_path, pattern="x*")
    refused(InputError, find, tmp_path, "foo")
    refused(InputError, find, tmp_path, "eth3d")
    v3(tmp_path / "a", "ndisp=3")
    refused(InputError, find, tmp_path / "a")
    assert len(find(tmp_path, "scenes")) == 1
    write_png(tmp_path / "a" / "left.jpg", GREY)
    refused(InputError, find, tmp_path / "a", "scenes")
    (tmp_path / "a" / "meta.json").write_bytes(b"{\xff")
    refused(InputError, find, tmp_path / "a", "scenes")


def test_sizes_must_agree(tmp_path: Path):
    folder = own(tmp_path / "a")
    write_png(folder / "right.png", COLOR[:5])
    write_png(folder / "mask_nonocc.png", GREY[:5])
    (scene,) = find(tmp_path)
    refused(InputError, load, scene)
    refused(InputError, true, scene)


@pytest.mark.slow
@needs_data
def test_every_stereo_scene_of_the_shared_data_loads():
    scenes = find(DATA)
    metas = [p for p in DATA.rglob("meta.json") if any(p.parent.glob("disp_left.*"))]
    own_layout = [scene for scene in scenes if scene.layout == "scenes"]
    assert len(own_layout) == len(metas) == 29
    assert sum(scene.layout == "middlebury-v3" for scene in scenes) == 8
    for scene in own_layout:
        facts = json.loads((scene.left.parent / "meta.json").read_text())
        truth = true(scene)
        assert truth.disparity.shape == (facts["height"], facts["width"])
        assert scene.max_disparity == facts["max_disparity"]
        assert np.nanmin(truth.disparity) > 0
        assert np.nanmax(truth.disparity) <= facts["max_disparity"] + 1
        if scene.right is not None:
            assert load(scene).shape == truth.disparity.shape


def test_layouts_of_a_users_file(tmp_path: Path):
    for name in ("7", "8"):
        write_png(tmp_path / "set" / "cam" / f"a_{name}.png", COLOR)
        write_png(tmp_path / "set" / "other" / f"b_{name}.png", COLOR)
    write_pfm(tmp_path / "set" / "gt" / "7.pfm", TRUTH)
    rows = tmp_path / "mine.yaml"
    rows.write_text(
        "mine: {left: 'cam/a_{id}.*', right: 'other/b_{id}.*', disparity_left: 'gt/{id}.*', max_disparity: 5}"
    )
    first, second = find(tmp_path / "set", str(rows))
    assert (first.name, first.layout, first.max_disparity, second.has_truth) == ("7", "mine", 5, False)
    np.testing.assert_array_equal(true(first).disparity, TRUTH)
    rows.write_text("mine: {left: 'cam/a_{id}.*', decode: x.png}")  # no file, but a function that reads one
    refused(ConfigError, find, tmp_path / "set", str(rows))
    rows.write_text("mine: {left: 'cam/a_{id}.*', right: 'other/b_{id}.*', max_disparity: far}")
    refused(ConfigError, find, tmp_path / "set", str(rows))
    rows.write_text("mine: {left: 'cam/a_{id}.*', masks: 'other/b_{id}.*'}")
    refused(ConfigError, find, tmp_path / "set", str(rows))
    rows.write_text("mine: {left: 'cam/a_{id}.*', right: 'other/b_{id}.*', mask.glass: 'gt/{id}.*'}")
    write_png(tmp_path / "set" / "gt" / "8.png", COLOR)
    assert [list(each.masks) for each in find(tmp_path / "set", str(rows))] == [[], ["glass"]]
