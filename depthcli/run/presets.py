"""Presets: the configs of the package and of plug-ins."""

from __future__ import annotations

import importlib.util
import itertools
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import BaseModel

from depthcli.core.errors import ConfigError
from depthcli.core.method import Method
from depthcli.core.registry import Plugin, PluginWarning, plugins_in
from depthcli.core.text import did_you_mean
from depthcli.core.yaml_source import to_yaml

THESIS = "thesis/"
"""Prefix of presets with the methods of the thesis, and nothing else."""

_GROUP = "depthcli.presets"  # of entry points such as "package:folder", with files COMMAND/NAME.yaml


def preset_folder() -> Path:
    """Return the folder of presets: inside the installed package, or next to it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "configs"
    return shipped if shipped.is_dir() else package.parent / "configs"


@dataclass(frozen=True)
class Preset:
    """A file with a config of ``command``, ours or of the package of a plug-in."""

    command: str
    name: str
    file: Path
    plugin: Plugin | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All names that it may be called by."""
        return self.name, self.file.stem if self.plugin is None else f"{self.plugin.package}:{self.file.stem}"

    def is_called(self, name: str) -> bool:
        """Return whether ``name`` is one of its names; case and underscores do not matter."""
        return name.lower().replace("_", "-") in (each.lower().replace("_", "-") for each in self.names)


def presets() -> list[Preset]:
    """Return our presets, then the presets of plug-ins; one whose name is taken is called ``package:name``."""
    root, found = preset_folder(), []
    for file in (*root.glob("*/*.yaml"), *root.glob(f"*/{THESIS}*.yaml")):
        command, _, name = file.relative_to(root).with_suffix("").as_posix().partition("/")
        found.append(Preset(command, name, file))
    found.sort(key=lambda preset: (preset.command, preset.name.startswith(THESIS), preset.name))
    others = [(plugin, file) for plugin in plugins_in(_GROUP) for file in _files_of(plugin)]
    taken = [(of.command, name) for of in found for name in of.names] + [(f.parent.name, f.stem) for _, f in others]
    for plugin, file in others:
        command, name = file.parent.name, file.stem
        own = name if taken.count((command, name)) == 1 else f"{plugin.package}:{name}"
        found.append(Preset(command, own, file, plugin))
    return found


@cache
def _files_of(plugin: Plugin) -> list[Path]:
    module, _, folder = plugin.reference.partition(":")
    try:
        spec = importlib.util.find_spec(module)
    except Exception:  # a stranger's code may raise anything
        spec = None
    places = [Path(place, folder) for place in (spec and spec.submodule_search_locations) or ()]
    files = sorted(file for place in places for file in place.glob("*/*.yaml"))
    if not files:
        text = f"presets of {plugin.package} {plugin.version}: no COMMAND/NAME.yaml in {plugin.reference}"
        warnings.warn(text, PluginWarning, stacklevel=2)
    return files


def list_presets(command: str | None = None) -> list[tuple[str, str, str]]:
    """Return command, name and first comment line of every preset.

    They are ordered by command, presets of the thesis after the others; those of plug-ins come last, with package and
    version before the comment.
    """
    found = []
    for preset in presets():
        if command in (None, preset.command):
            about = preset.file.read_text("utf-8", "replace").partition("\n")[0].removeprefix("#").strip()
            of = "" if preset.plugin is None else f"({preset.plugin.package} {preset.plugin.version}) "
            found.append((preset.command, preset.name, of + about))
    return found


def find_preset(command: str, name: str) -> Path | None:
    """Return the file of a preset, or None; case, underscores and the prefix ``thesis/`` do not matter."""
    found = (preset.file for preset in presets() if preset.command == command and preset.is_called(name))
    return next(found, None)


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
