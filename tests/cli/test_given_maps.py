"""Commands on maps that were made before: confidence, fuse maps."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import read_pfm, read_status, write_pfm
from depthcli.io.formats.images import read_image
from depthcli.problems.given_maps import peak_bytes
from tests.command_line import contents, rows, run
from tests.files import laid
from tests.golden import refused, told

NAMES = ["foreground_0", "planes_0"]


@pytest.fixture
def maps(two_scenes: Path, tmp_path: Path) -> Path:
    """The truth with a wrong block in every map, and -1 in its corner."""
    for name in NAMES:
        values = read_pfm(two_scenes / name / "disp_left.pfm")
        values[20:40, 40:70] += 5
        values[48:58, 20:40] = -1
        write_pfm(tmp_path / "sgm" / f"{name}.pfm", values)
    return tmp_path / "sgm"


def views(scene: Path) -> tuple[np.ndarray, np.ndarray]:
    return read_image(scene / "left.png"), read_image(scene / "right.png")


def test_confidence_writes_what_it_says(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    out = tmp_path / "sure"
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o", out, "--share", "0.8", "--measure", "rank")
    printed = tool.both(0, *words, "--measure", "census")
    assert "% of the pixels are -1: taken as no value (--invalid nan keeps them)" in printed.err
    assert "expected right" in printed.out
    made, row, given = out / NAMES[0], rows(out)[NAMES[0]], read_pfm(maps / f"{NAMES[0]}.pfm") >= 0
    maps_and_previews = ("probability", "confidence_census", "confidence_rank", "disp_left")
    assert {path.name for path in made.iterdir()} == {
        "bound.pfm", "preview.png", "record.json", "status.png",
        *(f"{name}.{end}" for name in maps_and_previews for end in ("pfm", "png")),
    }  # fmt: skip
    sure, kept, bound = (read_pfm(made / f"{name}.pfm") for name in ("probability", "disp_left", "bound"))
    wrong, right = np.s_[22:38, 42:68], np.s_[42:58, 60:90]
    assert sure[wrong].mean() < 0.4 < 0.8 < sure[right].mean() and bound[wrong].mean() > 2 > bound[right].mean()
    np.testing.assert_array_equal(np.isfinite(bound), given)
    assert row["median_bound"] == pytest.approx(np.median(bound[given]), abs=1e-3)
    assert np.count_nonzero(np.isfinite(kept)) == pytest.approx(0.8 * np.count_nonzero(given), rel=0.01)
    status = read_status(made / "status.png")
    assert (status[50:56, 22:38] == Status.NO_DATA).all()
    outside, occluded = ((status & bit) != 0 for bit in (Status.OUT_OF_RANGE, Status.OCCLUDED))
    assert outside.any() and row["hidden"] == pytest.approx(np.mean(outside | occluded), abs=1e-6)


def test_the_same_bytes_from_the_command_and_from_python(two_scenes: Path, maps: Path, tmp_path: Path):
    one, two, best = (tmp_path / name for name in ("one", "two", "best"))
    words = ("-i", two_scenes, "--maps", maps, "-q", "--max-disparity", "16", "-o")
    for line in (("confidence", *words, one, "--threads", "1"), ("confidence", *words, two, "--jobs", "2")):
        assert run(*line, "--measure", "all") == 0
    assert run("fuse", "maps", *words, best) == 0
    assert contents(one) == contents(two)
    assert "bound:\n  level: 0.9\n  within: 1.0\n" in (one / "run.yaml").read_text()
    for name in NAMES:
        values = read_pfm(maps / f"{name}.pfm")
        values[values == -1] = np.nan
        judged = depthcli.map_confidence(*views(two_scenes / name), values, max_disparity=16, measures=["all"])
        fused = depthcli.fuse_maps(*views(two_scenes / name), [values], max_disparity=16)
        for made, of_command in ((judged, one), (fused, best)):
            made.save(tmp_path / "py" / of_command.name / name)
            assert contents(tmp_path / "py" / of_command.name / name) == contents(of_command / name)


def same_but_where_filled(judged: depthcli.MapConfidence, folder: Path) -> None:
    """Compare a map's bounds with those of a run, which has tables of its own, one for filled pixels."""
    bound, filled = read_pfm(folder / "bound.pfm"), (read_status(folder / "status.png") & Status.FILLED) > 0
    ranks = [np.argsort(np.argsort(one[~filled], kind="stable")) for one in (judged.bound, bound)]
    assert np.corrcoef(ranks)[0, 1] > 0.99  # both grow with the same odds
    assert filled.any() and not filled.all()


