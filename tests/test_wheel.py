"""Wheels with kernels, as a user gets them: installed elsewhere, without a home, the first map compiles nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from depthcli.cli import main
from depthcli.kernels import jit, shipped  # noqa: F401  # jit first: it prepares numba

ROOT = Path(__file__).resolve().parent.parent
PRESET = "stereo/fast"
MAX_BYTES = 12e6  # of a wheel with the kernels of all presets


@pytest.mark.system
@pytest.mark.skipif(shipped.baseline() is None, reason="no wheels with kernels are made for this kind of machine")
def test_the_first_map_compiles_nothing(tmp_path: Path, made_scenes: Path):
    build = [sys.executable, str(ROOT / "scripts" / "build_wheel"), "--output", str(tmp_path / "dist")]
    subprocess.run([*build, "--presets", PRESET], check=True, capture_output=True)
    pure, native = sorted((tmp_path / "dist").glob("*.whl"), key=lambda path: "none-any" not in path.name)
    assert pure.stat().st_size < native.stat().st_size < MAX_BYTES

    # An environment that shares the dependencies, and nothing else, with this one.
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "env")], check=True)
    python = tmp_path / "env" / "bin" / "python"
    (packages,) = (tmp_path / "env" / "lib").glob("python*/site-packages")
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(packages)]
    subprocess.run([*install, str(native)], check=True)
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    (tmp_path / "home").mkdir()
    environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path / "home")}
    where = [str(python), "-c", "import depthcli; print(depthcli.__file__)"]
    installed = subprocess.run(where, env=environment, cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert installed.startswith(str(packages))

    command, _, name = PRESET.partition("/")
    scene = ["-i", str(made_scenes), "--scenes", "planes_0"]
    run = [str(python), "-m", "depthcli", command, name, *scene, "-o", str(tmp_path / "out")]
    done = subprocess.run(run, env=environment, cwd=tmp_path, check=True, capture_output=True, text=True)
    try:
        shipped.ShippedKernels(packages / "depthcli" / "kernels" / "compiled")
    except ValueError as error:
        pytest.skip(str(error))  # this processor is below the baseline: everything was compiled
    assert "compiling" not in done.stderr
    assert not list((tmp_path / "home").rglob("*.nb?"))
    assert main([command, name, *scene, "-o", str(tmp_path / "here")]) == 0  # compiled for this processor
    maps = [(tmp_path / out / "planes_0" / "disp_left.pfm").read_bytes() for out in ("out", "here")]
    assert maps[0] == maps[1]
