"""The command line: find the command, give its function to typer, and map errors to exit codes.

Exit codes: 0 all done; 1 a bug; 2 wrong usage, config or plug-in, or a full disk; 3 finished, but something failed; 4
rows are flagged, with ``--fail-flagged``; 130 Ctrl-C; 143 SIGTERM. Heavy modules are imported only when a command runs.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import inspect
import logging
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_type_hints

import typer
from typer.core import TyperGroup
from typer.main import get_command

from depthcli import __version__, commands
from depthcli.core.errors import RESUME, SOME_FAILED, ConfigError, DepthcliError, IncompleteError, Terminated, shortage
from depthcli.core.plugins import load_plugin, plugin_behind
from depthcli.run.console import Reporter, silence_warnings

_STREAM_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EFBIG)
"""Errors of a stream if the disk is full or the device fails."""

_MAY_BE_EMPTY = ("--caption", "--set")
_MAX_THREADS = 1024

_SETTINGS: dict[str, Any] = {
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 80},
}


PluginOption: TypeAlias = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="PLUGIN", help="FILE.py or module, with methods, layouts or commands of your own; repeatable."
    ),
]
"""Loaded before all else, since it may define the command itself."""


class _Commands(TyperGroup):
    """The commands of ``commands/``; each is imported on use."""

    def list_commands(self, ctx: Any) -> list[str]:
        return commands.names()

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        found = command_of(cmd_name)
        if found is None:  # typer looks for similar names
            self.commands = dict.fromkeys(commands.names())  # type: ignore[assignment]
        return found

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        for heading, names in commands.grouped_names().items():
            with formatter.section(heading):
                formatter.write_dl([(f"{name:<19}", commands.help_of(name)) for name in names])


def command_of(name: str) -> Any:
    """Return typer's command of that name, or None if there is none."""
    found = commands.find(name)
    if found is None:
        return None
    app = typer.Typer(add_completion=False, **_SETTINGS)
    text = commands.text_of(found).replace("\nExamples:\n", "\n\b\nExamples:\n")  # \b: these lines are not wrapped
    callback = _with_groups(found)
    if _is_completing():
        from depthcli.commands._completion import complete_values

        complete_values(callback)
    app.command(name.replace("_", "-"), help=text)(callback)
    return get_command(app)


def _with_groups(function: Callable[..., int]) -> Callable[..., int]:
    """Return a command's function with a signature for typer, in which fields of groups are options."""
    groups: dict[str, tuple[Any, list[str]]] = {}
    parameters = [_keyword("plugin", PluginOption, None), _keyword("context", typer.Context)]
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kind))
            continue
        options = _options_of(kind)
        parameters += options
        groups[name] = kind, [option.name for option in options]

    @functools.wraps(function)
    def callback(context: typer.Context, **values: Any) -> int:
        values.pop("plugin")
        for name, (kind, names) in groups.items():
            line = {"command_line": context.obj or ""} if hasattr(kind, "command_line") else {}
            values[name] = kind(**{each: values.pop(each) for each in names}, **line)
        return function(**values)

    callback.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return callback


