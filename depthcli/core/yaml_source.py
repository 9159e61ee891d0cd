"""Read YAML as plain data with the line of every value, and write it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from depthcli.core.errors import ConfigError
from depthcli.core.text import short

Location = tuple[str | int, ...]

OVERRIDES = ("--", "override ")
"""Prefixes of places that are no files: options of the command line, and overrides in Python."""

# Limits for damaged or malicious files, since anchors can multiply nodes.
_MAX_BYTES = 1 << 20
_MAX_NODES = 50_000
_MAX_DEPTH = 60
_PLAIN_TAGS = {f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null", "merge")}


_OLD_NUMBER = re.compile(r"[-+]?(0[0-7_]+$|[\d_]+:)")  # octal and sexagesimal numbers of YAML 1.1


class _Loader(yaml.SafeLoader):
    """Safe loader that reads ``1e-3`` as a number, as YAML 1.2 does, and dates as text."""

    _n_nodes = 0

    def plain(self, node: yaml.Node, places: dict[Location, str], location: Location = ()) -> Any:
        """Return the node at ``location`` as plain data, and add the place of every value in it to ``places``."""
        self._n_nodes += 1
        if self._n_nodes > _MAX_NODES or len(location) > _MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem="too large, or nested too deeply", problem_mark=node.start_mark)
        if node.tag not in _PLAIN_TAGS:
            raise yaml.MarkedYAMLError(problem=f"unknown tag {node.tag}", problem_mark=node.start_mark)
        if isinstance(node, yaml.SequenceNode):
            items = []
            for i, child in enumerate(node.value):
                places[*location, i] = f"{self.name}:{child.start_mark.line + 1}"
                items.append(self.plain(child, places, (*location, i)))
            return items
        if not isinstance(node, yaml.MappingNode):
            return self.construct_object(node)
        self.flatten_mapping(node)
        values = {}
        for key, value in node.value:
            places[*location, key.value] = f"{self.name}:{key.start_mark.line + 1}"
            values[key.value] = self.plain(value, places, (*location, key.value))
        return values

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a key must be a name", problem_mark=key.start_mark)
            if key.value in lines:
                twice = f"the key {key.value} is written twice, first in line {lines[key.value]}"
                raise yaml.MarkedYAMLError(problem=twice, problem_mark=key.start_mark)
            lines[key.value] = key.start_mark.line + 1
        return node

    def number(self, node: yaml.ScalarNode) -> int | float:
        """Return the value of a number. Raise an error for forms that YAML 1.2 reads otherwise."""
        is_whole = node.tag.endswith(":int")
        value: int | float = self.construct_yaml_int(node) if is_whole else self.construct_yaml_float(node)
        if _OLD_NUMBER.match(node.value):
            problem = f"{node.value} is {value} in YAML; write {value}, or quote it if it is no number"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
        return value


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.number)
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith((":timestamp", ":value"))]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


@dataclass
class ConfigData:
    """A parsed config before it is checked."""

    name: str  # of the file, for messages
    data: dict[str, Any] = field(default_factory=dict)  # the root mapping
    places: dict[Location, str] = field(default_factory=dict)  # of a value -> file:line, or the option that set it

    def place(self, location: Location) -> str:
        """Return the place of the value at ``location``, for messages.

        It is the last option or override that set the value or a part of it; otherwise the ``file:line`` of the value
        or of the nearest enclosing value.
        """
        within = [place for at, place in self.places.items() if at[: len(location)] == location]
        if location and (changed := [place for place in within if place.startswith(OVERRIDES)]):
            return changed[-1]
        around = (self.places.get(location[:size]) for size in range(len(location), 0, -1))
        return next(filter(None, around), self.name)


def read_config(path: Path) -> ConfigData:
    """Parse a config file. Raise ConfigError if it cannot be read or is no YAML mapping."""
    try:
        if path.is_fifo():
            raise ConfigError(f"{path}: cannot be read (a pipe)")
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError(f"{path}: larger than 1 MiB; is this a config file?")
    try:
        return parse_config(raw.decode("utf-8-sig"), str(path))
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: not UTF-8 text; is this a config file?") from None


def parse_config(text: str, name: str) -> ConfigData:
    """Parse the text of the config file ``name``. Raise ConfigError if it is no YAML mapping."""
    places: dict[Location, str] = {}
    data = parse_value(text, name, places)
    if not isinstance(data, dict):
        got = "nothing" if data is None else short(data)
        raise ConfigError(f"{name}: expected a mapping of keys to values, got {got}")
    return ConfigData(name, data, places)


def parse_value(text: str, name: str, places: dict[Location, str] | None = None) -> Any:
    """Return the YAML text of a file or option as plain data. Raise ConfigError if it is invalid.

    ``file:line`` of every value is added to ``places``.
    """
    mark = None
    try:
        loader = _Loader(text)
        loader.name = name
        node = loader.get_single_node()
        return None if node is None else loader.plain(node, {} if places is None else places)
    except RecursionError:
        what = "nested too deeply"
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = " ".join(filter(None, [error.context, error.problem]))
        if "'\\t'" in what:
            what = "a tab; YAML needs spaces for indentation"
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        what = str(getattr(error, "reason", error)).splitlines()[0]
    place = name if mark is None or places is None else f"{name}:{mark.line + 1}"
    raise ConfigError(f"{place}: not valid YAML ({what})")


def to_yaml(value: Any) -> str:
    """Return plain data as YAML in the given order; flat lists are on one line."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110))


class _Dumper(yaml.SafeDumper):
    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        is_flat = {dict, list}.isdisjoint(map(type, sequence))
        return super().represent_sequence(tag, sequence, flow_style=is_flat)

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
