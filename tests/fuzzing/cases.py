"""Cases of inputs: one file, option, table or behind-lying file is odd or changed, and what must hold afterwards."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np

from tests.damage import NAMES, WORDS, damaged, put_special
from tests.fuzzing.common import Fault, checked, chosen, content, results
from tests.fuzzing.inputs import ROOT, network, odd_json, others, write_pair


def spoilt(victim: Path, rng: np.random.Generator, pool: list[bytes]) -> str:
    """Damage a file, or put something else in its place; return what was done."""
    if rng.random() < 0.2:
        victim.unlink()
        return f"{put_special(victim, rng)} for {victim.name}"
    if victim.suffix == ".json" and rng.random() < 0.5:
        what, text = odd_json(victim.read_text("utf-8"), rng)
        victim.write_text(text, "utf-8")
    else:
        what, data = damaged(victim.read_bytes(), rng, pool)
        victim.write_bytes(data)
    return f"{what} of {victim.name}"


def command_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Run one command whose inputs, config, options or run folder are damaged in one place; return the outcome."""
    shutil.copytree(base / "in", folder / "in")
    bad, good = sorted(path.name for path in (folder / "in").iterdir() if path.is_dir())
    kind = chosen(rng, ["stereo", "evaluate", "resume", "config", "options", "name"])
    config, scenes, output = "opencv-bm", folder / "in", folder / "out"
    victims, extra, allowed = sorted((scenes / bad).iterdir()), [], {0, 3}
    if kind == "config":
        text = (ROOT / "configs/stereo/opencv-bm.yaml").read_bytes()
        (folder / "config.yaml").write_bytes(text)
        config, victims, allowed = str(folder / "config.yaml"), [folder / "config.yaml"], {0, 2, 3}
    elif kind in ("resume", "evaluate"):
        shutil.copytree(base / "run", output)
        victims = sorted(path for path in output.rglob("*") if path.is_file()) + (victims if kind == "evaluate" else [])
        allowed = {0, 2, 3}
        extra = ["--overwrite"] if kind == "resume" and rng.random() < 0.5 else []
    elif kind == "options":
        keys = ["--max-disparity", "--set=pipeline.block", "--set=block", "--max-memory", "--scenes", "--jobs",
                "--seed", "--set", "--shard", "--min-disparity", "--keep", "--name", "--layout"]  # fmt: skip
        value = WORDS[rng.integers(len(WORDS))].replace(b"\0", b"").decode("utf-8", "surrogateescape")
        extra, victims, allowed = [f"{chosen(rng, keys)}={value or 'a.b=1'}"], [], {0, 2, 3}
    elif kind == "name":
        (scenes / bad).rename(scenes / chosen(rng, NAMES))
        victims = []
    what = "odd"
    if victims:
        pool = [path.read_bytes() for path in sorted((base / "in" / good).iterdir())]
        what = spoilt(victims[rng.integers(len(victims))], rng, pool)
    before = content(folder, "out")
    arguments = ["stereo", config, "-i", scenes, "-o", output, *extra]
    if kind == "evaluate":
        arguments = ["evaluate", output, "--truth", scenes, "-o", folder / "out2"]
    code, outcome = checked(sorted(allowed), f"{kind}, {what} {extra}", *arguments)
    if before != content(folder, "out"):
        raise Fault(f"a file outside the output folder changed: {outcome}")
    if kind in ("stereo", "name") or (kind == "resume" and code == 0):
        wanted, got = (parent / good / "disp_left.pfm" for parent in (base / "run", output))
        if not got.is_file() or got.read_bytes() != wanted.read_bytes():
            raise Fault(f"the scene in order was lost: {outcome}")
    return f"{kind}: exit code {code}"


def prepared(kind: str, rng: np.random.Generator, folder: Path, base: Path) -> tuple[list[str | Path], list[Path]]:
    """Write the inputs of a command into a folder; return the command and the files that it reads."""
    inputs = folder / "in"
    if kind == "volumes":
        write_pair(inputs / "pair", rng)
        small = ("--set", "radius=2", "--set", "half_window=1")
        return ["register-confidence", "cost0", "-i", inputs, *small], sorted((inputs / "pair").iterdir())
    source = kind if kind in ("kinect", "transparent") else "in"
    shutil.copytree(base / source, inputs)
    read = [path for path in sorted(inputs.rglob("*")) if path.is_file() and "disp" not in path.name]
    if kind == "network":
        (folder / "network.json").write_text(network(), "utf-8")
        weights = f"maps.choice.weights={folder / 'network.json'}"
        return ["fuse", "accurate", "-i", inputs, "--set", weights], [folder / "network.json"] * 3 + read
    if kind in ("depth", "calibrated"):
        name = "calib.txt" if kind == "depth" else "rig.yaml"
        (folder / name).write_bytes(others()[name])
        if kind == "calibrated":
            files = [folder / name] * 3 + read
            return ["stereo", "opencv-bm", "-i", inputs, "--calibration", folder / name, "--max-disparity", "8"], files
        shutil.copytree(base / "run", folder / "run")
        maps = sorted((folder / "run").glob("*/*"))
        return ["depth", folder / "run", "-i", inputs, "--calibration", folder / name, "--ply"], [folder / name, *maps]
    presets = {"stereo": ("stereo", "opencv-bm"), "kinect": ("refine-kinect", "nearest"),
               "transparent": ("transparent", "nearest")}  # fmt: skip
    return [*presets[kind], "-i", inputs], read


