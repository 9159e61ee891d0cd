"""Damaged inputs of every kind: no traceback, the documented exit code, and the good scenes written."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from depthcli.io.formats.images import write_png
from tests import damage
from tests.command_line import contents, rows, run, statuses

PRESET = "opencv-bm"
Damage = Callable[[np.random.Generator, Path], None]


def flip(rng: np.random.Generator, scene: Path) -> None:
    file = scene / rng.choice(["left.png", "right.png"])
    file.write_bytes(damage.flipped(file.read_bytes(), rng))


def cut(rng: np.random.Generator, scene: Path) -> None:
    file = scene / rng.choice(["left.png", "right.png", "meta.json"])
    file.write_bytes(damage.truncated(file.read_bytes(), rng))


def swap(rng: np.random.Generator, scene: Path) -> None:
    """One file in the place of another."""
    one, other = rng.permutation(["left.png", "right.png", "meta.json", "disp_left.pfm", "mask_all.png"])[:2]
    (scene / one).rename(scene / "old")
    (scene / other).rename(scene / one)
    (scene / "old").rename(scene / other)


def wrong_kind(rng: np.random.Generator, scene: Path) -> None:
    (scene / "left.png").unlink()
    kind = rng.integers(4)
    if kind == 0:
        (scene / "left.png").mkdir()
    elif kind == 1:
        (scene / "left.png").symlink_to(scene / "absent")
    else:
        name, start = (("left.jpg", b"\xff\xd8\xff\xe0"), ("left.ppm", b"P6 99999 99999 255\n"))[kind - 2]
        (scene / name).write_bytes(start + rng.bytes(200))


def wrong_size(rng: np.random.Generator, scene: Path) -> None:
    shape = ((1, 1), (64, 95), (63, 96), (64, 96, 3))[rng.integers(4)]
    write_png(scene / rng.choice(["left.png", "right.png"]), np.full(shape, 77, np.uint16))


def tiny_pair(rng: np.random.Generator, scene: Path) -> None:
    """A pair that agrees, but is smaller than any window."""
    image = np.full(rng.integers(1, 7, 2), 77, np.uint8)
    write_png(scene / "left.png", image)
    write_png(scene / "right.png", image)


def bad_meta(rng: np.random.Generator, scene: Path) -> None:
    texts = ['{"max_disparity": NaN}', '{"max_disparity": 1e99}', "[]", "{", '{"disp_scale": 0}', "[" * 9999, "\x00"]
    (scene / "meta.json").write_text(rng.choice(texts))


def bad_truth(rng: np.random.Generator, scene: Path) -> None:
    """Ground truth that evaluation must refuse or live with."""
    file = scene / "disp_left.pfm"
    data = file.read_bytes()
    head = data.partition(b"-1\n")[0] + b"-1\n"
    values = [head + np.full(96 * 64, value, "<f4").tobytes() for value in (np.nan, -np.inf, 3e38)]
    made = (b"", damage.truncated(data, rng), data + b"\0", damage.flipped(data, rng), head + rng.bytes(4 * 96 * 64),
            b"Pf\n5 5\n-1\n" + bytes(100), *values)  # fmt: skip
    file.write_bytes(made[rng.integers(len(made))])


def bad_mask(rng: np.random.Generator, scene: Path) -> None:
    file = scene / rng.choice(["mask_nonocc.png", "mask_all.png", "mask_disc.png"])
    kind = rng.integers(3)
    if kind == 0:
        file.write_bytes(damage.truncated(file.read_bytes(), rng))
    else:
        write_png(file, np.zeros((64, 96) if kind == 1 else (3, 3), np.uint8))


IMAGES: list[Damage] = [flip, cut, swap, wrong_kind, wrong_size, tiny_pair, bad_meta]
TRUTHS: list[Damage] = [bad_truth, bad_truth, bad_mask]


def broken_folder(made: Path, folder: Path, kinds: list[Damage], seed: int, count: int) -> list[str]:
    """A folder of ``count`` damaged scenes between two good ones; names of the damaged."""
    rng, names = np.random.default_rng(seed), []
    for number in range(count):
        spoil = kinds[number % len(kinds)]
        names.append(f"m{number:02d}_{spoil.__name__}")
        shutil.copytree(made / "planes_0", folder / names[-1])
        spoil(rng, folder / names[-1])
    for good in ("a_good", "z_good"):
        shutil.copytree(made / "planes_1", folder / good)
    return names


@pytest.fixture(scope="module")
def reference(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of an undisturbed run on the good scene."""
    out = tmp_path_factory.mktemp("reference")
    assert run("stereo", PRESET, "-i", made_scenes, "--scenes", "planes_1", "-o", out, "-q") == 0
    return contents(out / "planes_1")


