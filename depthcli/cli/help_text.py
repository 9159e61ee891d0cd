"""The help texts: options under headings, examples, and where the documentation is, for a terminal of 80 columns."""

from __future__ import annotations

from typing import Any, get_args

from depthcli.commands import grouped_commands, help_of
from depthcli.core.option import Option, OptionGroup
from depthcli.run.command import Command

DOCUMENTATION = "docs/{page}.md of depthcli's repository"
"""Where a page of the documentation is, as the last line of every help text names it."""

START = (
    "depthcli sample --output scenes",
    "depthcli stereo accurate --input scenes --output runs/accurate",
    "depthcli evaluate runs/accurate --truth scenes --output results --html",
)
"""The commands that the help of ``depthcli`` itself shows: scenes, maps, and a page that compares them with truth."""

_HELP = Option("help", bool, "Show this text.", default=False, short="-h", group="Run")
_WIDTH = 79  # a character in the last column makes some terminals break the line
_MAX_NAMES = 26  # width of the column of names; longer ones have a line of their own


def write_command_help(formatter: Any, command: Command, common: tuple[Option, ...]) -> None:
    """Write what a command does, its options by group, examples, and where to read more.

    Parameters
    ----------
    formatter : the ``HelpFormatter`` of click
    command : the command
    common : the options that every command has
    """
    formatter.width = min(formatter.width, _WIDTH)
    options = (*command.options, *common, _HELP)
    formatter.write_usage(f"depthcli {command.name}", _usage(command))
    formatter.write(f"\n{help_of(command.name)}\n")
    rows = [(option.group, _value(option), _text(option)) for option in command.arguments]
    rows += [(option.group, _names(option), _text(option)) for option in options]
    width = max((len(names) for _, names, _ in rows if len(names) <= _MAX_NAMES), default=0)
    for group in get_args(OptionGroup):
        found = [(f"{names:<{width}}", text) for each, names, text in rows if each == group]
        if found:
            with formatter.section(group):
                formatter.write_dl(found, width)
    _write_end(formatter, command.examples, command.page)


def write_main_help(formatter: Any, about: str, options: list[tuple[str, str]]) -> None:
    """Write the commands by group, one line each, the options of ``depthcli`` itself, and how to begin."""
    formatter.width = min(formatter.width, _WIDTH)
    formatter.write_usage("depthcli", "COMMAND [ARGUMENTS] [OPTIONS]")
    formatter.write_paragraph()
    formatter.write_text(about)
    groups = grouped_commands()
    width = max(len(name) for names in groups.values() for name in names)
    for group, names in groups.items():
        with formatter.section(group):
            formatter.write_dl([(f"{name:<{width}}", help_of(name)) for name in names])
    with formatter.section("Options"):
        formatter.write_dl(options)
    _write_end(formatter, START, "tutorial")


def _write_end(formatter: Any, examples: tuple[str, ...], page: str) -> None:
    with formatter.section("Examples"):
        for example in examples:
            formatter.write(f"  {example}\n")
    formatter.write(f"\nDocumentation: {DOCUMENTATION.format(page=page)}\n")


def _usage(command: Command) -> str:
    """Return arguments and required options; ``[OPTIONS]`` stands for the others."""
    required = (f"{option.flag} {_value(option)}" for option in command.options if option.required)
    arguments = (_value(each) if each.required else f"[{_value(each)}]" for each in command.arguments)
    return " ".join((*arguments, *required, "[OPTIONS]"))


def _names(option: Option) -> str:
    names = ", ".join(filter(None, (option.short, option.flag)))
    return names if option.type is bool else f"{names} {_value(option)}"


def _value(option: Option) -> str:
    return option.metavar or option.name.upper()


def _text(option: Option) -> str:
    if option.required:
        return f"{option.help} Required."
    if option.type is bool or option.default is None:
        return option.help
    default = f"{option.default:g}" if option.type is float else option.default
    return f"{option.help} Default: {default}."
