"""Commands on maps that were made before: confidence, fuse maps."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import read_pfm, read_status, write_pfm
from depthcli.io.formats.images import read_image, write_png
from tests.command_line import contents, rows, run
from tests.golden import refused

NAMES = ["foreground_0", "planes_0"]


@pytest.fixture
def maps(two_scenes: Path, tmp_path: Path) -> Path:
    """The truth with a wrong block in every map, and -1 in its corner."""
    folder = tmp_path / "sgm"
    folder.mkdir()
    for name in NAMES:
        values = read_pfm(two_scenes / name / "disp_left.pfm")
        values[20:40, 40:70] += 5
        values[48:58, 20:40] = -1
        write_pfm(folder / f"{name}.pfm", values)
    return folder


def test_confidence_writes_what_it_says(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    out = tmp_path / "sure"
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o", out, "--share", "0.8", "--measure", "rank")
    printed = tool.both(0, *words, "--measure", "census")
    assert "% of the pixels are -1: taken as no value (--invalid nan keeps them)" in printed.err
    assert "expected right" in printed.out
    made = out / NAMES[0]
    assert sorted(path.name for path in made.iterdir()) == sorted(
        ["bound.pfm", "probability.pfm", "probability.png", "confidence_census.pfm", "confidence_census.png",
         "confidence_rank.pfm", "confidence_rank.png", "disp_left.pfm", "disp_left.png",
         "preview.png", "record.json", "status.png"]
    )  # fmt: skip
    sure, kept = read_pfm(made / "probability.pfm"), read_pfm(made / "disp_left.pfm")
    assert sure[22:38, 42:68].mean() < 0.4 < 0.8 < sure[42:58, 60:90].mean()
    bound = read_pfm(made / "bound.pfm")
    assert bound[22:38, 42:68].mean() > 2 > bound[42:58, 60:90].mean()
    np.testing.assert_array_equal(np.isfinite(bound), read_pfm(maps / f"{NAMES[0]}.pfm") >= 0)
    assert rows(out)[NAMES[0]]["median_bound"] == pytest.approx(np.median(bound[np.isfinite(bound)]), abs=1e-3)
    known = np.count_nonzero(read_pfm(maps / f"{NAMES[0]}.pfm") >= 0)
    assert np.count_nonzero(np.isfinite(kept)) == pytest.approx(0.8 * known, rel=0.01)
    status = read_status(made / "status.png")
    assert (status[50:56, 22:38] == Status.NO_DATA).all()
    outside, occluded = ((status & bit) != 0 for bit in (Status.OUT_OF_RANGE, Status.OCCLUDED))
    assert outside.any() and rows(out)[NAMES[0]]["hidden"] == pytest.approx(np.mean(outside | occluded), abs=1e-6)


def test_the_same_bytes_from_the_command_and_from_python(two_scenes: Path, maps: Path, tmp_path: Path):
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    words = ("confidence", "-i", two_scenes, "--maps", maps, "--measure", "all", "-q", "--max-disparity", "16")
    assert run(*words, "-o", one, "--threads", "1") == 0
    assert run(*words, "-o", two, "--jobs", "2") == 0
    best = ("fuse", "maps", "-i", two_scenes, "--maps", maps, "-q", "--max-disparity", "16", "-o", three)
    assert run(*best) == 0
    assert contents(one) == contents(two)
    assert "bound:\n  level: 0.9\n  within: 1.0\n" in (one / "run.yaml").read_text()
    for name in NAMES:
        left, right = (read_image(two_scenes / name / f"{view}.png") for view in ("left", "right"))
        values = read_pfm(maps / f"{name}.pfm")
        values[values == -1] = np.nan
        depthcli.map_confidence(left, right, values, max_disparity=16, measures=["all"]).save(tmp_path / "py" / name)
        assert contents(tmp_path / "py" / name) == contents(one / name)
        depthcli.fuse_maps(left, right, [values], max_disparity=16).save(tmp_path / "pf" / name)
        assert contents(tmp_path / "pf" / name) == contents(three / name)


def same_but_where_filled(judged: depthcli.MapConfidence, folder: Path) -> None:
    """Compare a map's bounds with those of a run, which has tables of its own, one for filled pixels."""
    bound, filled = read_pfm(folder / "bound.pfm"), (read_status(folder / "status.png") & Status.FILLED) > 0
    ranks = [np.argsort(np.argsort(one[~filled], kind="stable")) for one in (judged.bound, bound)]
    assert np.corrcoef(ranks)[0, 1] > 0.99  # both grow with the same odds
    assert filled.any() and not filled.all()


