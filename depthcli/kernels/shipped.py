"""Compiled kernels that a wheel carries: a read-only level behind the user's folder of compiled kernels.

They are made for a baseline of processors by ``scripts/build_wheel`` and used where processor, Python and numba are
those that they were made for; everything else is compiled as if they were not there. A file is unpickled only if its
digest is that of the manifest, which came with the wheel.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import platform
import sys
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
import numba

FOLDER = Path(__file__).resolve().parent / "compiled"
MANIFEST = "manifest.json"

# Per machine: name of the baseline processor in LLVM, and the features that a processor must have to run its code.
BASELINES = {
    "x86_64": ("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "aarch64": ("generic", ("neon",)),
    "arm64": ("apple-m1", ()),
}


def baseline() -> tuple[str, tuple[str, ...]] | None:
    """Return name and features of the processors that wheels for such machines are made for; None: none are made."""
    machine = platform.machine()
    return BASELINES.get("x86_64" if machine in ("AMD64", "x86_64") else machine)


def build_settings() -> dict[str, str]:
    """Return the environment variables under which numba compiles for the baseline."""
    own = baseline()
    if own is None:
        raise RuntimeError(f"no baseline of processors is known for {platform.machine()}")
    return {"NUMBA_CPU_NAME": own[0], "NUMBA_CPU_FEATURES": ""}


def conditions() -> dict[str, str]:
    """Return all that has to be alike where kernels are compiled and where they are used."""
    return {
        "machine": f"{sys.platform} {platform.machine()}",
        "python": f"{sys.version_info[0]}.{sys.version_info[1]}",
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
    }


def write_manifest(folder: Path) -> None:
    """Write the manifest of the kernels in ``folder``, compiled in this environment under :func:`build_settings`."""
    files = {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*.nb[ic]"))
    }
    document = {"conditions": conditions(), "triple": llvmlite.binding.get_process_triple(), "files": files}
    (folder / MANIFEST).write_text(json.dumps(document, indent=1))


class ShippedKernels:
    """The kernels of one folder, where this machine can run them.

    Parameters
    ----------
    folder : holds a manifest and numba's files, one folder a module

    Raises
    ------
    OSError, ValueError, KeyError
        There are none, the manifest cannot be read, or the kernels are for another machine or other versions.
    """

    def __init__(self, folder: Path) -> None:
        document = json.loads((folder / MANIFEST).read_text())
        own = baseline()
        if own is None or document["conditions"] != conditions():
            raise ValueError("the kernels are for another machine or other versions")
        name, needed = own
        features: Any = llvmlite.binding.get_host_cpu_features()
        if not all(features.get(feature) for feature in needed):
            raise ValueError(f"the kernels are for {name}, which this processor is not")
        self._folder = folder
        self._digests: dict[str, str] = document["files"]
        self._target = (document["triple"], name, "")

    def load(self, place: str, version: str, stamp: str, key: tuple[Any, ...]) -> Any | None:
        """Return what numba keeps of one compiled kernel; None where there is none, or its files are damaged.

        Parameters
        ----------
        place : path of the index, relative to the folder
        version : first object of the index: numba's version and the form of the file
        stamp : fingerprint of the kernel
        key : signature, target and digests as numba has them; the target is replaced by the baseline
        """
        index = self._read(place)
        if index is None:
            return None
        head = pickle.dumps(version, protocol=-1)
        found, names = pickle.loads(index[len(head) :]) if index.startswith(head) else ("", {})
        name = names.get((key[0], self._target, *key[2:])) if found == stamp else None
        data = None if name is None else self._read(f"{Path(place).parent.as_posix()}/{name}")
        return None if data is None else pickle.loads(data)

    def _read(self, place: str) -> bytes | None:
        if place not in self._digests:
            return None
        data = (self._folder / place).read_bytes()
        return data if hashlib.sha256(data).hexdigest() == self._digests[place] else None


@cache
def shipped_kernels() -> ShippedKernels | None:
    """Return the kernels that came with the package; None where none did or this machine cannot run them."""
    try:
        return ShippedKernels(FOLDER)
    except (OSError, ValueError, KeyError, RuntimeError):
        return None
