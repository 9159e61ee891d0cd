"""Kernels that a wheel carries: found where they fit, compiled as ever where they do not."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.kernels import jit, shipped  # noqa: F401  # jit first: it prepares numba
from tests.kernels.test_cache import FIRST, PACKAGE, ROOT

pytestmark = pytest.mark.slow

USE = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from depthcli.kernels.jit import CompileWatch
from depthcli.kernels import shipped
shipped.FOLDER = Path(sys.argv[2])
with CompileWatch() as watch:
    from edited_caller import caller
    print(caller(0), end=" ")
print(watch.kernels)
"""


def use(sources: Path, kernels: Path, cache: Path, **environment: str) -> tuple[int, int]:
    """Return the kernel's value and how many kernels were compiled for it, in a process of its own."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(cache)} | environment
    command = [sys.executable, "-c", USE, str(sources), str(kernels)]
    value, count = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout.split()
    return int(value), int(count)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with ``sources`` and their kernels in ``kernels``, as they lie in a wheel."""
    if shipped.baseline() is None:
        pytest.skip("no wheels with kernels are made for this kind of machine")
    folder = tmp_path_factory.mktemp("shipped")
    (folder / "sources").mkdir()
    for name, text in PACKAGE.items():
        (folder / "sources" / f"edited_{name}.py").write_text("import numpy as np\n" + text)
    first = use(folder / "sources", folder / "none", folder / "kernels", **shipped.build_settings())
    assert first[0] == FIRST
    assert first[1] > 0
    shipped.write_manifest(folder / "kernels")
    try:
        shipped.ShippedKernels(folder / "kernels")
    except ValueError as error:
        pytest.skip(str(error))
    return folder


def test_nothing_is_compiled_where_the_kernels_fit(made: Path, tmp_path: Path):
    assert use(made / "sources", made / "kernels", tmp_path / "cache") == (FIRST, 0)
    assert not list((tmp_path / "cache").rglob("*.nb*"))


def test_an_edited_helper_is_compiled(made: Path, tmp_path: Path):
    shutil.copytree(made / "sources", tmp_path / "sources", ignore=shutil.ignore_patterns("__pycache__"))
    file = tmp_path / "sources" / "edited_deep.py"
    file.write_text(file.read_text().replace("1000", "3000"))
    value, count = use(tmp_path / "sources", made / "kernels", tmp_path / "cache")
    assert value == FIRST + 2000
    assert count > 0


@pytest.mark.parametrize("damage", ["data", "index", "manifest", "no manifest", "another numba", "gone"])
def test_what_is_damaged_or_foreign_is_compiled(made: Path, tmp_path: Path, damage: str):
    kernels = tmp_path / "kernels"
    shutil.copytree(made / "kernels", kernels)
    manifest = kernels / shipped.MANIFEST
    if damage in ("data", "index"):
        for file in kernels.rglob("*.nbc" if damage == "data" else "*.nbi"):
            file.write_bytes(file.read_bytes()[:-1] + b"?")
    elif damage == "manifest":
        manifest.write_text(manifest.read_text()[:-5])
    elif damage == "another numba":
        document = json.loads(manifest.read_text())
        document["conditions"]["numba"] = "0.1"
        manifest.write_text(json.dumps(document))
    else:
        manifest.unlink()
        if damage == "gone":
            shutil.rmtree(kernels)
    value, count = use(made / "sources", kernels, tmp_path / "cache")
    assert value == FIRST
    assert count > 0


def test_files_that_are_not_in_the_manifest_are_never_unpickled(made: Path, tmp_path: Path):
    kernels = tmp_path / "kernels"
    shutil.copytree(made / "kernels", kernels)
    planted = next(kernels.rglob("*.nbi"))
    planted.write_bytes(planted.read_bytes() + b"more")
    own = shipped.ShippedKernels(kernels)
    assert own._read(planted.relative_to(kernels).as_posix()) is None
    assert own._read("elsewhere/planted.nbi") is None
