"""The help texts: one screen, every option under a heading, examples that parse, configs of theirs that load."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
from depthcli.cli.help_text import START

from depthcli.cli import app, main
from depthcli.commands import command_names, grouped_commands, help_of, load_command
from depthcli.commands._old_batch import ConfigCommand
from depthcli.core.option import OptionGroup
from depthcli.run.combinations import parse_axis

NAMES = command_names()
MAX_LINES = 60
ROOT = Path(__file__).parents[2]
EXAMPLES = [*START, *(example for name in NAMES for example in load_command(name).examples)]


def help_text(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main([*words, "--help"]) == 0
    return capsys.readouterr().out


def sections(text: str) -> dict[str, str]:
    """Return heading -> the lines under it."""
    parts = re.split(r"^(\S[^:\n]*):\n", text, flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def parser_of(name: str) -> Any:
    tool = typer.main.get_command(app)
    return tool.get_command(typer.Context(tool), name)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["", *NAMES])
@pytest.mark.parametrize("columns", ["80", "200"])
def test_a_help_text_fits_a_screen(name: str, columns: str, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", columns)
    text = help_text(capsys, *([name] if name else []))
    lines = text.splitlines()
    assert max(map(len, lines)) < 80
    assert len(lines) <= MAX_LINES
    assert "`" not in text
    assert 1 <= len(sections(text)["Examples"].split("\n\n")[0].splitlines()) <= 3
    page = lines[-1].removeprefix("Documentation: ").partition(" ")[0]
    assert (ROOT / page).is_file(), page


@pytest.mark.parametrize("name", NAMES)
def test_every_option_is_under_its_heading(name: str, capsys):
    shown = sections(help_text(capsys, name))
    groups = [heading for heading in shown if heading != "Examples"]
    assert groups == [group for group in get_args(OptionGroup) if group in shown]
    found = re.findall(r"^  (?:-\w, )?(--[\w-]+)", "".join(shown[group] for group in groups), re.M)
    assert found[-4:] == ["--json", "--verbose", "--quiet", "--help"]
    taken = [parameter.opts[0] for parameter in parser_of(name).params if parameter.opts[0].startswith("--")]
    assert sorted(found) == sorted([*taken, "--help"])
    command = load_command(name)
    for option in command.options:
        assert re.search(rf"^  (-\w, )?{option.flag}\b", shown[option.group], re.M), option.flag
    for argument in command.arguments:
        assert f"\n  {argument.metavar} " in "\n" + shown[argument.group], argument.name


def test_every_command_is_under_a_heading_with_one_line(capsys):
    shown = sections(help_text(capsys))
    for heading, names in grouped_commands().items():
        assert heading != "More"
        lines = [f"  {name:<19}  {help_of(name)}" for name in names]
        assert shown[heading].strip("\n").splitlines() == lines
    assert sorted(name for names in grouped_commands().values() for name in names) == NAMES


@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_parse_and_their_configs_load(example: str, capsys):
    tool, name, *words = shlex.split(example)
    assert tool == "depthcli"
    if [name, *words[:1]] == ["fuse", "maps"]:  # two words for one name
        name, words = "fuse-maps", words[1:]
    values = parser_of(name).make_context(name, list(words)).params
    if values.get("preset") is not None:
        assert main([name, *words]) == 0
    if "config" not in values:
        return
    command = load_command(values.get("command", name))
    assert isinstance(command, ConfigCommand)
    axes = [parse_axis(text) for text in values.get("over", ())]
    settings = [*(values["set"] or ()), *(f"{axis.key}={value}" for axis in axes for value in axis.values)]
    own = {option.name: values.get(option.name) for option in command.options}
    command.config({**own, "config": values["config"], "set": settings})


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("nope",), "depthcli: no such command 'nope'; see depthcli --help"),
        (("sterio",), "depthcli: no such command 'sterio'; did you mean 'stereo'? See depthcli --help"),
        (("stereo",), "depthcli stereo: missing argument 'CONFIG'; see depthcli stereo --help"),
        (("merge", "a", "--jso"), "depthcli merge: no such option: --jso (Possible options: --json)"),
    ],
)
def test_wrong_usage_is_one_line(words: tuple[str, ...], line: str, capsys):
    assert main(list(words)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(line)
    assert err.count("\n") == 1


def test_without_a_command_the_help_is_shown(capsys):
    assert main([]) == 2
    assert "Match and refine:" in capsys.readouterr().err
