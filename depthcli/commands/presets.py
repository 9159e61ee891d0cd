"""List the presets, or print one with all its fields."""

from __future__ import annotations

from depthcli.core.errors import ConfigError
from depthcli.core.option import Option
from depthcli.run.command import Command, Values
from depthcli.run.console import Reporter
from depthcli.run.json_csv import to_json


class PresetsCommand(Command):
    """Lists and prints the configs that are shipped with the package."""

    arguments = (
        Option("action", str, "The word show, to print one preset.", "show", group="Input"),
        Option("preset", str, "The preset: NAME, or COMMAND/NAME.", "NAME", group="Input"),
    )

    examples = ("depthcli presets", "depthcli presets show stereo/accurate")

    def run(self, values: Values, reporter: Reporter) -> int:
        """Print the list or the preset; return the exit code."""
        from depthcli.run.presets import THESIS, list_presets

        if values["action"] == "show" and values["preset"]:
            reporter.data(_show(values["preset"]))
        elif values["action"] is not None:
            raise ConfigError("give depthcli presets, or depthcli presets show NAME")
        elif values["json"]:
            found = list_presets()
            reporter.data(to_json([{"command": c, "preset": p, "about": about} for c, p, about in found]))
        else:
            found = list_presets()
            width = max((len(f"{command} {preset}") for command, preset, _ in found), default=0)
            lines = [(p.startswith(THESIS), f"{f'{c} {p}':<{width}}  {about}") for c, p, about in found]
            groups = [[line for thesis, line in lines if thesis == group] for group in (False, True)]
            reporter.data("\n".join([*groups[0], "", *groups[1]]).rstrip())
        return 0


def _show(name: str) -> str:
    """Return a preset as YAML with every field and its description; ``name`` may be ``command/name``."""
    from depthcli.commands import find_command
    from depthcli.commands._old_batch import ConfigCommand
    from depthcli.core.config_file import load_config
    from depthcli.run.presets import describe, find_preset, leading_comment, presets

    found = [p for p in presets() if p.is_called(name.removeprefix(f"{p.command}/"))]
    if not found:
        raise ConfigError(f"no preset called {name!r}; see: depthcli presets")
    if len(found) > 1:
        names = " or ".join(f"{preset.command}/{preset.name}" for preset in found)
        raise ConfigError(f"several commands have a preset {name!r}; give depthcli presets show {names}")
    (preset,) = found
    command = find_command(preset.command)
    if not isinstance(command, ConfigCommand):
        raise ConfigError(f"{preset.file}: no command called {preset.command!r} that has configs")
    title = [leading_comment(preset.file.read_text("utf-8", "replace"))]
    use = f"depthcli {preset.command} {preset.name} ..."
    title.append(f"Use it as it is: {use}; or save, change and name this text as a file.")
    config = load_config(command.config_model(), preset.file, find=lambda base: find_preset(preset.command, base))
    return describe(config, "\n".join(title))


COMMAND = PresetsCommand()
