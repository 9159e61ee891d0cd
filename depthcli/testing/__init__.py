"""What cost measures, confidence measures and refinement steps have to pass: those of plug-ins, and our own.

>>> from depthcli.methods.stereo.cost.census import Census
>>> from depthcli.testing import check_cost_measure
>>> check_cost_measure(Census())

Every ``check_...`` raises AssertionError with a line that names the class and the promise that it does not keep.
"""

from __future__ import annotations

from depthcli.testing.confidence import check_confidence_measure
from depthcli.testing.cost import check_cost_measure
from depthcli.testing.refinement import check_refinement

__all__ = ["check_confidence_measure", "check_cost_measure", "check_refinement"]
