"""Shell completion: names of presets, layouts and protocols, and keys of a config."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from typer import Context

from depthcli.commands import config_model
from depthcli.core.config_file import find_config, list_presets, load_config
from depthcli.core.method import RootConfig
from depthcli.evaluation import protocols as known_protocols
from depthcli.io.scenes.find import ALL_KINDS


def complete_values(callback: Callable[..., int]) -> None:
    """Add completion to the annotations of a command's parameters, before typer reads them."""
    for name, annotation in callback.__annotations__.items():
        if name in _FUNCTIONS:
            annotation.__metadata__[0].autocompletion = _beginning(_FUNCTIONS[name])


def _beginning(function: Callable[[Context], list[str]]) -> Callable[[Context, str], list[str]]:
    def complete(ctx: Context, incomplete: str) -> list[str]:
        with contextlib.suppress(Exception):  # completion cannot show messages
            return [text for text in function(ctx) if text.startswith(incomplete)]
        return []

    return complete


def presets(context: Context) -> list[str]:
    """Return the names of the command's presets, or of all presets if it has none."""
    found = list_presets()
    own = [name for command, name, _ in found if command == _command(context)]
    return own or list(dict.fromkeys(name for _, name, _ in found))


def layouts(context: Context) -> list[str]:
    """Return the names of all layouts."""
    return [layout.name for layout in ALL_KINDS.with_plugins().rows]


def protocols(context: Context) -> list[str]:
    """Return the names of all protocols."""
    return known_protocols.names()


def keys(context: Context) -> list[str]:
    """Return the keys of the command line's config, each with an equals sign."""
    command = _command(context)
    model = config_model(command)
    if model is None or not issubclass(model, RootConfig):
        return []
    named = context.params["config"] or context.args[0]  # args: before an option without a value
    config = load_config(model, find_config(command, named))
    return [f"{key}=" for key in _keys(config.model_dump(mode="json", by_alias=True))]


def _command(context: Context) -> str:
    return str(context.params.get("command") or context.info_name)  # sweep has an option for it


def _keys(values: Mapping[str, Any]) -> Iterator[str]:
    for key, value in values.items():
        yield key
        if isinstance(value, Mapping):
            yield from (f"{key}.{inside}" for inside in _keys(value))


_FUNCTIONS = {"config": presets, "names": presets, "layout": layouts, "protocol": protocols, "set": keys}
