"""The evaluation of Booster: bad pixels of large images, by visibility and by material."""

from __future__ import annotations

from dataclasses import replace

from depthcli.evaluation.protocols._disparity import PRESENTATION, DisparityProtocol


class BoosterProtocol(DisparityProtocol):
    """Bad-pixel rates at 2, 4, 6 and 8 px and average errors; missing values count as bad.

    The regions come from the files: all pixels with a true disparity, pixels that both views show, and classes of
    materials, ``class_0`` to ``class_3`` (transparent, or a mirror).
    """

    presentation = replace(PRESENTATION, title="Booster: bad pixels, %; missing counts as bad", scene_rows=True)
    region_order = ("all", "nonocc", "class_0", "class_1", "class_2", "class_3")
    curve_regions = ("all", "nonocc")
    thresholds = (2.0, 4.0, 6.0, 8.0)
    default_threshold = 2.0
