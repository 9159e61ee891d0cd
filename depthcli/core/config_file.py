"""Config files: YAML with a memory of where every value stands, checked against a pydantic model.

Precedence: field default < file < ``--set key=value``. All problems are reported together, each as
``file:line: key: what is wrong (got ...); did you mean ...``.
"""

from __future__ import annotations

import contextlib
import difflib
import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, BeforeValidator, ValidationError

from depthcli.core.errors import ConfigError
from depthcli.core.method import Family

Location = tuple[str | int, ...]
_Model = TypeVar("_Model", bound=BaseModel)

_MAX_BYTES = 1 << 20
_MAX_NODES = 50_000
_MAX_DEPTH = 60
_MISSING = object()
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null")}


class _Loader(yaml.SafeLoader):
    """Safe loader that also reads ``1e-3`` as a number, as YAML 1.2 does, and leaves dates as text."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith((":timestamp", ":value"))]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


@dataclass
class ConfigData:
    """A parsed config before it is checked.

    Attributes
    ----------
    name : what messages call the file
    data : the root mapping
    places : location of a key or item -> ``file:line`` (or ``--set``)
    problems : what was wrong so far, ready to be shown
    """

    name: str
    data: dict[str, Any] = field(default_factory=dict)
    places: dict[Location, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def place(self, location: Location) -> str:
        """Where the value at ``location``, or the nearest one around it, was written."""
        for size in range(len(location), 0, -1):
            if location[:size] in self.places:
                return self.places[location[:size]]
        return self.name


def read_config(path: Path) -> ConfigData:
    """Parse a config file.

    Raises
    ------
    ConfigError
        The file cannot be read or is not a YAML mapping. Problems inside it are collected, not raised.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror or error})") from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError(f"{path}: larger than 1 MiB; is this a config file?")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: not UTF-8 text; is this a config file?") from None
    return parse_config(text, str(path))


def parse_config(text: str, name: str) -> ConfigData:
    """Parse the text of a config file; ``name`` stands in messages. Errors as :func:`read_config`."""
    node = _compose(text, name)
    config = ConfigData(name)
    if node is None:
        raise ConfigError(f"{name}: the file is empty; want a mapping of keys to values")
    if not isinstance(node, yaml.MappingNode):
        kind = "a list" if isinstance(node, yaml.SequenceNode) else "a single value"
        raise ConfigError(f"{name}:{_line(node)}: want a mapping of keys to values at the root, got {kind}")
    config.data = _Builder(name, config.places, config.problems).build(node, ())
    return config


def overlay(config: ConfigData, settings: Iterable[str], defaults: dict[str, Any] | None = None) -> None:
    """Apply ``--set`` options in order, in place.

    Parameters
    ----------
    config : what the file said
    settings : ``a.b=value``; value is YAML, a number in the path is the index of a list item
    defaults : values of keys that the file leaves out, so that one key below them can be set
    """
    for setting in settings:
        path, equals, text = setting.partition("=")
        parts = [int(p) if p.isdecimal() and len(p) < 9 else p for p in path.strip().split(".")]
        if not equals or any(p == "" for p in parts):
            config.problems.append(f"--set {setting}: want KEY=VALUE, such as --set cost.window=[9,7]")
            continue
        place = f"--set {path.strip()}"
        try:
            node = _compose(text, place)
        except ConfigError as error:
            config.problems.append(str(error))
            continue
        location: Location = tuple(parts)
        problem = _assign(config.data, location, defaults or {})
        if problem:
            config.problems.append(f"{place}: {problem}")
            continue
        places: dict[Location, str] = {}
        value = None if node is None else _Builder(place, places, config.problems, lines=False).build(node, location)
        parent = _walk(config.data, location[:-1])
        parent[location[-1]] = value
        for known in [p for p in config.places if p[: len(location)] == location]:
            del config.places[known]
        config.places.update(places)
        config.places[location] = place


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
        problems += [_explain(model, config, item) for item in error.errors(include_url=False)]
    if problems:
        raise ConfigError("\n".join(sorted(dict.fromkeys(problems), key=_line_number)))
    return value


def load_config(model: type[_Model], source: Path | ConfigData, settings: Sequence[str] = ()) -> _Model:
    """Read, overlay and check in one go; ConfigError with every problem found."""
    config = read_config(source) if isinstance(source, Path) else source
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


def to_yaml(value: Any) -> str:
    """Plain data as YAML in the given order, short lists on one line."""
    text: str = yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
    return text


