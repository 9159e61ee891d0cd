"""List the presets, print one, or compile their kernels.

Examples:
  depthcli presets
  depthcli presets fuse
  depthcli presets thesis
  depthcli presets show stereo/accurate
  depthcli presets thesis/ch2-kp-dedc
  depthcli presets compile 'stereo/*' fuse/accurate
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel
from typer import Argument

from depthcli.commands import config_model
from depthcli.commands._options import Printing
from depthcli.core.config_file import THESIS, list_presets, load_config
from depthcli.core.config_file import presets as all_presets
from depthcli.core.errors import ConfigError, OutputError
from depthcli.core.method import Method
from depthcli.core.text import show_bytes
from depthcli.core.yaml_source import to_yaml
from depthcli.run.console import Reporter
from depthcli.show.table import to_json

_SCENES = {"refine-kinect": ["--kinect"], "transparent": ["--transparent"], "register-confidence": ["--registration"]}
_BOUNDED = ("stereo", "fuse")
"""Commands that compute error bounds only with ``--bound``, which has its own kernels."""


def presets(
    printing: Printing,
    action: Annotated[
        str | None,
        Argument(
            metavar="show|compile",
            help="show: print a preset; compile: compile kernels; a command, or thesis: list its presets.",
        ),
    ] = None,
    names: Annotated[
        list[str] | None,
        Argument(metavar="NAME...", help="Preset, as NAME or COMMAND/NAME; for compile also 'stereo/*'."),
    ] = None,
) -> int:
    """Print the list or the preset, or compile kernels; return the exit code."""
    reporter, names = printing.reporter, names or []
    if action is not None and not names and "/" in action:  # thesis/ch2-kp-dedc, stereo/fast
        action, names = "show", [action]
    if action == "show" and len(names) == 1:
        reporter.data(_shown(names[0]))
        return 0
    if action == "compile" and names:
        return _compile(names, reporter)
    if action == THESIS.rstrip("/"):
        found = sorted((row for row in list_presets() if row[1].startswith(THESIS)), key=lambda row: row[1])
    else:
        found = list_presets(action)
    if action is not None and (names or not found):
        raise ConfigError(
            "give depthcli presets, depthcli presets COMMAND, depthcli presets thesis, depthcli presets show NAME, or "
            "depthcli presets compile NAME..."
        )
    if printing.json:
        reporter.data(to_json([{"command": c, "preset": p, "about": about} for c, p, about in found]))
    else:
        width = max((len(f"{command} {name}") for command, name, _ in found), default=0)
        lines = [(name.startswith(THESIS), f"{f'{c} {name}':<{width}}  {about}") for c, name, about in found]
        groups = [[line for thesis, line in lines if thesis == group] for group in (False, True)]
        reporter.data("\n".join([*groups[0], "", *groups[1]]).strip())
    return 0


def _shown(name: str) -> str:
    """Return a preset as YAML, with descriptions of all fields; ``name`` may be ``command/name``."""
    found = [p for p in all_presets() if p.is_called(name.removeprefix(f"{p.command}/"))]
    if not found:
        raise ConfigError(f"no preset called {name!r}; see: depthcli presets")
    if len(found) > 1:
        names = " or ".join(f"{preset.command}/{preset.name}" for preset in found)
        raise ConfigError(f"several commands have a preset {name!r}; give depthcli presets show {names}")
    (preset,) = found
    model = config_model(preset.command)
    if model is None:
        raise ConfigError(f"{preset.file}: no command called {preset.command!r} that has configs")
    comment = itertools.takewhile(
        lambda line: line.startswith("#"), preset.file.read_text("utf-8", "replace").splitlines()
    )
    title = [line.removeprefix("#").strip() for line in comment]
    use = f"depthcli {preset.command} {preset.name} ..."
    title.append(f"Use it as it is: {use}; or save, change and name this text as a file.")
    return _described(load_config(model, preset.file), title)


def _described(config: BaseModel, title: Sequence[str]) -> str:
    """Return a resolved config as YAML with every field, its description above it, and the title as first comment."""
    flat: str = getattr(config, "flattened", "")
    method = getattr(config, flat) if flat else None
    lines = [*_method_lines(method), *_field_lines(config, flat, gap=[""])]
    lines += _field_lines(method, gap=[""]) if isinstance(method, BaseModel) else []
    return "".join(f"# {line}\n" for line in title) + "\n" + "\n".join(lines).strip() + "\n"


def _method_lines(method: object) -> list[str]:
    """Return a method's line below the first paragraph of its docstring, or an empty list for other values."""
    if not isinstance(method, Method):
        return []
    key, name = next(iter(method.model_dump(mode="json").items()))
    return [*_comment((method.__doc__ or "").strip().split("\n\n")[0]), f"{key}: {name}"]


def _field_lines(model: BaseModel, flat: str = "", gap: Sequence[str] = ()) -> list[str]:
    """Return the fields of a model except ``flat``, each below its description, with ``gap`` before it."""
    lines: list[str] = []
    # ``plugins``, a field of every config, comes last.
    for name, info in sorted(type(model).model_fields.items(), key=lambda field: field[0] == "plugins"):
        if name == flat or info.exclude:
            continue
        key, value = info.alias or name, getattr(model, name)
        elements = list(value) if isinstance(value, list | tuple) else []
        lines += [*gap, *_comment(info.description or "")]
        if isinstance(value, BaseModel):
            lines += [f"{key}:", *(f"  {line}" for line in _method_lines(value) + _field_lines(value))]
        elif any(isinstance(element, BaseModel) for element in elements):
            lines.append(f"{key}:")
            for element in elements:
                inside = [str(element)]
                if isinstance(element, BaseModel):
                    inside = _method_lines(element) + _field_lines(element)
                # Put comments before the dash, so that the element starts with its first key.
                first = next(k for k, line in enumerate(inside) if not line.startswith("#"))
                lines += [*inside[:first], f"- {inside[first]}", *(f"  {line}" for line in inside[first + 1 :])]
        else:
            lines += to_yaml({key: elements if isinstance(value, tuple) else value}).splitlines()
    return lines


def _comment(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 100, initial_indent="# ", subsequent_indent="# ")


def _compile(patterns: Sequence[str], reporter: Reporter) -> int:
    """Compute a generated scene with each preset that matches a pattern; return 0, or 1 if a preset failed."""
    from depthcli.kernels.cache import cache_folder  # imports numba

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
            if error := _run(["sample", *_SCENES.get(command, []), "-o", f"{place}/{command}"]):
                raise OutputError(f"no scene for {command}: {error}")
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
    said = done.stderr.strip().removeprefix("depthcli: ")
    return said or f"exit code {done.returncode}" if done.returncode else ""
