"""A command is one file in jobs/, its package, its layout, its protocol: nothing else is edited.

The package is copied, a toy command (invert a depth map) is put beside the others, and run as a user would.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import depthcli
from depthcli.data.formats.disparity import read_pfm, write_pfm

FILES = {
    "inversion/__init__.py": '"""Inverts depth maps."""\n',
    "inversion/config.py": '''
from pydantic import BaseModel, ConfigDict, Field


class InvertConfig(BaseModel):
    """How to invert."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    power: float = Field(1.0, gt=0, le=4, description="the depth is taken to minus this power")
    run: dict[str, object] | None = Field(default=None, exclude=True, description="How a run was made; ignored.")
''',
    "data/scenes/plain.py": '''
from dataclasses import dataclass
from pathlib import Path

from depthcli.data.scenes import Scene


@dataclass(frozen=True, kw_only=True)
class PlainScene(Scene):
    """A depth map and, where known, its inverse."""

    depth: Path
    inverse: Path | None = None

    @property
    def input_files(self):
        return {"depth": self.depth}

    @property
    def has_truth(self):
        return self.inverse is not None

    def load(self):
        from depthcli.data.formats.disparity import read_pfm

        self.check()
        return read_pfm(self.depth)

    def truth(self):
        from depthcli.data.formats.disparity import read_pfm

        return read_pfm(self.inverse)
''',
    "data/layouts/plain.py": '''
from depthcli.data.scenes.plain import PlainScene
from depthcli.data.layouts import Folder, Layout


class Plain(Layout):
    """``plain.pfm`` and ``plain_inverse.pfm``."""

    kind = PlainScene
    wants = "`plain.pfm`, `plain_inverse.pfm`"

    def scenes(self, folder: Folder):
        depth = folder.one("plain", (".pfm",))
        if depth is None:
            return []
        inverse = folder.one("plain_inverse", (".pfm",))
        return [PlainScene(name=folder.name, folder=folder.path, layout=self.name, protocol="inverse", depth=depth,
                          inverse=inverse)]
''',
    "evaluation/protocols/inverse.py": '''
import numpy as np

from depthcli.evaluation.map_files import MapFiles
from depthcli.evaluation.presentation import Presentation
from depthcli.evaluation.protocols import Protocol
from depthcli.evaluation.scores import ESTIMATED_ONLY, Measure, Tally
from depthcli.data.formats.disparity import read_pfm
from depthcli.data.scenes.plain import PlainScene


class Inverse(Protocol):
    """Mean error of the inverse."""

    kind = PlainScene
    files = MapFiles(("{scene}/inverse",), (".pfm",))
    presentation = Presentation("Inverse depth: mean error", "1/m")
    headline = Measure("mean", "1/m", convention=ESTIMATED_ONLY)

    def truth(self, scene):
        return scene.truth()

    def read(self, path, scene, truth):
        return read_pfm(path)

    def nothing(self, truth):
        return np.full_like(truth, np.nan)

    def regions(self, truth):
        return {"all": np.isfinite(truth)}

    def error(self, estimate, truth):
        return np.abs(estimate - truth)

    def wrong(self, estimate, truth):
        return self.error(estimate, truth) > 0.5

    def scores(self, estimate, truth):
        tally = Tally("all", self.error(estimate, truth)[np.isfinite(truth)])
        return [tally.number(self.headline, float(tally.valid.mean()), tally.valid.size)]
''',
    "commands/invert.py": '''"""Turn depth maps upside down."""

from depthcli.data.scenes.plain import PlainScene
from depthcli.commands._batch import ConfigCommand


class InvertCommand(ConfigCommand):
    kinds = (PlainScene,)

    def config_model(self):
        from depthcli.inversion.config import InvertConfig

        return InvertConfig

    def columns(self):
        from depthcli.batch.tables import SIZE

        return (SIZE,)

    def compute(self, config, scene, folder, memory):
        from depthcli.batch.runner import Outcome
        from depthcli.data.formats.disparity import write_pfm

        depth = scene.load()
        write_pfm(folder / "inverse.pfm", depth**-config.power)
        return Outcome({"width": depth.shape[1], "height": depth.shape[0]}, {"invert": 0.0})


COMMAND = InvertCommand()
''',
    "configs/invert/plain.yaml": "# The inverse itself.\npower: 1.0\n",
}


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with the toy's files in it, and two scenes."""
    root = tmp_path_factory.mktemp("house")
    source = Path(depthcli.__file__).parent
    shutil.copytree(source, root / "depthcli", ignore=shutil.ignore_patterns("__pycache__"))
    shipped = source / "configs"
    shutil.copytree(shipped if shipped.is_dir() else source.parent / "configs", root / "depthcli" / "configs",
                    dirs_exist_ok=True)  # fmt: skip
    for name, text in FILES.items():
        file = root / "depthcli" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    for name, value in (("near", 2.0), ("far", 8.0)):
        write_pfm(root / "in" / name / "plain.pfm", np.full((4, 6), value, np.float32))
        write_pfm(root / "in" / name / "plain_inverse.pfm", np.full((4, 6), 1 / value, np.float32))
    return root


def run(house: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(house)}
    command = [sys.executable, "-m", "depthcli", *map(str, arguments)]
    return subprocess.run(command, cwd=house, env=environment, capture_output=True, text=True, check=False)


def test_a_new_command_needs_no_edit_elsewhere(house: Path):
    assert "invert Turn depth maps upside down." in " ".join(run(house, "--help").stdout.split())
    assert "invert plain" in run(house, "presets").stdout
    assert "# the depth is taken to minus this power\npower: 1.0" in run(house, "presets", "show", "plain").stdout
    done = run(house, "invert", "plain", "-i", "in", "-o", "run", "--jobs", "2", "--evaluate")
    assert done.returncode == 0, done.stderr
    assert "Inverse depth: mean error" in done.stdout
    assert np.all(read_pfm(house / "run" / "near" / "inverse.pfm") == 0.5)
    before = (house / "run" / "near" / "inverse.pfm").stat().st_mtime_ns
    again = run(house, "invert", "plain", "-i", "in", "-o", "run", "--json")
    assert json.loads(again.stdout)["done"] == 2
    assert "2 of 2 scenes are done already" in again.stderr
    assert (house / "run" / "near" / "inverse.pfm").stat().st_mtime_ns == before
    other = run(house, "invert", "plain", "-i", "in", "-o", "run", "--set", "power=2")
    assert (other.returncode, "another config" in other.stderr) == (2, True)
    typo = run(house, "invert", "plain", "-i", "in", "-o", "run2", "--set", "powr=2")
    assert "did you mean 'power'?" in typo.stderr
    assert run(house, "invert", "plain", "-i", "in", "-o", "run2", "--set", "power=2").returncode == 0
    compared = run(house, "evaluate", "run", "run2", "--truth", "in", "-o", "report")
    assert compared.returncode == 0, compared.stderr
    scores = json.loads((house / "report" / "scores.json").read_text())
    assert scores["runs"] == ["run", "run2"]
