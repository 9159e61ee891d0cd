"""One left view and two right ones: maps of both pairs, fused in inverse depth."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import depthcli
from depthcli.cli import main
from depthcli.commands._several_cameras import _range as search_range
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import read_pfm, write_pfm
from depthcli.io.formats.images import write_png
from depthcli.io.formats.pictures import read_status
from depthcli.simulate.arrays.rendering import light_maps, render, trace
from depthcli.simulate.arrays.room import Room
from depthcli.simulate.arrays.stereo_kinds import FURNISH

BASELINES = (2.5, 1.0)  # the longest first, in units of the other
TOP = 14  # disparity of the short baseline, pixels


class Trinocular(NamedTuple):
    left: np.ndarray
    rights: list[np.ndarray]
    truth: np.ndarray  # disparity of the short baseline
    maps: list[np.ndarray]  # as matched


def photograph(seed: int, *positions: float) -> tuple[list[np.ndarray], np.ndarray]:
    """Views (H, W, 3) uint8 of cameras at these multiples of the baseline, and the disparity at 0."""
    room = Room(np.random.default_rng([seed, 0]), 200, 140, TOP, 1.0)
    FURNISH["planes"](room)
    lights, noise = light_maps(room), np.random.default_rng(seed)
    views = [render(room, lights, at, 3) * 255 for at in positions]  # type: ignore[arg-type]  # False, True are 0, 1
    depth, _ = trace(room, np.arange(200.0)[None], np.arange(140.0)[:, None], False)
    return [np.clip(v + noise.normal(0, 4, v.shape), 0, 255).astype(np.uint8) for v in views], room.focal / depth


@pytest.fixture(scope="module")
def shot() -> Trinocular:
    (left, *rights), truth = photograph(3, 0.0, *BASELINES)
    maps = [
        depthcli.stereo(left, right, int(TOP * baseline), "accurate").values
        for right, baseline in zip(rights, BASELINES, strict=True)
    ]
    return Trinocular(left, rights, truth.astype(np.float32), maps)


def errors(values: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Share of pixels off by more than half a pixel of the short baseline, and the mean error, at most 3 pixels."""
    off = np.minimum(np.nan_to_num(np.abs(values - truth), nan=3.0), 3.0)
    return float(np.mean(off > 0.5)), float(off.mean())


@pytest.mark.slow
def test_the_fused_map_is_better_than_either(shot: Trinocular) -> None:
    fused = depthcli.fuse_maps(shot.left, shot.rights[0], shot.maps, baselines=BASELINES, max_disparity=35)
    each = [errors(values / baseline, shot.truth) for values, baseline in zip(shot.maps, BASELINES, strict=True)]
    both = errors(fused.values / BASELINES[0], shot.truth)
    assert both[0] < min(one[0] for one in each)
    assert both[1] < min(one[1] for one in each)


@pytest.mark.slow
def test_the_command_writes_the_same_map(shot: Trinocular, tmp_path: Path) -> None:
    write_png(tmp_path / "left.png", shot.left)
    write_png(tmp_path / "right.png", shot.rights[0])
    for name, values in zip(("far", "near"), shot.maps, strict=True):
        write_pfm(tmp_path / name / "left.pfm", values)
    maps = ["--maps", f"far={tmp_path / 'far' / 'left.pfm'}", "--maps", f"near={tmp_path / 'near' / 'left.pfm'}"]
    views = ["--left", str(tmp_path / "left.png"), "--right", str(tmp_path / "right.png"), "--name", "room"]
    words = ["fuse", "maps", *views, *maps, "--max-disparity", "35", "-o", str(tmp_path / "out"), "-q"]
    assert main([*words, "--baselines", "2.5,1"]) == 0
    fused = depthcli.fuse_maps(shot.left, shot.rights[0], shot.maps, baselines=BASELINES, max_disparity=35)
    np.testing.assert_array_equal(read_pfm(tmp_path / "out" / "room" / "disp_left.pfm"), fused.values)
    assert "far: 2.5" in (tmp_path / "out" / "run.yaml").read_text()


