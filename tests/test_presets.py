"""Every preset that ships: read, shown, run on a small scene."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.commands import config_model
from depthcli.core.config_file import PRESET_FOLDER, dump_config, find_config, find_preset, list_presets, load_config
from depthcli.core.yaml_source import parse_config
from depthcli.io.formats.disparity import read_pfm
from depthcli.io.formats.images import read_image
from depthcli.io.scenes.find import discover_scenes
from depthcli.io.scenes.pairs import PAIRS
from depthcli.io.stereo_pairs import load_pair
from depthcli.kernels.jit import n_threads, set_threads
from tests.command_line import contents
from tests.golden import same_figures

PRESETS = [(command, name) for command, name, _ in list_presets()]
USUAL = ("stereo fast", "stereo accurate", "stereo segments", "fuse accurate")

_PAIR, _VOLUMES = ("made_scenes", "--scenes", "planes_0"), ("made_volumes", "--scenes", "pair_0")
INPUTS = {
    "stereo": _PAIR,
    "fuse": _PAIR,
    "refine-kinect": ("made_kinect",),
    "transparent": ("made_glass",),
    "register-confidence": (*_VOLUMES, "--set", "max_voxels=40000"),
}
"""The fixture with a small input of a command, and options."""


def words_of(request: pytest.FixtureRequest, command: str, name: str, output: Path) -> list[str]:
    fixture, *options = INPUTS[command]
    return [command, name, "-i", str(request.getfixturevalue(fixture)), "-o", str(output), "-q", *options]


def loaded(command: str, name: str) -> Any:
    model = config_model(command)
    assert model is not None
    return load_config(model, find_config(command, name))


def test_names_are_found_in_any_case_and_bases_are_resolved():
    assert len(PRESETS) == len(list(PRESET_FOLDER.rglob("*.yaml"))) > 0
    assert find_preset("stereo", "OpenCV_SGBM") == PRESET_FOLDER / "stereo" / "opencv-sgbm.yaml"
    assert find_preset("fuse", "CH6_all") == PRESET_FOLDER / "fuse" / "thesis" / "ch6-all.yaml"
    texts = [dump_config(loaded("fuse", name)) for name in ("ch6-all", "ch6-cw")]
    differing = [pair for pair in zip(*(text.splitlines() for text in texts), strict=True) if pair[0] != pair[1]]
    assert differing == [("blend: after", "blend: before")]


def test_presets_of_the_thesis_are_listed_by_chapter(tool):
    """Chapter 3 has every cost and aggregation; from chapter 4 on each preset says that it is reconstructed."""
    lines = tool.out(0, "presets", "thesis").splitlines()
    names = [tuple(line.split()[:2]) for line in lines]
    assert set(names) == {(command, name) for command, name in PRESETS if name.startswith("thesis/")}
    costs, aggregations = ("ad", "ad-gradient", "ad-rank", "ad-census"), ("cw", "cross", "aw")
    chapter_3 = {("stereo", f"thesis/ch3-{cost}-{way}") for cost in costs for way in aggregations}
    assert chapter_3 == {name for name in names if "/ch3-" in name[1]}
    others = ("refine-kinect thesis/ch4", "transparent thesis/ch5", "register-confidence thesis/ch7")
    assert {*others} < {" ".join(name) for name in names}
    chapters = [name.partition("/")[2][:3] for _, name in names]
    assert chapters == sorted(chapters)
    for chapter, line in zip(chapters, lines, strict=True):
        assert ("reconstructed" in line.lower()) == (chapter >= "ch4"), line


@pytest.mark.slow
@pytest.mark.parametrize(("command", "name"), PRESETS)
def test_shown_with_every_field_it_is_the_same_config(command: str, name: str, tool):
    shown, resolved = tool.out(0, "presets", "show", f"{command}/{name}"), loaded(command, name)
    assert dump_config(load_config(type(resolved), parse_config(shown, "shown"))) == dump_config(resolved)
    assert shown.count("#") > 3
    about = next(line for c, n, line in list_presets() if (c, n) == (command, name))
    assert 20 < len(about) <= 140


def saved_by_python(command: str, name: str, scenes: Path, output: Path) -> None:
    """Compute a toy scene by the function for Python, and save it as the command does, in folders of its name."""
    if command in ("stereo", "fuse"):
        views = [read_image(scenes / "planes_0" / f"{side}.png") for side in ("left", "right")]
        solve: Any = depthcli.stereo if command == "stereo" else depthcli.fuse
        solve(*views, 12, name).save(output / "planes_0")
    elif command == "refine-kinect" and name == "sequence":
        frames = sorted((scenes / "moving").glob("color*.png"))
        colors = [read_image(file) for file in frames]
        depths = [read_pfm(file.with_name(file.name.replace("color", "depth")).with_suffix(".pfm")) for file in frames]
        for file, depth in zip(frames, depthcli.refine_depth(colors, depths, name, fb=43.5), strict=True):
            depth.save(output / "moving" / file.stem.removeprefix("color_"))
    elif command == "refine-kinect":
        color, measured = read_image(scenes / "planes" / "color.png"), read_pfm(scenes / "planes" / "depth.pfm")
        depthcli.refine_depth(color, measured, name, fb=43.5).save(output / "planes")
    elif command == "transparent":
        scene = scenes / "glass_0"
        config = depthcli.load_config(depthcli.TransparentConfig, name)
        given: dict[str, Any] = {"sparse": read_pfm(scene / "sparse.pfm"), "fb": 24.0}
        if config.stereo is not None:
            limit = json.loads((scene / "meta.json").read_text())["max_disparity"]
            given = {"infrared": read_image(scene / "ir.png"), "calibration": scene / "calib.json"}
            given["overrides"] = {"stereo.max_disparity": limit}
        elif config.pipeline.needs == "objects":
            given = {"objects": read_image(scene / "mask_transparent.png"), "fb": 24.0}
        frame = read_image(scene / "color.png"), read_pfm(scene / "depth.pfm")
        depthcli.complete_transparent(*frame, preset=name, **given).save(output / "glass_0")
    else:
        sitk = pytest.importorskip("SimpleITK", reason="no SimpleITK, which reads volumes")
        roles = ("fixed", "moving_warped", "mask")
        fixed, warped, mask = (sitk.ReadImage(str(scenes / "pair_0" / f"{role}.nii.gz")) for role in roles)
        result = depthcli.registration_confidence(fixed, warped, preset=name, mask=mask, max_voxels=40000)
        result.save(output / "pair_0")


@pytest.mark.slow
@pytest.mark.parametrize(("command", "name"), PRESETS)
def test_a_toy_scene_has_the_same_files_by_the_command_and_from_python(
    request: pytest.FixtureRequest, tmp_path: Path, command: str, name: str
):
    assert main(words_of(request, command, name, tmp_path / "r")) == 0
    report = json.loads((tmp_path / "r" / "report.json").read_text())
    assert report["done"] >= 1
    renewed = request.config.getoption("renew")
    same_figures(f"{command} {name}", tmp_path / "r", renewed, columns=[*report["scenes"][0]])
    if command in ("stereo", "fuse"):
        values = read_pfm(tmp_path / "r" / "planes_0" / "disp_left.pfm")
        known = values[np.isfinite(values)]
        assert values.shape == (64, 96) and known.size > 0.5 * values.size and 0 <= known.min() <= known.max() <= 13
    saved_by_python(command, name, request.getfixturevalue(INPUTS[command][0]), tmp_path / "python")
    (scene,) = (tmp_path / "python").iterdir()
    by_python, by_command = (contents(tmp_path / place / scene.name) for place in ("python", "r"))
    by_command.pop("points.csv", None)  # of landmarks, which the volumes have in files
    assert by_python.keys() == by_command.keys()
    assert [file for file, data in by_python.items() if by_command[file] != data] == []


@pytest.mark.parametrize(("command", "name"), [
    pytest.param(*each, marks=pytest.mark.slow if " ".join(each) in USUAL else pytest.mark.system) for each in PRESETS
])  # fmt: skip
def test_same_bytes_at_any_number_of_threads(request, tmp_path: Path, monkeypatch, command: str, name: str):
    """Of more than there are cores, too."""
    found = []
    monkeypatch.setattr("depthcli.kernels.jit._threads.most", 16)
    for kernels, opencv in ((16, 1), (3, 1), (1, 8)):
        monkeypatch.setattr(
            "depthcli.run.workers.use_threads", lambda _, k=kernels, n=opencv: (set_threads(k), cv2.setNumThreads(n))
        )
        assert main(words_of(request, command, name, tmp_path / str(kernels))) == 0
        assert n_threads() == kernels
        found.append(contents(tmp_path / str(kernels)))
    assert len(found[0]) > 2
    for other in found[1:]:
        assert found[0].keys() == other.keys()
        assert [name for name, data in found[0].items() if other[name] != data] == []


def test_the_map_that_fuse_accurate_begins_with_is_that_of_stereo_accurate(made_scenes: Path):
    """Its network knows the maps of these methods and of no others: a change of one copy must not be forgotten."""
    fusion, alone = loaded("fuse", "accurate"), loaded("stereo", "accurate").pipeline
    assert fusion.refinement == alone.refinement
    assert fusion.optimization.p2 * len(fusion.measures) == alone.optimization.p2
    pair = load_pair(discover_scenes(made_scenes, PAIRS, patterns=("planes_0",))[0])
    first = fusion.model_copy(update={"maps": None, "confidence": ()})
    own, other = (method(pair, 31).disparity.values for method in (first, alone))
    assert np.mean(np.abs(own - other) <= 0.25) > 0.97
