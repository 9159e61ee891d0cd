"""A program as a process: run to its end within its time and memory, whatever it starts and prints."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from depthcli.core.errors import InputError
from depthcli.core.text import one_line, show_bytes

_SUPERVISOR = Path(__file__).with_name("_supervisor.py")
_MAX_REASON = 300  # characters of a program's output in a message


class ProgramError(InputError):
    """A program failed: it cannot be started, was ended, or its result cannot be used."""


@dataclass(frozen=True)
class Finished:
    """What is known of a program that ended with exit code 0.

    Attributes
    ----------
    cpu_seconds : processor time, of all processes that it started, too
    peak_memory : largest resident memory of all of them together, bytes; short peaks between two looks, some hundredths
        of a second apart, count for single processes alone
    stdout, stderr : the ends of its output, at most 16 KiB each
    """

    cpu_seconds: float
    peak_memory: int
    stdout: str
    stderr: str


def run_program(
    words: Sequence[str], folder: Path, timeout: float, memory: int | None, variables: Mapping[str, str]
) -> Finished:
    """Run a program in ``folder``, and end every process that it started.

    Parameters
    ----------
    words : program, with its path, and arguments
    timeout : seconds
    memory : bytes of resident memory that the program and all processes that it starts may take; None: any
    variables : environment variables beside those of this process

    Raises
    ------
    ProgramError
        It cannot be started, ended with another exit code than 0 or by a signal, ran for too long, took too much
        memory, or left processes behind that were ended. The message ends with the end of its output.
    """
    name = os.path.basename(words[0])
    task = json.dumps({"words": list(words), "folder": str(folder), "timeout": timeout, "memory": memory})
    supervisor = subprocess.Popen(
        [sys.executable, "-I", "-S", str(_SUPERVISOR), task],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, env={**os.environ, **variables},
    )  # fmt: skip
    assert supervisor.stdin is not None and supervisor.stdout is not None
    try:
        data = supervisor.stdout.read()
    finally:
        supervisor.stdin.close()  # the supervisor ends the program where this is raised out of
        supervisor.wait()
        supervisor.stdout.close()
    if supervisor.returncode != 0:
        raise ProgramError(f"{name}: the process that watches it was ended from outside (memory?)")
    result = json.loads(data)
    if problem := _problem(result, timeout, memory):
        raise ProgramError(f"{name} {problem}{_said(result)}")
    return Finished(result["cpu"], result["memory"], result["stdout"], result["stderr"])


def _problem(result: Mapping[str, Any], timeout: float, memory: int | None) -> str:
    """Return what is wrong with how a program ended, or empty."""
    ended, code = result["ended"], result.get("code")
    if ended == "missing":
        return f"cannot be started: {result['why']}"
    if ended == "timeout":
        return f"was ended after {timeout:g} s; see timeout"
    if ended == "memory":
        assert memory is not None
        return f"was ended: it took more than the {show_bytes(memory)} that may be used; see --max-memory, --jobs"
    if code:
        try:
            return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        except ValueError:
            return f"was ended by signal {-code}"
    return "left processes running, which were ended" if ended == "stayed" else ""


def _said(result: Mapping[str, Any]) -> str:
    """Return the last lines of standard error, or else of standard output, as the end of a message."""
    for stream in ("stderr", "stdout"):
        lines = [line.strip() for line in str(result.get(stream, "")).splitlines() if line.strip()]
        text = one_line(" | ".join(lines))
        if text:
            return f": {text}" if len(text) <= _MAX_REASON else f": ...{text[-_MAX_REASON:]}"
    return ""
