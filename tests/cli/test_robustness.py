"""Damaged inputs of every kind: no traceback, the documented exit code, and the good scenes written."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from depthcli.cli import main
from depthcli.io.formats.images import write_png

PRESET = "opencv-bm"
Damage = Callable[[random.Random, Path], None]


def flip(rng: random.Random, scene: Path) -> None:
    """Some bytes of one image."""
    file = scene / rng.choice(["left.png", "right.png"])
    data = bytearray(file.read_bytes())
    for _ in range(rng.choice([1, 1, 3, 50])):
        data[rng.randrange(rng.choice([33, len(data)]))] ^= 1 << rng.randrange(8)  # 33: the header
    file.write_bytes(data)


def cut(rng: random.Random, scene: Path) -> None:
    file = scene / rng.choice(["left.png", "right.png", "meta.json"])
    data = file.read_bytes()
    file.write_bytes(data[: rng.choice([0, 1, rng.randrange(len(data))])])


def swap(rng: random.Random, scene: Path) -> None:
    """One file in the place of another."""
    names = ["left.png", "right.png", "meta.json", "disp_left.pfm", "mask_all.png"]
    a, b = rng.sample(names, 2)
    first, second = (scene / a).read_bytes(), (scene / b).read_bytes()
    (scene / a).write_bytes(second)
    (scene / b).write_bytes(first)


def wrong_kind(rng: random.Random, scene: Path) -> None:
    (scene / "left.png").unlink()
    rng.choice(
        [
            lambda: (scene / "left.png").mkdir(),
            lambda: (scene / "left.png").symlink_to(scene / "absent"),
            lambda: (scene / "left.png").write_text("not an image"),
            lambda: (scene / "left.jpg").write_bytes(b"\xff\xd8\xff\xe0" + rng.randbytes(200)),
            lambda: (scene / "left.ppm").write_bytes(b"P6 99999 99999 255\n" + rng.randbytes(50)),
            lambda: (scene / "left.tif").write_bytes(b"II*\0" + rng.randbytes(300)),
        ]
    )()


def wrong_size(rng: random.Random, scene: Path) -> None:
    shape = rng.choice([(1, 1), (64, 95), (63, 96), (96, 64), (1, 96), (64, 96, 3)])
    kind = rng.choice([np.uint8, np.uint16])
    write_png(scene / rng.choice(["left.png", "right.png"]), np.full(shape, 77, kind))


def tiny_pair(rng: random.Random, scene: Path) -> None:
    """A pair that agrees, but is smaller than any window."""
    shape = (rng.randint(1, 6), rng.randint(1, 6))
    for name in ("left.png", "right.png"):
        write_png(scene / name, np.full(shape, 77, np.uint8))


def bad_meta(rng: random.Random, scene: Path) -> None:
    text = rng.choice(
        ['{"max_disparity": NaN}', '{"max_disparity": -1}', '{"max_disparity": 1e99}', '{"max_disparity": "x"}', "[]",
         "null", "{", '{"max_disparity": 999999}', '{"disp_scale": 0}', "[" * 9999, '{"max_disparity": 95.5}', "\x00"]
    )  # fmt: skip
    (scene / "meta.json").write_text(text)


def bad_truth(rng: random.Random, scene: Path) -> None:
    """Ground truth that evaluation must refuse or live with."""
    file = scene / "disp_left.pfm"
    data = file.read_bytes()
    head, _, body = data.partition(b"-1\n")
    new = rng.choice(
        [
            b"",
            data[: rng.randrange(len(data))],
            data + b"\0",
            b"P5" + data[2:],
            head.replace(b"96", b"-96") + b"-1\n" + body,
            head.replace(b"96", b"99999999") + b"-1\n" + body,
            head + b"nan\n" + body,
            head + b"0\n" + body,
            head + b"1\n" + body,
            b"Pf\n" + rng.randbytes(300),
            head + b"-1\n" + np.full(96 * 64, np.nan, "<f4").tobytes(),
            head + b"-1\n" + np.full(96 * 64, -np.inf, "<f4").tobytes(),
            head + b"-1\n" + np.full(96 * 64, 3e38, "<f4").tobytes(),
            head + b"-1\n" + rng.randbytes(len(body)),
            b"Pf\n5 5\n-1\n" + bytes(100),
        ]
    )
    file.write_bytes(new)


def bad_mask(rng: random.Random, scene: Path) -> None:
    file = scene / rng.choice(["mask_nonocc.png", "mask_all.png", "mask_disc.png"])
    rng.choice(
        [
            lambda: file.write_bytes(b""),
            lambda: file.write_bytes(file.read_bytes()[:40]),
            lambda: write_png(file, np.zeros((64, 96), np.uint8)),
            lambda: write_png(file, np.full((3, 3), 255, np.uint8)),
        ]
    )()


IMAGES: list[Damage] = [flip, cut, swap, wrong_kind, wrong_size, tiny_pair, bad_meta]
TRUTHS: list[Damage] = [bad_truth, bad_truth, bad_mask]


def broken_folder(made: Path, folder: Path, kinds: list[Damage], seed: int, count: int) -> list[str]:
    """A folder of ``count`` damaged scenes between two good ones; names of the damaged."""
    rng = random.Random(seed)
    names = []
    for number in range(count):
        damage = kinds[number % len(kinds)]
        name = f"m{number:02d}_{damage.__name__}"
        shutil.copytree(made / "planes_0", folder / name)
        damage(rng, folder / name)
        names.append(name)
    shutil.copytree(made / "planes_1", folder / "a_good")
    shutil.copytree(made / "planes_1", folder / "z_good")
    return names


@pytest.fixture(scope="module")
def reference(made_scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The files of an undisturbed run on the good scene."""
    out = tmp_path_factory.mktemp("reference")
    assert main(["stereo", PRESET, "-i", str(made_scenes), "--scenes", "planes_1", "-o", str(out), "-q"]) == 0
    return {p.name: p.read_bytes() for p in (out / "planes_1").iterdir() if p.name != "record.json"}


