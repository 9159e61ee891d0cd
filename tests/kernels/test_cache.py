"""Where compiled kernels go, and that nothing is compiled twice."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from depthcli.kernels import cache

ROOT = Path(__file__).parents[2]

KERNEL = """
import numpy as np
from depthcli.kernels.jit import jit

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
from depthcli.kernels.jit import CompileWatch, cache_folder, compile_seconds
said = []
with CompileWatch(lambda watch: said.append(watch.calls)) as watch:
    import numpy as np, toy_kernel
    assert toy_kernel.total(np.arange(5)) == 15
assert abs(watch.seconds - compile_seconds()) < 0.05
print(watch.kernels, len(set(said)), watch.seconds > 0, cache_folder())
"""


def use(tmp_path: Path, before: str = "", **environment: str) -> tuple[int, int, bool, str, str]:
    """Kernels compiled, times it was said, seconds counted, cache folder, standard error of a new process."""
    (tmp_path / "source").mkdir(exist_ok=True)
    if not (tmp_path / "source" / "toy_kernel.py").exists():
        (tmp_path / "source" / "toy_kernel.py").write_text(KERNEL)
    clean = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    env = clean | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)} | environment
    command = [sys.executable, "-c", before + USE, str(tmp_path / "source")]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    kernels, said, timed, folder = done.stdout.split(maxsplit=3)
    return int(kernels), int(said), timed == "True", folder.strip(), done.stderr


def compiled(tmp_path: Path) -> list[Path]:
    return sorted((tmp_path / "mine").rglob("*.nb[ci]"))


@pytest.mark.slow
def test_compiled_once_and_kept_in_the_users_cache(tmp_path: Path):
    kernels, said, timed, folder, messages = use(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert (kernels, said, timed, messages) == (2, 1, True, "")
    assert Path(folder) == tmp_path / "cache" / "depthcli" / "kernels"
    assert list(Path(folder).rglob("*.nbi"))
    assert not list((tmp_path / "source").rglob("*.nbi"))  # the package's own folder may be read-only
    assert use(tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache")) == (0, 0, False, folder, "")


@pytest.mark.slow
def test_the_users_choice_is_respected(tmp_path: Path):
    assert use(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))[3] == str(tmp_path / "mine")
    assert len(compiled(tmp_path)) == 4


@pytest.mark.slow
def test_the_folder_holds_where_numba_was_imported_before(tmp_path: Path):
    assert use(tmp_path, "import numba\n", XDG_CACHE_HOME=str(tmp_path))[4] == ""
    assert list((tmp_path / "depthcli" / "kernels").rglob("*.nbi"))
    assert not list((tmp_path / "source").rglob("*.nbi"))


@pytest.mark.slow
def test_without_a_home_that_can_be_written_a_temporary_folder_serves(tmp_path: Path):
    home = "/proc/no-such-home"  # nobody can make a folder there, not even root
    if not Path("/proc").is_dir():
        pytest.skip("needs /proc as a place that cannot be written")
    first = use(tmp_path, HOME=home, XDG_CACHE_HOME=home)
    assert Path(first[3]).parent.parent == tmp_path
    assert use(tmp_path, HOME=home, XDG_CACHE_HOME=home) == (0, 0, False, first[3], "")


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "TMPDIR"])
def test_where_no_folder_can_be_written_kernels_are_compiled_in_memory_and_that_is_said_once(tmp_path, variable):
    nowhere = "/proc/no-such-folder"
    if not Path("/proc").is_dir():
        pytest.skip("needs /proc as a place that cannot be written")
    before = "import tempfile; tempfile._candidate_tempdir_list = lambda: ['/proc/no-such-folder']\n"
    kernels, _, _, folder, messages = use(tmp_path, before, HOME=nowhere, XDG_CACHE_HOME=nowhere, **{variable: nowhere})
    assert (kernels, folder) == (2, "None")
    assert messages.count("no folder for compiled kernels can be written") == len(messages.splitlines()) == 1
    assert not list((tmp_path / "source").rglob("*.nb*"))


def flip(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 4]) + data[len(data) // 2 + 1 :]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "damage"), [("nbc", lambda data: b""), ("nbc", flip), ("nbi", lambda data: data[:-9])]
)
def test_damaged_files_are_compiled_again_and_that_is_said_once(tmp_path: Path, kind: str, damage):
    mine = str(tmp_path / "mine")
    use(tmp_path, NUMBA_CACHE_DIR=mine)
    for file in compiled(tmp_path):
        if file.suffix == f".{kind}":
            file.write_bytes(damage(file.read_bytes()))
    kernels, _, _, _, messages = use(tmp_path, NUMBA_CACHE_DIR=mine)
    assert kernels == 2
    assert messages.count("are damaged; they are compiled again") == len(messages.splitlines()) == 1
    assert use(tmp_path, NUMBA_CACHE_DIR=mine)[0] == 0


@pytest.mark.slow
def test_a_full_disk_only_means_that_nothing_is_kept(tmp_path: Path):
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    kernels, _, _, folder, messages = use(tmp_path, full, NUMBA_CACHE_DIR=str(tmp_path / "mine"))
    assert (kernels, folder) == (2, str(tmp_path / "mine"))
    assert messages.count("cannot be kept there") == len(messages.splitlines()) == 1
    assert use(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "mine"))[0] == 2


SUMS = """
import hashlib, numpy as np
from depthcli.methods.stereo.segments import energy
from depthcli.algorithms.plane_fitting.segment_planes import SegmentPlanes
from depthcli.algorithms.regions import RegionPixels
rng = np.random.default_rng(0)
labels = np.arange(100, dtype=np.int32).reshape(10, 10).repeat(10, 0).repeat(10, 1)
values = (rng.random((100, 100)) * 50).astype(np.float32)
planes = SegmentPlanes(rng.normal(size=(30, 3)) * [0.01, 0.01, 20], np.arange(30), np.zeros((30, 2)))
sums = energy.discrepancy(values, RegionPixels.of(labels), planes, 10.0, 2.0)
print(hashlib.sha256(sums.tobytes()).hexdigest(), energy._discrepancy.stats.cache_hits.total())
"""


PACKAGE = {
    "limits": "LIMIT = 10\nTABLE = np.array([1, 2, 3])\n",
    "operations": """