def test_stereo_and_fuse_write_the_same_bounds_as_python_and_confidence(two_scenes: Path, tmp_path: Path):
    one = ("-i", two_scenes, "--scenes", NAMES[0], "-q")
    wanted = ("--bound", "--level", "0.8", "--max-disparity", "16")
    left, right = (read_image(two_scenes / NAMES[0] / f"{view}.png") for view in ("left", "right"))
    for command, preset, function in (("stereo", "fast", depthcli.stereo), ("fuse", "accurate", depthcli.fuse)):
        assert run(command, preset, *one, *wanted, "--set", "confidence=[lrc]", "-o", tmp_path / command) == 0
        made = tmp_path / command / NAMES[0]
        found = function(left, right, 16, preset, bound={"level": 0.8}, confidence=["lrc"])
        found.save(tmp_path / "py" / command / NAMES[0])
        assert contents(tmp_path / "py" / command / NAMES[0]) == contents(made)
        row = rows(tmp_path / command)[NAMES[0]]
        assert row["median_bound"] == pytest.approx(np.median(found.bound), abs=1e-3)
        assert row["expected_right"] == pytest.approx(found.probability.mean(), abs=1e-3)
        same_but_where_filled(depthcli.map_confidence(left, right, found.values, max_disparity=16, level=0.8), made)
    maps = ("--maps", tmp_path / "stereo", "--maps", tmp_path / "fuse", "-o", tmp_path / "maps")
    assert run("fuse", "maps", *one, *maps, *wanted) == 0
    best = tmp_path / "maps" / NAMES[0]
    values = read_pfm(best / "disp_left.pfm")
    same_but_where_filled(depthcli.map_confidence(left, right, values, max_disparity=16, level=0.8), best)
    assert not depthcli.stereo(left, right, 16, "fast").bound


def test_bounds_move_with_the_search_range(two_scenes: Path):
    left, right = (read_image(two_scenes / NAMES[0] / f"{view}.png") for view in ("left", "right"))
    for low in (-4, 3):
        moved = np.roll(right, low, axis=1)
        found = depthcli.stereo(left, moved, 16 - low, "fast", min_disparity=-low, bound=True)
        assert found.bound.shape == found.values.shape
        np.testing.assert_array_equal(np.isnan(found.bound), np.isnan(found.values))
        assert np.nanmedian(found.bound) < 1
        assert found.probability.mean() > 0.7
        assert (found.bound[:, : max(-low, 0)] == 16).all()  # without a match they may be off by the whole range


def test_several_maps_are_better_than_each(two_scenes: Path, tmp_path: Path, tool):
    for k, run_name in enumerate(("upper", "lower")):
        (tmp_path / run_name).mkdir()
        for name in NAMES:
            values = read_pfm(two_scenes / name / "disp_left.pfm")
            rows = slice(0, 32) if k == 0 else slice(32, 64)
            values[rows] = np.maximum(values[rows] - 4, 0)
            write_pfm(tmp_path / run_name / f"{name}.pfm", values)
    (tmp_path / "lower" / f"{NAMES[1]}.pfm").unlink()
    words = ("fuse", "maps", "-i", two_scenes, "--maps", tmp_path / "upper", "--maps", tmp_path / "lower")
    tool.told(0, *words, "-o", tmp_path / "best")
    scene = two_scenes / NAMES[0]
    truth, visible = read_pfm(scene / "disp_left.pfm"), read_image(scene / "mask_nonocc.png")
    best = read_pfm(tmp_path / "best" / NAMES[0] / "disp_left.pfm")
    assert np.isfinite(best).all()
    assert np.mean(np.abs(best - truth)[visible == 255] > 1) < 0.08


