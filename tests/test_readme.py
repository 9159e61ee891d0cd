"""What the README says is true: its names exist and are complete, its commands parse, its example works."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from depthcli.batch.presets import find_config, list_presets
from depthcli.cli import app, main
from depthcli.core.maps import DepthStatus, Status
from depthcli.core.method import Family
from depthcli.data.formats.disparity import read_pfm
from depthcli.data.formats.pictures import DEPTH_STATUS_PALETTE
from depthcli.methods.stereo import cost
from scripts import readme_tables
from tests.methods.stereo._pairs import shifted_pair

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text("utf-8")


def blocks(language: str) -> list[str]:
    """Fenced blocks of a language, without comments' lines and with continued lines joined."""
    found = re.findall(rf"^```{language}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    return [block.replace("\\\n", " ") for block in found]


def commands() -> list[str]:
    """Every ``depthcli`` call of the shell and Makefile blocks, up to a pipe."""
    lines = [line.strip() for language in ("sh", "make") for block in blocks(language) for line in block.splitlines()]
    calls = [re.split(r" \| | > |  # ", line)[0] for line in lines if line.startswith("depthcli ")]
    inline = re.findall(r"`(depthcli [^`]+)`", TEXT)
    return calls + inline


def test_the_tables_are_those_of_the_code():
    """Methods, layouts, protocols, presets: ``scripts/readme_tables.py`` would change nothing."""
    assert readme_tables.filled(TEXT) == TEXT
    found = (ROOT / "depthcli").rglob("__init__.py")
    folders = [file.parent for file in found if "method_of(" in file.read_text("utf-8")]
    families = {folder.relative_to(ROOT / "depthcli").as_posix() for folder in folders}
    assert families - set(re.findall(r"<!-- table: methods/([\w/]+) -->", TEXT)) == set()


def test_every_preset_named_in_the_text_is_one():
    names = {f"{command} {name}" for command, name, _ in list_presets()}
    commands = "|".join(sorted({command for command, _, _ in list_presets()}))
    assert set(re.findall(rf"`((?:{commands}) [a-z/-]+)`", TEXT)) <= names
    advice = TEXT[TEXT.index("## Which preset") : TEXT.index("All presets:")]
    short = {name for _, name, _ in list_presets()}
    words = re.findall(r"`((?:thesis/)?[a-z]+(?:-[a-z]+)*)`", advice)
    assert set(words) <= short
    assert words


def test_status_bits_and_exit_codes():
    bits = TEXT[TEXT.index("| bit of `status.png`") : TEXT.index("| exit code")]
    for flag in Status:
        assert re.search(rf"^\| {flag.value} \| {flag.name.lower().replace('_', '.*')}", bits, re.MULTILINE), flag
    bits = TEXT[TEXT.index("| bit of a depth map's") : TEXT.index("### Transparent objects")]
    for depth_flag in DepthStatus:
        words = DEPTH_STATUS_PALETTE[int(depth_flag)][0]
        assert re.search(rf"^\| {depth_flag.value} \| {words}", bits, re.MULTILINE), depth_flag
    for code in (0, 1, 2, 3, 130, 143):
        assert re.search(rf"^\| {code} \|", TEXT[TEXT.index("| exit code") :], re.MULTILINE)


def test_commands_parse(tmp_path: Path):
    tool = typer.main.get_command(app)
    found = commands()
    assert len(found) > 10
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


def test_files_that_are_named_exist():
    named = re.findall(r"\b((?:scripts|depthcli|tests|configs)/[\w./-]*[\w/])", TEXT)
    assert len(named) > 10
    example = "depthcli/methods/stereo/cost/squared_difference.py"
    missing = [name for name in named if not (ROOT / name).exists() and name != example]
    assert not missing


@pytest.fixture
def added_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The README's cost measure as a file of the family, found like any other."""
    (source,) = blocks("python")
    (tmp_path / "squared_difference.py").write_text(source)
    monkeypatch.setattr(cost, "__path__", [*cost.__path__, str(tmp_path)])
    yield "squared_difference"  # type: ignore[misc]
    sys.modules.pop("depthcli.methods.stereo.cost.squared_difference", None)


def test_the_example_is_a_cost_measure(added_cost: str, made_scenes: Path, tmp_path: Path):
    family = Family.of("depthcli.methods.stereo.cost")
    assert added_cost in family.names()
    volume = family.parse(added_cost)(shifted_pair(20, 40, 3), 60)
    assert volume.costs.shape == (20, 40, 60)
    np.testing.assert_array_equal(volume.costs[:, 3:, 3], 0)
    assert (volume.costs[np.broadcast_to(np.arange(60) > np.arange(40)[:, None], volume.costs.shape)] == 100).all()
    run = ["stereo", "cross", "-i", str(made_scenes), "--scenes", "planes_0", "-o", str(tmp_path / "r"), "-q"]
    assert main([*run, "--set", f"cost={added_cost}"]) == 0
    assert np.isfinite(read_pfm(tmp_path / "r" / "planes_0" / "disp_left.pfm")).mean() > 0.5
