"""Confidence: how sure a cost curve is of its minimum.

The curve measures know nothing of images and serve any search space; ``lrc`` and ``lrd`` read the right
view from a stereo volume, ``da`` and ``apkr`` look at the pixels around. Formulas: Hu & Mordohai,
"A quantitative evaluation of confidence measures for stereo vision", TPAMI 2012.
"""

from __future__ import annotations

from depthcli.methods.confidence.measures import (
    Curves,
    MeasureName,
    confidence_maps,
    curve_measures,
    measure_name,
    measures,
)

__all__ = ["Curves", "MeasureName", "confidence_maps", "curve_measures", "measure_name", "measures"]
