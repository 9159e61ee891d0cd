"""Options that commands share, whether or not they run over scenes, as typer reads them from the types of parameters.

A command takes single options (``set: SetOption = None``) and groups of them (``run: RunOptions``), dataclasses whose
fields become options of their own.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_type_hints

from typer import Argument, BadParameter, Context, Option

from depthcli.core.errors import ConfigError
from depthcli.run.console import Reporter

_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # pathlib leaves one slash
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


# A name is given where typer would make another one of the parameter's: flags get no "--no-..." by it.
ConfigArgument: TypeAlias = Annotated[
    str,
    Argument(metavar="CONFIG", help="YAML file, or the name of a preset."),
]
InputOption: TypeAlias = Annotated[
    Path | None,
    Option("--input", "-i", metavar="DIR", help="Folder, archive or URL; or CSV of stereo pairs (-: stdin)."),
]
LayoutOption: TypeAlias = Annotated[
    str | None,
    Option(metavar="NAME", help="Layout of the folder. Default: recognized."),
]
ScenesOption: TypeAlias = Annotated[
    list[str] | None, Option(metavar="GLOB", help="Only scenes whose name matches; repeatable.")
]
SetOption: TypeAlias = Annotated[
    list[str] | None,
    Option(metavar="KEY=VALUE", help="Override one key of the config; repeatable."),
]
MaxDisparityOption: TypeAlias = Annotated[
    str | None, Option(metavar="N", help="Largest disparity searched, or auto: from the pair.")
]
WithinOption: TypeAlias = Annotated[
    float, Option(metavar="PX", min=0.25, max=8, help="Error up to which a value is right in probability.pfm, pixels.")
]
LevelOption: TypeAlias = Annotated[
    float, Option(metavar="P", min=0.5, max=0.99, help="Share of the errors that are not larger than bound.pfm.")
]
BoundOption: TypeAlias = Annotated[
    bool, Option("--bound", help="Also write bound.pfm, which 90 % of the errors do not exceed, and probability.pfm.")
]
HtmlOption: TypeAlias = Annotated[bool, Option("--html", help="Also write evaluation/report.html.")]
FlagOption: TypeAlias = Annotated[
    list[str] | None, Option(metavar="CONDITION", help="Flag rows, such as 'measured<0.6'; repeatable, any of them.")
]
FailFlaggedOption: TypeAlias = Annotated[bool, Option("--fail-flagged", help="Exit with 4 where a row is flagged.")]
PluginOption: TypeAlias = Annotated[
    list[Path] | None,
    Option(metavar="PLUGIN", help="FILE.py or module, with methods, layouts or commands of your own; repeatable."),
]
"""Loaded by ``cli`` before all else, since it may define the command itself."""


def option(default: Any, *names: str, **settings: Any) -> Any:
    """Return a field of a group that is an option of its own, described as by ``typer.Option``."""
    return field(default=default, metadata={"option": Option(*names, **settings)})


@dataclass(frozen=True, kw_only=True)
class Printing:
    """Options of the output on the terminal."""

    json: bool = option(False, "--json", help="Print one JSON document instead of a table.")
    verbose: bool = option(False, "--verbose", "-v", help="Print details on stderr.")
    quiet: bool = option(False, "--quiet", "-q", help="Print only errors, and no table.")
    command_line: str = ""  # of this call, as a shell takes it

    @cached_property
    def reporter(self) -> Reporter:
        """What takes messages and data."""
        return Reporter(-1 if self.quiet else int(self.verbose), self.command_line)


@dataclass(frozen=True, kw_only=True)
class TableOptions:
    """Which tables of an evaluation are printed, and how."""

    tables: str | None = option(
        None, metavar="NAMES", help="Tables to print: all, or metrics,scenes-nonocc ... or headline."
    )
    format: str | None = option(None, metavar="FORMAT", help="Print wide tables: latex, markdown or csv.")
    columns: str | None = option(None, metavar="NAMES", help="Of the tables, print only these columns.")
    caption: str | None = option(None, metavar="TEXT", help="Caption of the one table that --tables chooses.")


def local_output(output: Path | None) -> Path | None:
    """Return the value of ``--output``; typer.BadParameter where it names no place on this machine."""
    if output is not None and _URL.match(str(output)) and not os.path.lexists(output.parts[0]):
        raise BadParameter("results are written to this machine, not to URLs; give a folder")
    if str(output) == "-":
        raise BadParameter("results are files, nothing that can be written to stdout; see --json")
    return output


def parse_bytes(text: str, option: str = "--max-memory") -> int:
    """Return ``2GiB``, ``500M`` or ``1e9`` in bytes; ConfigError for any other text."""
    match = re.fullmatch(r"\s*(\d{1,18}(?:\.\d{0,9})?(?:[eE]\d{1,2})?)\s*([kmgt]i?|)b?\s*", text, re.IGNORECASE)
    size = int(float(match[1]) * _UNITS[match[2].lower()]) if match else 0
    if size < 1:
        raise ConfigError(f"{option}: must be a size such as 2GiB or 500M (got {text[:40]!r})")
    return size


def with_groups(function: Callable[..., int]) -> Callable[..., int]:
    """Return a command's function with the signature that typer reads: fields of groups are options of their own."""
    groups: dict[str, tuple[type, list[str]]] = {}
    make = functools.partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    parameters = [make("plugin", default=None, annotation=PluginOption), make("context", annotation=Context)]
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind))
            continue
        types, own = get_type_hints(kind, include_extras=True), []
        for each in fields(kind):
            described = each.metadata.get("option")
            annotation = types[each.name] if described is None else Annotated[types[each.name], described]
            if hasattr(annotation, "__metadata__"):
                default = inspect.Parameter.empty if each.default is MISSING else each.default
                parameters.append(make(each.name, default=default, annotation=annotation))
                own.append(each.name)
        groups[name] = kind, own  # type: ignore[assignment]

    @functools.wraps(function)
    def callback(context: Context, **values: Any) -> int:
        values.pop("plugin")
        for name, (kind, names) in groups.items():
            line = {"command_line": context.obj or ""} if issubclass(kind, Printing) else {}
            values[name] = kind(**{each: values.pop(each) for each in names}, **line)
        return function(**values)

    callback.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return callback