def check_run(output: Path, damaged: list[str], reference: dict[str, bytes], code: int, err: str) -> None:
    rows = {row["scene"]: row for row in json.loads((output / "report.json").read_text())["scenes"]}
    assert set(rows) == {*damaged, "a_good", "z_good"}
    failed = [name for name, row in rows.items() if row["status"] == "failed"]
    assert code == (3 if failed else 0)
    for name in failed:
        assert rows[name]["error"]
        assert "bug" not in rows[name]["error"], (name, rows[name]["error"])
        assert "\n" not in rows[name]["error"]
        assert [path.name for path in (output / name).iterdir()] == ["record.json"]
    assert "Traceback" not in err
    for good in ("a_good", "z_good"):
        got = {p.name: p.read_bytes() for p in (output / good).iterdir() if p.name != "record.json"}
        assert got == reference


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_damaged_images(made_scenes, tmp_path, reference, capfd, seed: int):
    damaged = broken_folder(made_scenes, tmp_path / "in", IMAGES, seed, 24)
    code = main(["stereo", PRESET, "-i", str(tmp_path / "in"), "-o", str(tmp_path / "out")])
    assert code == 3
    check_run(tmp_path / "out", damaged, reference, code, capfd.readouterr().err)


@pytest.mark.parametrize("seed", range(2))
def test_damaged_truth(made_scenes, tmp_path, reference, capfd, seed: int):
    damaged = broken_folder(made_scenes, tmp_path / "in", TRUTHS, seed, 15)
    folders = ["-i", str(tmp_path / "in"), "-o", str(tmp_path / "out")]
    assert main(["stereo", PRESET, *folders]) == 0  # the images are whole, the truth does not matter
    check_run(tmp_path / "out", damaged, reference, 0, capfd.readouterr().err)
    evaluate = ["evaluate", str(tmp_path / "out"), "--truth", str(tmp_path / "in"), "-o", str(tmp_path / "e")]
    assert main(evaluate) in (0, 3)
    out, err = capfd.readouterr()
    assert "Traceback" not in err
    assert "a_good" in out or "a_good" in (tmp_path / "e" / "scores.csv").read_text()


