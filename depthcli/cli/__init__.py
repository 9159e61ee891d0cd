"""The command line: the only place with typer and exit codes; commands are built from the objects in ``commands/``.

Exit codes: 0 all done; 1 a bug; 2 wrong usage or config; 3 finished, but something failed; 130 Ctrl-C; 143 SIGTERM.
Nothing heavy is imported here, so that ``--help`` answers at once.
"""

from __future__ import annotations

import contextlib
import errno
import inspect
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from depthcli.batch.command import SOME_FAILED, Command
from depthcli.batch.console import Reporter, silence_warnings
from depthcli.commands import command_names, help_of, load_command
from depthcli.core.errors import DepthcliError, IncompleteError
from depthcli.core.option import Option

_COMMON = (
    Option("json", bool, "Print one JSON document instead of a table.", default=False),
    Option("verbose", bool, "Print details on stderr.", default=False, short="-v"),
    Option("quiet", bool, "Print only errors, and no table.", default=False, short="-q"),
)
_STREAM_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
"""What a disk or device behind a stream answers when it takes no more."""

_SETTINGS: dict[str, Any] = {
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class _Terminated(BaseException):
    """SIGTERM arrived: end as by Ctrl-C, with another exit code."""


class _Commands(TyperGroup):
    """The commands of ``commands/``; each is built when it is needed."""

    def list_commands(self, ctx: Any) -> list[str]:
        return command_names()

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in command_names():
            return None
        app = typer.Typer(**_SETTINGS)
        app.command(cmd_name, help=help_of(cmd_name))(_function(load_command(cmd_name)))
        return get_command(app)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_of(name)) for name in command_names()])


app = typer.Typer(name="depthcli", cls=_Commands, no_args_is_help=True, **_SETTINGS | {"add_completion": True})


def _version(value: bool) -> None:
    if value:
        from depthcli import __version__

        Reporter().data(f"depthcli {__version__}")
        raise typer.Exit


@app.callback()
def depthcli(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Depth from images and its evaluation, in batches: YAML configs and folders in, maps and reports out."""


def _function(command: Command) -> Callable[..., int]:
    """Return a function that runs a command, with the signature that typer makes a command line of."""

    def function(**values: Any) -> int:
        reporter = Reporter(-1 if values["quiet"] else int(values["verbose"]))
        return command.run(values, reporter)

    parameters = [
        inspect.Parameter(option.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=_annotation(option))
        for option, default in (
            *((argument, _argument(argument)) for argument in command.arguments),
            *((option, _option(option)) for option in (*command.options, *_COMMON)),
        )
    ]
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return function


def _annotation(option: Option) -> Any:
    kind: Any = list[option.type] if option.repeatable else option.type  # type: ignore[name-defined]
    return kind if option.required or option.type is bool else kind | None


def _argument(option: Option) -> Any:
    default = ... if option.required else option.default
    return typer.Argument(default, metavar=option.metavar or None, help=option.help)


def _option(option: Option) -> Any:
    default = ... if option.required else option.default
    names = (option.flag, option.short) if option.short else (option.flag,)
    return typer.Option(
        default, *names, metavar=option.metavar or None, help=option.help, min=option.min_value, max=option.max_value
    )


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code; messages go to stderr, never a traceback except for a bug."""
    _repair_streams()
    silence_warnings()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, _terminate)
    try:
        code = int(app(arguments, prog_name="depthcli", standalone_mode=False) or 0)
        if code == 130:  # typer turns Ctrl-C into this code, silently
            raise KeyboardInterrupt
        return code
    except IncompleteError as error:
        _print_error(f"depthcli: {error}")
        return SOME_FAILED
    except DepthcliError as error:
        _print_error(f"depthcli: {error}" if "\n" not in str(error) else str(error))
        return 2
    except _Terminated:
        _print_error("depthcli: terminated; the same command goes on where it stopped")
        return 143
    except (KeyboardInterrupt, typer.Abort):
        _print_error("depthcli: interrupted; the same command goes on where it stopped")
        return 130
    except SystemExit as error:
        if error.code != 1 or "_DEPTHCLI_COMPLETE" in os.environ:
            raise
        return 0  # typer ends so where the reader of its help text has closed it
    except Exception as error:
        if isinstance(error, OSError) and error.filename is None and error.errno in _STREAM_ERRORS:  # typer's help text
            Reporter.close_stdout()
            _print_error(f"depthcli: stdout: cannot be written ({error.strerror})")
            return SOME_FAILED
        if getattr(error, "exit_code", None) == 2 and hasattr(error, "show"):  # wrong usage: typer has the message
            with contextlib.suppress(OSError):
                error.show()
            return 2
        import traceback

        _print_error(traceback.format_exc().rstrip())
        _print_error("depthcli: this is a bug, not something you did; please report the lines above")
        return 1
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()


def _repair_streams() -> None:
    """Prevent that a closed stream, or one that cannot encode a name, ends a run."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed; else the next file that is opened would take its number
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        with contextlib.suppress(AttributeError, ValueError, OSError):
            getattr(sys, name).reconfigure(errors="backslashreplace")


def _terminate(number: int, frame: Any) -> None:
    raise _Terminated


def _print_error(text: str) -> None:
    Reporter(-1).error(text)