def test_stereo_and_fuse_write_the_same_bounds_as_python_and_confidence(two_scenes: Path, tmp_path: Path):
    one = ("-i", two_scenes, "--scenes", NAMES[0], "-q")
    wanted = ("--bound", "--level", "0.8", "--max-disparity", "16")
    pair = views(two_scenes / NAMES[0])
    for command, preset, function in (("stereo", "fast", depthcli.stereo), ("fuse", "accurate", depthcli.fuse)):
        assert run(command, preset, *one, *wanted, "--set", "confidence=[lrc]", "-o", tmp_path / command) == 0
        made, row = tmp_path / command / NAMES[0], rows(tmp_path / command)[NAMES[0]]
        found = function(*pair, 16, preset, bound={"level": 0.8}, confidence=["lrc"])
        found.save(tmp_path / "py" / command / NAMES[0])
        assert contents(tmp_path / "py" / command / NAMES[0]) == contents(made)
        assert row["median_bound"] == pytest.approx(np.median(found.bound), abs=1e-3)
        assert row["expected_right"] == pytest.approx(found.probability.mean(), abs=1e-3)
        same_but_where_filled(depthcli.map_confidence(*pair, found.values, max_disparity=16, level=0.8), made)
    maps = ("--maps", tmp_path / "stereo", "--maps", tmp_path / "fuse", "-o", tmp_path / "maps")
    assert run("fuse", "maps", *one, *maps, *wanted) == 0
    best = tmp_path / "maps" / NAMES[0]
    values = read_pfm(best / "disp_left.pfm")
    same_but_where_filled(depthcli.map_confidence(*pair, values, max_disparity=16, level=0.8), best)
    assert not depthcli.stereo(*pair, 16, "fast").bound


def test_bounds_move_with_the_search_range(two_scenes: Path):
    left, right = views(two_scenes / NAMES[0])
    for low in (-4, 3):
        found = depthcli.stereo(left, np.roll(right, low, axis=1), 16 - low, "fast", min_disparity=-low, bound=True)
        assert found.bound.shape == found.values.shape
        np.testing.assert_array_equal(np.isnan(found.bound), np.isnan(found.values))
        assert np.nanmedian(found.bound) < 1 and found.probability.mean() > 0.7
        assert (found.bound[:, : max(-low, 0)] == 16).all()  # without a match they may be off by the whole range


def test_pixels_that_no_map_has_measured_are_filled(two_scenes: Path, tmp_path: Path, tool):
    """What was filled in all runs that are fused is filled in their best map; depth leaves it out."""
    words, runs = ("-i", two_scenes, "--scenes", NAMES[0], "-q", "-o"), ("fast", "opencv-sgbm", "best")
    for preset in runs[:2]:
        assert run("stereo", preset, *words, tmp_path / preset) == 0
    maps = [word for preset in runs[:2] for word in ("--maps", tmp_path / preset)]
    assert run("fuse", "maps", *words, tmp_path / "best", *maps) == 0
    status = [read_status(tmp_path / each / NAMES[0] / "status.png") for each in runs]
    one, other, best = ((each & Status.FILLED) != 0 for each in status)
    assert (one & other).mean() > 0.01
    assert best[one & other].mean() > 0.9 and best[~(one & other)].mean() < 0.03
    assert rows(tmp_path / "best")[NAMES[0]]["measured"] == round(float(np.mean(~best)), 6)
    # A map that one of the runs lacks is said, and not needed.
    lower = laid(tmp_path / "lower", {f"{NAMES[0]}.pfm": read_pfm(two_scenes / NAMES[0] / "disp_left.pfm")})
    tool.told(0, "fuse", "maps", "-i", two_scenes, "--maps", two_scenes, "--maps", lower, "-o", tmp_path / "lacking")


def test_a_changed_map_is_judged_again_and_others_are_not(two_scenes: Path, maps: Path, tmp_path: Path):
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o", tmp_path / "out", "-q")

    def stamps(*more: str) -> list[int]:
        assert run(*words, *more) == 0
        return [(tmp_path / "out" / name / "probability.pfm").stat().st_mtime_ns for name in NAMES]

    before = stamps()
    write_pfm(maps / f"{NAMES[0]}.pfm", np.full((64, 96), 3, np.float32))
    after = stamps()
    assert after[0] != before[0] and after[1] == before[1]
    assert all(stamp != old for stamp, old in zip(stamps("--invalid", "7"), after, strict=True))  # read in another way