CONFIG = """\
# a comment
pipeline: opencv_sgbm
block: 5
mode: sgbm
p1: null
uniqueness: 10
wls: {}
fill: true
"""


@pytest.mark.slow
def test_damaged_configs(made_scenes, tmp_path, capfd):
    rng = random.Random(0)
    file = tmp_path / "c.yaml"
    codes = []
    for number in range(60):
        data = bytearray(CONFIG.encode())
        for _ in range(rng.choice([1, 2, 5])):
            at = rng.randrange(len(data))
            kind = rng.randrange(4)
            if kind == 0:
                data[at] ^= 1 << rng.randrange(8)
            elif kind == 1:
                del data[at : at + rng.randrange(1, 9)]
            elif kind == 2:
                data[at:at] = rng.choice(
                    [b"\t", b"{", b"]", b"*x", b"&x ", b"!!", b": ", b"- ", b"\x00", b"\xff", b"'"]
                )
            else:
                data[at:at] = rng.choice([b".nan", b"1e999", b"-1", b"9" * 400, b"[" * 300, b"null", b"{a: b}"])
        file.write_bytes(data)
        out = tmp_path / f"out{number}"
        code = main(["stereo", str(file), "-i", str(made_scenes), "-o", str(out), "--scenes", "planes_0"])
        err = capfd.readouterr().err
        assert code in (0, 2), (data, err)
        assert "Traceback" not in err, data
        if code == 2:
            assert err.startswith((str(file), "depthcli: " + str(file))), err
            assert not out.exists()
        codes.append(code)
    assert 20 < codes.count(2) < 60  # some damage is harmless, most is not


def test_loops_of_links(made_scenes, tmp_path, capsys):
    shutil.copytree(made_scenes, tmp_path / "in")
    bad = sorted(path.name for path in (tmp_path / "in").iterdir() if path.is_dir())[0]
    victim = next((tmp_path / "in" / bad).glob("left.*"))
    victim.unlink()
    victim.symlink_to(victim.name)
    for name in ("loop", "loop.yaml"):
        (tmp_path / name).symlink_to(name)
    assert main(["stereo", PRESET, "-i", str(tmp_path / "in"), "-o", str(tmp_path / "r"), "-q"]) == 3
    assert f"{bad}: {victim}: cannot be read (Too many levels of symbolic links)" in capsys.readouterr().err
    done = [path.parent.name for path in (tmp_path / "r").glob("*/disp_left.pfm")]
    assert sorted([*done, bad]) == sorted(path.name for path in made_scenes.iterdir() if path.is_dir())
    loop, scenes = str(tmp_path / "loop"), str(made_scenes)
    for arguments in (
        ["stereo", PRESET, "-i", loop, "-o", str(tmp_path / "x")],
        ["stereo", PRESET, "-i", scenes, "-o", loop],
        ["stereo", f"{loop}.yaml", "-i", scenes, "-o", str(tmp_path / "x")],
        ["evaluate", loop, "--truth", scenes],
        ["evaluate", str(tmp_path / "r"), "--truth", loop],
    ):
        assert main(arguments) == 2, arguments
        assert "loop" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["run.yaml", "report.json", "planes_0/record.json"])
def test_a_pipe_among_the_files_of_a_run_is_not_waited_for(made_scenes, tmp_path, capsys, name: str):
    command = ["stereo", PRESET, "-i", str(made_scenes), "-o", str(tmp_path / "r"), "-q", "--scenes", "planes_*"]
    assert main(command) == 0
    (tmp_path / "r" / name).unlink()
    os.mkfifo(tmp_path / "r" / name)
    assert main(command) == (2 if name == "run.yaml" else 0)
    assert ("run.yaml cannot be read" in capsys.readouterr().err) == (name == "run.yaml")
    assert main([*command, "--overwrite"]) == 0
