"""Every number that a config may hold has a largest and a smallest value."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import BaseModel

from depthcli.core.method import Family
from depthcli.methods.fusion.config import FuseConfig
from depthcli.methods.stereo.config import StereoConfig

STEREO = [f"methods.stereo.{stage}" for stage in ("cost", "aggregation", "optimization", "refinement", "pipeline")]
FAMILIES = (*STEREO, "algorithms.keypoints", "algorithms.segmentation")
METHODS = [f.load(n) for f in (Family.of(f"depthcli.{each}") for each in FAMILIES) for n in f.names()]
MODELS: list[type[BaseModel]] = [*METHODS, FuseConfig, StereoConfig]


def unbounded(schema: Any, path: str) -> Iterator[str]:
    if isinstance(schema, list):
        for scene in schema:
            yield from unbounded(scene, path)
    if not isinstance(schema, dict):
        return
    if schema.get("type") in ("integer", "number") and "enum" not in schema and "const" not in schema:
        low, high = ({"minimum", "exclusiveMinimum"} & set(schema), {"maximum", "exclusiveMaximum"} & set(schema))
        if not (low and high):
            yield path
    for key, value in schema.items():
        yield from unbounded(value, path if key in ("anyOf", "properties", "$defs", "items") else f"{path}.{key}")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_number_has_bounds(model: type[BaseModel]):
    assert not list(unbounded(model.model_json_schema(mode="validation"), model.__name__))
