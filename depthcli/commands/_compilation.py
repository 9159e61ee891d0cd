"""Compile kernels for ``presets compile``: compute a generated scene with each preset, in parallel processes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from pathlib import Path

from depthcli.core.config_file import list_presets
from depthcli.core.errors import ConfigError
from depthcli.core.text import show_bytes
from depthcli.kernels.cache import cache_folder
from depthcli.run.console import Reporter

_SCENES = {"refine-kinect": ["--kinect"], "transparent": ["--transparent"], "register-confidence": ["--registration"]}
_BOUNDED = ("stereo", "fuse")
"""Commands that compute error bounds only with ``--bound``, which has its own kernels."""


def compile_presets(patterns: Sequence[str], reporter: Reporter) -> int:
    """Compile the kernels of all presets that match a pattern; return 0, or 1 if a preset failed."""
    presets = [(command, name) for command, name, _ in list_presets()]
    for pattern in patterns:
        if not any(_is_called(preset, pattern) for preset in presets):
            raise ConfigError(f"no preset called {pattern!r}; see: depthcli presets")
    presets = [preset for preset in presets if any(_is_called(preset, pattern) for pattern in patterns)]
    folder = cache_folder()
    if folder is None:
        raise ConfigError("no folder for compiled kernels can be written; see NUMBA_CACHE_DIR")
    begun, failed = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(os.cpu_count()) as processes:
        for command in {command for command, _ in presets}:
            _run(["sample", *_SCENES.get(command, []), "-o", f"{place}/{command}"])
        runs = [
            [command, name, "-i", f"{place}/{command}", "-o", f"{place}/runs/{command}/{name}{option}", *option.split()]
            for command, name in presets
            for option in (["", " --bound"] if command in _BOUNDED else [""])
        ]
        for number, (words, error) in enumerate(zip(runs, processes.map(_run, runs), strict=True), 1):
            title = " ".join(word for word in words if not word.startswith((place, "-i", "-o")))
            seconds = f"{time.monotonic() - begun:.0f} s"
            if not error:
                reporter.info(f"{number} of {len(runs)} compiled, {seconds}: {title}")
            elif "--bound" not in words:  # not every preset has bounds
                failed += 1
                reporter.error(f"{title}: {error}")
    size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    reporter.data(f"{folder}: {show_bytes(size)}")
    return 1 if failed else 0


def _is_called(preset: tuple[str, str], pattern: str) -> bool:
    command, name = preset
    return fnmatchcase(f"{command}/{name}", pattern) or fnmatchcase(name, pattern)


def _run(words: Sequence[str]) -> str:
    """Run a command in another process on one thread; return its error message, or an empty text."""
    command = [sys.executable, "-m", "depthcli", *words, "-q"]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env=os.environ | {"NUMBA_NUM_THREADS": "1"}
    )
    return done.stderr.strip() or f"exit code {done.returncode}" if done.returncode else ""
