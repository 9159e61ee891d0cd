"""Where compiled kernels go, and that nothing is compiled twice."""

import ast
import os
import re
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from depthcli.kernels import cache
from depthcli.kernels.jit import empty, helper, jit, zeros
from tests.command_line import ended
from tests.files import laid

ROOT = Path(__file__).parents[2]

NOWHERE = "/proc/none"  # nobody can make a folder there, not even root
needs_proc = pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs a place that cannot be written")

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


class Used(NamedTuple):
    """Of a new process."""

    kernels: int  # that were compiled
    said: int  # how often
    timed: bool
    folder: str  # of the cache
    messages: str  # on stderr


def use(tmp_path: Path, before: str = "", source: str = "source", **environment: str) -> Used:
    file = tmp_path / source / "toy_kernel.py"
    if not file.exists():
        file.parent.mkdir(exist_ok=True)
        file.write_text(KERNEL)
    clean = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    env = clean | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)} | environment
    done = ended(0, sys.executable, "-c", before + USE, file.parent, env=env)
    kernels, said, timed, folder = done.stdout.split(maxsplit=3)
    return Used(int(kernels), int(said), timed == "True", folder.strip(), done.stderr)


@pytest.mark.slow
def test_compiled_once_and_kept_in_the_users_cache_wherever_the_package_is(tmp_path: Path):
    own = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    folder = tmp_path / "cache" / "depthcli" / "kernels"
    assert use(tmp_path, **own) == (2, 1, True, str(folder), "")
    assert list(folder.rglob("*.kernel"))
    assert not list((tmp_path / "source").rglob("*.kernel"))  # the package's own folder may be read-only
    assert use(tmp_path, source="moved", **own) == (0, 0, False, str(folder), "")
    laid(tmp_path, {"moved/toy_kernel.py": KERNEL.replace("x + 1", "x + 1 + 0")})
    assert use(tmp_path, source="moved", **own).kernels == 2


@needs_proc
@pytest.mark.slow
def test_without_a_home_that_can_be_written_a_temporary_folder_serves(tmp_path: Path):
    nowhere = {"HOME": NOWHERE, "XDG_CACHE_HOME": NOWHERE}
    folder = use(tmp_path, **nowhere).folder
    assert Path(folder).parent.parent == tmp_path
    assert use(tmp_path, **nowhere) == (0, 0, False, folder, "")


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "TMPDIR"])
def test_where_no_folder_can_be_written_kernels_are_compiled_in_memory_and_that_is_said_once(tmp_path, variable):
    before = "import tempfile; tempfile._candidate_tempdir_list = lambda: ['/proc/none']\n"
    used = use(tmp_path, before, HOME=NOWHERE, XDG_CACHE_HOME=NOWHERE, **{variable: NOWHERE})
    assert (used.kernels, used.folder) == (2, "None")
    assert used.messages.count("no folder for compiled kernels can be written") == used.messages.count("\n") == 1
    assert not list((tmp_path / "source").rglob("*.kernel"))


