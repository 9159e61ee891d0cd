"""Where compiled kernels are kept: a folder named by a digest of everything that determines machine code.

numba's own cache identifies a kernel by the path and the digest of its source file. A moved package would not find its
kernels, and after a change in a helper of another file a kernel would still run the old code. Here, the digest covers
all source files with kernels, the versions of numba and LLVM, the compiler's settings and the processor.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

# On machines that have Intel's vector math library, it would give different last digits.
os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")

# LLVM's level 3 takes 10 % longer, and its code is not faster.
os.environ.setdefault("NUMBA_OPT", "2")

import llvmlite
import llvmlite.binding
import numba

_PACKAGE = Path(__file__).parents[1]
_HAS_KERNELS = re.compile(rb"^(@jit|@helper|@intrinsic)\b", re.M)
_MAX_AGE_DAYS = 30  # a month on another branch does not discard kernels
_DAY = 86400


def _candidates() -> list[Path]:
    """Return candidate folders for compiled kernels, the preferred one first."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return [Path(os.environ["NUMBA_CACHE_DIR"])]
    found = []
    with contextlib.suppress(RuntimeError, OSError):  # if there is no home folder
        home = {"win32": "~/AppData/Local", "darwin": "~/Library/Caches"}.get(sys.platform, "~/.cache")
        found.append(Path(os.environ.get("XDG_CACHE_HOME") or Path(home).expanduser()) / "depthcli" / "kernels")
    with contextlib.suppress(OSError):
        user = os.getuid() if hasattr(os, "getuid") else "user"
        found.append(Path(tempfile.gettempdir()) / f"depthcli-{user}" / "kernels")
    return found


@cache
def cache_folder() -> Path | None:
    """Return the folder of compiled kernels: ``NUMBA_CACHE_DIR``, the user's cache, or otherwise a temporary folder.

    The package's own folder is not used, since it may be read-only or belong to another user. Unless it is
    ``NUMBA_CACHE_DIR``, a folder that another user created or can write to is not used either, since the cache contains
    code. None if no folder can be written: then every process compiles its own kernels.
    """
    for folder in _candidates():
        with contextlib.suppress(OSError):
            for new in (*reversed(folder.parents), folder):
                new.mkdir(mode=0o700, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                shared = folder.parent.parent == Path(tempfile.gettempdir())  # there any user can create the parent
                if "NUMBA_CACHE_DIR" in os.environ or all(map(_is_private, [folder, folder.parent][: 1 + shared])):
                    return folder
    warn_once("no folder for compiled kernels can be written (see NUMBA_CACHE_DIR): each process compiles its own")
    return None


def _is_private(folder: Path) -> bool:
    """Return True if ``folder`` is no link, belongs to this user, and no other user can write to it."""
    state = folder.lstat()
    own = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    return own and stat.S_ISDIR(state.st_mode)


@cache
def warn_once(message: str) -> None:
    """Log a warning once per message."""
    logging.getLogger("depthcli").warning(message)


@cache  # once per process
def digest_of_kernels(folder: Path, files: str) -> str:
    """Return the digest of everything that determines the machine code of kernels: sources, versions, settings."""
    config: Any = numba.config
    settings = (config.BOUNDSCHECK, config.OPT, config.USING_SVML, config.CPU_NAME, config.CPU_FEATURES)
    processor = llvmlite.binding.get_host_cpu_name(), llvmlite.binding.get_host_cpu_features().flatten()
    facts = (sys.version, numba.__version__, llvmlite.__version__, processor, settings)
    digest = hashlib.sha256(repr(facts).encode())
    for file in sorted(folder.glob(files)):
        source = file.read_bytes()
        if file.parent.name == "kernels" or _HAS_KERNELS.search(source):
            digest.update(f"{file.relative_to(folder).as_posix()} {len(source)} ".encode() + source)
    return digest.hexdigest()


@cache  # once per process
def _kernel_folder(folder: Path) -> Path:
    """Return this version's folder, marked as used; remove folders of other versions unused for a month."""
    own = folder / digest_of_kernels(_PACKAGE, "**/*.py")[:20]
    with contextlib.suppress(OSError):
        own.mkdir(exist_ok=True)
        if time.time() - own.stat().st_mtime > _DAY:
            os.utime(own)
        # Folders named by a module come from versions with another cache layout.
        for other in (*folder.glob("[0-9a-f]" * 20), *folder.glob("depthcli.*")):
            if time.time() - other.stat().st_mtime > _MAX_AGE_DAYS * _DAY:
                shutil.rmtree(other, ignore_errors=True)
    return own


def kernel_files(function: Any) -> tuple[Path, str] | None:
    """Return the folder of the compiled versions of a kernel, and the beginning of their files' names.

    None if they cannot be kept: no folder can be written, or the kernel was made inside another function.
    """
    folder, code = cache_folder(), function.__code__
    if folder is None or function.__closure__:
        return None
    source = Path(code.co_filename)
    # A plug-in's kernels are current as long as all kernels in its folder are.
    stamp = "" if source.is_relative_to(_PACKAGE) else f"-{digest_of_kernels(source.parent, '*.py')[:20]}"
    return _kernel_folder(folder) / function.__module__, f"{function.__name__}-{code.co_firstlineno}{stamp}"
