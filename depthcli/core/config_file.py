"""Configs: the presets of the package and of plug-ins, and config files checked against a pydantic model.

Precedence: field default < base < file < ``--set key=value``, or values that a call from Python overrides. All problems
are reported together, each as ``file:line: key: what is wrong (got ...); did you mean ...``.
"""

from __future__ import annotations

import contextlib
import copy
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from depthcli.core.errors import ConfigError
from depthcli.core.method import RootConfig, used_files
from depthcli.core.plugins import load_plugin, loaded, plain_name
from depthcli.core.text import did_you_mean, short
from depthcli.core.yaml_source import OVERRIDES, ConfigData, Location, parse_value, read_config, to_yaml

_Model = TypeVar("_Model", bound=BaseModel)
_Config = TypeVar("_Config", bound=RootConfig)

_METHOD_KEYS = ("method", "pipeline")

THESIS = "thesis/"
"""Prefix of presets that contain only methods of the thesis."""

_PACKAGE = Path(__file__).resolve().parents[1]
PRESET_FOLDER = (_PACKAGE if (_PACKAGE / "configs").is_dir() else _PACKAGE.parent) / "configs"
"""Folder inside the installed package, or next to the package in a checkout."""


class Preset(NamedTuple):
    """A file with a config for ``command``."""

    command: str
    name: str
    file: Path
    source: str = ""  # package and version of the plug-in that adds it

    def is_called(self, name: str) -> bool:
        """Return whether ``name`` is its name; case, underscores and the prefix ``thesis/`` do not matter."""
        return plain_name(name) in (plain_name(self.name), plain_name(self.name.removeprefix(THESIS)))


def presets() -> list[Preset]:
    """Return the package's presets, thesis presets last, followed by the plug-ins' presets.

    If the name of a plug-in's preset is taken, its name is the path of its file.
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
    """Return command, name and first comment line of every preset; plug-ins are named before the comment."""
    rows = []
    for preset in presets():
        if command in (None, preset.command):
            about = preset.file.read_text("utf-8", "replace").partition("\n")[0].removeprefix("#").strip()
            rows.append((preset.command, preset.name, f"({preset.source}) {about}" if preset.source else about))
    return rows


def find_preset(command: str, name: str) -> Path | None:
    """Return the file of a preset, or None if there is no such preset; ``name`` may be ``COMMAND/NAME``."""
    name = name.removeprefix(f"{command}/")
    for preset in presets():
        if preset.command == command and preset.is_called(name):
            return preset.file
    return None


def find_config(command: str, config: str) -> Path:
    """Return the file of a CONFIG argument, a path or a preset of ``command``. Raise ConfigError if it is neither."""
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


def load_config(
    model: type[_Model],
    source: Path | ConfigData,
    settings: Sequence[str | tuple[str, str]] = (),
    values: Mapping[str, Any] | None = None,
) -> _Model:
    """Return a checked config: a file over its base, with options. Raise ConfigError with all problems.

    Parameters
    ----------
    model : of the config's root
    source : a file, or a parsed config, whose ``base`` is ignored
    settings : ``--set`` options in order, each as ``a.b=value``, or with the name of another option as (option,
        ``a.b=value``). The value is YAML; a number in the path is an index of a list
    values : ``a.b`` -> plain value, after the options. A mapping that selects no method changes only its own keys
    """
    command = getattr(model, "command", "")
    config = source if isinstance(source, ConfigData) else _with_base(read_config(source), source, command)
    symbols = _symbols(config)
    problems = _overlay(model, config, symbols, settings, values or {}) if settings or values else []
    folder = source.parent if isinstance(source, Path) else None  # validators look for files there
    value = None
    try:
        value = model.model_validate(config.data, context={"folder": folder})
    except ValidationError as error:
        problems += [_explain(config, each) for each in error.errors(include_url=False) if not _follows(each)]
    if value is None or problems:
        lines = {text: re.match(r"[^\n]*?:(\d+): ", text) for text in problems}
        raise ConfigError("\n".join(sorted(lines, key=lambda text: int(at[1]) if (at := lines[text]) else 0)))
    return value


def symbols_of(source: Path, command: str) -> dict[str, str]:
    """Return symbol -> key, the short names in a config for ``--set`` and ``--over``."""
    return _symbols(_with_base(read_config(source), source, command))


def config_with_options(
    model: type[_Config], config: str, settings: Sequence[str | tuple[str, str]] | None, options: Mapping[str, object]
) -> _Config:
    """Return a command's config with all overrides. Raise ConfigError with all problems.

    Parameters
    ----------
    model : class of the command's configs
    config, settings : the CONFIG argument and the values of ``--set``
    options : config key -> value of the option with that name, or None if it is not given
    """
    given = [*(settings or []), *option_settings(options)]
    checked = load_config(model, find_config(model.command, config), given)
    used_files(checked)  # raises for missing files before any scene is opened
    return checked


def option_settings(options: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return option and setting, for :func:`load_config`, from config key -> value, None if it is not given."""
    return [
        (f"--{key.rpartition('.')[2].replace('_', '-')}", f"{key}={value}")
        for key, value in options.items()
        if value is not None
    ]


