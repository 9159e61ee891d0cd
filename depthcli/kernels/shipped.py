"""Compiled kernels that a wheel carries: a read-only addition to the user's folder of compiled kernels.

They are made for a baseline of processors by ``scripts/build_wheel`` and used where processor, Python and numba are
those that they were made for; otherwise kernels are compiled as if there were none. A file is unpickled only if its
digest is that of the manifest, which came with the wheel.

numba keeps a kernel in two kinds of files. The index (``.nbi``) holds a header, the kernel's fingerprint, and per
signature (types of the arguments, target processor, digests of the function) the name of a data file. Each data file
(``.nbc``) holds the machine code for one signature.
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
    """Return name and features of the processors that wheels for this kind of machine are made for, or None."""
    machine = platform.machine()
    return BASELINES.get("x86_64" if machine in ("AMD64", "x86_64") else machine)


def build_settings() -> dict[str, str]:
    """Return the environment variables under which numba compiles for the baseline."""
    own = baseline()
    if own is None:
        raise RuntimeError(f"no baseline of processors is known for {platform.machine()}")
    return {"NUMBA_CPU_NAME": own[0], "NUMBA_CPU_FEATURES": ""}


def conditions() -> dict[str, str]:
    """Return what must be the same where kernels are compiled and where they are used: machine and versions."""
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
    """The compiled kernels of one folder, which this machine can run.

    Parameters
    ----------
    folder : holds a manifest and, in one folder per module, numba's files

    Raises
    ------
    OSError, ValueError, KeyError
        There is no manifest, it cannot be read, or the kernels are for another machine or other versions.
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

    def load(self, index_path: str, index_header: str, fingerprint: str, signature_key: tuple[Any, ...]) -> Any | None:
        """Return the content of the data file of one compiled kernel; None if there is none, or it is damaged.

        Parameters
        ----------
        index_path : path of the index, relative to the folder
        index_header : first object of the index: numba's version and the form of the file
        fingerprint : of the kernel, as in :mod:`depthcli.kernels.fingerprint`
        signature_key : types of the arguments, target and digests as in numba's index; the target is replaced by the
            baseline
        """
        index = self._read(index_path)
        if index is None:
            return None
        header = pickle.dumps(index_header, protocol=-1)
        kept, names = pickle.loads(index[len(header) :]) if index.startswith(header) else ("", {})
        name = names.get((signature_key[0], self._target, *signature_key[2:])) if kept == fingerprint else None
        data = None if name is None else self._read(f"{Path(index_path).parent.as_posix()}/{name}")
        return None if data is None else pickle.loads(data)

    def _read(self, path: str) -> bytes | None:
        if path not in self._digests:
            return None
        data = (self._folder / path).read_bytes()
        return data if hashlib.sha256(data).hexdigest() == self._digests[path] else None


@cache
def shipped_kernels() -> ShippedKernels | None:
    """Return the kernels that came with the package; None where none did or this machine cannot run them."""
    try:
        return ShippedKernels(FOLDER)
    except (OSError, ValueError, KeyError, RuntimeError):
        return None