@pytest.fixture
def views(tmp_path: Path) -> list[str]:
    (left, *rights), _ = photograph(3, 0.0, *BASELINES, -0.5)
    for name, view in zip(("left", "far", "near", "other"), (left, *rights), strict=True):
        write_png(tmp_path / f"{name}.png", view)
    words = ["stereo", "fast", "--left", str(tmp_path / "left.png"), "--name", "room", "-q"]
    return [*words, "--max-disparity", "14"]


def rights(folder: Path, *names: str) -> list[str]:
    return [word for name in names for word in ("--right", str(folder / f"{name}.png"))]


@pytest.mark.slow
def test_several_right_views_are_matched_and_fused(views: list[str], tmp_path: Path, capsys) -> None:
    words = [*views, *rights(tmp_path, "near", "far", "other"), "--baselines", "1,2.5,-.5", "-o", str(tmp_path / "all")]
    assert main(words) == 0
    found = tmp_path / "all" / "room" / "disp_left.pfm"
    for name, low, top in (("near", 0, 14), ("far", 0, 35), ("other", -7, 0)):
        ends = ["--min-disparity", str(low), "--max-disparity", str(top), "-o", str(tmp_path / name), "--html"]
        assert main([*views, *rights(tmp_path, name), *ends]) == 0
    maps = [word for name in ("far", "near", "other") for word in ("--maps", str(tmp_path / name))]
    alike = ["fuse", "maps", *views[2:-2], *rights(tmp_path, "far"), *maps, "--baselines", "2.5,1,-0.5", "-q"]
    assert main([*alike, "--max-disparity", "35", "-o", str(tmp_path / "by_hand")]) == 0
    assert found.read_bytes() == (tmp_path / "by_hand" / "room" / "disp_left.pfm").read_bytes()
    status = [read_status(tmp_path / "all" / "pairs" / f"right_{k}" / "room" / "status.png") for k in (1, 2, 3)]
    filled = np.logical_and.reduce([(each & Status.FILLED) != 0 for each in status])
    assert filled.sum() > 20 and np.all(read_status(found.with_name("status.png"))[filled] & Status.FILLED)
    before = found.stat().st_mtime_ns, (tmp_path / "all" / "pairs" / "right_2" / "report.json").read_bytes()
    capsys.readouterr()
    assert main([*words, "--json"]) == 0  # nothing is computed again, and one document is printed
    assert '"maps": 3' in capsys.readouterr().out
    assert before == (found.stat().st_mtime_ns, (tmp_path / "all" / "pairs" / "right_2" / "report.json").read_bytes())


@pytest.mark.parametrize(
    ("names", "words", "message"),
    [
        (("far", "near"), (), "give --baselines, such as"),
        (("far",), ("--baselines", "1"), "wants a --right for each"),
        (("far", "near"), ("--baselines", "1"), "one for each of the 2 views"),
        (("far", "near"), ("--baselines", "1,x"), "want numbers"),
        (("far", "near"), ("--baselines", "-1,2"), "the first one positive"),
        (("far", "near"), ("--baselines", "2,1", "--axis", "vertical"), "--axis vertical wants one --right alone"),
        (("far", "near"), ("--baselines", "2,1", "--shard", "1/2"), "--shard wants one --right alone"),
        (("far", "near"), ("--baselines", "2,1", "--calibration", "rig.yml"), "calibration: wants one --right alone"),
        (("far", "near"), ("--baselines", "2,1", "--set", "calibration=rig.yml"), "calibration: wants one --right"),
        (("far", "near"), ("--baselines", "2,1", "--flag", "nothing>1"), "no column 'nothing'"),
        (("far", "near"), ("--baselines", "2,1", "--fail-flagged"), "nothing is flagged without a condition"),
        (("far",) * 33, ("--baselines", ",".join(["1"] * 33)), "--right: at most"),
        (("far", "nothing*"), ("--baselines", "2,1"), "nothing*.png"),
    ],
)
def test_several_right_views_that_cannot_be_matched(views, tmp_path, names, words, message, capsys) -> None:
    code = main([*views, *rights(tmp_path, *names), *words, "-o", str(tmp_path / "out")])
    assert code == 2 and message in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_of_a_view_that_is_not_there_the_others_are_done(views: list[str], tmp_path: Path, capsys) -> None:
    words = [*views, *rights(tmp_path, "far", "nowhere", "near"), "--baselines", "2,1.5,1", "-o", str(tmp_path / "out")]
    assert main(words) == 3 and "nowhere.png: no such file" in capsys.readouterr().err
    assert (tmp_path / "out" / "room" / "disp_left.pfm").exists()