def test_pixels_that_no_map_has_measured_are_filled(two_scenes: Path, tmp_path: Path):
    """What was filled in all runs that are fused is filled in their best map; depth leaves it out."""
    words = ("-i", two_scenes, "--scenes", NAMES[0], "-q")
    for preset in ("fast", "opencv-sgbm"):
        assert run("stereo", preset, *words, "-o", tmp_path / preset) == 0
    runs = [word for preset in ("fast", "opencv-sgbm") for word in ("--maps", tmp_path / preset)]
    assert run("fuse", "maps", *words, *runs, "-o", tmp_path / "best") == 0
    runs_and_best = ("fast", "opencv-sgbm", "best")
    filled = [(read_status(tmp_path / each / NAMES[0] / "status.png") & Status.FILLED) != 0 for each in runs_and_best]
    in_all = filled[0] & filled[1]
    assert in_all.mean() > 0.01
    assert filled[2][in_all].mean() > 0.9 and filled[2][~in_all].mean() < 0.03
    assert rows(tmp_path / "best")[NAMES[0]]["measured"] == round(float(np.mean(~filled[2])), 6)


def test_a_changed_map_is_judged_again_and_others_are_not(two_scenes: Path, maps: Path, tmp_path: Path):
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "out", "-q")
    assert run(*words) == 0
    files = [tmp_path / "out" / name / "probability.pfm" for name in NAMES]
    before = [file.stat().st_mtime_ns for file in files]
    write_pfm(maps / f"{NAMES[0]}.pfm", np.full((64, 96), 3, np.float32))
    assert run(*words) == 0
    after = [file.stat().st_mtime_ns for file in files]
    assert after[0] != before[0]
    assert after[1] == before[1]
    assert run(*words, "--invalid", "7") == 0  # read in another way
    assert all(file.stat().st_mtime_ns != stamp for file, stamp in zip(files, after, strict=True))