def resumed_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Change one of the files that a run was made from, behind others too: started again it is like a fresh run."""
    kinds = ["volumes", "volumes", "volumes", "network", "depth", "calibrated", "stereo", "kinect", "transparent"]
    kind = chosen(rng, kinds)
    command, read = prepared(kind, rng, folder, base)
    output, fresh = folder / "out", folder / "fresh"
    code, outcome = checked((0, 3), f"resumed {kind}, intact", *command, "-o", output)
    records = {path: path.stat().st_mtime_ns for path in output.rglob("record.json")}
    if (code == 3 and kind != "calibrated") or not records:
        raise Fault(f"intact inputs: {outcome}")
    _, outcome = checked((code,), f"resumed {kind}, unchanged", *command, "-o", output)
    if records != {path: path.stat().st_mtime_ns for path in output.rglob("record.json")}:
        raise Fault(f"computed again though nothing changed: {outcome}")
    victim = read[rng.integers(len(read))]
    what = f"resumed {kind}, {spoilt(victim, rng, [path.read_bytes() for path in read[:5]])}"
    first, outcome = checked((0, 2, 3), what, *command, "-o", fresh)
    again, outcome = checked((0, 2, 3), what, *command, "-o", output, "--overwrite")
    if first != again:
        raise Fault(f"{outcome}; a fresh run: exit code {first}")
    # A run that is refused leaves the earlier one as it was.
    if first != 2 and (got := results(output)) != (wanted := results(fresh)):
        names = sorted({name for name, _ in set(got.items()) ^ set(wanted.items())})
        raise Fault(f"{outcome}; other than a fresh run: {names[:6]}")
    return f"resumed {kind}: exit code {first}"


def list_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Run over a table of pairs with colliding names, repeated columns and odd numbers: each row has its own result."""
    scenes = sorted(path for path in (base / "in").iterdir() if path.is_dir())
    stems = ["a", "2_a", "1_a", "A", "b", "2", "left", "a.b", "日本", "x" * 100]
    for stem in stems:
        scene = scenes[rng.integers(2)]
        for side in ("left", "right"):
            (folder / side).mkdir(exist_ok=True)
            shutil.copy(scene / f"{side}.png", folder / side / f"{stem}.png")
    columns = ["left", "right", *(c for c in ("name", "max_disparity", "min_disparity") if rng.random() < 0.6)]
    twice = rng.random() < 0.15
    columns += [chosen(rng, columns)] if twice else []
    rng.shuffle(columns)
    rows = []
    for _ in range(rng.integers(1, 6)):
        stem = chosen(rng, stems[:4] if rng.random() < 0.7 else stems)
        number = {"max_disparity": "8", "min_disparity": "0"}
        if rng.random() < 0.2:
            word = WORDS[rng.integers(len(WORDS))].decode("utf-8", "surrogateescape")
            number[chosen(rng, list(number))] = word if "\0" not in word else "-1e400"
        name = "" if rng.random() < 0.6 else chosen(rng, [*stems[:6], *NAMES])
        values = {"left": f"left/{stem}.png", "right": f"right/{stem}.png", "name": name, **number}
        rows.append([values[column] for column in columns])
    with (folder / "pairs.csv").open("w", encoding="utf-8", errors="surrogateescape", newline="") as file:
        csv.writer(file).writerows([columns, *rows])
    code, outcome = checked(
        (0, 2, 3), f"list of {len(rows)}", "stereo", "opencv-bm", "-i", folder / "pairs.csv", "-o", folder / "out",
        "--max-disparity=8" if "max_disparity" not in columns else "--threads=1",
    )  # fmt: skip
    if twice and code != 2:
        raise Fault(f"columns {columns} are not refused: {outcome}")
    if code == 2:
        return "list: exit code 2"
    report = json.loads((folder / "out" / "report.json").read_text("utf-8"))["scenes"]
    names = [row["scene"] for row in report if row["status"] == "done"]
    found = [path.parent.relative_to(folder / "out").as_posix() for path in (folder / "out").rglob("record.json")]
    sources = sorted(Path(row["source"]).name for row in report)
    if sorted(found) != sorted(names) or len(report) != len(rows) or len(set(names)) != len(names):
        raise Fault(f"{len(rows)} rows, {len(report)} in the report, maps of {found}: {outcome}")
    if code == 0 and sources != sorted(Path(row[columns.index("left")]).name for row in rows):
        raise Fault(f"not every row was computed: {sources}: {outcome}")
    return f"list: exit code {code}"
