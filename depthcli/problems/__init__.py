"""The problems, one file each: inputs from files or arrays, the solution, and the results.

A command computes its scenes with a ``Problem`` of this package. The Python function of the command creates the inputs
of the same problem from arrays.

| module | content |
|---|---|
| ``problem`` | ``Problem``: load, solve, row; ``SceneJob`` for commands that are no problem |
| ``inputs`` | configs from presets and overrides; images, maps and volumes from arrays |
| ``results``, ``rectified``, ``frames`` | results and their files; rectified pairs; refined sensor depth |
| ``stereo``, ``fusion`` | disparity maps of pairs |
| ``map_checks`` | warnings about a pair's map, and its error bound |
| ``given_maps``, ``given_runs`` | confidence and fusion of maps from other programs; where these maps are |
| ``kinect``, ``transparent`` | refined depth of a sensor |
| ``registration`` | expected error of a registration |
| ``evaluation`` | scores of an estimate |
| ``depth``, ``rectify``, ``boards``, ``sample`` | metric depth, rectified pairs, calibrations, generated scenes |
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from depthcli.core.method import RootConfig
    from depthcli.problems.problem import Problem

PROBLEMS = {
    "stereo": "stereo:Stereo",
    "fuse": "fusion:Fuse",
    "refine-kinect": "kinect:RefineKinect",
    "transparent": "transparent:Transparent",
    "register-confidence": "registration:Register",
}
"""Command with configs -> names of module and class, so that listing presets imports none of them."""


def load(command: str) -> type[Problem[Any, Any, Any]]:
    """Return the class of a command's problem."""
    module, _, name = PROBLEMS[command].partition(":")
    problem: type[Problem[Any, Any, Any]] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    return problem


def config_model(command: str) -> type[RootConfig]:
    """Return the class of a command's configs."""
    return load(command).model
