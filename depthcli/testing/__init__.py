"""Checks for cost measures, confidence measures, optimizers, refinement steps and smoothness terms, ours included.

>>> from depthcli.methods.stereo.cost.census import Census
>>> from depthcli.testing import check_cost_measure
>>> check_cost_measure(Census())

Every ``check_...`` raises AssertionError with a line that names the class and the broken promise. ``inputs`` makes the
random inputs of all checks.
"""

from __future__ import annotations

from depthcli.testing.confidence import check_confidence_measure
from depthcli.testing.cost import check_cost_measure
from depthcli.testing.optimization import check_optimizer, check_smoothness
from depthcli.testing.refinement import check_refinement

__all__ = [
    "check_confidence_measure", "check_cost_measure", "check_optimizer", "check_refinement", "check_smoothness",
]  # fmt: skip