def _line_number(problem: str) -> int:
    found = re.match(r"[^\n]*?:(\d+): ", problem)
    return int(found[1]) if found else 0


class _Dumper(yaml.SafeDumper):
    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        short = all(not isinstance(item, dict | list) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=short)

    def represent_float(self, data: float) -> yaml.ScalarNode:
        # PyYAML writes 1e-05 as text that YAML 1.1 reads as a string; repr with a dot is safe everywhere.
        text = repr(float(data))
        if "e" in text and "." not in text:
            text = text.replace("e", ".0e")
        if not math.isfinite(data):
            text = {"inf": ".inf", "-inf": "-.inf"}.get(text, ".nan")
        return self.represent_scalar("tag:yaml.org,2002:float", text)

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(float, _Dumper.represent_float)


def _compose(text: str, name: str) -> yaml.Node | None:
    """The node tree of a YAML text; ConfigError with the line where it is not YAML."""
    inline = name.startswith("--set")
    try:
        loader = _Loader(text)
        try:
            node: yaml.Node | None = loader.get_single_node()
        finally:
            loader.dispose()
        return node
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = " ".join(filter(None, [error.context, error.problem]))
        if "\\t" in what or "'\t'" in what:
            what = "a tab; YAML wants spaces for indentation"
        at = name if inline or mark is None else f"{name}:{mark.line + 1}"
        raise ConfigError(f"{at}: not valid YAML ({what})") from None
    except yaml.YAMLError as error:
        what = str(getattr(error, "reason", error)).splitlines()[0]
        raise ConfigError(f"{name}: not valid YAML ({what})") from None
    except RecursionError:
        raise ConfigError(f"{name}: nested too deeply") from None
    except ValueError as error:
        raise ConfigError(f"{name}: not valid YAML ({str(error).splitlines()[0]})") from None


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


