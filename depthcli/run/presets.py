"""Presets: the configs that are shipped with the package, and those of plug-ins."""

from __future__ import annotations

import importlib.util
import itertools
import textwrap
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import BaseModel

from depthcli.core.config_file import to_yaml
from depthcli.core.errors import ConfigError
from depthcli.core.registry import Plugin, PluginWarning, plugins_in
from depthcli.core.text import did_you_mean


def preset_folder() -> Path:
    """Return the folder of presets: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "configs"
    return shipped if shipped.is_dir() else package.parent / "configs"


THESIS = "thesis/"
"""Prefix of presets that reproduce a table or figure of the thesis."""


_GROUP = "depthcli.presets"  # of entry points such as "package:folder", which holds COMMAND/NAME.yaml


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
    """Return our presets, then those of plug-ins; one whose name is taken is called ``package:name``."""
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

    They are ordered by command, those of the thesis behind the others; those of plug-ins come last, with package and
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
    fields = "\n".join(_lines(config, 0, getattr(config, "flattened", ""), gap=("",)))
    return "".join(f"# {line}\n" for line in title.splitlines()) + "\n" + fields.strip() + "\n"


def leading_comment(text: str) -> str:
    """Return the comment lines at the start of a file, without ``#``."""
    lines = itertools.takewhile(lambda line: line.startswith("#"), text.splitlines())
    return "\n".join(line.removeprefix("#").strip() for line in lines)


def _lines(model: BaseModel, depth: int, flat: str, gap: tuple[str, ...] = ()) -> Iterator[str]:
    inner = getattr(model, flat, None) if flat else None
    pad = "  " * depth
    if isinstance(inner, BaseModel):
        doc = (type(inner).__doc__ or "").strip().split("\n\n")[0]
        yield from _comment(" ".join(doc.split()), pad)
        yield f"{pad}{flat}: {inner.model_dump(mode='json')[flat]}"
    # What every config has comes first in the model and last in the text.
    for name, info in sorted(type(model).model_fields.items(), key=lambda field: field[0] == "plugins"):
        if name == flat or info.exclude:
            continue
        yield from gap
        if info.description:
            yield from _comment(info.description, pad)
        yield from _value(info.alias or name, getattr(model, name), depth)
    if isinstance(inner, BaseModel):
        yield from _lines(inner, depth, "", gap)


def _value(name: str, value: object, depth: int) -> Iterator[str]:
    pad = "  " * depth
    elements = list(value) if isinstance(value, list | tuple) else []
    if isinstance(value, BaseModel):
        yield f"{pad}{name}:"
        yield from _model(value, depth + 1)
    elif any(isinstance(element, BaseModel) for element in elements):
        yield f"{pad}{name}:"
        for element in elements:
            dash = "- "
            for line in _model(element, 0) if isinstance(element, BaseModel) else [str(element)]:
                # A comment stands before the dash, so that the element starts with its first key.
                comment = dash == "- " and line.lstrip().startswith("#")
                yield f"{pad}{'' if comment else dash}{line}"
                dash = dash if comment else "  "
    else:
        yield from (
            pad + line for line in to_yaml({name: elements if isinstance(value, tuple) else value}).splitlines()
        )


def _model(value: BaseModel, depth: int) -> Iterator[str]:
    pad = "  " * depth
    doc = " ".join((type(value).__doc__ or "").strip().split("\n\n")[0].split())
    own = type(value).model_fields
    extra = {key: v for key, v in value.model_dump(mode="json").items() if key not in own}
    if extra:
        yield from _comment(doc, pad)
    for key, name in extra.items():
        yield f"{pad}{key}: {name}"
    yield from _lines(value, depth, "")


def _comment(text: str, pad: str) -> Iterator[str]:
    yield from textwrap.wrap(text, 100, initial_indent=f"{pad}# ", subsequent_indent=f"{pad}# ")
