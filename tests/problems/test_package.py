"""``import depthcli``: light, typed, and every public name with an example that runs."""

import ast
import doctest
import importlib
import inspect
import sys
from pathlib import Path

import pytest

import depthcli
from tests.command_line import ended
from tests.golden import saying

ROOT = Path(__file__).resolve().parents[2]
USER_SCRIPT = """
import numpy as np
from PIL import Image

import depthcli

left, right = (np.asarray(Image.open(f"{side}.png")) for side in ("left", "right"))
disparity = depthcli.stereo(left, right, max_disparity=16, preset="fast", optimization={"p2": 2.0})
depth = disparity.to_depth(focal=100.0, baseline=0.1)
cloud = depth.to_points(near=0.1, far=50.0)
disparity.save("pair")
depth.save("depth")
cloud.save("points.ply")
print(disparity.density, disparity.measured.mean(), len(cloud), depthcli.Status(disparity.status[0, 0]))
"""


def test_the_import_is_light():
    heavy = {"numpy", "numba", "cv2", "pydantic", "yaml"}
    light = f"""import sys, depthcli
assert "stereo" in dir(depthcli) and "Disparity" in depthcli.__all__ and not {heavy} & set(sys.modules)
depthcli.InputError  # errors need no kernels
assert "numba" not in sys.modules"""
    ended(0, sys.executable, "-c", light)


def test_the_stub_names_what_the_package_has_and_all_of_it_has_a_docstring():
    tree = ast.parse((ROOT / "depthcli" / "__init__.pyi").read_text())
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    stub = {alias.asname: node.module for node in imports for alias in node.names}
    assert set(depthcli.__all__) == {*stub, "__version__"}
    for name, module in stub.items():
        assert getattr(depthcli, name) is getattr(importlib.import_module(str(module)), name)
        assert inspect.getdoc(getattr(depthcli, name)), name
    with saying(AttributeError):
        depthcli.stereos  # noqa: B018


@pytest.mark.parametrize("name", [
    "evaluation", "fusion", "given_maps", "inputs", "kinect", "registration", "results", "stereo", "transparent",
])  # fmt: skip
def test_examples_run(name: str):
    failed, tried = doctest.testmod(importlib.import_module(f"depthcli.problems.{name}"))
    assert tried and not failed


@pytest.mark.system
def test_a_script_of_ten_lines_is_typed_and_runs(tmp_path: Path, made_scenes: Path):
    (tmp_path / "user.py").write_text(USER_SCRIPT)
    options = ["--strict", "--config-file", "", "--cache-dir", str(tmp_path / "cache"), "--follow-imports=silent"]
    assert ended(0, sys.executable, "-m", "mypy", *options, "user.py", cwd=tmp_path).stdout.startswith("Success")
    for side in ("left", "right"):
        (tmp_path / f"{side}.png").write_bytes((made_scenes / "planes_0" / f"{side}.png").read_bytes())
    said = ended(0, sys.executable, "user.py", cwd=tmp_path).stdout.split()
    assert float(said[0]) == 1.0 and float(said[1]) > 0.5 and int(said[2]) > 1000
    assert (tmp_path / "points.ply").read_bytes().startswith(b"ply\n")
    assert {p.name for p in (tmp_path / "depth").iterdir()} == {"depth.pfm", "depth.png", "status.png", "preview.png"}
