"""Every script starts on a fresh checkout, by a Python that has nothing installed; those that test do so."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from depthcli.cli import app
from depthcli.device import opencl
from tests.command_line import ended
from tests.scenes import DATA

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = sorted(
    file.name
    for file in (ROOT / "scripts").iterdir()
    if file.is_file() and file.name[0] != "_" and file.read_bytes().startswith(b"#!/usr/bin/env python3")
)
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
BARE = (sys.executable, "-S", "-E")  # without site-packages and PYTHONPATH

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="the scripts are for sh")]


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout whose environment is ready: it holds the Python that runs the tests."""
    root = tmp_path_factory.mktemp("checkout")
    shutil.copytree(ROOT / "scripts", root / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    for name in ("depthcli", "configs", "tests"):
        (root / name).symlink_to(ROOT / name)
    (root / ".venv" / "bin").mkdir(parents=True)
    python = root / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\nPYTHONPATH="{root}" exec "{sys.executable}" "$@"\n')
    python.chmod(0o755)
    (line,) = re.findall("^wanted=.*", (root / "scripts" / "_env.sh").read_text(), re.M)
    ready = ended(0, *BARE, "-c", line.partition("-c '")[2].rpartition("'")[0], cwd=root).stdout
    for mark in ("ready", "ready-dev"):
        (root / ".venv" / mark).write_text(ready.rstrip("\n"))
    return root


def test_all_that_can_be_started_is_tested():
    files = [file for file in (ROOT / "scripts").iterdir() if file.is_file() and os.access(file, os.X_OK)]
    assert {file.name for file in files} == {*SCRIPTS, "demo", "test"}


@pytest.mark.system
@pytest.mark.parametrize("name", SCRIPTS)
def test_help_by_a_python_without_packages(checkout: Path, tmp_path: Path, name: str):
    environment = os.environ | {"PYTHON": sys.executable}
    done = ended(0, *BARE, checkout / "scripts" / name, "--help", cwd=tmp_path, env=environment)
    assert done.stdout.startswith(f"usage: {name} ") and done.stderr == ""
    usage = " ".join(done.stdout.partition("\n\n")[0].split())
    assert not re.search(r"\[-[^\]]*\.\.\.", usage), "an option with several words takes positional arguments"


def test_a_python_that_is_too_old_is_told_in_a_line(checkout: Path, tmp_path: Path):
    old = tmp_path / "python3"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo "Python 3.8.1" || exit 1\n')
    old.chmod(0o755)
    done = ended(1, *BARE, checkout / "scripts" / "bench", "--help", env=os.environ | {"PYTHON": str(old)})
    assert done.stderr == "depthcli needs Python 3.11 or newer; Python 3.8.1 is too old (set PYTHON)\n"


@pytest.mark.parametrize(("words", "lacks_real"), [([], False), (["--all"], False), ([], True)])
def test_the_demo_ends_with_the_addresses_of_its_pages(checkout: Path, tmp_path: Path, words, lacks_real: bool):
    """The real pair comes first; without it the demo shows generated scenes alone."""
    log = tmp_path / "log"
    tool = checkout / ".venv" / "bin" / "depthcli"
    code = '[ "$2" != --real ]' if lacks_real else "true"
    # One write a call: two of the commands run side by side.
    tool.write_text(f'#!/bin/sh\nline=$(printf "%s\\t" "$@")\necho "$line" >> "{log}"\n{code}\n')
    tool.chmod(0o755)
    done = ended(0, checkout / "scripts" / "demo", *words, "my demo", cwd=tmp_path)
    parts = ["generated"] if lacks_real else ["real", "generated"]
    pages = [tmp_path / "my demo" / part / "evaluation" / "report.html" for part in parts]
    shown = done.stderr.splitlines()
    assert shown[-len(pages) :] == [page.as_uri() for page in pages]
    previews = [line for line in shown if line.endswith("preview.png")]
    assert ("Motorcycle" in previews[0]) is not lacks_real
    called = [line.rstrip("\t").split("\t") for line in log.read_text().splitlines()]
    evaluations = [line for line in called if line[0] == "evaluate"]
    assert [line[line.index("--output") + 1] for line in evaluations] == [str(page.parent) for page in pages]
    assert all("--html" in line for line in evaluations)
    for name, *rest in called:
        get_command(app).get_command(None, name).make_context(name, rest)  # type: ignore[attr-defined, arg-type]


def script(code: int | None, name: str | Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return ended(code, sys.executable, ROOT / "scripts" / name, *words, cwd=ROOT, env=ENVIRONMENT)


@pytest.mark.first
@pytest.mark.system
@pytest.mark.skipif(not DATA.is_dir(), reason="no data sets in ../shared/data")
def test_the_page_on_the_thesis_is_up_to_date():
    """Some of the scenes, frames and registrations of each chapter are measured again."""
    script(0, "thesis", DATA, "--check")


@pytest.mark.system
def test_chapters_of_the_thesis_s_page_change_alone_and_missing_data_are_a_line(tmp_path: Path):
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("docs/thesis.md", "docs/figures.md", "README.md", "docs/static/thesis/measured.json"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in ("depthcli", "configs", "tests"):
        (tmp_path / name).symlink_to(ROOT / name)
    kept = tmp_path / "docs" / "static" / "thesis" / "measured.json"
    measured = json.loads(kept.read_text("utf-8"))
    for rows in measured["repetition"].values():
        rows["segments"]["nonocc"] = 99.0
    kept.write_text(json.dumps(measured), "utf-8")
    page = (tmp_path / "docs" / "thesis.md").read_text("utf-8")
    (tmp_path / "data").mkdir()
    for more in (["--chapter", "3"], ["--only", "v2", "--check"], ["--only", "v2"]):
        done = script(None, tmp_path / "scripts" / "thesis", tmp_path / "data", *more)
        assert "Traceback" not in done.stderr
        assert "middlebury_v2" in done.stderr and ("not checked" if "--check" in more else "skipped") in done.stderr
    second = slice(page.index("<!-- begin 2-tables -->"), page.index("## Chapter 3"))
    assert (tmp_path / "docs" / "thesis.md").read_text("utf-8")[second] == page[second]


def test_what_takes_minutes_starts_first(request: pytest.FixtureRequest):
    first = [item.get_closest_marker("first") is not None for item in request.session.items]
    assert first == sorted(first, reverse=True)


@pytest.mark.first
@pytest.mark.system
def test_killed_runs_end_with_the_same_bytes():
    """Two kills of each command: of one process, and of one with two workers."""
    done = script(0, "kill_test", "--kills", "22", "--preset", "opencv-sgbm", "--width", "160", "--scenes", "5")
    assert done.stdout.count("every re-run gave the bytes") == 11  # commands


@pytest.mark.system
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits as Linux has them")
def test_it_runs_as_in_a_container():
    done = script(None, "container_test", "--presets", "stereo/opencv-bm", "--width", "160")
    if done.returncode == 2:
        pytest.skip(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.first
@pytest.mark.system
@pytest.mark.parametrize(("device", "code"), [("cuda:77", 1), ("opencl", 0)])
def test_a_gpu_is_measured_section_by_section(tmp_path: Path, device: str, code: int):
    if device == "opencl" and not opencl.find_devices()[0]:
        pytest.skip(opencl.find_devices()[1])
    words = ("--tiny", "--seconds", "500", "--device", device, "--only", "device,pipelines,video")
    script(code, "gpu_check", tmp_path, *words)
    found = json.loads((tmp_path / "gpu_check.json").read_text())
    assert {"device", "pipelines", "video"} <= found.keys()
    assert all(bool(found[name].get("problem")) == bool(code) for name in ("device", "pipelines", "video"))
    assert "not run" in (tmp_path / "gpu_check.md").read_text()  # the other sections
    if code:
        return
    assert found["device"]["bandwidth"] > 0 and found["device"]["operations"] > 0
    fast, accurate = found["pipelines"]["rows"]
    assert fast["ms"] < accurate["ms"] and fast["density"] == 1
    kernels = {row["kernel"]: row for row in fast["kernels"]}
    assert kernels["paths"]["launches"] == 8 and kernels["paths"]["bandwidth_share"] > 0
    assert found["video"]["pairs"] > 0 and 0 < found["video"]["busy"] <= 100
