"""Every preset that ships: read, shown, run on a small scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthcli.batch.presets import find_config, list_presets, preset_folder
from depthcli.cli import main
from depthcli.core.config_file import dump_config, load_config, parse_config
from depthcli.io.disparity import read_pfm
from depthcli.jobs.commands import root_config, show_preset

PRESETS = [(command, name) for command, name, _ in list_presets()]


def test_there_are_presets():
    assert len(PRESETS) == len(list(preset_folder().rglob("*.yaml"))) > 0


@pytest.mark.parametrize(("command", "name"), PRESETS)
def test_shown_with_every_field_it_is_the_same_config(command: str, name: str):
    model = root_config(command)
    shown = show_preset(f"{command}/{name}")
    resolved = dump_config(load_config(model, find_config(command, name)))
    assert dump_config(load_config(model, parse_config(shown, "shown"))) == resolved
    assert shown.count("#") > 3
    about = next(line for c, n, line in list_presets() if (c, n) == (command, name))
    assert 20 < len(about) <= 140


@pytest.mark.parametrize(("command", "name"), PRESETS)
def test_it_runs_on_a_toy_scene(made_scenes: Path, tmp_path: Path, command: str, name: str):
    one = ["-i", str(made_scenes), "--scenes", "planes_0", "-o", str(tmp_path / "r"), "-q"]
    assert main([command, name, *one]) == 0
    values = read_pfm(tmp_path / "r" / "planes_0" / "disp_left.pfm")
    assert values.shape == (64, 96)
    known = np.isfinite(values)
    assert known.mean() > 0.5
    assert values[known].min() >= 0
    assert values[known].max() <= 13
