"""The device implementations: class of a method -> the function that computes the same on a device.

Only code that uses a device imports this module. A function takes the method and the arguments of the method's
``__call__``, as the types of :mod:`.on_device`: a cost has ``census(method, pair, n_disparities)``, aggregation and
optimization ``cross(method, volume, pair)``, refinement ``median(method, disparity, context)``.
"""

from __future__ import annotations

from depthcli.methods.stereo.aggregation import _device as aggregation
from depthcli.methods.stereo.aggregation.adaptive_weight import AdaptiveWeight
from depthcli.methods.stereo.aggregation.constant_window import ConstantWindow
from depthcli.methods.stereo.aggregation.cross import Cross
from depthcli.methods.stereo.cost import _device as cost
from depthcli.methods.stereo.cost.absolute_difference import AbsoluteDifference
from depthcli.methods.stereo.cost.census import Census
from depthcli.methods.stereo.cost.combined import Combined
from depthcli.methods.stereo.cost.gradient import Gradient
from depthcli.methods.stereo.cost.rank import Rank
from depthcli.methods.stereo.on_device import Table
from depthcli.methods.stereo.optimization import _device as optimization
from depthcli.methods.stereo.optimization.scanline import Scanline
from depthcli.methods.stereo.optimization.winner_takes_all import WinnerTakesAll
from depthcli.methods.stereo.pipeline import _device as pipeline
from depthcli.methods.stereo.pipeline.local import Local
from depthcli.methods.stereo.refinement import _device as refinement
from depthcli.methods.stereo.refinement.background_fill import BackgroundFill
from depthcli.methods.stereo.refinement.directional_fill import DirectionalFill
from depthcli.methods.stereo.refinement.left_right_check import LeftRightCheck
from depthcli.methods.stereo.refinement.median import Median
from depthcli.methods.stereo.refinement.slanted_median import SlantedMedian
from depthcli.methods.stereo.refinement.speckle_filter import SpeckleFilter
from depthcli.methods.stereo.refinement.subpixel import Subpixel
from depthcli.methods.stereo.refinement.surface_fill import SurfaceFill
from depthcli.methods.stereo.refinement.weighted_median import WeightedMedian

TABLE: Table = {
    AbsoluteDifference: cost.absolute_difference,
    Census: cost.census,
    Combined: cost.combined,
    Gradient: cost.gradient,
    Rank: cost.rank,
    AdaptiveWeight: aggregation.adaptive_weight,
    ConstantWindow: aggregation.constant_window,
    Cross: aggregation.cross,
    Scanline: optimization.scanline,
    WinnerTakesAll: optimization.winner_takes_all,
    BackgroundFill: refinement.background_fill,
    DirectionalFill: refinement.directional_fill,
    LeftRightCheck: refinement.left_right_check,
    Median: refinement.median,
    SlantedMedian: refinement.slanted_median,
    SpeckleFilter: refinement.speckle_filter,
    Subpixel: refinement.subpixel,
    SurfaceFill: refinement.surface_fill,
    WeightedMedian: refinement.weighted_median,
    Local: pipeline.local,
}
