"""Cases of names and folders: long names, shards of other inputs, files that are not ours, results inside of inputs."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from tests.damage import NAMES
from tests.fuzzing.common import REPORTS, Fault, checked, chosen, content, results
from tests.fuzzing.inputs import others


def name_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Use a hostile or long name for a scene, an option or a folder; whatever a folder may be called is done."""
    unit = chosen(rng, ["n", "é", "語", "🙂", "-", "%", " x", "'"])
    length = int(rng.choice([1, 100, 230, 242, 250, 255, 256, 300, 4000]))
    name = (unit * length).encode()[:length].decode("utf-8", "ignore").strip() or "x"
    name = name if rng.random() < 0.7 else chosen(rng, NAMES)
    fits = len(os.fsencode(name)) <= 255
    scenes, what = folder / "in", f"name {name[:20]!r} of {len(os.fsencode(name))} bytes"
    shutil.copytree(base / "in", scenes)
    bad, good = sorted(path for path in scenes.iterdir() if path.is_dir())
    place = chosen(rng, ["scene", "scene", "run", "option", "truth", "input", "output", "single"])
    stereo = ["stereo", "opencv-bm"]
    if place == "scene" and fits:
        bad.rename(scenes / name)
        hidden = name.startswith(".")
        code, outcome = checked((0,), what, *stereo, "-i", scenes, "-o", folder / "out")
        if not hidden and not (folder / "out" / name / "disp_left.pfm").is_file():
            raise Fault(f"not done: {outcome}")
        code, outcome = checked((0,), what, "evaluate", folder / "out", "--truth", scenes, "-o", folder / "out2")
        if not (folder / "out2").exists():
            raise Fault(f"not evaluated: {outcome}")
    elif place in ("scene", "single"):
        pair = ["--left", good / "left.png", "--right", good / "right.png", "--max-disparity", "8", f"--name={name}"]
        code, outcome = checked((0, 2, 3), what, *stereo, *pair, "-o", folder / "out")
        if fits and "/" not in name and not name.startswith(".") and code:
            raise Fault(f"refused: {outcome}")
    elif place in ("run", "truth"):
        run_folder = folder / name if place == "run" else base / "run"
        if fits and place == "run":
            shutil.copytree(base / "run", run_folder)
        truth = scenes if place == "run" else folder / name
        code, outcome = checked((0, 2, 3), what, "evaluate", run_folder, "--truth", truth, "-o", folder / "out2")
        if fits and place == "run" and code:
            raise Fault(f"not evaluated: {outcome}")
    elif place == "option":
        option = chosen(rng, ["--scenes", "--layout", "--keep", "--set", "--calibration"])
        code, outcome = checked((0, 2, 3), what, *stereo, "-i", scenes, "-o", folder / "out", f"{option}={name}")
    else:
        source, target = (folder / name, folder / "out") if place == "input" else (scenes, folder / name)
        code, outcome = checked((0, 2, 3), what, *stereo, "-i", source, "-o", target)
        if place == "output" and fits and "\0" not in name and code:
            raise Fault(f"refused: {outcome}")
    return f"name of {place}: exit code {code}"