def dump_config(model: BaseModel) -> str:
    """Return the resolved model as YAML, which reads back to an equal model."""
    return to_yaml(model.model_dump(mode="json", by_alias=True))


# The base of a config, and the files of its plug-ins.


def _with_base(config: ConfigData, path: Path, command: str, chain: tuple[Path, ...] = ()) -> ConfigData:
    """Return ``config``, of the file ``path``, merged with its ``base``, a file or preset.

    Mappings are merged key by key, unless they select different methods. A file in the folder of ``path`` has
    precedence over a preset; ``chain`` are the files whose base this config is, to detect circles.
    """
    if config.data.get("plugins"):
        _load_plugins(config, path.parent)
    if "base" not in config.data:
        return config
    name, place = config.data.pop("base"), f"{config.place(('base',))}: base"
    if not isinstance(name, str):
        raise ConfigError(f"{place}: expected the name of a preset or a file (got {short(name)})")
    near = (file for file in (path.parent / name, path.parent / f"{name}.yaml") if os.path.isfile(file))
    target = next((file for file in near if file.resolve() != path.resolve()), None) or find_preset(command, name)
    if target is None:
        raise ConfigError(f"{place}: {short(name)} is neither a preset nor a file next to this one")
    chain = (*chain, path.resolve())
    if target.resolve() in chain:
        raise ConfigError(f"{place}: {name} leads back to this file")
    base = _with_base(read_config(target), target, command, chain)
    files = [*base.data.get("plugins", ()), *config.data.get("plugins", ())]  # a base's methods need its files
    data = _merged(base.data, config.data)
    if files:
        data["plugins"] = list(dict.fromkeys(files))
    return ConfigData(config.name, data, base.places | config.places)


def _merged(base: Any, over: Any) -> Any:
    if not isinstance(base, dict) or not isinstance(over, dict):
        return over
    if any(key in over and over[key] != base.get(key) for key in _METHOD_KEYS):
        return over
    return base | {key: _merged(base[key], value) if key in base else value for key, value in over.items()}


def _load_plugins(config: ConfigData, folder: Path) -> None:
    """Load the plug-ins of the key ``plugins``: modules, and files in ``folder`` or of ``--plugin``."""
    names, place = config.data["plugins"], f"{config.place(('plugins',))}: plugins"
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"{place}: expected a list of names of Python files and modules (got {short(names)})")
    for name in names:
        if not name.endswith(".py") or os.path.isfile(folder / name):
            load_plugin(name, folder)
        elif not any(plugin.package == Path(name).name for plugin in loaded.values()):
            raise ConfigError(f"{place}: {name} is no file in {folder}; give its path by --plugin FILE.py")


def _symbols(config: ConfigData) -> dict[str, str]:
    """Remove the key ``symbols`` from a config, and return it."""
    if "symbols" not in config.data:
        return {}
    symbols = config.data.pop("symbols")
    if not isinstance(symbols, dict) or not all(isinstance(word, str) for word in (*symbols, *symbols.values())):
        place = f"{config.place(('symbols',))}: symbols"
        raise ConfigError(f"{place}: expected symbols and their keys, such as w: energy.smoothness")
    return symbols


# Values of the command line and of Python.


def _overlay(
    model: type[BaseModel],
    config: ConfigData,
    symbols: Mapping[str, str],
    settings: Sequence[str | tuple[str, str]],
    values: Mapping[str, Any],
) -> list[str]:
    """Apply ``--set`` options and then overrides, in place; return one line per problem."""
    problems = list[str]()
    options = [each if isinstance(each, tuple) else ("", each) for each in settings]
    changes = [(option or f"--set {text.partition('=')[0].strip()[:64]}", text, None) for option, text in options]
    changes += [(f"override {key[:64]}", key, value) for key, value in _leaves(values)]
    changes.sort(key=lambda change: change[1].partition("=")[0].strip() != "plugins")  # which others may need
    for place, text, value in changes:
        key, equals, setting = text.partition("=")
        try:
            if place.startswith("--"):
                if not equals:
                    raise ConfigError(f"{place}: expected KEY=VALUE, such as --set cost.window=[9,7]")
                value = parse_value(setting, place)
            key = symbols.get(key.strip(), key.strip())
            _put(config, key, value, place, _defaults(model, config) if "." in key else {})
            if key == "plugins":
                _load_plugins(config, Path())
        except ConfigError as error:
            problems.append(str(error))
    return problems


