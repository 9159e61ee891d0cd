"""Config files checked against a pydantic model.

Precedence: field default < base < file < ``--set key=value``. All problems are reported together, each as
``file:line: key: what is wrong (got ...); did you mean ...``.

A model whose key got another name says so in ``renamed: ClassVar[dict[str, str]] = {"old": "new"}``. The old key
is then refused as any unknown key is, with the new name as the hint, however little the two are alike.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ValidationError

from depthcli.core.errors import ConfigError
from depthcli.core.method import Family
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

__all__ = ["ConfigData", "dump_config", "load_config", "overlay", "parse_config", "read_config", "to_yaml", "validate"]

_Model = TypeVar("_Model", bound=BaseModel)

_MISSING = object()
_METHOD_KEYS = ("method", "pipeline")


def overlay(
    config: ConfigData, settings: Iterable[str | tuple[str, str]], defaults: dict[str, Any] | None = None
) -> None:
    """Apply ``--set`` options in order, in place.

    Parameters
    ----------
    config : what the file said
    settings : ``a.b=value``; value is YAML, a number in the path is the index of a list scene. A pair begins with the
        option that messages shall blame instead of ``--set``
    defaults : values of keys that the file leaves out, so that one key below them can be set
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
        problem = _assign(config.data, location, defaults or {})
        if problem:
            config.problems.append(f"{place}: {problem}")
            continue
        places: dict[Location, str] = {}
        value = None if node is None else Builder(place, places, config.problems, lines=False).build(node, location)
        parent = _walk(config.data, location[:-1])
        parent[location[-1]] = value
        for known in [p for p in config.places if p[: len(location)] == location]:
            del config.places[known]
        config.places.update(places)
        config.places[location] = place


def with_base(config: ConfigData, path: Path, find: Callable[[str], Path | None], seen: tuple[Path, ...] = ()) -> None:
    """Lay ``config`` over the one that its key ``base`` names, in place.

    Mappings are merged key by key, but for one that names another method; anything else replaces what the base says.

    Parameters
    ----------
    config : of the file ``path``
    find : gives the file of a preset's name, or None; a file beside ``path`` goes first

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
    target = next((file for file in beside if file.is_file() and file.resolve() != path.resolve()), None) or find(name)
    if target is None:
        config.problems.append(f"{place}: base: {short(name)} is neither a preset nor a file beside this one")
        return
    chain = (*seen, path.resolve())
    if target.resolve() in chain:
        raise ConfigError(f"{place}: base: {name} leads back to this file")
    base = read_config(target)
    with_base(base, target, find, chain)
    config.problems += base.problems
    config.data = _merged(base.data, config.data)
    config.places = {at: where for at, where in base.places.items() if _has(config.data, at)} | config.places


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


def validate(model: type[_Model], config: ConfigData) -> _Model:
    """Check ``config`` against ``model``.

    Raises
    ------
    ConfigError
        All problems, one a line.
    """
    problems = list(config.problems)
    try:
        value = model.model_validate(config.data)
    except ValidationError as error:
        problems += [_explain(model, config, scene) for scene in error.errors(include_url=False)]
    if problems:
        raise ConfigError("\n".join(sorted(dict.fromkeys(problems), key=_line_number)))
    return value


def load_config(
    model: type[_Model],
    source: Path | ConfigData,
    settings: Sequence[str | tuple[str, str]] = (),
    find: Callable[[str], Path | None] = lambda name: None,
) -> _Model:
    """Read, lay over its base, overlay and check in one go.

    Parameters
    ----------
    model : of the config's root
    source : a file, or what was read already
    settings : as for :func:`overlay`
    find : as for :func:`with_base`

    Raises
    ------
    ConfigError
        With every problem found.
    """
    config = source if isinstance(source, ConfigData) else read_config(source)
    if isinstance(source, Path):
        with_base(config, source, find)
    if settings:
        defaults: dict[str, Any] = {}
        if not config.problems:
            with contextlib.suppress(ValidationError):  # reported below, where --set may have mended it
                defaults = model.model_validate(config.data).model_dump(mode="json", by_alias=True)
        overlay(config, settings, defaults)
    return validate(model, config)


def dump_config(model: BaseModel) -> str:
    """The resolved model as YAML, always the same text for the same values; reads back to an equal model."""
    return to_yaml(model.model_dump(mode="json", by_alias=True))


def _line_number(problem: str) -> int:
    found = re.match(r"[^\n]*?:(\d+): ", problem)
    return int(found[1]) if found else 0


def _walk(data: Any, location: Location) -> Any:
    for part in location:
        data = data[part]
    return data


def _assign(data: dict[str, Any], location: Location, defaults: Any) -> str:
    """Make room for a value at ``location``; the problem in words where that cannot be."""
    here: Any = data
    for depth, part in enumerate(location):
        last = depth == len(location) - 1
        at = dotted(location[:depth]) or "the root"
        if isinstance(here, list):
            if not isinstance(part, int):
                return f"{at} is a list of {len(here)}; want an index such as {at}.0 (got {part!r})"
            if part >= len(here):
                return f"{at} has {len(here)} scenes; the last index is {len(here) - 1} (got {part})"
        elif not isinstance(here, dict):
            return f"{at} is a single value, nothing can be set below it"
        if last:
            return ""
        default = _MISSING
        if isinstance(defaults, dict) or (isinstance(defaults, list) and isinstance(part, int)):
            try:
                default = defaults[part]  # type: ignore[index]
            except (KeyError, IndexError):
                default = _MISSING
        below = here.get(part) if isinstance(here, dict) else here[part]
        if below is None:
            below = json.loads(json.dumps(default)) if isinstance(default, dict | list) else {}
        elif isinstance(below, str):
            # A method written by its name alone: the key goes into its parameters.
            below = {"method": below}
        here[part] = below
        here, defaults = below, default
    return ""


def _explain(model: type[BaseModel], config: ConfigData, scene: Any) -> str:
    """One pydantic error as one line."""
    kind: str = scene["type"]
    location = _resolve(model, config.data, tuple(scene["loc"]), kind == "missing")
    place = config.place(location)
    key = dotted(location)
    got, hint = scene.get("input"), ""
    known: list[str] = []
    if kind == "extra_forbidden":
        what = "no such key"
        owners = _models(model, config.data, location[:-1])
        known = _keys(owners)
        old = str(location[-1]) if location else ""
        renamed: list[dict[str, str]] = [getattr(owner, "renamed", {}) for owner in owners]
        near = [names[old] for names in renamed if old in names] or difflib.get_close_matches(old, known, 1, 0.6)
        if near:
            hint = f"; did you mean {near[0]!r}?"
        elif known:
            hint = f"; there are: {', '.join(known)}"
    elif kind == "missing":
        what = "missing, and it has no default"
    elif kind in ("method_name", "method_type"):
        what, _, hint = str(scene["msg"]).partition(";")
        hint = f";{hint}" if hint else ""
    else:
        what = str(scene["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
        what = what.replace("Input should", "should", 1)
    shown = "" if kind in ("missing", "method_name") or _is_big(got) else f" (got {short(got)})"
    # An option that names the key, or one below it, needs no key beside it.
    named = place.startswith("--") and (not place.startswith("--set ") or f"{place[6:]}.".startswith(f"{key}."))
    prefix = place if named or not key else f"{place}: {key}"
    return f"{prefix}: {what}{shown}{hint}"


def _resolve(model: type[BaseModel], data: Any, loc: Location, missing: bool) -> Location:
    """Pydantic's location as keys of the file, without the names of union members and of a flattened field."""
    flat = getattr(model, "flattened", None)
    out: list[str | int] = []
    here = data
    for depth, part in enumerate(loc):
        last = depth == len(loc) - 1
        if depth == 0 and part == flat and not last:
            continue
        if isinstance(here, dict) and isinstance(part, str):
            if part in here or last:
                out.append(part)
            here = here.get(part, here)  # names of union members and of a flattened field are not in the data
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            out.append(part)
            here = here[part]
        elif missing and last:
            out.append(part)
    return tuple(out)


