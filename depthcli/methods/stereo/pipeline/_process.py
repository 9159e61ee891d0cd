"""External programs as processes: started in a scratch folder, watched, and ended with all that they started."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from depthcli.core.context import Context
from depthcli.core.errors import InputError
from depthcli.core.text import one_line, show_bytes
from depthcli.kernels.jit import n_threads

_LOOK_SECONDS = 0.05  # between two checks of a running program
_MAX_REASON = 300  # characters of a program's output in a message


class ProgramError(InputError):
    """A program failed: it cannot be started, was ended, or gave no usable result."""


@contextlib.contextmanager
def scratch_folder(context: Context) -> Iterator[Path]:
    """Yield an empty folder and delete it at the end; if a program fails, keep it and name it in the message."""
    name = re.sub(r"[^\w.-]", "_", context.name)[:40]
    folder, kept = Path(tempfile.mkdtemp(prefix=f"depthcli-{name}-")), False
    try:
        yield folder
    except ProgramError as error:
        kept = True
        raise ProgramError(f"{error}; its files are in {folder}") from error
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)


def run_program(
    words: Sequence[str], folder: Path, timeout: float, context: Context, variables: Mapping[str, str] | None = None
) -> None:
    """Run a program in ``folder`` and end its process group; its output goes to files there.

    ``variables`` are added to its environment, its CPU time and memory to the figures of the scene. ProgramError, with
    the end of the program's output, if it fails, runs for more than ``timeout`` seconds, or takes more memory than the
    scene may.
    """
    try:
        import resource
    except ImportError:
        raise ProgramError("programs of others run on Linux and macOS only") from None
    name = os.path.basename(words[0])
    logs = [folder / "stderr.txt", folder / "stdout.txt"]
    until, peak, problem = time.monotonic() + timeout, 0, ""
    env = os.environ | {"OMP_NUM_THREADS": str(n_threads())} | dict(variables or {})
    try:
        with logs[0].open("wb") as err, logs[1].open("wb") as out:
            program = subprocess.Popen(
                words, cwd=folder, env=env, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
            )
    except OSError as error:
        raise ProgramError(f"{name} cannot be started: {error.strerror or error}") from error
    with _ended_group(program.pid):
        while not _has_ended(program.pid):
            peak = max(peak, _resident_bytes(program.pid))
            if time.monotonic() > until:
                problem = f"was ended after {timeout:g} s; see timeout"
            elif context.program_memory is not None and peak > context.program_memory:
                problem = f"was ended: it took more than the {show_bytes(context.program_memory)} that may be used; "
                problem += "see --max-memory, --jobs"
            if problem:
                break
            time.sleep(_LOOK_SECONDS)
    _, status, used = os.wait4(program.pid, 0)
    program.returncode = code = os.waitstatus_to_exitcode(status)
    if not problem and code:
        names = {int(each): each.name for each in signal.Signals}
        problem = f"was ended by {names.get(-code, -code)}" if code < 0 else f"ended with exit code {code}"
    if problem:
        raise ProgramError(f"{name} {problem}{_end_of(logs)}")
    context.used["program_cpu"] = round(context.used.get("program_cpu", 0.0) + used.ru_utime + used.ru_stime, 6)
    if used.ru_maxrss > resource.getrusage(resource.RUSAGE_SELF).ru_maxrss:  # it includes our memory at the start
        peak = max(peak, used.ru_maxrss * (1 if sys.platform == "darwin" else 1024))
    context.used["program_memory"] = max(context.used.get("program_memory", 0), peak)


def _has_ended(child: int) -> bool:
    """Return whether a child has ended; it stays a zombie, so that no other process gets its number."""
    if hasattr(os, "waitid"):
        return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
    words = ["ps", "-o", "state=", "-p", str(child)]  # macOS before Python 3.13
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.startswith("Z")


@contextlib.contextmanager
def _ended_group(group: int) -> Iterator[None]:
    """End a group of processes after the block, even if this process is killed within it."""
    line = ["/bin/sh", "-c", 'read -r _; kill -s KILL -- "-$0"', str(group)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True):
        yield  # then the pipe closes, as it does when this process ends


def _resident_bytes(session: int) -> int:
    """Return the resident memory of the processes of a session, bytes; 0 if there is no ``/proc``."""
    pages = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError):  # the process has ended
            facts = stat.read_bytes().rpartition(b")")[2].split()
            pages += int(facts[21]) if int(facts[3]) == session else 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _end_of(logs: Sequence[Path]) -> str:
    """Return the last lines of the first of these files that has any, to append to a message."""
    for log in logs:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 4 * _MAX_REASON))
            lines = [line.strip() for line in file.read().decode("utf-8", "backslashreplace").splitlines()]
        if text := one_line(" | ".join(filter(None, lines))):
            return f": {text}" if len(text) <= _MAX_REASON else f": ...{text[-_MAX_REASON:]}"
    return ""