def check_run(output: Path, damaged: list[str], reference: dict[str, bytes], err: str) -> int:
    """Return the exit code that the run has to have."""
    found = rows(output)
    assert set(found) == {*damaged, "a_good", "z_good"}
    failed = {name: row["error"] for name, row in found.items() if row["status"] == "failed"}
    for name, error in failed.items():
        assert error and "bug" not in error and "\n" not in error, (name, error)
        assert [path.name for path in (output / name).iterdir()] == ["record.json"]
    assert "Traceback" not in err
    assert contents(output / "a_good") == contents(output / "z_good") == reference
    return 3 if failed else 0


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "kinds", [pytest.param(IMAGES, marks=pytest.mark.slow, id="images"), pytest.param(TRUTHS, id="truth")]
)
def test_damaged_inputs(made_scenes, tmp_path, reference, capfd, kinds: list[Damage], seed: int):
    """Without whole images a scene fails; the truth matters to the evaluation alone."""
    scenes, out, scores = (tmp_path / name for name in ("in", "out", "scores"))
    damaged = broken_folder(made_scenes, scenes, kinds, seed, 24 if kinds is IMAGES else 15)
    code = run("stereo", PRESET, "-i", scenes, "-o", out)
    assert code == check_run(out, damaged, reference, capfd.readouterr().err) == (3 if kinds is IMAGES else 0)
    code = run("evaluate", out, "--truth", scenes, "-o", scores)
    assert code == (3 if json.loads((scores / "scores.json").read_text())["failed"] else 0)
    assert "Traceback" not in capfd.readouterr().err and "a_good" in (scores / "scores.csv").read_text()


def test_loops_of_links(two_scenes, tmp_path, tool):
    scenes, out, loop = shutil.copytree(two_scenes, tmp_path / "in"), tmp_path / "r", tmp_path / "loop"
    victim = scenes / "planes_0" / "left.png"
    victim.unlink()
    for link in (victim, loop, tmp_path / "loop.yaml"):
        link.symlink_to(link.name)
    tool.told(3, "stereo", PRESET, "-i", scenes, "-o", out, "-q")
    assert statuses(out) == {"foreground_0": "done", "planes_0": "failed"}
    for arguments in (
        ("stereo", PRESET, "-i", loop, "-o", tmp_path / "x"),
        ("stereo", PRESET, "-i", two_scenes, "-o", loop),
        ("stereo", tmp_path / "loop.yaml", "-i", two_scenes, "-o", tmp_path / "x"),
        ("evaluate", loop, "--truth", two_scenes),
        ("evaluate", out, "--truth", loop),
    ):
        tool.told(2, *arguments)


@pytest.mark.parametrize("name", ["run.yaml", "report.json", "planes_0/record.json"])
def test_a_pipe_among_the_files_of_a_run_is_not_waited_for(made_scenes, tmp_path, tool, name: str):
    command = ("stereo", PRESET, "-i", made_scenes, "-o", tmp_path, "-q", "--scenes", "planes_0")
    assert run(*command) == 0
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    assert ("run.yaml cannot be read" in tool.err(2 if name == "run.yaml" else 0, *command)) == (name == "run.yaml")
    assert run(*command, "--overwrite") == 0
