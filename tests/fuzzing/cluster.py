"""Cases of clusters: workers of this code and of others join before or during a run; only the first ones compute."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tests.fuzzing.common import Fault, chosen, results
from tests.fuzzing.inputs import ROOT
from tests.fuzzing.watching import limit

PACKAGE = ROOT / "depthcli"
# At the end of the module that writes maps: what a worker of other code computes differs.
_WRONG = "\n_right = write_pfm\n\n\ndef write_pfm(path, values):\n    _right(path, values + 1)\n"


def other_package(rng: np.random.Generator, folder: Path) -> str:
    """Write a depthcli that makes other maps, of the same version or another one; return what differs."""
    place = folder / "depthcli"
    shutil.copytree(PACKAGE, place, ignore=shutil.ignore_patterns("__pycache__"))
    what = chosen(rng, ["sources", "version", "a file more", "a file less", "a preset"])
    if what == "sources":
        with (place / "data/formats/disparity.py").open("a") as file:
            file.write(_WRONG)
    elif what == "version":
        head = place / "__init__.py"
        head.write_text(head.read_text("utf-8").replace('__version__ = "', '__version__ = "9'), "utf-8")
    elif what == "a file more":
        (place / "methods/stereo/cost/extra.py").write_text("")
    elif what == "a file less":
        files = sorted(path for path in (place / "methods").rglob("*.py") if path.name != "__init__.py")
        files[rng.integers(len(files))].unlink()
    else:
        path = place / "data/networks/accurate.json"
        path.write_text(path.read_text("utf-8").replace("1", "2", 1), "utf-8")
    return what


def cluster_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Run over a cluster whose workers join before and while it runs: what workers of other code make is never kept."""
    if importlib.util.find_spec("distributed") is None:
        return "cluster: no dask.distributed"
    kinds = [["right"], ["other"], ["other"], ["right", "other"], ["other", "right"]][int(rng.integers(5))]
    n_late = int(rng.integers(len(kinds) + 1))
    what = f"cluster of {kinds}, the last {n_late} late"
    if "other" in kinds:
        what += f", other {other_package(rng, folder / 'package')}"
    seconds = 0.45 * limit()  # for a scheduler to begin, and then for a run
    output, file = folder / "out", folder / "scheduler.json"
    processes: list[subprocess.Popen[bytes]] = []

    def started(module: str, *arguments: str | Path, package: Path = ROOT) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *sys.path])}
        with (folder / "log").open("ab") as log:
            command = [sys.executable, "-m", module, *map(str, arguments)]
            processes.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=environment))
        return processes[-1]

    def join(kind: str) -> None:
        package = ROOT if kind == "right" else folder / "package"
        options = ("--no-dashboard", "--no-nanny", "--nthreads", "1", "--scheduler-file", file)
        started("distributed.cli.dask_worker", *options, package=package)

    def wait_for(path: Path, pattern: str) -> None:
        end = time.monotonic() + seconds
        while not any(found.stat().st_size for found in path.glob(pattern)):
            if time.monotonic() > end or any(process.poll() for process in processes):
                raise Fault(f"{what}: no {pattern}: {(folder / 'log').read_text('utf-8', 'replace')[-400:]}")
            time.sleep(0.05)

    try:
        options = ("--no-dashboard", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file)
        started("distributed.cli.dask_scheduler", *options)
        wait_for(folder, file.name)
        for kind in kinds[: len(kinds) - n_late]:
            join(kind)
        log = folder / "run.log"
        with log.open("wb") as stream:
            address = file.read_text("utf-8").partition('"address": "')[2].partition('"')[0]
            command = ["stereo", "opencv-bm", "-i", base / "in", "-o", output, "--scheduler", address]
            environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
            run = subprocess.Popen([sys.executable, "-m", "depthcli", *map(str, command)], stdout=stream,
                                   stderr=stream, cwd=folder, env=environment)  # fmt: skip
        processes.append(run)
        for kind in kinds[len(kinds) - n_late :]:
            time.sleep(rng.uniform(0, 3))
            join(kind)
        try:
            code = run.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
    finally:
        for process in processes:
            process.kill()
            process.wait()
    outcome = f"{what}: exit code {code}: {' / '.join(log.read_text('utf-8', 'replace').splitlines()[-3:])}"
    allowed = {("right",): (0,), ("other",): (2,)}.get(tuple(kinds), (0, 2))
    if code not in allowed or "Traceback" in outcome:
        raise Fault(outcome)
    got, wanted = results(output), results(base / "run")
    maps = {name: text for name, text in got.items() if "/" in name and not name.startswith(".")}
    if (code == 0 and got != wanted) or any(wanted.get(name) != text for name, text in maps.items()):
        raise Fault(f"other files than those of one process: {outcome}")
    if kinds == ["other"] and maps:
        raise Fault(f"computed by other code: {outcome}")
    return f"cluster of {' and '.join(sorted(kinds))}: exit code {code}"
