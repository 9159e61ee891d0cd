"""List the presets, print one, or compile their kernels.

Examples:
  depthcli presets
  depthcli presets fuse
  depthcli presets thesis
  depthcli presets show stereo/accurate
  depthcli presets thesis/ch2-kp-dedc
  depthcli presets compile 'stereo/*' fuse/accurate
"""

from __future__ import annotations

from typing import Annotated

from typer import Argument

from depthcli.commands import config_model
from depthcli.commands._shared_options import Printing
from depthcli.core.config_file import load_config
from depthcli.core.errors import ConfigError
from depthcli.run.json_csv import to_json
from depthcli.run.presets import THESIS, describe, find_preset, leading_comment, list_presets
from depthcli.run.presets import presets as all_presets


def presets(
    printing: Printing,
    action: Annotated[
        str | None,
        Argument(
            metavar="show|compile",
            help="To print one preset, or compile the kernels of some; or a command, or thesis, to list its presets.",
        ),
    ] = None,
    names: Annotated[
        list[str] | None,
        Argument(metavar="NAME...", help="The preset: NAME, or COMMAND/NAME; to compile: also 'stereo/*'."),
    ] = None,
) -> int:
    """Print the list or the preset, or compile kernels; return the exit code."""
    reporter, names = printing.reporter, names or []
    if action is not None and not names and "/" in action:  # thesis/ch2-kp-dedc, stereo/fast
        action, names = "show", [action]
    if action == "show" and len(names) == 1:
        reporter.data(_shown(names[0]))
        return 0
    if action == "compile" and names:
        from depthcli.commands._compilation import compile_presets

        return compile_presets(names, reporter)
    if action == THESIS.rstrip("/"):
        found = sorted((row for row in list_presets() if row[1].startswith(THESIS)), key=lambda row: row[1])
    else:
        found = list_presets(action)
    if action is not None and (names or not found):
        raise ConfigError(
            "give depthcli presets, depthcli presets COMMAND, depthcli presets thesis, depthcli presets show NAME, or "
            "depthcli presets compile NAME..."
        )
    if printing.json:
        reporter.data(to_json([{"command": c, "preset": p, "about": about} for c, p, about in found]))
    else:
        width = max((len(f"{command} {name}") for command, name, _ in found), default=0)
        lines = [(name.startswith(THESIS), f"{f'{c} {name}':<{width}}  {about}") for c, name, about in found]
        groups = [[line for thesis, line in lines if thesis == group] for group in (False, True)]
        reporter.data("\n".join([*groups[0], "", *groups[1]]).strip())
    return 0


def _shown(name: str) -> str:
    """Return a preset as YAML with every field and its description; ``name`` may be ``command/name``."""
    found = [p for p in all_presets() if p.is_called(name.removeprefix(f"{p.command}/"))]
    if not found:
        raise ConfigError(f"no preset called {name!r}; see: depthcli presets")
    if len(found) > 1:
        names = " or ".join(f"{preset.command}/{preset.name}" for preset in found)
        raise ConfigError(f"several commands have a preset {name!r}; give depthcli presets show {names}")
    (preset,) = found
    model = config_model(preset.command)
    if model is None:
        raise ConfigError(f"{preset.file}: no command called {preset.command!r} that has configs")
    title = [leading_comment(preset.file.read_text("utf-8", "replace"))]
    use = f"depthcli {preset.command} {preset.name} ..."
    title.append(f"Use it as it is: {use}; or save, change and name this text as a file.")
    config = load_config(model, preset.file, find=lambda base: find_preset(preset.command, base))
    return describe(config, "\n".join(title))
