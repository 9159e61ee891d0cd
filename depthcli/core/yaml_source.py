"""YAML as plain data, with the place in the file of every value; and back."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from depthcli.core.errors import ConfigError

Location = tuple[str | int, ...]

OVERRIDES = ("--", "override ")
"""How the places of values begin that no file holds: options of the command line, and keywords of Python."""

# Far above any config, far below what would take long or much memory (anchors can multiply nodes).
_MAX_BYTES = 1 << 20
_MAX_NODES = 50_000
_MAX_DEPTH = 60
_MAX_DIGITS = 300  # of a number, in any base; the largest that floating point holds has 309
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
    name : of the file, for messages
    data : the root mapping
    places : location of a key or list entry -> ``file:line``, or the option that set it
    problems : lines for the user about what is wrong
    """

    name: str
    data: dict[str, Any] = field(default_factory=dict)
    places: dict[Location, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    def place(self, location: Location) -> str:
        """Return the place of the value at ``location``, for messages.

        That is the last option or override that set the value or a part of it; else its own ``file:line``, or that of
        the nearest value around it whose place is known.
        """
        if location not in self.places or not self.places[location].startswith(OVERRIDES):
            below = [place for at, place in self.places.items() if at[: len(location)] == location]
            changed = [place for place in below if place.startswith(OVERRIDES)]
            if location and changed:
                return changed[-1]
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
        if os.path.exists(path) and not os.path.isfile(path):  # a pipe would be waited for
            raise ConfigError(f"{path}: cannot be read (not a regular file)")
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if len(raw) > _MAX_BYTES:
        raise ConfigError(f"{path}: larger than 1 MiB; is this a config file?")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise ConfigError(f"{path}:{line}: not UTF-8 text; is this a config file?") from None
    return parse_config(text, str(path))


def parse_config(text: str, name: str) -> ConfigData:
    """Parse the text of a config file, which messages call ``name``. Raises as :func:`read_config` does."""
    node = compose(text, name)
    config = ConfigData(name)
    if node is None:
        raise ConfigError(f"{name}: the file is empty; want a mapping of keys to values")
    if not isinstance(node, yaml.MappingNode):
        kind = "a list" if isinstance(node, yaml.SequenceNode) else "a single value"
        raise ConfigError(f"{name}:{_line(node)}: want a mapping of keys to values at the root, got {kind}")
    config.data = Builder(name, config.places, config.problems).build(node, ())
    return config


def to_yaml(value: Any) -> str:
    """Return plain data as YAML in the given order, lists without mappings or lists in them on one line."""
    return str(yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110))


class _Dumper(yaml.SafeDumper):
    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        short = all(not isinstance(entry, dict | list) for entry in sequence)
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


def compose(text: str, name: str) -> yaml.Node | None:
    """Return the node tree of a YAML text, None of an empty one; ConfigError with the line where it is not YAML."""
    inline = name.startswith("--")
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_node()
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        what = " ".join(filter(None, [error.context, error.problem]))
        if "\\t" in what or "'\t'" in what:
            what = "a tab; YAML wants spaces for indentation"
        at = name if inline or mark is None else f"{name}:{mark.line + 1}"
        raise ConfigError(f"{at}: not valid YAML ({what})") from None
    except RecursionError:
        raise ConfigError(f"{name}: nested too deeply") from None
    except (yaml.YAMLError, ValueError) as error:
        what = str(getattr(error, "reason", error)).splitlines()[0]
        raise ConfigError(f"{name}: not valid YAML ({what})") from None


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


class Builder:
    """Turns YAML nodes into plain data.

    Parameters
    ----------
    name : of the file or option, for messages
    places : gets the place of every value
    problems : gets a line for every problem
    lines : whether a place has a line number
    """

    def __init__(self, name: str, places: dict[Location, str], problems: list[str], lines: bool = True) -> None:
        self.name, self.places, self.problems, self.lines = name, places, problems, lines
        self.nodes = 0
        self.open: list[int] = []
        self.scalars = _Loader("")

    def at(self, node: yaml.Node) -> str:
        return f"{self.name}:{_line(node)}" if self.lines else self.name

    def build(self, node: yaml.Node, location: Location) -> Any:
        """Return the plain data of a node that stands at ``location``; ConfigError where it is too large."""
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
                return [self.value(child, (*location, i)) for i, child in enumerate(node.value)]
            try:
                # Long ones take time that grows with the square of their length, or cannot be shown afterwards.
                if node.tag.endswith((":int", ":float")) and len(node.value) > _MAX_DIGITS:
                    raise ValueError
                return self.scalars.construct_object(node)
            except (ValueError, OverflowError, KeyError, yaml.YAMLError):
                kind = node.tag.rpartition(":")[2]
                self.problem(node, location, f"cannot be read as {kind} (got {short(node.value)})")
                return None
        finally:
            self.open.pop()

    def value(self, node: yaml.Node, location: Location) -> Any:
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
        key = dotted(location)
        self.problems.append(f"{self.at(node)}: {key}: {what}" if self.lines and key else f"{self.at(node)}: {what}")


def dotted(location: Iterable[str | int]) -> str:
    """Return a location as a user writes it: its parts with dots between."""
    return ".".join(str(part) for part in location)


def short(value: Any) -> str:
    """Return a value as text for a message, on one line of at most 64 characters."""
    try:
        text = value if isinstance(value, BaseModel) else json.dumps(value, ensure_ascii=False)
        text = str(text)
    except (TypeError, ValueError):
        try:
            text = repr(value)
        except ValueError:  # Python writes no integer of more than 4300 digits, which YAML holds as 0x...
            text = "a number of thousands of digits"
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 64 else text[:61] + "..."
