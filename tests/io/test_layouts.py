"""Scene folders in every layout, and what is said about broken ones."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from depthcli.core.errors import ConfigError, InputError
from depthcli.io.formats.disparity import write_disparity_png, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.scenes import Folder, Scene
from depthcli.io.scenes.find import ALL_KINDS, chosen_scenes, discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.scenes.volumes import VOLUMES
from tests.files import laid
from tests.golden import refused, warned
from tests.scenes import DATA, load, needs_data, true

GREY = np.arange(48, dtype=np.uint8).reshape(6, 8)
COLOR = np.dstack([GREY, GREY + 1, GREY + 2]).astype(np.uint8)
TRUTH = np.full((6, 8), 2, np.float32)
TRUTH[0] = np.nan
MASK = np.repeat(np.array([128, 0, 0, 255, 255, 255], np.uint8), 8).reshape(6, 8)
MASKS = {"mask_nonocc.png": np.dstack([MASK] * 3), "mask_nonocc_right.png": MASK}


def find(folder: Path, layout: str | None = None, pattern: str = "*", warn=lambda line: None) -> list:
    return discover_scenes(folder, PAIRS, layout, [pattern], warn)


def names(*arguments, **options) -> list[str]:
    return [scene.name for scene in find(*arguments, **options)]


def own(folder: Path, meta: object = None, masks: dict[str, np.ndarray] = MASKS) -> Path:
    truth = np.where(np.isnan(TRUTH), 0, TRUTH * 4).astype(np.uint8)
    meta = {"disp_scale": 4, "max_disparity": 5} if meta is None else meta
    files = {"left.png": COLOR, "right.png": COLOR, "disp_left.png": truth, "meta.json": meta}
    return laid(folder, files | masks)


def v3(folder: Path, calib: str) -> Path:
    mask = np.full((6, 8), 255, np.uint8)
    files = {"im0.png": COLOR, "im1.png": COLOR, "disp0GT.pfm": TRUTH, "mask0nocc.png": mask, "calib.txt": calib}
    return laid(folder, files)


def kitti(folder: Path, views: tuple[str, str], occ: str, noc: str) -> None:
    visible = TRUTH.copy()
    visible[1] = np.nan
    for frame in ("000000", "000001"):
        laid(folder, {f"{view}/{frame}_{time}.png": COLOR for view in views for time in (10, 11)})
        write_disparity_png(folder / occ / f"{frame}_10.png", TRUTH)
        write_disparity_png(folder / noc / f"{frame}_10.png", visible)


def test_own_layout(tmp_path: Path):
    folder = tmp_path / "set"
    own(folder / "b")
    own(folder / "a")
    (folder / "notes").mkdir()
    first, second = find(folder)
    assert (first.name, second.name) == ("a", "b")
    assert (first.layout, first.protocol, first.max_disparity) == ("scenes", "middlebury_v2", 5)
    pair, truth = load(first), true(first)
    np.testing.assert_array_equal(pair.left, COLOR)
    assert pair.right.shape == COLOR.shape
    np.testing.assert_array_equal(truth.disparity, TRUTH)
    assert list(truth.masks) == ["nonocc"] and truth.masks["nonocc"].sum() == 24  # 128 does not count
    assert names(folder, pattern="b*") == ["b"] and names(folder / "a") == ["a"]
    assert names(tmp_path, pattern="a") == ["set/a"]
    (folder / "a/run.yaml").mkdir()  # a folder of a run has a file of that name
    assert names(folder) == ["a", "b"]
    refused(InputError, Folder, tmp_path / "none", "", "")
    refused(InputError, chosen_scenes, [first, replace(second, name="a")], ["*"], tmp_path)
    own(folder / "c")
    assert [s.name for s in discover_scenes(folder, PAIRS, None, ["c", "a"])] == ["a", "c"]
    refused(InputError, discover_scenes, folder, PAIRS, None, ["a", "x"])


def test_the_protocol_is_said_never_guessed(tmp_path: Path):
    (own(tmp_path / "a") / "disp_left.png").unlink()
    write_pfm(tmp_path / "a" / "disp_left.pfm", TRUTH)
    own(tmp_path / "b", {"disp_scale": 256, "masks": "none (sparse GT)"}, {})
    own(tmp_path / "c", {"protocol": "kitti_2015", "disp_scale": 256}, {})
    write_disparity_png(tmp_path / "c" / "disp_left_noc.png", TRUTH)
    scenes = find(tmp_path)
    assert [s.protocol for s in scenes] == ["middlebury_v2", "middlebury_v2", "kitti_2015"]
    assert true(scenes[2]).noc is not None


def test_half_a_pair_is_an_item_with_a_problem(tmp_path: Path):
    for name, missing in (("a", ("right", "disp_left")), ("b", ("left",))):
        own(tmp_path / name)
        for stem in missing:
            (tmp_path / name / f"{stem}.png").unlink()
    (v3(tmp_path / "c", "ndisp=3") / "im1.png").unlink()
    for scene in find(tmp_path):
        refused(InputError, load, scene)
        with pytest.raises(InputError):
            true(scene)
    (own(tmp_path / "one/a") / "right.png").unlink()
    (scene,) = find(tmp_path / "one")  # a single view with truth is a scene without a pair
    assert scene.right is None
    refused(InputError, load, scene)


def test_files_are_not_opened_until_they_are_loaded(tmp_path: Path):
    views = laid(tmp_path / "views", {"a/view1.png": COLOR, "a/view5.png": COLOR, "a/disp1.png": b"damaged"})
    (scene,) = find(views)
    load(scene)
    refused(InputError, true, scene)
    laid(own(tmp_path / "sizes/a"), {"right.png": COLOR[:5], "mask_nonocc.png": GREY[:5]})
    (scene,) = find(tmp_path / "sizes")
    refused(InputError, load, scene)
    refused(InputError, true, scene)
    own(tmp_path / "folders/left.png")  # a folder named as an image is none
    (own(tmp_path / "folders/other") / "right.pgm").mkdir()
    assert [scene.name for scene in find(tmp_path / "folders") if not scene.problem] == ["left.png", "other"]


def test_scenes_that_are_not_used_are_told(tmp_path: Path):
    for name in ("set/a", "x/y/z/deep", "x/y/deep"):
        own(tmp_path / "in" / name)
    lines: list[str] = []
    assert names(tmp_path / "in", warn=lines.append) == ["set/a"]
    assert len(lines) == 1 and str(tmp_path / "in/x/y/deep") in lines[0] and "lies too deep" in lines[0]
    for folder in (tmp_path / "below", tmp_path / "below/later"):
        laid(folder, {"a_L.png": COLOR, "a_R.png": COLOR})
    own(tmp_path / "below/two/levels")
    lines.clear()
    assert names(tmp_path / "below", warn=lines.append) == ["a"]
    assert len(lines) == 1 and str(tmp_path / "below/later") in lines[0] and "not used" in lines[0]
    laid(tmp_path / "views", {"left/7.png": COLOR, "right/7.png": COLOR})
    assert len(find(tmp_path / "views", warn=lines.append)) == len(lines) == 1


def test_every_layout_says_what_it_wants():
    assert [each.name for each in ALL_KINDS.rows] == sorted(each.name for each in ALL_KINDS.rows)
    assert all(each.about and issubclass(each.kind, Scene) for each in ALL_KINDS.rows)


@pytest.mark.parametrize(("stems", "truth", "width", "codes"), [
    (("im2", "im6"), ("disp2", "disp6"), 8, 4),
    (("imL", "imR"), ("groundtruth",), 8, 4),
    (("view1", "view5"), ("disp1", "disp5"), 413, 3),  # 2005/2006 sets: third, half, or full size by the width
    (("view1", "view5"), ("disp1", "disp5"), 620, 2),
    (("view1", "view5"), ("disp1", "disp5"), 1240, 1),
])  # fmt: skip
def test_middlebury_v2(tmp_path: Path, stems, truth, width, codes):
    laid(tmp_path / "Teddy", {f"{stem}.png": np.resize(COLOR, (6, width, 3)) for stem in stems})
    laid(tmp_path / "Teddy", {f"{stem}.png": np.full((6, width), 12, np.uint8) for stem in truth})
    (scene,) = find(tmp_path)
    assert (scene.layout, scene.protocol) == ("middlebury-v2", "middlebury_v2")
    assert scene.max_disparity == (None if stems[0] == "view1" else 59)
    assert np.all(true(scene).disparity == 12 / codes)
    assert (true(scene).right is None) == (len(truth) == 1)


def test_middlebury_v3_and_eth3d(tmp_path: Path):
    v3(tmp_path / "A", "cam0=[1 0 2; 0 1 2; 0 0 1]\ndoffs=0\nbaseline=100\nwidth=8\nheight=6\nndisp=7\nisint=1\n")
    laid(v3(tmp_path / "B", "baseline=1\nwidth=8\nndisp=8\n"), {"cameras.txt": "", "images.txt": ""})
    a, b = find(tmp_path)
    assert (a.layout, a.max_disparity, a.round_disparity, a.protocol) == ("middlebury-v3", 7, True, "middlebury_v3")
    assert (b.layout, b.max_disparity, b.round_disparity, b.protocol) == ("eth3d", None, False, "eth3d")
    assert list(true(a).masks) == ["nonocc"]
    assert names(tmp_path, "eth3d") == ["B"] and names(tmp_path, "Middlebury_V3") == ["A"]


def test_kitti(tmp_path: Path):
    kitti(tmp_path / "k12", ("colored_0", "colored_1"), "disp_occ", "disp_noc")
    kitti(tmp_path / "k15", ("image_2", "image_3"), "disp_occ_0", "disp_noc_0")
    write_png(tmp_path / "k15" / "obj_map" / "000000_10.png", np.eye(6, 8, dtype=np.uint8))
    scenes = find(tmp_path)
    assert [s.name for s in scenes] == ["k12/000000_10", "k12/000001_10", "k15/000000_10", "k15/000001_10"]
    assert [s.layout for s in scenes[1:3]] == ["kitti-2012", "kitti-2015"] and scenes[2].protocol == "kitti_2015"
    truth = true(scenes[2])
    assert (truth.objects.sum(), np.isfinite(truth.noc).sum(), np.isfinite(truth.disparity).sum()) == (6, 32, 40)
    assert names(tmp_path / "k15") == ["000000_10", "000001_10"]
    assert len(find(tmp_path, pattern="000001_10")) == 2


@pytest.mark.parametrize("meta", [
    [1], {"disp_scale": "4"}, {"disp_scale": 0}, {"max_disparity": -3}, {"max_disparity": 2.5}, {"disp_scale": True},
    {"min_disparity": 4, "max_disparity": 4}, {"protocol": 3},
])  # fmt: skip
def test_broken_meta(tmp_path: Path, meta):
    refused(InputError, find, own(tmp_path / "a", meta))


def test_broken_names_of_labels_and_volumes_without_a_fixed_one(tmp_path: Path):
    laid(tmp_path, {"a/fixed.mha": "", "a/moving_warped.mha": "", "a/mask_organs.mha": ""})
    for labels in ({"organs": {"=": 1}}, {"organs": {"liver": 1, "lung": 1}}, {"organs": {"liver": 1.5}}, 3):
        laid(tmp_path, {"a/meta.json": {"labels": labels}})
        refused(InputError, discover_scenes, tmp_path / "a", VOLUMES)
    laid(tmp_path, {"a/meta.json": {"labels": {"organs": {"liver": 2, "air": 0}, "bones": {"rib": 1}}}})
    (scene,), lines = warned(discover_scenes, tmp_path, VOLUMES)
    assert scene.labels == (("organs", (("liver", 2),)),)
    assert len(lines) == 1 and "there is no mask_bones.*" in lines[0]
    (tmp_path / "a/fixed.mha").unlink()
    (scene,) = discover_scenes(tmp_path / "a", VOLUMES)
    refused(InputError, load, scene)
    refused(InputError, discover_scenes, laid(tmp_path / "b", {"fixed.txt": ""}), VOLUMES)  # which is no volume


def test_what_is_said_where_nothing_fits(tmp_path: Path):
    refused(InputError, find, tmp_path / "absent")
    refused(InputError, find, tmp_path)
    refused(InputError, find, tmp_path, "kitti-2015")
    for name in ("im2.png", "view1.png"):  # one view alone
        refused(InputError, find, laid(tmp_path / "one" / name, {f"a/{name}": COLOR}))
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
        assert np.nanmin(truth.disparity) > 0 and np.nanmax(truth.disparity) <= facts["max_disparity"] + 1
        assert scene.right is None or load(scene).shape == truth.disparity.shape


def test_layouts_of_a_users_file(tmp_path: Path):
    for name in ("7", "8"):
        laid(tmp_path / "set", {f"cam/a_{name}.png": COLOR, f"other/b_{name}.png": COLOR})
    write_pfm(tmp_path / "set/gt/7.pfm", TRUTH)

    def find_by(row: str) -> list:
        (tmp_path / "mine.yaml").write_text("mine: {left: 'cam/a_{id}.*', " + row + "}")
        return find(tmp_path / "set", str(tmp_path / "mine.yaml"))

    first, second = find_by("right: 'other/b_{id}.*', disparity_left: 'gt/{id}.*', max_disparity: 5")
    assert (first.name, first.layout, first.max_disparity, second.has_truth) == ("7", "mine", 5, False)
    np.testing.assert_array_equal(true(first).disparity, TRUTH)
    refused(ConfigError, find_by, "decode: x.png")  # no file, but a function that reads one
    refused(ConfigError, find_by, "right: 'other/b_{id}.*', max_disparity: far")
    refused(ConfigError, find_by, "masks: 'other/b_{id}.*'")
    refused(ConfigError, find_by, "right: 3")
    refused(ConfigError, find_by, "}\nother: {right: 'other/b_{id}.*'")
    write_png(tmp_path / "set/gt/8.png", COLOR)
    glass = find_by("right: 'other/b_{id}.*', mask.glass: 'gt/{id}.*'")
    assert [list(each.masks) for each in glass] == [[], ["glass"]]
