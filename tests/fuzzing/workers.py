"""Clusters that workers of other code join at odd moments: what they would compute is never among the results."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import depthcli
from tests.fuzzing.common import Fault, chosen, results

_PACKAGE = Path(depthcli.__file__).parent
_SECONDS = 50  # of a run; it waits for workers, of which one that fits always comes
_SETTLED = 1.5  # seconds in which the run meets what is there


def edited_package(rng: np.random.Generator, folder: Path) -> str:
    """Copy the package to ``folder`` and change one thing, or nothing; return what was changed."""
    shutil.copytree(_PACKAGE, folder / "depthcli", ignore=shutil.ignore_patterns("__pycache__"))
    what = chosen(rng, ["nothing", "line", "line", "version", "new file", "lost file", "no newline", "number"])
    sources = sorted((folder / "depthcli").rglob("*.py"))
    file = sources[int(rng.integers(len(sources)))]
    text = file.read_text("utf-8")
    if what == "line":
        file.write_text(text + "\n# edited\n", "utf-8")
    elif what == "version":
        file = folder / "depthcli" / "__init__.py"
        file.write_text(file.read_text("utf-8") + '\n__version__ = "99.0"\n', "utf-8")
    elif what == "new file":
        (file.parent / "new_module_of_a_user.py").write_text("", "utf-8")
    elif what == "lost file":
        file = folder / "depthcli" / "commands" / "devices.py"
        file.unlink()
    elif what == "no newline":
        file = max(sources, key=lambda path: path.stat().st_size)
        file.write_text(file.read_text("utf-8").rstrip(), "utf-8")
    elif what == "number":  # the same length, and other disparities
        file = folder / "depthcli" / "core" / "maps.py"
        file.write_text(file.read_text("utf-8").replace(" = 1\n", " = 2\n", 1) + "\n", "utf-8")
    return what if what == "nothing" else f"{what} in {file.relative_to(folder)}"


@contextlib.contextmanager
def cluster(folder: Path) -> Iterator[tuple[str, Path]]:
    """Start a scheduler of dask.distributed; yield its address and the file by which workers find it."""
    folder.mkdir()
    file = folder / "scheduler.json"
    scheduler = started("dask_scheduler", file, _PACKAGE.parent, "--host", "127.0.0.1", "--port", "0")
    try:
        end = time.monotonic() + _SECONDS
        while not (file.exists() and file.stat().st_size):
            if scheduler.poll() is not None or time.monotonic() > end:
                raise Fault("late worker: no scheduler; is dask.distributed installed (extra 'cluster')?")
            time.sleep(0.05)
        yield json.loads(file.read_text())["address"], file
    finally:
        scheduler.kill()
        scheduler.wait()


def started(program: str, scheduler: Path, package: Path, *options: str) -> subprocess.Popen[bytes]:
    """Start a scheduler or worker that imports depthcli from the folder ``package``."""
    command = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard", "--scheduler-file", scheduler]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *sys.path])}
    return subprocess.Popen(
        [*command, *options], cwd=scheduler.parent, env=environment, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


def late_worker_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Run on a cluster that a worker of edited code joins; it computes nothing, and the run is whole in the end."""
    what = edited_package(rng, folder / "copy")
    places = [folder / "copy", *[_PACKAGE.parent] * int(rng.integers(0, 2))]
    random.Random(int(rng.integers(1 << 30))).shuffle(places)
    moments = sorted(float(rng.uniform(0, _SETTLED)) * int(rng.integers(0, 2)) for _ in places)
    command = [sys.executable, "-m", "depthcli", "stereo", "opencv-bm", "-i", base / "in", "-o", folder / "out"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(_PACKAGE.parent), *sys.path])}
    processes = []
    with cluster(folder / "dask") as (address, file):
        begun = time.monotonic()
        run = subprocess.Popen([*command, "--scheduler", address], env=environment, stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True, errors="replace")  # fmt: skip
        try:
            for moment, place in zip(moments, places, strict=True):
                time.sleep(max(0.0, begun + moment - time.monotonic()))
                processes.append(started("dask_worker", file, place, "--no-nanny", "--nthreads", "1"))
            text, _ = run.communicate(timeout=_SECONDS)
        except subprocess.TimeoutExpired:
            raise Fault(f"late worker, {what}, workers {len(places)}: no end") from None
        finally:
            for process in (run, *processes):
                process.kill()
                process.wait()
    same, alone = what == "nothing", len(places) == 1
    outcome = f"late worker, {what}, workers {len(places)}: exit code {run.returncode}: {text[-300:]!r}"
    allowed = {0} if same else {2} if alone else {0, 2}
    if run.returncode not in allowed or "Traceback" in text or "a bug in depthcli" in text:
        raise Fault(outcome)
    if run.returncode == 2 and "has another depthcli" not in text:
        raise Fault(f"not said: {outcome}")
    wanted = results(base / "run")
    if wrong := [name for name, content in results(folder / "out").items() if wanted.get(name) != content]:
        raise Fault(f"other bytes {wrong[:4]}: {outcome}")
    done = subprocess.run([*command, "-q"], env=environment, capture_output=True, text=True, check=False)
    if done.returncode or results(folder / "out") != wanted:
        raise Fault(f"not whole afterwards: {done.returncode} {done.stderr[-300:]!r}; {outcome}")
    return f"late worker, {what.partition(' in ')[0]}: exit code {run.returncode}"