def _keyword(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _options_of(group: Any) -> list[inspect.Parameter]:
    """Return the options of a group: those of its fields that have typer's description."""
    types, options = get_type_hints(group, include_extras=True), []
    for each in fields(group):
        described = each.metadata.get("option")
        annotation = types[each.name] if described is None else Annotated[types[each.name], described]
        if hasattr(annotation, "__metadata__"):
            default = inspect.Parameter.empty if each.default is MISSING else each.default
            options.append(_keyword(each.name, annotation, default))
    return options


app = typer.Typer(
    name="depthcli",
    cls=_Commands,
    no_args_is_help=True,
    epilog="Begin with docs/tutorial.md: sample makes scenes, stereo accurate matches them, evaluate compares.",
    **_SETTINGS,
)


def _print_version(value: bool) -> None:
    if value:
        Reporter().data(f"depthcli {__version__}")
        raise typer.Exit


@app.callback()
def depthcli(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    plugin: PluginOption = None,
) -> None:
    """Depth from images and its evaluation, in batches: YAML configs and folders in, maps and reports out."""


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code; messages go to stderr, with tracebacks only for bugs and plug-ins."""
    words = sys.argv[1:] if arguments is None else arguments
    _repair_streams()
    silence_warnings()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, _terminate)
    printed = set[str]()

    def is_new(record: logging.LogRecord) -> bool:  # each warning of a call is printed once
        text, n_before = record.getMessage(), len(printed)
        printed.add(text)
        return len(printed) > n_before

    logging.getLogger("depthcli").addFilter(is_new)
    try:
        _check_words(words)
        _load_plugins(words)
        code = int(app(words, prog_name="depthcli", standalone_mode=False, obj=shlex.join(["depthcli", *words])) or 0)
        if code == 130:
            raise KeyboardInterrupt
        return code
    except BaseException as error:
        return _code_of(error)
    finally:
        logging.getLogger("depthcli").removeFilter(is_new)
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
        try:
            sys.stderr.flush()
        except (OSError, ValueError):  # otherwise the interpreter's last flush would change the exit code
            Reporter.close(sys.stderr)


def _code_of(error: BaseException) -> int:
    """Print an error that ended a command, and return the exit code; call it while the error is handled."""
    if isinstance(error, IncompleteError):
        _print_error(f"depthcli: {error}")
        return SOME_FAILED
    if isinstance(error, DepthcliError):  # several lines are a config's problems, each with its place
        _print_error(f"depthcli: {error}" if "\n" not in str(error) else str(error))
        return 2
    if isinstance(error, KeyboardInterrupt | typer.Abort | Terminated):
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)  # it tells of every download that is left
        is_terminated = isinstance(error, Terminated)
        _print_error(f"depthcli: {'terminated' if is_terminated else 'interrupted'}; {RESUME}")
        return 143 if is_terminated else 130
    if getattr(error, "exit_code", None) == 2 and hasattr(error, "show"):  # wrong usage; typer prints it
        with contextlib.suppress(OSError):
            error.show()
        return 2
    if isinstance(error, OSError) and error.filename is None and error.errno in _STREAM_ERRORS:
        Reporter.close(sys.stdout)
        _print_error(f"depthcli: stdout: cannot be written ({error.strerror})")
        return SOME_FAILED
    plugin = plugin_behind(error)
    if isinstance(error, SystemExit) and not plugin:
        if error.code != 1 or _is_completing():
            raise error
        return 0  # the reader of the help has closed the pipe (--help | head)
    if not plugin and (text := shortage(error)):
        _print_error(f"depthcli: {text}")
        return 2
    _print_error(traceback.format_exc().rstrip())
    if plugin:
        _print_error(f"depthcli: plug-in {plugin}: {type(error).__name__}: {error}")
        return 2
    _print_error("depthcli: this is a bug, not something you did; please report the lines above")
    return 1


def _is_completing() -> bool:
    """Return whether a shell asks for completions."""
    return "_DEPTHCLI_COMPLETE" in os.environ


def _check_words(words: Sequence[str]) -> None:
    """Raise ConfigError for a wrong NUMBA_NUM_THREADS or an empty word, which would name the current folder."""
    for before, word in pairwise(["", *words]):
        name = word[:-1] if word.startswith("--") and word.endswith("=") else before
        if (not word or word == f"{name}=") and name not in _MAY_BE_EMPTY:
            raise ConfigError(f"{name if name.startswith('-') else 'an argument'}: is empty; is a variable not set?")
    threads = os.environ.get("NUMBA_NUM_THREADS")
    if threads is not None and not (threads.strip().isdecimal() and 1 <= int(threads) <= _MAX_THREADS):
        raise ConfigError(f"NUMBA_NUM_THREADS: expected a whole number of threads (got {threads[:40]!r}); unset it")


def _load_plugins(words: Sequence[str]) -> None:
    """Load all ``--plugin`` options, since a plug-in may define the command; typer reports a missing value."""
    completes = _is_completing()
    if completes:  # an incomplete line; bash and the other shells pass it in different variables
        words = (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")).split()
    for option, value in pairwise([*words, ""]):
        if option == "--":
            return
        name, equals, inside = option.partition("=")
        if name == "--plugin" and (inside or (not equals and value)):
            with contextlib.suppress(ConfigError) if completes else contextlib.nullcontext():
                load_plugin(inside or value)


def _repair_streams() -> None:
    """Prevent that a run ends because a stream is closed or cannot encode a name."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed; the next opened file would get its number
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        with contextlib.suppress(AttributeError, ValueError, OSError):
            getattr(sys, name).reconfigure(errors="backslashreplace")


def _terminate(number: int, frame: Any) -> None:
    raise Terminated


def _print_error(text: str) -> None:
    Reporter(-1).error(text)