@pytest.mark.parametrize(
    ("low", "top", "ratio", "ends"),
    [
        (None, 14, 2.5, (None, "35")),
        (3, 15, 0.5, ("1", "8")),
        (None, 14, -0.5, ("-7", "0")),
        (3, 15, -0.5, ("-8", "-1")),
        ("auto", 64, 5.0, ("auto", "320")),
        (8, "auto", 2.0, ("16", "auto")),
        (8, "auto", -2.0, ("auto", "-16")),
        ("auto", 64, -0.5, ("-32", "auto")),
        ("auto", "auto", -1.0, ("auto", "auto")),
        (None, None, 3.0, (None, None)),
        (None, None, -3.0, ("auto", "0")),
    ],
)
def test_search_ranges_are_in_proportion_to_baselines(low, top, ratio: float, ends: tuple[str | None, ...]) -> None:
    assert tuple(search_range(low, top, ratio).values()) == ends


def test_maps_that_contradict_the_baselines_are_said() -> None:
    image = np.random.default_rng(0).integers(0, 256, (30, 80), np.uint8)
    far, near = np.full((30, 80), 9.0, np.float32), np.full((30, 80), 3.0, np.float32)
    right = depthcli.fuse_maps(image, np.roll(image, -9, 1), [far, near], baselines=(3, 1), max_disparity=12)
    assert not any("baselines say" in line for line in right.warnings)
    wrong = depthcli.fuse_maps(image, np.roll(image, -9, 1), [far, near], baselines=(1, 3), max_disparity=12)
    assert any("0.333 times those of" in line and "baselines say 3" in line for line in wrong.warnings)


def test_a_camera_on_the_left_has_a_negative_baseline() -> None:
    left = np.random.default_rng(0).integers(0, 256, (40, 80), np.uint8)
    right = np.roll(left, -6, axis=1)
    maps = [np.full((40, 80), np.nan), np.full((40, 80), -12.0)]
    fused = depthcli.fuse_maps(left, right, maps, baselines=(1, -2), max_disparity=12)
    assert np.median(fused.values) == pytest.approx(6, abs=0.1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1", "want one for each of the 2 maps"),
        ("1,x", "want numbers such as 0.1,0.3"),
        ("0,1", "want lengths other than 0, the first one positive"),
        ("-1,1", "the first one positive"),
        ("1,nan", "want lengths other than 0"),
    ],
)
def test_wrong_baselines(tmp_path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    image = np.zeros((20, 40), np.uint8)
    for name in ("left", "right"):
        write_png(tmp_path / f"{name}.png", image)
    for name in ("a", "b"):
        write_pfm(tmp_path / f"{name}.pfm", np.ones((20, 40), np.float32))
    words = ["fuse", "maps", "--left", str(tmp_path / "left.png"), "--right", str(tmp_path / "right.png")]
    maps = ["--maps", str(tmp_path / "a.pfm"), "--maps", str(tmp_path / "b.pfm")]
    assert main([*words, *maps, "-o", str(tmp_path / "out"), f"--baselines={text}"]) == 2
    assert message in capsys.readouterr().err
    with pytest.raises(depthcli.ConfigError, match="want one a map, 1"):
        depthcli.fuse_maps(image, image, [np.ones((20, 40))], baselines=(1, 2))
