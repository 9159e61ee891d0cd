"""Errors whose message is meant for the user, one line saying what, where, and what to do; exit codes."""

from __future__ import annotations

import errno

from depthcli.core.text import printable, without_secrets

RESUME = "run the same command again to resume"
"""Advice after a command was stopped."""

SOME_FAILED = 3
"""Exit code of a command that finished, but not for every scene."""

FLAGGED = 4
"""Exit code of a command with ``--fail-flagged`` that flagged a row."""

EXIT_CODES = {
    0: "all done",
    1: "a bug in depthcli; the traceback is printed",
    2: "wrong usage, config, plug-in or folder, nothing was computed; or the disk became full",
    SOME_FAILED: "finished, but something failed or could not be written; see the report",
    FLAGGED: "finished, and rows are flagged that count as failures here, or a condition has no values",
    130: f"ended by Ctrl-C; {RESUME}",
    143: f"ended by SIGTERM; {RESUME}",
}
"""Exit code -> meaning."""


_NO_FILES = ("Too many open files",)
_NO_MEMORY = (
    "Cannot allocate memory", "failed to map segment", "can't start new thread", "Insufficient memory",
    "Unable to allocate",
)  # fmt: skip


def shortage(error: BaseException | None) -> str:
    """Return a line about the resource that an error, or one of its causes, ran out of, or an empty text."""
    while error is not None:
        number, text = getattr(error, "errno", None), str(error)
        if number in (errno.EMFILE, errno.ENFILE) or any(words in text for words in _NO_FILES):
            return "too many open files for the limit of this process; raise it (ulimit -n)"
        if isinstance(error, MemoryError) or number == errno.ENOMEM or any(words in text for words in _NO_MEMORY):
            return "too little memory or address space; raise the limit (ulimit -v), or see --max-memory, --jobs"
        error = error.__cause__ or error.__context__
    return ""


class Terminated(BaseException):
    """SIGTERM arrived: end as by Ctrl-C, with another exit code."""


class DepthcliError(Exception):
    """Base of the errors a command reports without a traceback. The message can always be printed and encoded.

    Queries and passwords of URLs are left out, since reports contain this text.
    """

    def __str__(self) -> str:
        return without_secrets(printable(super().__str__()))


class InputError(DepthcliError):
    """An image or data file is missing, damaged, or of the wrong kind."""


class ConfigError(DepthcliError):
    """A config file or option is wrong."""


class OutputError(DepthcliError):
    """A result cannot be written."""


class IncompleteError(DepthcliError):
    """Results were saved, but the report or standard output could not be written."""