def test_what_is_wrong_with_one_scene_fails_alone(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    words, first = ("confidence", "-i", two_scenes, "--maps", maps, "-q", "-o"), maps / f"{NAMES[0]}.pfm"
    whole, negative = first.read_bytes(), -np.random.default_rng(0).uniform(1, 9, (64, 96)).astype(np.float32)
    for case, content in {"sign": negative, "empty": 0 * negative + np.nan, "cut": whole[:9999], "gone": None}.items():
        first.unlink()
        laid(maps, {} if content is None else {first.name: content})
        tool.told(3, *words, tmp_path / case)
        assert (tmp_path / case / NAMES[1] / "probability.pfm").is_file()
        assert [path.name for path in (tmp_path / case / NAMES[0]).iterdir()] == ["record.json"]
    folder = shutil.copytree(two_scenes, tmp_path / "scenes")
    shutil.copy(folder / NAMES[0] / "left.png", folder / NAMES[0] / "left.jpg")  # a folder that cannot be used
    words = ("confidence", "-i", folder, "--maps", maps, "-o", tmp_path / "out")
    tool.told(3, *words, "--evaluate")
    assert (tmp_path / "out" / NAMES[1] / "probability.pfm").is_file()
    tool.told(2, *words, "--pattern", "other={scene}.pfm")  # of no run


def test_a_single_pair_and_a_scene_without_a_right_image(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    folder = two_scenes / NAMES[0]
    words = ("--left", folder / "left.png", "--right", folder / "right.png", "--maps", maps / f"{NAMES[0]}.pfm")
    assert run("confidence", *words, "-o", tmp_path / "one", "-q", "--keep", "probability.pfm") == 0
    assert {path.name for path in (tmp_path / "one").glob("*/*")} == {"probability.pfm", "record.json"}
    shutil.copytree(two_scenes, tmp_path / "in", ignore=shutil.ignore_patterns("right*", NAMES[1], "mask*"))
    words = ("-i", tmp_path / "in", "--maps", maps, "-q", "-o")
    assert run("confidence", *words, tmp_path / "out") == 0
    assert (tmp_path / "out" / NAMES[0] / "probability.pfm").is_file()
    assert run("fuse", "maps", *words, tmp_path / "fused") == 3
    tool.told(3, "confidence", *words, tmp_path / "witnesses", "--witness", f"truth={two_scenes}")
    one, given = ("confidence", "-i", two_scenes, "-q", "-o", tmp_path / "o", "--maps"), maps / f"{NAMES[0]}.pfm"
    tool.told(2, *one, given)  # one map for both
    planned = (*one, given, "--scenes", NAMES[0], "--dry-run", "--json", "--max-disparity")
    low, high = (json.loads(tool.out(0, *planned, top))["scenes"][0]["memory"] for top in ("20", "90"))
    assert high - low == peak_bytes((64, 96), 90, 1) - peak_bytes((64, 96), 20, 1) > 0
    names = {f"net/{name}_{what}.pfm": b"no map" for name in NAMES for what in ("flow", "guess")}
    laid(tmp_path, names | {f"net/{name}_flow.pfm": np.full((64, 96), 3, np.float32) for name in NAMES})
    tool.told(0, *(word for word in one if word != "-q"), tmp_path / "net")  # another program's names


def test_witnesses_right_maps_and_evaluation(two_scenes: Path, maps: Path, tmp_path: Path, tool):
    rights, out = tmp_path / "rights", tmp_path / "out"
    shutil.copytree(two_scenes, rights, ignore=shutil.ignore_patterns("*left*", "*.json", "*.yaml", "*.png"))
    words = ("confidence", "-i", two_scenes, "--maps", maps, "-o")
    measures = ("--measure", "agreement", "--measure", "left_right")
    more = ("--witness", f"truth={two_scenes}", "--right-maps", rights, *measures, "--evaluate", "--html")
    assert run(*words, out, *more) == 0
    assert (out / "evaluation" / "report.html").is_file()
    agree, consistent = (read_pfm(out / NAMES[0] / f"confidence_{name}.pfm") for name in ("agreement", "left_right"))
    wrong, right = np.s_[24:36, 44:66], np.s_[42:58, 60:90]
    assert agree[wrong].mean() < 0.5 < agree[right].mean()
    assert np.nanmedian(consistent[right]) > -0.6 > -3 > np.nanmedian(consistent[wrong])
    assert run(*words, tmp_path / "x", "--right-maps", f"r={rights}", "--scale", "r=2", *measures[2:], "-q") == 0
    (rights / NAMES[0] / "disp_right.pfm").unlink()
    write_pfm(rights / NAMES[1] / "disp_right.pfm", np.ones((64, 80), np.float32))
    tool.told(3, *words, tmp_path / "y", "--right-maps", rights)


def test_python_speaks_of_keywords():
    left = np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8)
    refused(depthcli.ConfigError, depthcli.map_confidence, left, left, np.ones((40, 60)), measures=["x"])
    refused(depthcli.ConfigError, depthcli.map_confidence, left, None, np.ones((40, 60)), witnesses=[left])
    for wrong in (np.ones((40, 59)), np.ones((2, 40, 60)), np.full((40, 60), np.nan)):
        refused(depthcli.InputError, depthcli.map_confidence, left, left, wrong)
    refused(depthcli.InputError, depthcli.map_confidence, left, left, np.ones((40, 60)), max_disparity=0)
    refused(depthcli.InputError, depthcli.fuse_maps, left, left, [])
    found = depthcli.map_confidence(left, left, np.zeros((40, 60)), max_disparity=8)
    assert (found.probability > 0).all()  # 0 is a value
    for shares in ((0.5, 0.5), (1.5,), (None, -0.1)):
        refused(depthcli.ConfigError, found.kept, *shares)
    assert np.isfinite(found.kept(threshold=0.0)).all()
    assert np.count_nonzero(np.isfinite(found.kept(share=0.25))) >= 600
    assert np.isnan(found.kept(share=0.0)).all()
    assert found._repr_png_().startswith(b"\x89PNG")
    # Where the images tell nothing of the range, the maps do: 2 pixels of 2400 have a larger value.
    flat, values = np.full((40, 60), 9, np.uint8), np.full((40, 60), 5.0)
    values[0, :2] = 50
    found = depthcli.map_confidence(flat, flat, values)
    assert found.max_disparity == 5
    told("\n".join(found.warnings))
    found = depthcli.map_confidence(left, left, np.full((40, 60), np.nan), witnesses=[values], max_disparity=8)
    told("\n".join(found.warnings))
    assert np.isnan(found.values).all()


def test_a_map_outside_of_what_the_images_allow_is_found_wrong(two_scenes: Path):
    pair, truth = views(two_scenes / NAMES[0]), read_pfm(two_scenes / NAMES[0] / "disp_left.pfm")
    for wrong in (0 * truth, truth / 64, truth / 16, 4 * truth):
        assert depthcli.map_confidence(*pair, wrong).probability.mean() < 0.1
    assert depthcli.map_confidence(*pair, truth).probability.mean() > 0.7


@pytest.mark.parametrize("command", [("confidence",), ("fuse", "maps"), ("evaluate",), ("export",)])
def test_16_bit_codes_of_other_programs_need_a_scale(two_scenes: Path, tmp_path: Path, capsys, command):
    """Codes of KITTI and OpenCV look alike; only a folder for KITTI's server, or a run, says whose they are."""
    name = f"{NAMES[0]}.png"
    codes = np.rint(read_pfm(two_scenes / NAMES[0] / "disp_left.pfm") * 16).astype(np.uint16)
    large = codes * np.uint16(16) | np.uint16(65520) * (codes == codes.min())
    laid(tmp_path, {f"sgm/{name}": codes, "sgm/delivery_area_1l.png": codes, f"large/{name}": large})
    laid(tmp_path, {f"kitti/disp_0/{name}": codes * np.uint16(16)})

    def result(folder: str, *options: str) -> tuple[int, str]:
        maps, out = tmp_path / folder, ("-o", tmp_path / f"out_{folder}{len(options)}")
        line = {
            "export": (maps, "--for", "eth3d", "--method", "x", "--seconds", "1"),
            "evaluate": (maps, "--truth", two_scenes, "--scenes", NAMES[0]),
        }.get(command[0], ("-i", two_scenes, "--maps", maps, "--scenes", NAMES[0]))
        return run(*command, *line, *out, *options), capsys.readouterr().err

    code, said = result("sgm")
    assert code in (2, 3) and all(word in said for word in (".png: uint16", str(codes.max()), "--scale 256")), said
    if command != ("export",):
        assert result("sgm", "--scale", "16")[0] == 0
        code, said = result("kitti")
        assert code == 0 and "uint16" not in said
        code, said = result("large")  # with 16 codes per pixel, disparities were wider than the image
        assert code == 0 and "divided by 256" in said