from depthcli.kernels.jit import intrinsic, types
from llvmlite import ir

@intrinsic
def plus(typingctx, value):
    def codegen(context, builder, signature, args):
        return builder.add(args[0], ir.Constant(ir.IntType(64), 100))
    return types.int64(value), codegen
""",
    "deep": """
from depthcli.kernels.jit import jit

@jit
def deepest(x):
    return x + 1000
""",
    "helper": """
import edited_deep
from depthcli.kernels.jit import jit

@jit
def helper(x, step=1):
    return edited_deep.deepest(x) + 10000 * step
""",
    "caller": """
from depthcli.kernels.jit import jit, parallel_jit, prange
from edited_helper import helper
from edited_limits import LIMIT, TABLE
from edited_operations import plus

@parallel_jit
def caller(x):
    s = 0
    for i in prange(3):
        s += TABLE[i]
    return helper(plus(np.int64(x))) + s + LIMIT
""",
}
ASK = "import sys; sys.path.insert(0, sys.argv[1]); from edited_caller import caller; print(caller(0))"
FIRST = 100 + 1000 + 10000 + 6 + 10


@pytest.fixture(scope="module")
def edited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of five modules whose kernels have been compiled."""
    folder = tmp_path_factory.mktemp("edited")
    assert ask(folder, PACKAGE) == FIRST
    return folder


