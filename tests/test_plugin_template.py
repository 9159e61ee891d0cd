"""The wheel and the template of a plug-in in an environment of their own: tested, run, evaluated, and changed."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from depthcli.core.plugins import registries, registry_of
from depthcli.testing.inputs import shifted_pair
from tests.command_line import ended
from tests.files import laid

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "depthcli_example"

pytestmark = pytest.mark.system


class Environment:
    """An environment with the wheel, the template, and the libraries of the running one."""

    def __init__(self, place: Path) -> None:
        self.place, self.python = place, place / "env" / "bin" / "python"
        self.environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place / "env")], check=True)
        (self.packages,) = (place / "env" / "lib").glob("python*/site-packages")
        (self.packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
        self.install(ROOT)
        shutil.copytree(ROOT / "docs" / "plugin_template", place / "mine")
        write_version(place / "mine", "1.0")
        self.install(place / "mine")

    def install(self, project: Path) -> None:
        for old in list(self.packages.glob(f"{PACKAGE}*")):
            shutil.rmtree(old)
        pip = ["-m", "pip", "install", "--quiet", "--no-deps", "--target", self.packages]
        ended(0, sys.executable, *pip, project, cwd=self.place, env=self.environment)

    def run(self, *words: str, module: str = "depthcli", code: int = 0) -> subprocess.CompletedProcess[str]:
        return ended(code, self.python, "-m", module, *words, cwd=self.place, env=self.environment)


def write_version(project: Path, version: str) -> None:
    file = project / "pyproject.toml"
    file.write_text(re.sub(r'(?m)^version = ".*"$', f'version = "{version}"', file.read_text()))


@pytest.fixture(scope="module")
def env(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    made = Environment(tmp_path_factory.mktemp("template"))
    for name, shift in (("near", 9), ("far", 5)):
        pair, truth = shifted_pair(48, 64, shift), f"{f'{shift} ' * 64}\n" * 48
        files = {"first.png": pair.left, "second.png": pair.right, "first_truth.table": truth}
        laid(made.place / "scenes" / name, files)
    return made


def test_its_own_tests_pass(env: Environment):
    assert "5 passed" in env.run("-q", "-p", "no:cacheprovider", "mine/tests", module="pytest").stdout


def test_its_readme_names_the_base_of_every_registry():
    text = (ROOT / "docs" / "plugin_template" / "README.md").read_text("utf-8")
    bases = [base.rpartition(".") for base in re.findall(r"^\| .+ \| `(depthcli\.\S+)` \|$", text, re.MULTILINE)]
    of_bases = {registry_of(getattr(importlib.import_module(module), name)) for module, _, name in bases}
    assert of_bases == {registry for package, registry in registries.items() if package.startswith("depthcli.")}


def test_it_runs_is_evaluated_and_is_refused_with_another_version(env: Environment):
    stereo = ["stereo", "fast", "-i", "scenes", "-o", "squared", "--jobs", "2", "--set", "cost=squared-difference"]
    stereo += ["--plugin", PACKAGE]
    assert "Eighth of a pixel" in env.run(*stereo, "--evaluate").stdout
    assert "    depthcli-example: '1.0'\n" in (env.place / "squared" / "run.yaml").read_text()
    scores = json.loads((env.place / "squared" / "evaluation" / "scores.json").read_text())
    assert scores["plugins"] == {"depthcli-example": "1.0"}
    constant = ["constant", "five", "-i", "scenes", "-o", "constant", "--jobs", "2", "--plugin", PACKAGE]
    env.run(*constant)
    compared = env.run("evaluate", "squared", "constant", "--truth", "scenes", "--json", "--plugin", PACKAGE)
    assert {result["protocol"] for result in json.loads(compared.stdout)["results"]} == {"eighth-pixel"}
    assert "2 of 2 scenes are done already" in env.run(*stereo).stderr
    env.run("stereo", "squared", "-i", "scenes", "-o", "preset", "--plugin", PACKAGE)
    write_version(env.place / "mine", "1.1")
    env.install(env.place / "mine")
    for command in (stereo, constant):
        refused = env.run(*command, code=2)
        assert "'1.0'" in refused.stderr and "'1.1'" in refused.stderr and "--overwrite" in refused.stderr