def shard_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Fill one run from shards, some of other inputs or another config: those are refused, the others are one run."""
    shutil.copytree(base / "in", folder / "in")
    second, config, what = folder / "in", "opencv-bm", "same"
    kind = rng.random()
    if kind < 0.25:
        second, what = folder / "moved", "the same, moved"
        shutil.copytree(base / "in", second)
    elif kind < 0.5:
        second, what = base / "other", "other inputs"
    elif kind < 0.6:
        config, what = "opencv-sgbm", "another config"
    elif kind < 0.7:
        second, what = folder / "more", "more scenes"
        shutil.copytree(base / "in", second)
        shutil.copytree(next(path for path in sorted(second.iterdir()) if path.is_dir()), second / "zz")
    numbers = [1, 2] if rng.random() < 0.5 else [2, 1]
    checked((0,), f"shards, {what}", "stereo", "opencv-bm", "-i", folder / "in", "-o", folder / "out",
            "--shard", f"{numbers[0]}/2")  # fmt: skip
    late, outcome = checked((0, 2), f"shards, {what}", "stereo", config, "-i", second, "-o", folder / "out",
                            "--shard", f"{numbers[1]}/2")  # fmt: skip
    merged, text = checked((0, 2, 3), f"shards, {what}", "merge", folder / "out")
    if what == "same":
        if late or merged or results(folder / "out") != results(base / "run"):
            raise Fault(f"not the run of one process: {outcome}; {text}")
    elif what != "the same, moved" and not late and not merged:
        raise Fault(f"mixed without a word: {outcome}; {text}")
    return f"shards, {what}: {'refused' if late or merged else 'joined'}"


def foreign_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Write into a folder that holds other files under the names of results: they stay as they are."""
    shutil.copytree(base / "in", folder / "in")
    command, written = chosen_command(rng, folder, base)
    output = folder / "out"
    checked((0,), "foreign, trial", *command, "-o", folder / "trial")
    names = [name for name in content(folder / "trial") if (folder / "trial" / name).is_file()]
    own = [name for name in names if "/" in name and "record.json" not in name] or names
    theirs, linked = [], rng.random() < 0.3
    for name in {chosen(rng, own) for _ in range(rng.integers(1, 4))} | {"notes/mine.txt", "mine.txt"}:
        place = output / name
        place.parent.mkdir(parents=True, exist_ok=True)
        target = folder / "theirs" / name if linked else place
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(rng.bytes(50))
        if linked:
            place.symlink_to(target)
        theirs.append((target, target.read_bytes(), place))
    code, outcome = checked((0, 2, 3), f"foreign, {'linked' if linked else 'plain'}", *command, "-o", output)
    lost = [str(place) for target, data, place in theirs if target.read_bytes() != data or place.is_symlink() != linked]
    if lost:
        raise Fault(f"replaced {[Path(name).relative_to(output).as_posix() for name in lost]}: {outcome}")
    again, outcome = checked((0, 2, 3), "foreign, again", *command, "-o", output)
    if again != code or any(target.read_bytes() != data for target, data, _ in theirs):
        raise Fault(f"foreign, the second time: {outcome}")
    return f"foreign files of {written}: exit code {code}"


def chosen_command(rng: np.random.Generator, folder: Path, base: Path) -> tuple[list[str | Path], str]:
    """Return a command that writes a folder, and its name."""
    (folder / "calib.txt").write_bytes(others()["calib.txt"])
    commands: dict[str, list[str | Path]] = {
        "stereo": ["stereo", "opencv-bm", "-i", folder / "in"],
        "fuse": ["fuse", "thesis/consensus", "-i", folder / "in"],
        "depth": ["depth", base / "run", "-i", folder / "in", "--calibration", folder / "calib.txt"],
        "sample": ["sample", "-n", "2", "--width", "64", "--height", "48", "--max-disparity", "8"],
        "refine-kinect": ["refine-kinect", "nearest", "-i", base / "kinect"],
    }
    name = chosen(rng, list(commands))
    return commands[name], name


def inside_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Write results inside of the input, or an input's folder: runs are alike, and no input is changed."""
    shutil.copytree(base / "in", folder / "in")
    bad = sorted(path.name for path in (folder / "in").iterdir() if path.is_dir())[0]
    before = content(folder / "in")
    output = folder / "in" / chosen(rng, ["out", "runs/a", f"{bad}/out", ".", bad, "in", "zz"])
    command: list[str | Path] = ["stereo", "opencv-bm", "-i", folder / "in", "-o", output]
    if rng.random() < 0.4:
        files = [folder / "in" / bad / f"{side}.png" for side in ("left", "right")]
        command = ["stereo", "opencv-bm", "--left", files[0], "--right", files[1], "--max-disparity", "8",
                   f"--name={chosen(rng, [bad, 'in', 'x'])}", "-o", output]  # fmt: skip
    what = f"inside {output.relative_to(folder)}"
    code, outcome = checked((0, 2, 3), what, *command)
    first = results(output) if output.exists() else {}
    _, outcome = checked((code,), what, *command)
    if changed := [name for name, text in before.items() if content(folder / "in").get(name) != text]:
        changed = [name for name in changed if Path(name).name not in {*REPORTS, "run.yaml"}]
        if changed:
            raise Fault(f"changed {changed[:4]}: {outcome}")
    if (results(output) if output.exists() else {}) != first:
        raise Fault(f"the second run made something else: {outcome}")
    return f"inside an input: exit code {code}"
