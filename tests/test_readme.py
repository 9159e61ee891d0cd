"""README and CONTRIBUTING: the table is that of the code, commands parse, the example works, links lead somewhere."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import docs_reference
import numpy as np
import pytest
import typer

from depthcli.cli import app, main
from depthcli.core.method import Family
from depthcli.methods.stereo import cost
from depthcli.run.presets import find_config
from tests.methods.stereo._pairs import shifted_pair

ROOT = Path(__file__).resolve().parent.parent
README, CONTRIBUTING = ((ROOT / name).read_text("utf-8") for name in ("README.md", "CONTRIBUTING.md"))


def blocks(text: str, language: str) -> list[str]:
    """Return the fenced blocks of a language, with continued lines joined."""
    found = re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [block.replace("\\\n", " ") for block in found]


def commands() -> list[str]:
    """Return every ``depthcli`` call of the shell and Makefile blocks, up to a pipe, and those in a line of text."""
    text = README + CONTRIBUTING
    found = [block for language in ("sh", "make") for block in blocks(text, language)]
    lines = [line.strip() for block in found for line in block.splitlines()]
    calls = [re.split(r" \|\|? | > |  # ", line)[0] for line in lines if line.startswith("depthcli ")]
    return calls + re.findall(r"`(depthcli [^`]+)`", text)


def test_table_and_named_files_are_up_to_date():
    assert docs_reference.with_commands(README) == README
    text = "\n".join([README, CONTRIBUTING, *(page.read_text("utf-8") for page in (ROOT / "docs").rglob("*.md"))])
    names = set(re.findall(r"(?<![\w/])((?:scripts|depthcli|tests|configs|docs)/[\w./-]*[\w/])", text))
    missing = {name for name in names if not (ROOT / name).exists()}
    assert missing == {"depthcli/methods/stereo/cost/squared_difference.py"}  # the example of CONTRIBUTING.md


def test_the_readme_is_short_and_its_links_lead_somewhere():
    assert len(README.splitlines()) <= 180 and len(README.encode()) <= 11_000
    links = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert len(links) > 8 and all((ROOT / link).exists() for link in links)
    assert (ROOT / "docs/static/overview.png").stat().st_size <= 300_000


def test_commands_parse(tmp_path: Path):
    tool = typer.main.get_command(app)
    found = commands()
    assert len(found) > 5
    for line in found:
        words = shlex.split(line)[1:]
        # Options of the tool itself (--help, --install-completion) would be done at once: they are only looked up.
        if words[0].startswith("--"):
            assert words[0] == "--help" or any(words[0] in option.opts for option in tool.params), line
            continue
        # make_context reads every option and argument, checks types and bounds, and runs nothing.
        context: Any = tool.make_context("depthcli", list(words))
        _, command, rest = tool.resolve_command(context, words)  # type: ignore[attr-defined]
        assert command is not None, line
        parameters = command.make_context(words[0], rest, parent=context).params
        if "config" in parameters and not parameters["config"].startswith("$"):
            of = parameters.get("command", words[0])  # of a sweep
            assert find_config(of, parameters["config"]).is_file(), line
        if parameters.get("action") == "show" and parameters["preset"] != "NAME":
            assert main(words) == 0


@pytest.fixture
def added_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Put the cost measure of CONTRIBUTING.md into the family, where it is found like any other."""
    (source,) = blocks(CONTRIBUTING, "python")
    (tmp_path / "squared_difference.py").write_text(source)
    monkeypatch.setattr(cost, "__path__", [*cost.__path__, str(tmp_path)])
    yield "squared_difference"  # type: ignore[misc]
    sys.modules.pop("depthcli.methods.stereo.cost.squared_difference", None)


def test_the_example_is_a_cost_measure(added_cost: str):
    """``tests/cli/test_new_command.py`` matches pairs with it."""
    family = Family.of("depthcli.methods.stereo.cost")
    assert added_cost in family.names()
    volume = family.parse(added_cost)(shifted_pair(20, 40, 3), 60)
    assert volume.costs.shape == (20, 40, 60)
    np.testing.assert_array_equal(volume.costs[:, 3:, 3], 0)
    assert (volume.costs[np.broadcast_to(np.arange(60) > np.arange(40)[:, None], volume.costs.shape)] == 100).all()


def _makefile() -> str:
    page = (ROOT / "docs/how_to/makefile.md").read_text("utf-8")
    return page.partition("```make file=Makefile\n")[2].partition("```")[0]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_the_makefile_evaluates_although_a_scene_fails(made_scenes: Path, tmp_path: Path):
    for name in ("planes_0", "planes_1"):
        shutil.copytree(made_scenes / name, tmp_path / "data/middlebury_v2" / name)
    damaged = tmp_path / "data/middlebury_v2/planes_0/left.png"
    image = damaged.read_bytes()
    damaged.write_bytes(b"damaged")
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments/small.yaml").write_text("base: opencv-bm\nblock: 7\n")
    (tmp_path / "Makefile").write_text(_makefile())
    program = tmp_path / "bin/depthcli"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m depthcli "$@"\n')
    program.chmod(0o755)
    environment = os.environ | {"PATH": f"{program.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}

    def make(*words: str) -> str:
        command = ["make", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "depthcli evaluate" in make()
    assert "planes_0" in (tmp_path / "results/report.md").read_text()
    assert "up to date" in make()
    assert json.loads((tmp_path / "runs/small/report.json").read_text())["failed"] == 1
    damaged.write_bytes(image)
    make("-B")
    assert json.loads((tmp_path / "runs/small/report.json").read_text())["failed"] == 0
    (tmp_path / "experiments/small.yaml").write_text("base: opencv-bm\nno_such_key: 1\n")
    done = subprocess.run(["make"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2  # a wrong config stops make
    assert "no_such_key" in done.stderr