def ask(folder: Path, package: dict[str, str]) -> int:
    for name, text in package.items():
        (folder / f"edited_{name}.py").write_text("import numpy as np\n" + text)
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder / "kept")}
    env["PYTHONDONTWRITEBYTECODE"] = "1"  # files of one size, written within a second
    done = subprocess.run([sys.executable, "-c", ASK, str(folder)], env=env, capture_output=True, text=True, check=True)
    return int(done.stdout)


@pytest.mark.parametrize(
    ("module", "old", "new", "difference"),
    [
        ("helper", "10000", "20000", 10000),
        ("helper", "step=1", "step=3", 20000),
        ("deep", "1000", "3000", 2000),  # two files away, through a module's attribute
        ("deep", "x + 1000", "x - 1000", -2000),
        ("limits", "LIMIT = 10", "LIMIT = 11", 1),
        ("limits", "[1, 2, 3]", "[1, 2, 4]", 1),
        ("operations", "100", "500", 400),
    ],
)
@pytest.mark.slow
def test_what_changed_in_another_file_is_compiled_anew(edited: Path, module: str, old: str, new: str, difference: int):
    assert old in PACKAGE[module]
    assert ask(edited, PACKAGE | {module: PACKAGE[module].replace(old, new)}) == FIRST + difference


MOVED = """
import sys
sys.path.insert(0, sys.argv[1])
from depthcli.kernels.jit import CompileWatch
with CompileWatch() as watch:
    from edited_caller import caller
    caller(0)
print(watch.kernels)
"""


@pytest.mark.slow
def test_a_moved_package_with_other_comments_finds_its_kernels(tmp_path: Path):
    folders = [tmp_path / "one", tmp_path / "two"]
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    counts = []
    for folder in folders:
        folder.mkdir()
        for name, text in PACKAGE.items():
            comment = f'"""Lies in {folder}."""\n\n# A comment.\n' if name != "operations" else ""
            (folder / f"edited_{name}.py").write_text(comment + "import numpy as np\n" + text)
        command = [sys.executable, "-c", MOVED, str(folder)]
        counts.append(int(subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout))
    assert counts[0] > 0
    assert counts[1] == 0


@pytest.mark.slow
def test_kernels_that_nothing_used_for_a_month_are_removed(tmp_path: Path):
    old, fresh = (tmp_path / "depthcli.toys" / f"{name}-0123456789abcdef.py311.nbi" for name in ("old", "fresh"))
    old.parent.mkdir()
    foreign = tmp_path / "other.package" / "f-12.py311.nbi"
    foreign.parent.mkdir()
    for file in (old, fresh, foreign):
        file.write_bytes(b"")
        file.with_suffix(".1.nbc").write_bytes(b"")
    for file in (old, foreign):
        os.utime(file, (1, 1))
    cache._remove_unused.__wrapped__(tmp_path)
    assert sorted(file.name for file in tmp_path.rglob("*.nb*")) == [
        "f-12.py311.1.nbc", "f-12.py311.nbi", "fresh-0123456789abcdef.py311.1.nbc", "fresh-0123456789abcdef.py311.nbi",
    ]  # fmt: skip


@pytest.mark.slow
def test_the_process_that_compiles_gives_the_same_bytes_as_those_that_find_the_kernel(tmp_path: Path):
    """Sums of floats in a loop of ``prange``: numba by itself runs other code than it keeps."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [
        subprocess.run([sys.executable, "-c", SUMS], env=env, capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]
    assert [found for _, found in runs] == ["0", "1"]
    assert runs[0][0] == runs[1][0]


def test_kernels_take_numba_from_one_place():
    files = {f for f in (ROOT / "depthcli").rglob("*.py") if re.search(r"^\s*(from|import) numba", f.read_text(), re.M)}
    assert {file.parent for file in files} == {ROOT / "depthcli" / "kernels"}


def test_a_folder_that_somebody_else_made_is_not_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if not hasattr(os, "getuid"):
        pytest.skip("needs owners of files")
    assert cache._usable(tmp_path / "kernels")
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    assert not cache._usable(tmp_path / "kernels")
