"""Config files checked against a pydantic model.

Precedence: field default < base < file < ``--set key=value``, or values that a call from Python overrides. All problems
are reported together, each as ``file:line: key: what is wrong (got ...); did you mean ...``.

A model whose key got another name says so in ``renamed: ClassVar[dict[str, str]] = {"old": "new"}``. The old key
is then refused as any unknown key is, with the new name as the hint, even where the two names are not similar.
"""

from __future__ import annotations

import contextlib
import copy
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from depthcli.core.config_errors import explain, missing_packages
from depthcli.core.errors import ConfigError
from depthcli.core.plugins import is_file_loaded, load_file
from depthcli.core.yaml_source import (
    Builder,
    ConfigData,
    Location,
    compose,
    dotted,
    parse_config,
    read_config,
    short,
    to_yaml,
)

__all__ = [
    "ConfigData", "dump_config", "load_config", "overlay", "overlay_values", "parse_config", "read_config", "to_yaml",
    "validate",
]  # fmt: skip

_Model = TypeVar("_Model", bound=BaseModel)

_METHOD_KEYS = ("method", "pipeline")


def overlay(
    config: ConfigData, settings: Iterable[str | tuple[str, str]], defaults: dict[str, Any] | None = None
) -> None:
    """Apply ``--set`` options in order, in place.

    Parameters
    ----------
    config : of the file
    settings : options, each as ``a.b=value`` or as (option, ``a.b=value``), where messages name ``option`` instead of
        ``--set``. The value is YAML; a number in the path is an index of a list
    defaults : values of keys that the file leaves out, so that a single key below them can be set
    """
    for entry in settings:
        option, setting = entry if isinstance(entry, tuple) else ("", entry)
        path, equals, text = setting.partition("=")
        parts = [int(p) if p.isdecimal() and len(p) < 9 else p for p in path.strip().split(".")]
        if not equals or any(p == "" for p in parts):
            config.problems.append(f"--set {setting[:64]}: want KEY=VALUE, such as --set cost.window=[9,7]")
            continue
        place = option or f"--set {path.strip()}"
        try:
            node = compose(text, place)
        except ConfigError as error:
            config.problems.append(str(error))
            continue
        location: Location = tuple(parts)
        places: dict[Location, str] = {}
        value = None if node is None else Builder(place, places, config.problems, lines=False).build(node, location)
        _put(config, location, value, place, defaults)
        config.places.update({at: each for at, each in places.items() if at != location})


def overlay_values(config: ConfigData, values: Mapping[str, Any], defaults: dict[str, Any] | None = None) -> None:
    """Apply values, in order, in place.

    Parameters
    ----------
    config : as for :func:`overlay`
    values : ``a.b`` -> plain value. A mapping that selects no method changes only the keys that it holds
    defaults : as for :func:`overlay`
    """
    for path, value in values.items():
        parts = [int(p) if p.isdecimal() and len(p) < 9 else p for p in path.split(".")]
        if isinstance(value, Mapping) and value and not any(key in value for key in _METHOD_KEYS):
            overlay_values(config, {f"{path}.{key}": each for key, each in value.items()}, defaults)
        elif any(part == "" for part in parts):
            config.problems.append(f"override {path[:64]!r}: want the name of a key, such as cost.window")
        else:
            _put(config, tuple(parts), value, f"override {path}", defaults)


def _put(config: ConfigData, location: Location, value: Any, place: str, defaults: dict[str, Any] | None) -> None:
    """Set one value that ``place`` gives, or note why that cannot be."""
    problem = _assign(config.data, location, defaults or {})
    if problem:
        config.problems.append(f"{place}: {problem}")
        return
    _walk(config.data, location[:-1])[location[-1]] = value
    for below in [p for p in config.places if p[: len(location)] == location]:
        del config.places[below]
    config.places[location] = place


def with_base(config: ConfigData, path: Path, find: Callable[[str], Path | None], chain: tuple[Path, ...] = ()) -> None:
    """Lay ``config`` over the one that its key ``base`` names, in place.

    Mappings are merged key by key, except that a mapping which selects a different method replaces the base's mapping.
    Any other value replaces that of the base.

    Parameters
    ----------
    config : of the file ``path``
    find : returns the file of a preset by its name, or None; a file in the folder of ``path`` has precedence
    chain : the files that were read before this one, each naming the next as its base

    Raises
    ------
    ConfigError
        The base cannot be read, or leads back to this file.
    """
    if "base" not in config.data:
        return
    name, place = config.data.pop("base"), config.place(("base",))
    config.places.pop(("base",), None)
    if not isinstance(name, str) or not name or "\0" in name:
        config.problems.append(f"{place}: base: want the name of a preset or a file (got {short(name)})")
        return
    beside = (path.parent / name, path.parent / f"{name}.yaml")
    others = (file for file in beside if os.path.isfile(file) and file.resolve() != path.resolve())
    target = next(others, None) or find(name)
    if target is None:
        config.problems.append(f"{place}: base: {short(name)} is neither a preset nor a file beside this one")
        return
    chain = (*chain, path.resolve())
    if target.resolve() in chain:
        raise ConfigError(f"{place}: base: {name} leads back to this file")
    base = read_config(target)
    load_plugins(base, target.parent)
    with_base(base, target, find, chain)
    config.problems += base.problems
    files = [data["plugins"] for data in (base.data, config.data) if isinstance(data.get("plugins"), list)]
    config.data = _merged(base.data, config.data)
    if len(files) == 2:  # a base's methods need its files
        config.data["plugins"] = list(dict.fromkeys(map(str, files[0] + files[1])))
    config.places = {at: where for at, where in base.places.items() if _has(config.data, at)} | config.places


