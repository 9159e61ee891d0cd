"""The command line, the only place with typer: builds commands from the objects in ``commands/``, maps errors to codes.

Exit codes: 0 all done; 1 a bug; 2 wrong usage or config, or a full disk; 3 finished, but something failed; 130 Ctrl-C;
143 SIGTERM. Nothing heavy is imported here, so that ``--help`` answers at once.
"""

from __future__ import annotations

import contextlib
import errno
import inspect
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from depthcli.cli.help_text import write_command_help, write_main_help
from depthcli.commands import REGISTRY, command_names, find_command, help_of, load_command
from depthcli.core.errors import ConfigError, DepthcliError, IncompleteError
from depthcli.core.option import Option
from depthcli.core.plugins import load_file
from depthcli.run.command import SOME_FAILED, Command
from depthcli.run.console import Reporter, silence_warnings

PLUGIN = Option(
    "plugin", Path, "Python file with methods, layouts, protocols or commands of your own; repeatable.", "FILE.py",
    repeatable=True, group="Run",
)  # fmt: skip
"""Read before all else: the file may hold the command itself. Also in front of the command."""

_COMMON = (
    PLUGIN,
    Option("json", bool, "Print one JSON document instead of a table.", default=False, group="Run"),
    Option("verbose", bool, "Print details on stderr.", default=False, short="-v", group="Run"),
    Option("quiet", bool, "Print only errors, and no table.", default=False, short="-q", group="Run"),
)
_URL = re.compile(r"[a-z][a-z0-9+.-]+:/", re.IGNORECASE)  # pathlib leaves one slash
_QUIET = -1
"""Level of a :class:`Reporter` that prints errors only."""

_STREAM_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
"""System errors of a stream whose disk is full or whose device fails."""

# Of every typer app: plain help texts, and no tracebacks of its own.
_SETTINGS: dict[str, Any] = {
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class _Terminated(BaseException):
    """SIGTERM arrived: end as by Ctrl-C, with another exit code."""


class _Command(TyperCommand):
    """One command, with the help of ``help_text``; an input that is given twice is refused, not the last one taken."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for option in load_command(self.name or "").options:
            if option.group == "Input" and not option.repeatable and option.type is not bool:
                names = tuple(filter(None, (option.flag, option.short)))
                given = sum(word in names or word.startswith(f"{option.flag}=") for word in args)
                if given > 1:
                    raise ConfigError(f"{option.flag}: given {given} times, takes one value")
        found: list[str] = super().parse_args(ctx, args)
        return found

    def format_help(self, ctx: Any, formatter: Any) -> None:
        write_command_help(formatter, load_command(self.name or ""), _COMMON)


class _Commands(TyperGroup):
    """The commands of ``commands/``; each is built when it is needed."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = dict.fromkeys(command_names())  # type: ignore[assignment]  # read for "did you mean" only

    def list_commands(self, ctx: Any) -> list[str]:
        return [*command_names(), *(name.replace("_", "-") for name in REGISTRY.plugins())]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Take two words for one name where there is such a command: ``fuse maps`` is ``fuse-maps``."""
        joined = "-".join(args[:2])
        return super().resolve_command(ctx, [joined, *args[2:]] if joined in command_names() else args)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        command = find_command(cmd_name)
        if command is None:
            return None
        app = typer.Typer(**_SETTINGS)
        app.command(cmd_name, cls=_Command, help=help_of(cmd_name))(_callback(command))
        return get_command(app)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        records = (each.get_help_record(ctx) for each in self.get_params(ctx))
        write_main_help(formatter, self.help or "", [record for record in records if record is not None])


app = typer.Typer(name="depthcli", cls=_Commands, no_args_is_help=True, **_SETTINGS | {"add_completion": True})


def _version(value: bool) -> None:
    if value:
        from depthcli import __version__

        Reporter().data(f"depthcli {__version__}")
        raise typer.Exit


@app.callback()
def depthcli(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
    plugin: list[Path] = typer.Option([], "--plugin", metavar="FILE.py", help=PLUGIN.help),  # typer's way
) -> None:
    """Depth from images and its evaluation, in batches: YAML configs and folders in, maps and reports out."""


def _callback(command: Command) -> Callable[..., int]:
    """Return the function that typer calls for a command; typer reads the options from its signature."""

    def callback(**values: Any) -> int:
        output = values.get("output")
        if isinstance(output, Path) and _URL.match(str(output)) and not os.path.lexists(output.parts[0]):
            raise ConfigError(f"{output}: results are written to this machine, not to URLs; give a folder")
        return command.run(values, Reporter(_QUIET if values["quiet"] else int(values["verbose"])))

    parameters = [_parameter(argument, positional=True) for argument in command.arguments]
    parameters += [_parameter(option, positional=False) for option in (*command.options, *_COMMON)]
    callback.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return callback


def _parameter(option: Option, *, positional: bool) -> inspect.Parameter:
    default = ... if option.required else option.default
    texts: dict[str, Any] = {"metavar": option.metavar or None, "help": option.help}
    if positional:
        declared = typer.Argument(default, **texts)
    else:
        names = (option.flag, option.short) if option.short else (option.flag,)
        declared = typer.Option(default, *names, min=option.min_value, max=option.max_value, **texts)
    kind: Any = list[option.type] if option.repeatable else option.type  # type: ignore[name-defined]
    annotation = kind if option.required or option.type is bool else kind | None
    return inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=declared, annotation=annotation)


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code; messages go to stderr, never a traceback except for a bug."""
    _repair_streams()
    silence_warnings()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, _terminate)
    try:
        _load_plugins(sys.argv[1:] if arguments is None else arguments)
        return _run_typer(arguments)
    except IncompleteError as error:
        _print_error(f"depthcli: {error}")
        return SOME_FAILED
    except DepthcliError as error:  # several lines are the problems of a config, each with its place
        _print_error(f"depthcli: {error}" if "\n" not in str(error) else str(error))
        return 2
    except _Terminated:
        _print_error("depthcli: terminated; the same command goes on where it stopped")
        return 143
    except KeyboardInterrupt:
        _print_error("depthcli: interrupted; the same command goes on where it stopped")
        return 130
    except Exception:
        import traceback

        _print_error(traceback.format_exc().rstrip())
        _print_error("depthcli: this is a bug, not something you did; please report the lines above")
        return 1
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
        try:
            sys.stderr.flush()
        except (OSError, ValueError):  # else the interpreter's last flush fails, and with it the exit code
            Reporter.close(sys.stderr)


