"""One program as a process: every way in which it may fail, with nothing left running."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from depthcli.programs.process import ProgramError, run_program

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc and prctl")


def run(folder: Path, code: str, timeout: float = 60.0, memory: int | None = None):
    program = folder / "program.py"
    program.write_text(textwrap.dedent(code))
    return run_program([sys.executable, str(program)], folder, timeout, memory, {"GIVEN": "seven"})


def running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_output_variables_time_and_memory_of_a_program_that_ends(tmp_path: Path):
    found = run(
        tmp_path,
        """
        import os, sys
        block = bytearray(b"x" * (64 << 20))
        print(os.environ["GIVEN"], sum(range(3_000_000)) > 0, os.getcwd())
        print("a remark", file=sys.stderr)
        """,
    )
    assert found.stdout == f"seven True {tmp_path}\n"
    assert found.stderr == "a remark\n"
    assert found.cpu_seconds > 0.01
    assert 64 << 20 < found.peak_memory < 400 << 20


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import sys; print('no licence', file=sys.stderr); sys.exit(3)", r"ended with exit code 3: no licence$"),
        ("print('only stdout'); raise SystemExit(1)", r"exit code 1: only stdout$"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", r"was ended by SIGSEGV$"),
        ("1 / 0", r"exit code 1: Traceback .* \| ZeroDivisionError: division by zero$"),
    ],
)
def test_exit_codes_and_signals_are_named_with_the_end_of_the_output(tmp_path: Path, code: str, message: str):
    with pytest.raises(ProgramError, match=message) as error:
        run(tmp_path, code)
    assert "\n" not in str(error.value)


def test_a_program_that_is_missing_or_cannot_be_run_is_named(tmp_path: Path):
    (tmp_path / "text").write_text("no program")
    for name, reason in (("absent", "No such file"), ("text", "Permission denied")):
        with pytest.raises(ProgramError, match=f"{name} cannot be started: {reason}"):
            run_program([str(tmp_path / name)], tmp_path, 9.0, None, {})


@LINUX
@pytest.mark.slow
def test_a_program_that_hangs_is_ended_with_all_its_children(tmp_path: Path):
    started = time.monotonic()
    with pytest.raises(ProgramError, match=r"was ended after 1 s; see timeout: waiting$"):
        run(
            tmp_path,
            """
            import os, signal, time
            from pathlib import Path
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            if os.fork() == 0:
                os.setsid()  # out of the process group
                Path("child").write_text(str(os.getpid()))
                time.sleep(300)
            print("waiting", flush=True)
            time.sleep(300)
            """,
            timeout=1.0,
        )
    assert time.monotonic() - started < 20
    assert not running(int((tmp_path / "child").read_text()))


@LINUX
@pytest.mark.slow
def test_processes_that_stay_behind_are_a_failure_and_are_ended(tmp_path: Path):
    with pytest.raises(ProgramError, match="left processes running, which were ended"):
        run(
            tmp_path,
            """
            import os, time
            from pathlib import Path
            if os.fork() == 0:
                os.setsid()
                if os.fork() == 0:  # a daemon, child of nobody
                    Path("daemon").write_text(str(os.getpid()))
                    time.sleep(300)
                os._exit(0)
            while not Path("daemon").is_file():
                time.sleep(0.01)
            """,
        )
    assert not running(int((tmp_path / "daemon").read_text()))


@pytest.mark.slow
def test_a_gigabyte_of_output_is_read_and_its_end_kept(tmp_path: Path):
    found = run(
        tmp_path,
        """
        import os
        for _ in range(1024):
            os.write(1, b"y" * (1 << 20))
            os.write(2, b"z" * 1000)
        os.write(1, b"the end")
        """,
    )
    assert found.stdout.endswith("yyythe end")
    assert len(found.stdout) == len(found.stderr) == 1 << 14
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) < 1 << 16


@LINUX
@pytest.mark.slow
def test_memory_of_all_processes_together_is_limited(tmp_path: Path):
    code = """
        import os, time
        for _ in range(3):
            if os.fork() == 0:
                break
        block = bytearray(b"x" * (80 << 20))
        time.sleep(60)
    """
    with pytest.raises(ProgramError, match=r"took more than the 200 MiB that may be used; see --max-memory, --jobs"):
        run(tmp_path, code, memory=200 << 20)


@LINUX
@pytest.mark.slow
def test_it_ends_with_the_process_that_wanted_it(tmp_path: Path):
    (tmp_path / "program.py").write_text(
        "import os, time; open('pid', 'w').write(str(os.getpid())); os.rename('pid', 'known'); time.sleep(300)"
    )
    call = (
        "import sys; from pathlib import Path; from depthcli.programs.process import run_program; "
        "run_program([sys.executable, 'program.py'], Path(sys.argv[1]), 300.0, None, {})"
    )
    with open(tmp_path / "errors", "wb") as errors:
        caller = subprocess.Popen([sys.executable, "-c", call, str(tmp_path)], stderr=errors)
    until = time.monotonic() + 60
    while not (tmp_path / "known").is_file() and time.monotonic() < until:
        time.sleep(0.01)
    pid = int((tmp_path / "known").read_text())
    assert running(pid)
    caller.send_signal(signal.SIGKILL)
    caller.wait()
    while running(pid) and time.monotonic() < until:
        time.sleep(0.01)
    assert not running(pid)
    time.sleep(0.2)
    assert (tmp_path / "errors").read_text() == ""
