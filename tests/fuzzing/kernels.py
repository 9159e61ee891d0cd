"""Small packages of kernels, edited at random: what is compiled must give what the same text gives in plain Python."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from depthcli.kernels import cache, fingerprint
from tests.fuzzing.common import Fault

# One line a statement; every number, operator and name of a helper may be edited.
MODULES = {
    "limits": "LIMIT = 10\nTABLE = np.array([1, 2, 3])\nSHIFTS = (4, 5)\n\n"
    "class Kind(enum.IntEnum):\n    A = 6\n    B = 7\n",
    "deep": "@jit\ndef first(x):\n    return x + 1000\n\n@jit\ndef second(x):\n    return x - 2000\n",
    "helper": (
        "from . import deep\nfrom .limits import SHIFTS\n\n@jit\ndef helper(x, step=3):\n"
        "    return deep.first(x) * 2 + SHIFTS[1] * step\n"
    ),
    "closure": (
        "def made(k):\n    @jit\n    def inner(x):\n        return x * k + 1\n    return inner\n\nclosed = made(5)\n"
    ),
    "caller": (
        "from .closure import closed\nfrom .helper import helper\nfrom .limits import LIMIT, TABLE, Kind\n\n"
        "@jit\ndef other(x):\n    return x + 50\n\nPARTS = (other, closed)\n\n"
        "@parallel_jit\ndef caller(a):\n    s = np.zeros(a.size, np.int64)\n    for i in prange(a.size):\n"
        "        x = a[i] + TABLE[i % 3] + LIMIT + Kind.A\n        t = [y + 7 for y in range(3)]\n"
        "        s[i] = helper(x) + closed(x) + other(x) + t[1]\n    return s\n"
    ),
}
HEADS = {
    True: "import enum\nimport numpy as np\nfrom depthcli.kernels.jit import jit, parallel_jit, prange\n",
    False: "import enum\nimport numpy as np\ndef jit(f):\n    return f\nparallel_jit, prange = jit, range\n",
}
_SWAPS = {"+": "-", "-": "+", "*": "+", "deep.first": "deep.second", "Kind.A": "Kind.B"}
_kept: list[dict[str, ModuleType]] = []  # kernels live as long as the process, as in the program


def edit(modules: dict[str, str], rng: np.random.Generator) -> tuple[str, dict[str, str]]:
    """Return what was changed, and the package with one number, operator or name changed."""
    places = [
        (name, match)
        for name, text in modules.items()
        for match in re.finditer(r"\b\d+\b(?!\])|(?<=[\w\]) ])\s[-+*]\s|deep\.(?:first|second)|Kind\.[AB]\b", text)
        if "import" not in text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
    ]
    name, match = places[rng.integers(len(places))]
    word = match[0].strip()
    swaps = _SWAPS | {value: key for key, value in _SWAPS.items() if "." in key}
    new = str(int(word) + int(rng.integers(1, 9))) if word.isdigit() else swaps[word]
    text = modules[name][: match.start()] + match[0].replace(word, new) + modules[name][match.end() :]
    return f"{name}: {word} -> {new}", modules | {name: text}


def answer(modules: dict[str, str], folder: Path, compiled: bool) -> list[int]:
    """Return what ``caller`` gives, of the package written into a folder and imported anew."""
    package = "fuzzed_kernels"
    place = folder / package
    place.mkdir(exist_ok=True)
    (place / "__init__.py").write_text("")
    for name, text in modules.items():
        (place / f"{name}.py").write_text(HEADS[compiled] + text)
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        del sys.modules[name]
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        caller = importlib.import_module(f"{package}.caller").caller
        _kept.append({name: sys.modules[name] for name in sys.modules if name.partition(".")[0] == package})
        return [int(value) for value in caller(np.arange(4))]
    finally:
        sys.path.remove(str(folder))
        sys.dont_write_bytecode = written


def kernel_case(rng: np.random.Generator, folder: Path, base: Path) -> str:
    """Edit helper kernels several times, each time with the kernels that were compiled before in the cache."""
    modules, edits = dict(MODULES), []
    kept, cache._FOLDER = cache._FOLDER, folder / "cache"
    (folder / "cache").mkdir()
    try:
        for _ in range(4):
            fingerprint._file_digest.cache_clear()  # it is kept for a process, and this one stands for several
            wanted, got = answer(modules, folder, False), answer(modules, folder, True)
            if got != wanted:
                raise Fault(f"kernels, after {edits}: {got}, want {wanted}")
            what, modules = edit(modules if rng.random() < 0.5 else MODULES, rng)
            edits.append(what)
    finally:
        cache._FOLDER = kept
    return "kernels: none is old"