def _load_plugins(arguments: Sequence[str]) -> None:
    """Read the files of all ``--plugin``; one without a value is left to typer."""
    for option, value in pairwise([*arguments, ""]):
        if option == "--":
            return
        name, equals, inside = option.partition("=")
        if name == PLUGIN.flag and (inside or (not equals and value)):
            load_file(Path(inside or value))


def _run_typer(arguments: list[str] | None) -> int:
    r"""Parse the command line, run its command and return the exit code.

    | event | what typer does | what this function does |
    |---|---|---|
    | Ctrl-C | returns 130 or raises ``Abort`` | raises ``KeyboardInterrupt`` |
    | wrong usage | raises an exception of a private class with ``exit_code`` 2 | prints one line, returns 2 |
    | the reader of a help text closes the pipe (``--help \| head``) | exits with 1 | returns 0: nothing failed |
    | a help text is written to a full disk | raises ``OSError`` | raises ``IncompleteError``, as for other output |
    | shell completion (``_DEPTHCLI_COMPLETE`` is set) | exits with its own code | leaves it so |
    """
    try:
        code = int(app(_help_option(arguments), prog_name="depthcli", standalone_mode=False) or 0)
    except typer.Abort:
        code = 130
    except SystemExit as error:
        if error.code != 1 or "_DEPTHCLI_COMPLETE" in os.environ:
            raise
        return 0
    except OSError as error:
        if error.filename is not None or error.errno not in _STREAM_ERRORS:
            raise
        Reporter.close(sys.stdout)
        raise IncompleteError(f"stdout: cannot be written ({error.strerror})") from error
    except Exception as error:
        if getattr(error, "exit_code", None) != 2 or not hasattr(error, "show"):
            raise
        _print_usage_error(error)
        return 2
    if code == 130:
        raise KeyboardInterrupt
    return code


def _help_option(arguments: list[str] | None) -> list[str]:
    """Return the arguments; of ``help COMMAND``, those that show the help of the command."""
    words = sys.argv[1:] if arguments is None else arguments
    if len(words) == 2 and words[0] == "help" and words[1] in command_names():
        from depthcli.commands.help import TOPICS

        return words if words[1] in TOPICS else [words[1], "--help"]
    return words


def _repair_streams() -> None:
    """Keep a closed stream, or one that cannot encode a name, from ending a run."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed; else the next file that is opened would take its number
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        with contextlib.suppress(AttributeError, ValueError, OSError):
            getattr(sys, name).reconfigure(errors="backslashreplace")


def _terminate(number: int, frame: Any) -> None:
    raise _Terminated


def _print_usage_error(error: Any) -> None:
    """Print what is wrong in one line, or the help where no command was given at all."""
    text = " ".join(error.format_message().split()).rstrip(".").replace(". Did you", "; did you")
    if error.ctx is None or text.startswith("Usage:"):
        with contextlib.suppress(OSError):
            error.show()
    else:
        path, see = error.ctx.command_path, " See" if text.endswith("?") else "; see"
        _print_error(f"{path}: {text[:1].lower()}{text[1:]}{see} {path} --help")


def _print_error(text: str) -> None:
    Reporter(_QUIET).error(text)
