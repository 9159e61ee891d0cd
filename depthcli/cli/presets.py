"""``depthcli presets``."""

from __future__ import annotations

from typing import Annotated

import typer

from depthcli.core.errors import ConfigError


def presets(
    action: Annotated[str | None, typer.Argument(metavar="show", help="'show' prints one preset.")] = None,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="NAME, or COMMAND/NAME.")] = None,
) -> None:
    """List the presets, or print one with every field and what it means: presets show NAME."""
    from depthcli.batch.presets import list_presets
    from depthcli.jobs.commands import show_preset

    if action is None:
        found = list_presets()
        width = max((len(f"{command} {preset}") for command, preset, _ in found), default=0)
        for command, preset, about in found:
            print(f"{f'{command} {preset}':<{width}}  {about}")
    elif action == "show" and name:
        print(show_preset(name), end="")
    else:
        raise ConfigError("want: depthcli presets, or depthcli presets show NAME")
