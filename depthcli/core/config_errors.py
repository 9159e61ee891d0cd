"""Pydantic's errors as messages about a config file: which line, which key, what is wrong, what may be meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator

from depthcli.core.method import Family, RootConfig
from depthcli.core.plugins import is_file_loaded, is_installed
from depthcli.core.yaml_source import OVERRIDES, ConfigData, Location, dotted, short


def explain(model: type[BaseModel], config: ConfigData, error: Any) -> str:
    """Return one of pydantic's errors about ``config``, read as ``model``, as a line with the place in the file.

    A hint names the key or method that may be meant: the new name of one that is ``renamed``, or a similar one.
    """
    kind: str = error["type"]
    location = _resolve(model, config.data, tuple(error["loc"]), kind == "missing")
    place = config.place(location)
    key = dotted(location)
    got, hint = error.get("input"), ""
    if kind == "extra_forbidden":
        what = "no such key"
        owners = _models(model, config.data, location[:-1])
        known = _keys(owners)
        name = str(location[-1]) if location else ""
        renamed: list[dict[str, str]] = [getattr(owner, "renamed", {}) for owner in owners]
        near = [names[name] for names in renamed if name in names] or difflib.get_close_matches(name, known, 1, 0.6)
        if near:
            hint = f"; did you mean {near[0]!r}?"
        elif known:
            hint = f"; there are: {', '.join(known)}"
    elif kind == "missing":
        what = "missing, and it has no default"
    elif kind in ("method_name", "method_type"):
        what, _, hint = str(error["msg"]).partition(";")
        hint = f";{hint}" if hint else ""
    else:
        what = str(error["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
        what = what.replace("Input should", "should", 1)
    big = isinstance(got, dict | list | tuple | BaseModel) and len(short(got)) > 60
    shown = "" if big or kind in ("missing", "method_name") else f" (got {short(got)})"
    # An option or override that names the key, or one below it, needs no key beside it.
    path = place.partition(" ")[2]
    named = place.startswith(OVERRIDES) and (not path or f"{path}.".startswith(f"{key}."))
    prefix = place if named or not key else f"{place}: {key}"
    return f"{prefix}: {what}{shown}{hint}"


def missing_packages(config: ConfigData) -> list[str]:
    """Return a line for every package, or plug-in file, that the run of a run.yaml was made with and that is not here.

    Their methods are unknown here, which the other errors say.
    """
    run = config.data.get("run")
    versions = run.get("versions") if isinstance(run, dict) else None
    lines = []
    for package, version in versions.items() if isinstance(versions, dict) else ():
        place = f"{config.place(('run', 'versions', package))}: run.versions.{package}"
        made = f"{place}: the run was made with {package} {version}, which is not"
        if str(package).endswith(".py"):
            if not is_file_loaded(str(package)):
                lines.append(f"{made} loaded; --plugin FILE.py says where it is")
        elif package != "python" and not is_installed(str(package)):
            lines.append(f"{made} installed")
    return lines


def _resolve(model: type[BaseModel], data: Any, loc: Location, missing: bool) -> Location:
    """Pydantic's location as keys of the file, without the names of union members and of a flattened field."""
    flat = getattr(model, "flattened", None)
    keys: list[str | int] = []
    inside = data
    for depth, part in enumerate(loc):
        last = depth == len(loc) - 1
        if depth == 0 and part == flat and not last:
            continue
        if isinstance(inside, dict) and isinstance(part, str):
            if part in inside or last:
                keys.append(part)
            inside = inside.get(part, inside)  # names of union members and of a flattened field are not in the data
        elif isinstance(inside, list) and isinstance(part, int) and part < len(inside):
            keys.append(part)
            inside = inside[part]
        elif missing and last:
            keys.append(part)
    return tuple(keys)


def _keys(owners: Iterable[type[BaseModel]]) -> list[str]:
    """Names of the keys that may stand in a mapping read as one of ``owners``."""
    names: list[str] = []
    for kind in owners:
        fields = [info.alias or name for name, info in kind.model_fields.items() if not info.exclude]
        names += [name for name in fields if name not in names]
    return names


def _models(kind: Any, data: Any, location: Location) -> list[type[BaseModel]]:
    # The models that the value at ``location`` of ``data``, annotated with ``kind``, may be read as. Goes down one
    # part of the location at a time; where a field holds a method of a family, the data say which method.
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        # A model: itself, and the method that is written at its own level (see RootConfig.flattened).
        flat = kind.model_fields.get(getattr(kind, "flattened", ""))
        family = _family([*flat.metadata, *_metadata(flat.annotation)]) if flat else None
        own = kind.with_method(data) if flat and issubclass(kind, RootConfig) and isinstance(data, dict) else data
        inner = _method(family, own) if family else []
        if not location:
            return [kind, *inner]
        name = location[0]
        for owner in (kind, *inner):
            if isinstance(name, str) and name in owner.model_fields:
                info = owner.model_fields[name]
                below = data.get(name) if isinstance(data, dict) else None
                annotation: Any = Annotated[(info.annotation, *info.metadata)] if info.metadata else info.annotation
                return _models(annotation, below, location[1:])
        return []
    origin = get_origin(kind)
    if origin is Annotated:
        # A method of a family, by the validator in its metadata; else what is annotated.
        inside, *metadata = get_args(kind)
        family = _family(metadata)
        if family is None:
            return _models(inside, data, location)
        return [m for method in _method(family, data) for m in _models(method, data, location)]
    if origin in (Union, UnionType):  # any of the alternatives
        return [m for option in get_args(kind) for m in _models(option, data, location)]
    # A sequence, then a dict: the next part of the location is an index, or a key.
    if origin in (list, tuple, Sequence) and location and isinstance(location[0], int):
        elements = [a for a in get_args(kind) if a is not Ellipsis]
        below = data[location[0]] if isinstance(data, list) and location[0] < len(data) else None
        return [m for element in elements for m in _models(element, below, location[1:])]
    if origin is dict and location:
        below = data.get(location[0]) if isinstance(data, dict) else None
        return _models(get_args(kind)[1], below, location[1:])
    return []


def _metadata(annotation: Any) -> list[Any]:
    # Metadata of an annotation, or of the alternatives in it.
    if get_origin(annotation) is Annotated:
        return list(get_args(annotation)[1:])
    return [entry for option in get_args(annotation) for entry in _metadata(option)]


def _family(metadata: Iterable[Any]) -> Family | None:
    for entry in metadata:
        owner = getattr(entry.func, "__self__", None) if isinstance(entry, BeforeValidator) else None
        if isinstance(owner, Family):
            return owner
    return None


def _method(family: Family, data: Any) -> list[type[BaseModel]]:
    name = data if isinstance(data, str) else data.get(family.key) if isinstance(data, dict) else None
    known = family.find(name) if isinstance(name, str) else None
    return [family.load(known)] if known is not None else []
