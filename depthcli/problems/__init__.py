"""The problems, one file each: what goes in, from files or arrays, how it is solved, and what comes out.

A command has its scenes computed by a ``Problem`` of this package; a function for Python makes the inputs of the same
problem from arrays.

| module | holds |
|---|---|
| ``problem`` | ``Problem``: load, solve, row; ``SceneJob`` for what a command computes otherwise |
| ``inputs`` | presets and overrides to configs; arrays to images, maps and volumes |
| ``results``, ``rectified``, ``frames`` | results and their files; pairs of a calibrated rig; depth of sensors |
| ``stereo``, ``fusion`` | a pair to its disparity map |
| ``given_maps`` | maps of other programs: confidence, fusion |
| ``kinect``, ``transparent`` | the depth of a sensor, refined |
| ``registration`` | two registered volumes to the expected error |
| ``evaluation`` | an estimate and the truth to scores |
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
"""Commands with configs -> module and class, by name: listing presets imports none."""


def load(command: str) -> type[Problem[Any, Any, Any]]:
    """Return the class of a command's problem."""
    module, _, name = PROBLEMS[command].partition(":")
    problem: type[Problem[Any, Any, Any]] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    return problem


def config_model(command: str) -> type[RootConfig]:
    """Return the class of a command's configs."""
    return load(command).model
