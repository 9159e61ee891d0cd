"""What cost measures, confidence measures, optimizers, refinement steps and smoothness terms have to pass, ours too.

>>> from depthcli.methods.stereo.cost.census import Census
>>> from depthcli.testing import check_cost_measure
>>> check_cost_measure(Census())

Every ``check_...`` raises AssertionError with a line that names the class and the promise that it does not keep.
"""

from __future__ import annotations

from depthcli.testing.confidence import check_confidence_measure
from depthcli.testing.cost import check_cost_measure
from depthcli.testing.optimization import check_optimizer, check_smoothness
from depthcli.testing.refinement import check_refinement

__all__ = [
    "check_confidence_measure", "check_cost_measure", "check_optimizer", "check_refinement", "check_smoothness",
]  # fmt: skip
