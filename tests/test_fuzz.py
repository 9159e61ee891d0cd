"""A thousand cases of ``scripts/fuzz``, and that it notices what it is there to notice."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

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
def test_faults_are_noticed(fuzz, capsys, monkeypatch, fault):
    left_open = []

    def reader(path: Path) -> None:
        if fault == "bug":
            raise ZeroDivisionError
        if fault == "warning":
            np.float32(1e38) * np.float32(10)
        if fault == "open file":
            left_open.append(open(__file__, "rb"))  # noqa: SIM115
        if fault == "message":
            raise fuzz.InputError("no")

    monkeypatch.setattr(fuzz, "READERS", (reader, reader))
    monkeypatch.setattr(fuzz, "SUITED", {})
    assert fuzz.main(["--only", "readers", "--cases", "3"]) == 1
    assert "3 cases, 3 faults" in capsys.readouterr().out
    for file in left_open:
        file.close()


@pytest.mark.slow
def test_a_hang_is_noticed(fuzz, monkeypatch):
    def endless() -> None:
        with fuzz.watched():
            while True:
                pass

    monkeypatch.setattr(fuzz, "SECONDS", 1)
    with pytest.raises(fuzz.Fault, match="no end"):
        endless()
