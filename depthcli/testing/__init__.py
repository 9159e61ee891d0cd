"""Tests that methods, layouts, protocols, formats and commands have to pass: for plug-ins, and for our own.

>>> from depthcli.methods.stereo.cost.census import Census
>>> from depthcli.testing import check_cost_measure
>>> check_cost_measure(Census())

Every ``check_...`` raises AssertionError with a line that names the class and the promise that it does not keep.
"""

from __future__ import annotations

from depthcli.testing.choices import check_choice, check_surface_model
from depthcli.testing.commands import check_command
from depthcli.testing.confidence import check_confidence_measure
from depthcli.testing.cost import check_cost_measure
from depthcli.testing.features import check_keypoint_detector, check_volume_feature
from depthcli.testing.formats import check_format
from depthcli.testing.layouts import check_layout
from depthcli.testing.pipelines import (
    check_kinect_pipeline,
    check_registration_pipeline,
    check_stereo_pipeline,
    check_transparent_pipeline,
)
from depthcli.testing.protocols import check_protocol
from depthcli.testing.refinement import check_refinement
from depthcli.testing.samples import check_sample
from depthcli.testing.segmentation import check_segmentation
from depthcli.testing.volume_steps import check_aggregation, check_optimization

__all__ = [
    "check_aggregation", "check_choice", "check_command", "check_confidence_measure", "check_cost_measure",
    "check_format", "check_keypoint_detector", "check_kinect_pipeline", "check_layout", "check_optimization",
    "check_protocol", "check_refinement", "check_registration_pipeline", "check_sample", "check_segmentation",
    "check_stereo_pipeline", "check_surface_model", "check_transparent_pipeline", "check_volume_feature",
]  # fmt: skip