def flip(data: bytes) -> bytes:
    return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 4]) + data[len(data) // 2 + 1 :]


@pytest.mark.slow
def test_damaged_files_are_compiled_again_and_that_is_said_once(tmp_path: Path):
    mine = tmp_path / "mine"
    use(tmp_path, NUMBA_CACHE_DIR=str(mine))
    for damages in ((lambda data: b"", flip), (lambda data: data[:-9], lambda data: data[:2])):
        for file, damage in zip(sorted(mine.rglob("*.kernel")), damages, strict=True):
            file.write_bytes(damage(file.read_bytes()))
        used = use(tmp_path, NUMBA_CACHE_DIR=str(mine))
        assert used.kernels == 2
        assert used.messages.count("are damaged; they are compiled again") == used.messages.count("\n") == 1
    assert use(tmp_path, NUMBA_CACHE_DIR=str(mine)).kernels == 0


@pytest.mark.slow
def test_a_full_disk_only_means_that_nothing_is_kept(tmp_path: Path):
    full, mine = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n", tmp_path / "mine"
    used = use(tmp_path, full, NUMBA_CACHE_DIR=str(mine))
    assert (used.kernels, used.folder) == (2, str(mine))
    assert used.messages.count("cannot be kept there") == used.messages.count("\n") == 1
    assert not [file for file in mine.rglob("*") if file.is_file()]
    assert use(tmp_path, NUMBA_CACHE_DIR=str(mine)).kernels == 2


SUMS = """
import hashlib, numpy as np
from depthcli.methods.stereo.segments import planes as energy
from depthcli.algorithms.regions import RegionPixels
from depthcli.kernels.jit import run_bands
rng = np.random.default_rng(0)
labels = np.arange(100, dtype=np.int32).reshape(10, 10).repeat(10, 0).repeat(10, 1)
values = (rng.random((100, 100)) * 50).astype(np.float32)
planes = rng.normal(size=(30, 3)) * [0.01, 0.01, 20]
sums, weights = np.zeros((100, 30)), np.ones((1, 1), np.float32)
run_bands(energy.discrepancy, 64, sums, values, weights, *RegionPixels.of(labels), planes, 10.0, 2.0)
print(hashlib.sha256(sums.tobytes()).hexdigest(), energy.discrepancy.stats.cache_hits.total())
"""


def test_a_change_of_any_file_with_kernels_is_another_folder(tmp_path: Path):
    other = "def two():\n    return 2\n"
    package = laid(tmp_path / "package", {"kernels/options.py": "FAST = True", "one.py": KERNEL, "other.py": other})

    def digest(folder: Path) -> str:
        return cache.digest_of_kernels.__wrapped__(folder, "**/*.py")

    before = digest(package)
    laid(package, {"other.py": other.replace("2", "3")})
    moved = shutil.copytree(package, tmp_path / "moved" / "package")
    assert digest(package) == digest(moved) == before
    for file in (package / "one.py", moved / "kernels" / "options.py"):
        file.write_text(file.read_text().replace("True", "False").replace("x + 1", "x + 2"))
        assert digest(package if file.parent == package else moved) != before


def test_kernels_read_constants_of_files_with_kernels_alone():
    """The folder's name is the digest of those files."""
    files = {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f
             for f in (ROOT / "depthcli").rglob("*.py")}  # fmt: skip
    hashed = {name for name, file in files.items()
              if name.startswith("depthcli.kernels") or cache._HAS_KERNELS.search(file.read_bytes())}  # fmt: skip
    for name in hashed:
        tree = ast.parse(files[name].read_text("utf-8"))
        origin = {}  # name -> the module that it comes from, or is
        for node in (each for each in ast.walk(tree) if isinstance(each, ast.ImportFrom)):
            for alias in node.names if (node.module or "").startswith("depthcli") else ():
                inside = f"{node.module}.{alias.name}"
                origin[alias.asname or alias.name] = inside if inside in files else node.module
        for kernel in ast.walk(tree):
            if isinstance(kernel, ast.FunctionDef) and any(
                each in ast.dump(kind) for each in ("jit", "helper") for kind in kernel.decorator_list
            ):
                names = {node.id for each in kernel.body for node in ast.walk(each) if isinstance(node, ast.Name)}
                assert {origin[each] for each in names & origin.keys()} <= hashed, (name, kernel.name)


def test_folders_that_nothing_used_for_a_month_are_removed(tmp_path: Path):
    for name in ("a" * 20, "b" * 20, "depthcli.methods", "others"):
        (tmp_path / name).mkdir()
        if name[0] != "b":
            os.utime(tmp_path / name, (1, 1))
    own = cache._kernel_folder.__wrapped__(tmp_path)
    assert {each.name for each in tmp_path.iterdir()} == {"b" * 20, "others", own.name}


@pytest.mark.slow
def test_the_process_that_compiles_gives_the_same_bytes_as_those_that_find_the_kernel(tmp_path: Path):
    """Sums of floats in functions of a kernel: numba by itself runs other code than it keeps."""
    env = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [ended(0, sys.executable, "-c", SUMS, env=env).stdout.split() for _ in range(2)]
    assert [found for _, found in runs] == ["0", "1"]
    assert runs[0][0] == runs[1][0]


@helper
def shared(values, first, size):
    made = zeros((2, size), values.dtype)
    made[1, 0] = values[first]
    return made + empty(size, np.int16).size


@jit
def both_ends(values, size):
    return shared(values, 0, size), shared(values, -1, np.int64(size)), shared(values, size, 1)


def test_a_helper_is_compiled_once_for_all_constants_and_not_called_by_python():
    first, last, middle = both_ends(np.arange(5, dtype=np.uint8), 3)
    assert (first.tolist(), last.tolist(), middle.tolist()) == ([[3, 3, 3]] * 2, [[3, 3, 3], [7, 3, 3]], [[1], [4]])
    assert len(shared.overloads) <= 1  # none where the kernel was kept by an earlier run
    with pytest.raises(TypeError, match=r"shared .* Python cannot call"):
        shared(np.arange(5, dtype=np.uint8), 0, 3)


def test_kernels_take_numba_from_one_place():
    files = {f for f in (ROOT / "depthcli").rglob("*.py") if re.search(r"^\s*(from|import) numba", f.read_text(), re.M)}
    assert {file.parent for file in files} == {ROOT / "depthcli" / "kernels"}


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs owners of files")
@pytest.mark.parametrize("danger", ["", "kernels", "owner"])
def test_a_folder_in_which_others_can_write_is_not_trusted(danger: str, tmp_path: Path, monkeypatch):
    """Whoever may write in it, or in the folder in everybody's temporary folder that holds it, may exchange code."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(cache, "_candidates", lambda: [tmp_path / "depthcli-1/kernels"])
    assert cache.cache_folder.__wrapped__() == tmp_path / "depthcli-1/kernels"
    assert (tmp_path / "depthcli-1").stat().st_mode & 0o777 == 0o700
    if danger == "owner":
        monkeypatch.setattr(os, "getuid", lambda: 12345)
    else:
        (tmp_path / "depthcli-1" / danger).chmod(0o777)
    assert cache.cache_folder.__wrapped__() is None
