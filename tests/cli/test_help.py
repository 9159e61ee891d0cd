"""The help texts: examples that parse, configs of theirs that load; wrong usage ends with 2."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

from depthcli.cli import command_of, main
from depthcli.commands import config_model, find, grouped_names, help_of, own_names, text_of
from depthcli.commands._sweep_axes import parse_axes
from depthcli.core.config_file import load_config
from depthcli.run.presets import find_config

ROOT = Path(__file__).parents[2]


def examples() -> list[str]:
    texts = (text_of(function) for name in own_names() if (function := find(name)) is not None)
    return [line.strip() for text in texts for line in text.splitlines() if line.startswith("  depthcli ")]


@pytest.mark.parametrize("name", ["", *own_names()])
@pytest.mark.parametrize("columns", ["80", "200"])
def test_a_help_text_fits_a_terminal(name: str, columns: str, capsys, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("COLUMNS", columns)
    assert main([*([name] if name else []), "--help"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


def test_every_command_is_listed_with_one_line(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in own_names():
        assert re.search(rf"^  {name} +{re.escape(help_of(name))}$", text, re.M), name
    assert sorted(name for names in grouped_names().values() for name in names) == list(own_names())


@pytest.mark.parametrize("example", examples())
def test_examples_parse_and_their_configs_load(example: str):
    _, name, *words = shlex.split(example)
    command = command_of(name)
    values: dict[str, Any] = command.make_context(name, words).params
    if values.get("preset") is not None:
        assert main([name, *words]) == 0
    model = config_model(values.get("command", name))
    if "config" in values and model is not None and values["config"] != "maps":
        axes = parse_axes(values.get("over") or ())
        settings = [*(values["set"] or ()), *(f"{key}={value}" for key in axes for value in axes[key])]
        load_config(model, find_config(values.get("command", name), values["config"]), settings)


def test_without_a_command_the_help_is_shown(capsys):
    assert main([]) == 2
    assert "Match and refine:" in capsys.readouterr().err
