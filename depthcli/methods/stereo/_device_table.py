"""The device implementations: class of a method -> the function that computes the same on a device.

Only code that uses a device imports this module. A function takes the method, whose class its annotation names, and the
arguments of the method's ``__call__``, as the types of :mod:`.on_device`: a cost has ``census(method, pair,
n_disparities)``, aggregation and optimization ``cross(method, volume, pair)``, refinement ``median(method, disparity,
context)``.
"""

from __future__ import annotations

from inspect import isfunction
from typing import get_type_hints

from depthcli.methods.stereo.aggregation import _device as aggregation
from depthcli.methods.stereo.cost import _device as cost
from depthcli.methods.stereo.on_device import Table
from depthcli.methods.stereo.optimization import _device as optimization
from depthcli.methods.stereo.pipeline import _device as pipeline
from depthcli.methods.stereo.refinement import _device as refinement

TABLE: Table = {
    get_type_hints(function)["method"]: function
    for family in (cost, aggregation, optimization, refinement, pipeline)
    for name, function in vars(family).items()
    if isfunction(function) and function.__module__ == family.__name__ and not name.startswith("_")
}