def _is_big(value: Any) -> bool:
    return isinstance(value, dict | list | tuple | BaseModel) and len(short(value)) > 60


def _keys(owners: Iterable[type[BaseModel]]) -> list[str]:
    """Names of the keys that may stand in a mapping read as one of ``owners``."""
    names: list[str] = []
    for kind in owners:
        fields = [info.alias or name for name, info in kind.model_fields.items() if not info.exclude]
        names += [name for name in fields if name not in names]
    return names


def _models(kind: Any, data: Any, location: Location) -> list[type[BaseModel]]:
    """The models that the value at ``location`` may be of, following the data where a family is met."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        flat = kind.model_fields.get(getattr(kind, "flattened", ""))
        family = _family([*flat.metadata, *_inside(flat.annotation)]) if flat else None
        inner = _method(family, data) if family else []
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
        inside, *metadata = get_args(kind)
        family = _family(metadata)
        if family is None:
            return _models(inside, data, location)
        return [m for method in _method(family, data) for m in _models(method, data, location)]
    if origin in (Union, UnionType):
        return [m for option in get_args(kind) for m in _models(option, data, location)]
    if origin in (list, tuple, Sequence) and location and isinstance(location[0], int):
        scenes = [a for a in get_args(kind) if a is not Ellipsis]
        below = data[location[0]] if isinstance(data, list) and location[0] < len(data) else None
        return [m for option in scenes for m in _models(option, below, location[1:])]
    if origin is dict and location:
        below = data.get(location[0]) if isinstance(data, dict) else None
        return _models(get_args(kind)[1], below, location[1:])
    return []


def _inside(annotation: Any) -> list[Any]:
    """What stands beside the types of an optional annotation."""
    if get_origin(annotation) is Annotated:
        return list(get_args(annotation)[1:])
    return [scene for option in get_args(annotation) for scene in _inside(option)]


def _family(metadata: Iterable[Any]) -> Family | None:
    for scene in metadata:
        owner = getattr(scene.func, "__self__", None) if isinstance(scene, BeforeValidator) else None
        if isinstance(owner, Family):
            return owner
    return None


def _method(family: Family, data: Any) -> list[type[BaseModel]]:
    name = data if isinstance(data, str) else data.get(family.key) if isinstance(data, dict) else None
    own = family.named(name) if isinstance(name, str) else None
    return [family.load(own)] if own is not None else []
