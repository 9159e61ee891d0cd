"""Presets: the configs of the package and of plug-ins."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pydantic import BaseModel

from depthcli.core.errors import ConfigError
from depthcli.core.method import Method
from depthcli.core.plugins import loaded
from depthcli.core.registry import plain_name
from depthcli.core.text import did_you_mean
from depthcli.core.yaml_source import to_yaml

THESIS = "thesis/"
"""Prefix of presets with the methods of the thesis, and nothing else."""

_PACKAGE = Path(__file__).resolve().parent.parent
PRESET_FOLDER = (_PACKAGE if (_PACKAGE / "configs").is_dir() else _PACKAGE.parent) / "configs"
"""Inside the installed package, or next to it in a checkout."""


class Preset(NamedTuple):
    """A file with a config of ``command``."""

    command: str
    name: str
    file: Path
    source: str = ""  # package and version of the plug-in that adds it

    def is_called(self, name: str) -> bool:
        """Return whether ``name`` is its name; case, underscores and the prefix ``thesis/`` do not matter."""
        return plain_name(name) in (plain_name(self.name), plain_name(self.name.removeprefix(THESIS)))


def presets() -> list[Preset]:
    """Return our presets, those of the thesis after the others, then those of plug-ins.

    A preset of a plug-in whose name is taken is called by its file.
    """
    found: list[Preset] = []
    folders = {PRESET_FOLDER: ""}
    for plugin in loaded.values():
        folders[plugin.folder / "presets"] = f"{plugin.package} {plugin.version}"
    for folder, source in folders.items():
        files = []
        for file in (*folder.glob("*/*.yaml"), *folder.glob(f"*/{THESIS}*.yaml")):
            command, _, name = file.relative_to(folder).with_suffix("").as_posix().partition("/")
            files.append((command, name.startswith(THESIS), name, file))
        for command, _, name, file in sorted(files):
            taken = source and any(preset.command == command and preset.is_called(name) for preset in found)
            found.append(Preset(command, str(file) if taken else name, file, source))
    return found


def list_presets(command: str | None = None) -> list[tuple[str, str, str]]:
    """Return command, name and first comment line of every preset, with the plug-in that adds it before the comment."""
    rows = []
    for preset in presets():
        if command in (None, preset.command):
            about = preset.file.read_text("utf-8", "replace").partition("\n")[0].removeprefix("#").strip()
            rows.append((preset.command, preset.name, f"({preset.source}) {about}" if preset.source else about))
    return rows


def find_preset(command: str, name: str) -> Path | None:
    """Return the file of a preset, None if there is none of that name, which may be ``COMMAND/NAME``."""
    name = name.removeprefix(f"{command}/")
    for preset in presets():
        if preset.command == command and preset.is_called(name):
            return preset.file
    return None


def find_config(command: str, config: str) -> Path:
    """Return the file that a CONFIG argument names: a path, or a preset of ``command``; ConfigError for neither."""
    path = Path(config)
    shipped = find_preset(command, config) if not path.suffix else None
    if shipped is not None:
        return shipped
    try:
        if path.exists():
            return path
    except (OSError, ValueError) as error:
        raise ConfigError(f"{config[:200]}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    names = [name for _, name, _ in list_presets(command)]
    elsewhere = [of for of, name, _ in list_presets() if name == config.lower() and of != command]
    hint = did_you_mean(config.lower(), names)
    if elsewhere:
        hint += f"; {' and '.join(elsewhere)} {'has' if len(elsewhere) == 1 else 'have'} one of that name"
    raise ConfigError(f"{config}: neither a file nor a preset of {command}{hint} (presets: {', '.join(names)})")


def describe(config: BaseModel, title: str) -> str:
    """Return a resolved config as YAML with every field, its description above it, and ``title`` as first comment."""
    flat: str = getattr(config, "flattened", "")
    method = getattr(config, flat) if flat else None
    lines = [*_method_lines(method), *_field_lines(config, flat, gap=[""])]
    lines += _field_lines(method, gap=[""]) if isinstance(method, BaseModel) else []
    return "".join(f"# {line}\n" for line in title.splitlines()) + "\n" + "\n".join(lines).strip() + "\n"


def leading_comment(text: str) -> str:
    """Return the comment lines at the start of a file, without ``#``."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    return "\n".join(line.removeprefix("#").strip() for line in lines)


def _method_lines(method: object) -> list[str]:
    """Return the line that names a method, under the first paragraph of its docstring; nothing for other values."""
    if not isinstance(method, Method):
        return []
    key, name = next(iter(method.model_dump(mode="json").items()))
    return [*_comment((method.__doc__ or "").strip().split("\n\n")[0]), f"{key}: {name}"]


def _field_lines(model: BaseModel, flat: str = "", gap: Sequence[str] = ()) -> list[str]:
    """Return the fields of a model but ``flat``, each under its description, with ``gap`` before it."""
    lines: list[str] = []
    # What every config has comes first in the model and last in the text.
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
                # Comments come before the dash, so that the element starts with its first key.
                first = next(k for k, line in enumerate(inside) if not line.startswith("#"))
                lines += [*inside[:first], f"- {inside[first]}", *(f"  {line}" for line in inside[first + 1 :])]
        else:
            lines += to_yaml({key: elements if isinstance(value, tuple) else value}).splitlines()
    return lines


def _comment(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 100, initial_indent="# ", subsequent_indent="# ")
