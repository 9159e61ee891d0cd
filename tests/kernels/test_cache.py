"""Where compiled kernels go, and that nothing is compiled twice."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.kernels import _jit

ROOT = Path(__file__).parents[2]

KERNEL = """
import numpy as np
from depthcli.kernels._jit import jit, parallel_jit

@jit
def inner(x):
    return x + 1

@jit
def total(a):
    s = 0
    for i in range(a.size):
        s += inner(a[i])
    return s
"""

USE = """
import sys
sys.path.insert(0, sys.argv[1])
from depthcli.kernels._jit import CompileWatch, cache_folder
said = []
with CompileWatch(lambda: said.append(1)) as watch:
    import numpy as np, toy_kernel
    assert toy_kernel.total(np.arange(5)) == 15
print(watch.kernels, len(said), watch.seconds > 0, cache_folder())
"""


def use(tmp_path: Path, **environment: str) -> tuple[int, int, bool, Path]:
    (tmp_path / "source").mkdir(exist_ok=True)
    if not (tmp_path / "source" / "toy_kernel.py").exists():
        (tmp_path / "source" / "toy_kernel.py").write_text(KERNEL)
    clean = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    env = clean | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)} | environment
    command = [sys.executable, "-c", USE, str(tmp_path / "source")]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    kernels, said, timed, folder = done.stdout.split(maxsplit=3)
    return int(kernels), int(said), timed == "True", Path(folder.strip())


def test_compiled_once_and_kept_in_the_users_cache(tmp_path: Path):
    kernels, said, timed, folder = use(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert (kernels > 0, said, timed) == (True, 1, True)
    assert folder == tmp_path / "cache" / "depthcli" / "kernels"
    assert list(folder.rglob("*.nbi"))
    assert not list((tmp_path / "source").rglob("*.nbi"))  # the package's own folder may be read-only
    assert use(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache")) == (0, 0, False, folder)


def test_the_users_choice_is_respected(tmp_path: Path):
    assert use(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))[3] == tmp_path / "mine"


def test_without_a_home_that_can_be_written_a_temporary_folder_serves(tmp_path: Path):
    home = "/proc/no-such-home"  # nobody can make a folder there, not even root
    if not Path("/proc").is_dir():
        pytest.skip("needs /proc as a place that cannot be written")
    first = use(tmp_path, HOME=home, XDG_CACHE_HOME=home)
    assert first[3].parent.parent == tmp_path
    assert use(tmp_path, HOME=home, XDG_CACHE_HOME=home) == (0, 0, False, first[3])


def test_a_folder_that_somebody_else_made_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if not hasattr(os, "getuid"):
        pytest.skip("needs owners of files")
    assert _jit._private(tmp_path / "kernels")
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert not _jit._private(tmp_path / "kernels")
