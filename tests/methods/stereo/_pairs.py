"""Methods that the stereo tests share."""

import tempfile
from pathlib import Path
from typing import Any

import pytest

from depthcli.core.method import Family
from depthcli.testing.inputs import shifted_pair
from tests.methods.stereo._networks import has_onnx, local_features

__all__ = ["PARAMETERS", "methods", "shifted_pair"]
# Parameters of methods that have no default for everything.
PARAMETERS: dict[str, dict[str, Any]] = {
    "combined": {
        "parts": [
            {"cost": "absolute_difference", "lambda": 10},
            {"cost": "census", "lambda": 30},
            {"cost": "gradient", "lambda": 4},
        ]
    }
}


def methods(package: str) -> list[Any]:
    """One pytest parameter for every method in the folder ``package``."""
    family = Family.of(package)
    return [_parameter(family, name) for name in family.names()]


def _parameter(family: Family, name: str) -> Any:
    fields = PARAMETERS.get(name, {})
    if name == "onnx":
        if not has_onnx():
            return pytest.param(None, id=name, marks=pytest.mark.skip(reason="onnxruntime or onnx is not installed"))
        file = local_features(Path(tempfile.mkdtemp()) / "features.onnx", channels=None)
        fields = {"model": str(file), "normalization": "image", "distance": "l1", "truncation": 2}
    return pytest.param(family.parse({family.key: name, **fields}, None), id=name)
