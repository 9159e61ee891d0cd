"""A thousand cases of ``scripts/fuzz``, and that it notices what it is there to notice."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from depthcli.core.errors import InputError
from tests.fuzzing import readers, watching
from tests.fuzzing.common import Fault

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "fuzz"


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("fuzz", str(SCRIPT))
    spec = importlib.util.spec_from_loader("fuzz", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.mark.system
def test_readers_and_commands():
    command = [sys.executable, str(SCRIPT), "--cases", "1000", "--seed", "7"]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert "1000 cases, 0 faults" in done.stdout


@pytest.mark.parametrize("fault", ["bug", "warning", "open file", "message"])
def test_faults_are_noticed(fuzz, tmp_path, monkeypatch, fault):
    left_open = []

    def reader(path: Path) -> None:
        if fault == "bug":
            raise ZeroDivisionError
        if fault == "warning":
            np.float32(1e38) * np.float32(10)
        if fault == "open file":
            left_open.append(open(__file__, "rb"))  # noqa: SIM115
        if fault == "message":
            raise InputError("no")

    monkeypatch.setattr(readers, "READERS", (reader, reader))
    monkeypatch.setattr(readers, "SUITED", {})
    results = [result for result in fuzz.run_cases(range(3), 0, "readers", tmp_path) if result]
    assert len(results) == 3
    assert all(result["fault"] for result in results)
    for file in left_open:
        file.close()


@pytest.mark.slow
@pytest.mark.parametrize("end", ["killed", "hung"])
def test_a_case_that_ends_its_process_is_a_fault_and_the_others_go_on(fuzz, capsys, monkeypatch, end):
    def case(rng: np.random.Generator, folder: Path, base: Path) -> str:
        if folder.name == "4" and end == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if folder.name == "4":  # as a library that Python cannot interrupt
            signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
            time.sleep(60)
        return "done"

    monkeypatch.setitem(fuzz.KINDS, "readers", (case, 1))
    monkeypatch.setattr(watching, "limit", lambda: 1)
    monkeypatch.setattr(fuzz, "limit", lambda: 1)
    assert fuzz.main(["--only", "readers", "--cases", "9", "--jobs", "2"]) == 1
    said = capsys.readouterr().out
    assert ("case 4: ended: no end" if end == "hung" else "case 4: ended: the process") in said
    assert "8  done" in said
    assert "9 cases, 1 faults" in said


@pytest.mark.slow
def test_a_hang_is_noticed(monkeypatch):
    def endless() -> None:
        with watching.watched():
            while True:
                pass

    monkeypatch.setattr(watching, "limit", lambda: 1)
    with pytest.raises(Fault, match="no end"):
        endless()