def test_what_is_wrong_with_one_scene_fails_alone(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    first = maps / f"{NAMES[0]}.pfm"
    whole, negative = first.read_bytes(), -np.random.default_rng(0).uniform(1, 9, (64, 96)).astype(np.float32)
    for case, content in {"sign": negative, "empty": 0 * negative + np.nan, "cut": whole[:9999], "gone": None}.items():
        if content is None:
            first.unlink()
        elif isinstance(content, bytes):
            first.write_bytes(content)
        else:
            write_pfm(first, content)
        tool.told(3, "confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / case, "-q")
        assert (tmp_path / case / NAMES[1] / "probability.pfm").is_file()
        assert [path.name for path in (tmp_path / case / NAMES[0]).iterdir()] == ["record.json"]


def test_a_folder_that_cannot_be_used_fails_alone(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    folder = tmp_path / "scenes"
    shutil.copytree(two_scenes, folder)
    shutil.copy(folder / NAMES[0] / "left.png", folder / NAMES[0] / "left.jpg")
    tool.told(3, "confidence", "-i", folder, "--maps", maps, "-o", tmp_path / "out", "--evaluate")
    assert (tmp_path / "out" / NAMES[1] / "probability.pfm").is_file()


def test_the_scale_of_a_run_that_is_not_given_is_refused(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "out")
    tool.told(2, *words, "--pattern", "other={scene}.pfm")


def test_names_of_kept_files_and_a_single_pair(two_scenes: Path, maps: Path, tmp_path: Path):
    folder = two_scenes / NAMES[0]
    words = ("--left", folder / "left.png", "--right", folder / "right.png", "--maps", maps / f"{NAMES[0]}.pfm")
    assert run("confidence", *words, "-o", tmp_path / "one", "-q", "--keep", "probability.pfm") == 0
    (made,) = (path for path in (tmp_path / "one").iterdir() if path.is_dir())
    assert sorted(path.name for path in made.iterdir()) == ["probability.pfm", "record.json"]


def test_witnesses_right_maps_and_evaluation(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    rights = tmp_path / "rights"
    for name in NAMES:
        (rights / name).mkdir(parents=True)
        shutil.copy(two_scenes / name / "disp_right.pfm", rights / name)
    measures = ("--measure", "agreement", "--measure", "left_right")
    words = ("--witness", f"truth={two_scenes}", "--right-maps", rights, *measures, "--evaluate", "--html")
    assert run("confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "out", *words) == 0
    assert (tmp_path / "out" / "evaluation" / "report.html").is_file()
    agreement = read_pfm(tmp_path / "out" / NAMES[0] / "confidence_agreement.pfm")
    assert agreement[24:36, 44:66].mean() < 0.5 < agreement[42:58, 60:90].mean()
    assert run("confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "x", "--right-maps", f"r={rights}",
               "--scale", "r=2", "--measure", "left_right", "-q") == 0  # fmt: skip
    (rights / NAMES[0] / "disp_right.pfm").unlink()
    write_pfm(rights / NAMES[1] / "disp_right.pfm", np.ones((64, 80), np.float32))
    tool.told(3, "confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "y", "--right-maps", rights)
    consistent = read_pfm(tmp_path / "out" / NAMES[0] / "confidence_left_right.pfm")
    assert np.nanmedian(consistent[42:58, 60:90]) > -0.6 > -3 > np.nanmedian(consistent[24:36, 44:66])


def test_a_scene_without_a_right_image(two_scenes: Path, maps: Path, tmp_path: Path):
    folder = tmp_path / "left_only" / NAMES[0]
    folder.mkdir(parents=True)
    for file in ("left.png", "disp_left.pfm", "meta.json"):
        shutil.copy(two_scenes / NAMES[0] / file, folder)
    words = ("confidence", "-i", tmp_path / "left_only", "--maps", maps, "-o", tmp_path / "out")
    assert run(*words) == 0
    assert (tmp_path / "out" / NAMES[0] / "probability.pfm").is_file()
    assert run("fuse", "maps", *words[1:5], "-o", tmp_path / "fused", "-q") == 3


def test_python_speaks_of_keywords():
    left = np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8)
    refused(depthcli.ConfigError, depthcli.map_confidence, left, left, np.ones((40, 60)), measures=["x"])
    refused(depthcli.InputError, depthcli.map_confidence, left, left, np.ones((40, 59)))
    refused(depthcli.InputError, depthcli.fuse_maps, left, left, [])
    found = depthcli.map_confidence(left, left, np.zeros((40, 60)), max_disparity=8)
    assert (found.probability > 0).all()  # 0 is a value
    refused(depthcli.ConfigError, found.kept, 0.5, 0.5)
    assert np.isfinite(found.kept(threshold=0.0)).all()
    assert np.count_nonzero(np.isfinite(found.kept(share=0.25))) >= 600
    assert np.isnan(found.kept(share=0.0)).all()


def test_a_map_outside_of_what_the_images_allow_is_found_wrong(two_scenes: Path):
    left, right = (read_image(two_scenes / NAMES[0] / f"{view}.png") for view in ("left", "right"))
    truth = read_pfm(two_scenes / NAMES[0] / "disp_left.pfm")
    for wrong in (0 * truth, truth / 64, truth / 16, 4 * truth):
        assert depthcli.map_confidence(left, right, wrong).probability.mean() < 0.1
    assert depthcli.map_confidence(left, right, truth).probability.mean() > 0.7


@pytest.mark.parametrize("command", [("confidence",), ("fuse", "maps"), ("evaluate",), ("export",)])
def test_16_bit_codes_of_other_programs_need_a_scale(two_scenes: Path, tmp_path: Path, capsys, command):
    """Codes of KITTI and OpenCV look alike; only a folder for KITTI's server, or a run, says whose they are."""
    name = NAMES[0]
    codes = np.rint(read_pfm(two_scenes / name / "disp_left.pfm") * 16).astype(np.uint16)
    write_png(tmp_path / "sgm" / f"{name}.png", codes)
    write_png(tmp_path / "sgm" / "delivery_area_1l.png", codes)
    write_png(tmp_path / "kitti" / "disp_0" / f"{name}.png", codes * np.uint16(16))

    def result(folder: str, *options: str) -> tuple[int, str]:
        maps, out = tmp_path / folder, ("-o", tmp_path / f"out_{folder}{len(options)}")
        line = ("-i", two_scenes, "--maps", maps, "--scenes", name)
        if command == ("export",):
            line = (maps, "--for", "eth3d", "--method", "x", "--seconds", "1")
        elif command == ("evaluate",):
            line = (maps, "--truth", two_scenes, "--scenes", name)
        return run(*command, *line, *out, *options), capsys.readouterr().err

    code, said = result("sgm")
    assert code in (2, 3)
    assert [word for word in (".png: uint16", str(codes.max()), "--scale 256") if word not in said] == [], said
    if command != ("export",):
        assert result("sgm", "--scale", "16")[0] == 0
        code, said = result("kitti")
        assert code == 0 and "uint16" not in said
        write_png(tmp_path / "large" / f"{name}.png", codes * np.uint16(16) | np.uint16(65520) * (codes == codes.min()))
        code, said = result("large")  # with 16 codes per pixel, disparities were wider than the image
        assert code == 0 and "divided by 256" in said