def _defaults(model: type[BaseModel], config: ConfigData) -> Any:
    """Return the config with its defaults, in which single keys can be set."""
    with contextlib.suppress(ValidationError):  # reported later, unless --set corrects it
        return model.model_validate(config.data).model_dump(mode="json", by_alias=True)
    return {}


def _leaves(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield key and value, also of keys inside mappings that select no method."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value and not any(method in value for method in _METHOD_KEYS):
            yield from _leaves({f"{key}.{name}": each for name, each in value.items()})
        else:
            yield key, value


def _put(config: ConfigData, key: str, value: Any, place: str, defaults: Any) -> None:
    """Set one value, which comes from ``place``. Raise ConfigError if there can be no such key."""
    location = tuple(int(part) if part.isdecimal() and len(part) < 9 else part for part in key.split("."))
    if "" in location:
        raise ConfigError(f"{place}: expected the name of a key, such as cost.window (got {short(key)})")
    inside: Any = config.data
    for depth, part in enumerate(location):
        if depth > 0:
            defaults = defaults.get(location[depth - 1]) if isinstance(defaults, dict) else None
            inside = _step_into(inside, location[depth - 1], defaults)
        if isinstance(inside, list) and not (isinstance(part, int) and part < len(inside)):
            at = _dotted(location[:depth])
            raise ConfigError(f"{place}: {at} is a list of {len(inside)}; expected an index (got {part!r})")
        if not isinstance(inside, dict | list):
            raise ConfigError(f"{place}: {_dotted(location[:depth])} is a single value, nothing can be set below it")
    inside[location[-1]] = value
    config.places = {at: of for at, of in config.places.items() if at[: len(location)] != location} | {location: place}


def _step_into(inside: Any, part: str | int, default: Any) -> Any:
    """Return the value at a key or index, as a container in which keys can be set."""
    below = inside.get(part) if isinstance(inside, dict) else inside[part]
    if below is None:
        below = copy.deepcopy(default) if isinstance(default, dict | list) else {}
    elif not isinstance(below, dict) and isinstance(default, dict) and not any(key in default for key in _METHOD_KEYS):
        below = copy.deepcopy(default)  # the short form of a mapping, such as the files of a calibration
    elif isinstance(below, str):  # the name of a method, which gets parameters
        below = {"method": below}
    inside[part] = below
    return below


# Errors of pydantic, with their place in the file.


def _follows(error: Any) -> bool:
    """Return whether a list seems too short only because pydantic left out items with errors of their own."""
    return bool(error["type"] == "too_short" and len(error["input"]) >= error["ctx"]["min_length"])


def _explain(config: ConfigData, error: Any) -> str:
    """Return an error of pydantic as a line: place, key, problem, and a hint."""
    kind, got, hint = error["type"], error.get("input"), ""
    keys, inside = [], config.data  # pydantic's location without the names of members of unions
    for part in error["loc"]:
        if part in inside if isinstance(inside, dict) else isinstance(inside, list) and part in range(len(inside)):
            keys.append(part)
            inside = inside[part]
    location: Location = (*keys, *error["loc"][-1:]) if kind == "missing" else tuple(keys)
    place, key = config.place(location), _dotted(location)
    text = re.sub(r"^(Value error|Assertion failed), ", "", error["msg"]).replace("Input should", "should", 1)
    if kind == "missing":
        text = "missing, and it has no default"
    elif kind in ("unknown_key", "method_name"):
        text, semicolon, hint = text.partition(";")
        hint = semicolon + hint
    elif kind == "tuple_type" and key.endswith("window") and isinstance(got, int):
        hint = f"; write [{got}, {got}]"
    big = isinstance(got, dict | list | tuple | BaseModel) and len(short(got)) > 60
    shown = "" if big or "(got " in text or kind in ("missing", "method_name") else f" (got {short(got)})"
    # An option or override that names the key, or one below it, needs no further key.
    path = place.partition(" ")[2]
    is_named = place.startswith(OVERRIDES) and (not path or f"{path}.".startswith(f"{key}."))
    return f"{place if is_named or not key else f'{place}: {key}'}: {text}{shown}{hint}"


def _dotted(location: Location) -> str:
    return ".".join(map(str, location))