def load_plugins(config: ConfigData, folder: Path) -> None:
    """Read the files of the key ``plugins``, which lie in ``folder`` or were read before (``--plugin``).

    Raises
    ------
    ConfigError
        A file is missing, or cannot be used.
    """
    names = config.data.get("plugins")
    for number, name in enumerate(names if isinstance(names, list) else []):
        place = f"{config.place(('plugins', number))}: plugins"
        if not isinstance(name, str) or not name or "\0" in name:
            config.problems.append(f"{place}: want the name of a Python file (got {short(name)})")
        elif os.path.isfile(folder / name):
            load_file(folder / name)
        elif not is_file_loaded(Path(name).name):
            raise ConfigError(f"{place}: {name} is no file in {folder}; --plugin FILE.py says where it is")


def _merged(base: Any, over: Any) -> Any:
    if not isinstance(base, dict) or not isinstance(over, dict):
        return over
    if any(key in over and over[key] != base.get(key) for key in _METHOD_KEYS):
        return over
    return base | {key: _merged(base[key], value) if key in base else value for key, value in over.items()}


def _has(data: Any, location: Location) -> bool:
    try:
        _walk(data, location)
    except (KeyError, IndexError, TypeError):
        return False
    return True


def validate(model: type[_Model], config: ConfigData, folder: Path | None = None) -> _Model:
    """Return ``config`` as ``model``, checked.

    Parameters
    ----------
    folder : of the config's file, None where it is none; validators find it as ``folder`` in their context

    Raises
    ------
    ConfigError
        All problems, one per line.
    """
    problems = list(config.problems)
    try:
        value = model.model_validate(config.data, context={"folder": folder})
    except ValidationError as error:
        problems += [explain(model, config, each) for each in error.errors(include_url=False)]
        problems += missing_packages(config)
    if problems:
        raise ConfigError("\n".join(sorted(dict.fromkeys(problems), key=_line_number)))
    return value


def load_config(
    model: type[_Model],
    source: Path | ConfigData,
    settings: Sequence[str | tuple[str, str]] = (),
    find: Callable[[str], Path | None] = lambda name: None,
    values: Mapping[str, Any] | None = None,
) -> _Model:
    """Return a config read, laid over its base, overlaid with options and checked.

    Parameters
    ----------
    model : of the config's root
    source : a file, or a config that was read already, whose ``base`` is not followed
    settings : as for :func:`overlay`
    find : as for :func:`with_base`
    values : as for :func:`overlay_values`

    Raises
    ------
    ConfigError
        With every problem found.
    """
    config = source if isinstance(source, ConfigData) else read_config(source)
    if isinstance(source, Path):
        load_plugins(config, source.parent)
        with_base(config, source, find)
    if settings or values:
        defaults: dict[str, Any] = {}
        if not config.problems:
            with contextlib.suppress(ValidationError):  # reported below, where --set may have mended it
                defaults = model.model_validate(config.data).model_dump(mode="json", by_alias=True)
        overlay(config, settings, defaults)
        overlay_values(config, values or {}, defaults)
    return validate(model, config, source.parent if isinstance(source, Path) else None)


def dump_config(model: BaseModel) -> str:
    """Return the resolved model as YAML, always the same text for the same values; reads back to an equal model."""
    return to_yaml(model.model_dump(mode="json", by_alias=True))


def _line_number(problem: str) -> int:
    match = re.match(r"[^\n]*?:(\d+): ", problem)
    return int(match[1]) if match else 0


def _walk(data: Any, location: Location) -> Any:
    for part in location:
        data = data[part]
    return data


def _assign(data: dict[str, Any], location: Location, defaults: Any) -> str:
    """Make room for a value at ``location``; the problem in words where that cannot be."""
    inside: Any = data
    for depth, part in enumerate(location):
        at = dotted(location[:depth]) or "the root"
        if isinstance(inside, list):
            if not isinstance(part, int):
                return f"{at} is a list of {len(inside)}; want an index such as {at}.0 (got {part!r})"
            if part >= len(inside):
                return f"{at} has {len(inside)} entries; the last index is {len(inside) - 1} (got {part})"
        elif not isinstance(inside, dict):
            return f"{at} is a single value, nothing can be set below it"
        if depth == len(location) - 1:
            break
        try:
            defaults = defaults[part]
        except (KeyError, IndexError, TypeError):
            defaults = None
        below = inside.get(part) if isinstance(inside, dict) else inside[part]
        if below is None:
            below = copy.deepcopy(defaults) if isinstance(defaults, dict | list) else {}
        elif isinstance(below, str):
            # A method written by its name alone: the key goes into its parameters.
            below = {"method": below}
        inside[part] = below
        inside = below
    return ""
