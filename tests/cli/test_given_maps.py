"""Commands on maps that were made before: confidence, fuse maps."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.core.maps import Status
from depthcli.io.formats.disparity import read_pfm, write_pfm
from depthcli.io.formats.images import read_image
from depthcli.io.formats.pictures import read_status
from tests.command_line import run


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.iterdir() if path.name != "record.json")
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes."""
    folder = tmp_path_factory.mktemp("pairs") / "scenes"
    size = ("--width", "120", "--height", "80", "--max-disparity", "16")
    assert run("sample", "-o", folder, "-n", "2", *size, "-q") == 0
    return folder


@pytest.fixture(scope="module")
def names(scenes: Path) -> list[str]:
    return sorted(path.name for path in scenes.iterdir() if (path / "left.png").is_file())


@pytest.fixture
def maps(scenes: Path, names: list[str], tmp_path: Path) -> Path:
    """The truth with a wrong block in every map, and -1 in its corner."""
    folder = tmp_path / "sgm"
    folder.mkdir()
    for name in names:
        values = read_pfm(scenes / name / "disp_left.pfm")
        values[20:40, 40:70] += 5
        values[60:70, 20:40] = -1
        write_pfm(folder / f"{name}.pfm", values)
    return folder


def test_confidence_writes_what_it_says(
    scenes: Path, names: list[str], maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "sure"
    words = ("confidence", "-i", scenes, "--maps", maps, "-o", out, "--keep", "0.8", "--measure", "rank")
    assert run(*words, "--measure", "census") == 0
    printed = capsys.readouterr()
    assert "% of the pixels are -1: taken as no value (--invalid nan keeps them)" in printed.err
    assert "expected right" in printed.out
    made = out / names[0]
    assert sorted(path.name for path in made.iterdir()) == sorted(
        ["confidence.pfm", "confidence.png", "confidence_census.pfm", "confidence_census.png", "confidence_rank.pfm",
         "confidence_rank.png", "disp_left.pfm", "disp_left.png", "preview.png", "record.json", "status.png"]
    )  # fmt: skip
    sure, kept = read_pfm(made / "confidence.pfm"), read_pfm(made / "disp_left.pfm")
    assert sure[22:38, 42:68].mean() < 0.4 < 0.8 < sure[42:58, 60:110].mean()
    known = np.count_nonzero(read_pfm(maps / f"{names[0]}.pfm") >= 0)
    assert np.count_nonzero(np.isfinite(kept)) == pytest.approx(0.8 * known, rel=0.01)
    assert (read_status(made / "status.png")[62:68, 22:38] == Status.NO_DATA).all()


def test_the_same_bytes_from_the_command_and_from_python(scenes: Path, names: list[str], maps: Path, tmp_path: Path):
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    words = ("confidence", "-i", scenes, "--maps", maps, "--measure", "all", "-q", "--max-disparity", "16")
    assert run(*words, "-o", one, "--threads", "1") == 0
    assert run(*words, "-o", two, "--jobs", "2") == 0
    best = ("fuse", "maps", "-i", scenes, "--maps", maps, "-q", "--max-disparity", "16", "-o", three)
    assert run(*best) == 0
    for name in names:
        assert digests(one / name) == digests(two / name)
        left, right = (read_image(scenes / name / f"{view}.png") for view in ("left", "right"))
        values = read_pfm(maps / f"{name}.pfm")
        values[values == -1] = np.nan
        depthcli.map_confidence(left, right, values, max_disparity=16, measures=["all"]).save(tmp_path / "py" / name)
        assert digests(tmp_path / "py" / name) == digests(one / name)
        depthcli.fuse_maps(left, right, [values], max_disparity=16).save(tmp_path / "pf" / name)
        assert digests(tmp_path / "pf" / name) == digests(three / name)


def test_several_maps_are_better_than_each(
    scenes: Path, names: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for k, run_name in enumerate(("upper", "lower")):
        (tmp_path / run_name).mkdir()
        for name in names:
            values = read_pfm(scenes / name / "disp_left.pfm")
            rows = slice(0, 40) if k == 0 else slice(40, 80)
            values[rows] = np.maximum(values[rows] - 4, 0)
            write_pfm(tmp_path / run_name / f"{name}.pfm", values)
    (tmp_path / "lower" / f"{names[1]}.pfm").unlink()
    words = ("fuse", "maps", "-i", scenes, "--maps", tmp_path / "upper", "--maps", tmp_path / "lower")
    assert run(*words, "-o", tmp_path / "best") == 0
    assert f"{names[1]}: warning: no map of lower: fused without it" in capsys.readouterr().err
    truth, visible = (read_pfm(scenes / names[0] / "disp_left.pfm"), read_image(scenes / names[0] / "mask_nonocc.png"))
    best = read_pfm(tmp_path / "best" / names[0] / "disp_left.pfm")
    assert np.isfinite(best).all()
    assert np.mean(np.abs(best - truth)[visible == 255] > 1) < 0.08


def test_a_changed_map_is_judged_again_and_others_are_not(scenes: Path, names: list[str], maps: Path, tmp_path: Path):
    words = ("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / "out", "-q")
    assert run(*words) == 0
    files = [tmp_path / "out" / name / "confidence.pfm" for name in names]
    before = [file.stat().st_mtime_ns for file in files]
    write_pfm(maps / f"{names[0]}.pfm", np.full((80, 120), 3, np.float32))
    assert run(*words) == 0
    after = [file.stat().st_mtime_ns for file in files]
    assert after[0] != before[0]
    assert after[1] == before[1]


def test_what_is_wrong_with_one_scene_fails_alone(
    scenes: Path, names: list[str], maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    first, second = (maps / f"{name}.pfm" for name in names)
    whole = first.read_bytes()
    rng = np.random.default_rng(0)
    cases: dict[str, tuple[str, object]] = {
        "sign": ("sgm: most disparities are negative", -rng.uniform(1, 9, (80, 120)).astype(np.float32)),
        "empty": ("sgm: no value at any pixel", np.full((80, 120), np.nan, np.float32)),
        "cut": ("damaged PFM", whole[: len(whole) // 2]),
        "gone": (f"no map of scene {names[0]}", None),
    }
    for case, (text, content) in cases.items():
        if content is None:
            first.unlink()
        elif isinstance(content, bytes):
            first.write_bytes(content)
        else:
            write_pfm(first, content)  # type: ignore[arg-type]
        assert run("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / case) == 3, case
        shown = capsys.readouterr().err
        (line,) = (line for line in shown.splitlines() if line.startswith(f"{names[0]}: ") and "warning" not in line)
        assert text in line, case
        assert (tmp_path / case / names[1] / "confidence.pfm").is_file()
        assert [path.name for path in (tmp_path / case / names[0]).iterdir()] == ["record.json"]
    assert second.is_file()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--keep", "0.8", "--threshold", "0.5"), "--keep SHARE and --threshold exclude each other"),
        (("--measure", "sharpness"), "--measure: no measure called 'sharpness'; one of: all, left_right"),
        (("--pattern", "other={scene}.pfm"), "--pattern other={scene}.pfm: no run is called 'other'; one of: sgm"),
    ],
)
def test_wrong_options_are_one_line(
    words: tuple[str, ...], text: str, scenes: Path, maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert run("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / "out", *words) == 2
    shown = capsys.readouterr().err
    assert text in shown
    assert len(shown.splitlines()) == 1


def test_names_of_kept_files_and_a_single_pair(scenes: Path, names: list[str], maps: Path, tmp_path: Path):
    folder = scenes / names[0]
    words = ("--left", folder / "left.png", "--right", folder / "right.png", "--maps", maps / f"{names[0]}.pfm")
    assert run("confidence", *words, "-o", tmp_path / "one", "-q", "--keep", "confidence.pfm") == 0
    (made,) = (path for path in (tmp_path / "one").iterdir() if path.is_dir())
    assert sorted(path.name for path in made.iterdir()) == ["confidence.pfm", "record.json"]


def test_witnesses_right_maps_and_evaluation(
    scenes: Path, names: list[str], maps: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    rights = tmp_path / "rights"
    for name in names:
        (rights / name).mkdir(parents=True)
        shutil.copy(scenes / name / "disp_right.pfm", rights / name)
    measures = ("--measure", "agreement", "--measure", "left_right")
    words = ("--witness", f"truth={scenes}", "--right-maps", rights, *measures)
    assert run("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / "out", *words, "--evaluate", "--html") == 0
    assert (tmp_path / "out" / "evaluation" / "report.html").is_file()
    agreement = read_pfm(tmp_path / "out" / names[0] / "confidence_agreement.pfm")
    assert agreement[24:36, 44:66].mean() < 0.5 < agreement[42:58, 60:110].mean()
    assert run("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / "x", "--right-maps", f"r={rights}",
               "--scale", "r=2", "--measure", "left_right", "-q") == 0  # fmt: skip
    (rights / names[0] / "disp_right.pfm").unlink()
    write_pfm(rights / names[1] / "disp_right.pfm", np.ones((80, 100), np.float32))
    assert run("confidence", "-i", scenes, "--maps", maps, "-o", tmp_path / "y", "--right-maps", rights) == 3
    shown = capsys.readouterr().err
    assert f"{names[0]}: warning: " in shown
    assert "no map of rights (right view): judged without it" in shown
    assert "disp_right.pfm: 100 x 80, but the images are 120 x 80" in shown
    consistent = read_pfm(tmp_path / "out" / names[0] / "confidence_left_right.pfm")
    assert np.nanmedian(consistent[42:58, 60:110]) > -0.6 > -3 > np.nanmedian(consistent[24:36, 44:66])
    capsys.readouterr()


def test_a_scene_without_a_right_image(scenes: Path, names: list[str], maps: Path, tmp_path: Path):
    folder = tmp_path / "left_only" / names[0]
    folder.mkdir(parents=True)
    for file in ("left.png", "disp_left.pfm", "meta.json"):
        shutil.copy(scenes / names[0] / file, folder)
    words = ("confidence", "-i", tmp_path / "left_only", "--maps", maps, "-o", tmp_path / "out")
    assert run(*words) == 0
    assert (tmp_path / "out" / names[0] / "confidence.pfm").is_file()
    assert run("fuse", "maps", *words[1:5], "-o", tmp_path / "fused", "-q") == 3


def test_python_speaks_of_keywords():
    left = np.random.default_rng(0).integers(0, 256, (40, 60), np.uint8)
    with pytest.raises(depthcli.ConfigError, match="no measure called 'x'"):
        depthcli.map_confidence(left, left, np.ones((40, 60)), measures=["x"])
    with pytest.raises(depthcli.InputError, match="disparity: 59 x 40, but the image is 60 x 40"):
        depthcli.map_confidence(left, left, np.ones((40, 59)))
    with pytest.raises(depthcli.InputError, match="1 to"):
        depthcli.fuse_maps(left, left, [])
    found = depthcli.map_confidence(left, left, np.full((40, 60), 1.0), max_disparity=8)
    with pytest.raises(depthcli.ConfigError, match="exclude"):
        found.kept(0.5, 0.5)
    assert np.isfinite(found.kept(threshold=0.0)).all()
    assert np.count_nonzero(np.isfinite(found.kept(share=0.25))) >= 600