class _Builder:
    """Turns nodes into plain data, noting places and collecting problems."""

    def __init__(self, name: str, places: dict[Location, str], problems: list[str], lines: bool = True) -> None:
        self.name, self.places, self.problems, self.lines = name, places, problems, lines
        self.nodes = 0
        self.open: list[int] = []
        self.scalars = _Loader("")

    def at(self, node: yaml.Node) -> str:
        return f"{self.name}:{_line(node)}" if self.lines else self.name

    def build(self, node: yaml.Node, location: Location) -> Any:
        self.nodes += 1
        if self.nodes > _MAX_NODES or len(self.open) > _MAX_DEPTH or id(node) in self.open:
            raise ConfigError(f"{self.at(node)}: too large, nested too deeply, or an anchor that contains itself")
        if node.tag not in _PLAIN_TAGS:
            kind = node.tag.removeprefix("tag:yaml.org,2002:")
            self.problem(node, location, f"want plain YAML, got the tag {kind!r}")
            return None
        self.open.append(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self.mapping(node, location)
            if isinstance(node, yaml.SequenceNode):
                return [self.item(child, (*location, i)) for i, child in enumerate(node.value)]
            try:
                return self.scalars.construct_object(node)
            except (ValueError, OverflowError, KeyError, yaml.YAMLError):
                kind = node.tag.rpartition(":")[2]
                self.problem(node, location, f"cannot be read as {kind} (got {_short(node.value)})")
                return None
        finally:
            self.open.pop()

    def item(self, node: yaml.Node, location: Location) -> Any:
        self.places[location] = self.at(node)
        return self.build(node, location)

    def mapping(self, node: yaml.MappingNode, location: Location) -> dict[str, Any]:
        result: dict[str, Any] = {}
        own: dict[str, int] = {}
        merged: list[tuple[yaml.Node, yaml.Node]] = []
        for key, value in node.value:
            if key.tag == "tag:yaml.org,2002:merge":
                sources = value.value if isinstance(value, yaml.SequenceNode) else [value]
                for source in sources:
                    if isinstance(source, yaml.MappingNode):
                        merged.append((key, source))
                    else:
                        self.problem(key, location, "'<<' wants a mapping or a list of mappings")
                continue
            if not isinstance(key, yaml.ScalarNode):
                self.problem(key, location, "a key must be a name")
                continue
            name = str(key.value)
            if name in own:
                self.problem(key, (*location, name), f"written twice (first in line {own[name]})")
                continue
            own[name] = _line(key)
            self.places[(*location, name)] = self.at(key)
            result[name] = self.build(value, (*location, name))
        for key, source in merged:
            if id(source) in self.open:
                raise ConfigError(f"{self.at(key)}: an anchor that contains itself")
            for name, value in self.build(source, location).items():
                result.setdefault(name, value)
        return result

    def problem(self, node: yaml.Node, location: Location, what: str) -> None:
        key = _dotted(location)
        self.problems.append(f"{self.at(node)}: {key}: {what}" if self.lines and key else f"{self.at(node)}: {what}")


def _walk(data: Any, location: Location) -> Any:
    for part in location:
        data = data[part]
    return data


def _assign(data: dict[str, Any], location: Location, defaults: Any) -> str:
    """Make room for a value at ``location``; the problem in words where that cannot be."""
    here: Any = data
    for depth, part in enumerate(location):
        last = depth == len(location) - 1
        at = _dotted(location[:depth]) or "the root"
        if isinstance(here, list):
            if not isinstance(part, int):
                return f"{at} is a list of {len(here)}; want an index such as {at}.0 (got {part!r})"
            if part >= len(here):
                return f"{at} has {len(here)} items; the last index is {len(here) - 1} (got {part})"
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


def _dotted(location: Iterable[str | int]) -> str:
    return ".".join(str(part) for part in location)


def _explain(model: type[BaseModel], config: ConfigData, item: Any) -> str:
    """One pydantic error as one line."""
    kind: str = item["type"]
    location = _resolve(model, config.data, tuple(item["loc"]), kind == "missing")
    place = config.place(location)
    key = _dotted(location)
    got, hint = item.get("input"), ""
    known: list[str] = []
    if kind == "extra_forbidden":
        what = "no such key"
        known = _keys(model, config.data, location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, 1, 0.6) if location else []
        if near:
            hint = f"; did you mean {near[0]!r}?"
        elif known:
            hint = f"; there are: {', '.join(known)}"
    elif kind == "missing":
        what = "missing, and it has no default"
    elif kind in ("method_name", "method_type"):
        what, _, hint = str(item["msg"]).partition(";")
        hint = f";{hint}" if hint else ""
    else:
        what = str(item["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
        what = what.replace("Input should", "should", 1)
    shown = "" if kind in ("missing", "method_name") or _is_big(got) else f" (got {_short(got)})"
    prefix = place if place.startswith("--set") and place == f"--set {key}" else f"{place}: {key}" if key else place
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
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            out.append(part)
            here = here[part]
        elif missing and last:
            out.append(part)
    return tuple(out)


def _is_big(value: Any) -> bool:
    return isinstance(value, dict | list | tuple | BaseModel) and len(_short(value)) > 60


def _short(value: Any) -> str:
    try:
        text = value if isinstance(value, BaseModel) else json.dumps(value, ensure_ascii=False)
        text = str(text)
    except (TypeError, ValueError):
        text = repr(value)
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 64 else text[:61] + "..."


def _keys(model: type[BaseModel], data: Any, location: Location) -> list[str]:
    """Names of the keys that may stand in the mapping at ``location``."""
    found = _models(model, data, location)
    names: list[str] = []
    for kind in found:
        fields = [info.alias or name for name, info in kind.model_fields.items() if not info.exclude]
        names += [name for name in fields if name not in names]
    return names


def _models(kind: Any, data: Any, location: Location) -> list[type[BaseModel]]:
    """The models that the value at ``location`` may be of, following the data where a family is met."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        flat = kind.model_fields.get(getattr(kind, "flattened", ""))
        family = _family(flat.metadata) if flat else None
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
        items = [a for a in get_args(kind) if a is not Ellipsis]
        below = data[location[0]] if isinstance(data, list) and location[0] < len(data) else None
        return [m for option in items for m in _models(option, below, location[1:])]
    if origin is dict and location:
        below = data.get(location[0]) if isinstance(data, dict) else None
        return _models(get_args(kind)[1], below, location[1:])
    return []


def _family(metadata: Iterable[Any]) -> Family | None:
    for item in metadata:
        owner = getattr(item.func, "__self__", None) if isinstance(item, BeforeValidator) else None
        if isinstance(owner, Family):
            return owner
    return None


def _method(family: Family, data: Any) -> list[type[BaseModel]]:
    name = data if isinstance(data, str) else data.get(family.key) if isinstance(data, dict) else None
    return [family.load(name)] if isinstance(name, str) and name in family.names() else []
