"""Confidence of the best match of a cost curve; larger values mean more confidence in every measure.

:func:`confidence_maps` takes a stereo cost volume (H, W, D); :class:`CostCurves` takes curves over any search space. A
measure is one float32 per curve. One pass over all curves computes their statistics (``_curves``), and most measures
are a short formula of these (the table ``MEASURES``). ``apkr`` and ``da`` need one curve per pixel, costs (H, W, K);
``lrc``, ``lrd`` and ``dap`` need a stereo volume.

A curve has costs ``c``: ``c1`` is the smallest cost, at ``d1``; ``c2`` is the next smallest cost anywhere; ``c2m`` is
the second smallest local minimum, at ``d2m``, or the largest cost if there is no such minimum; ``s`` is the standard
deviation of all costs of the volume.

Sources: Hu and Mordohai, "A quantitative evaluation of confidence measures for stereo vision", TPAMI 2012; ``apkr``:
Kim et al. 2014. In a ratio of two costs, 1e-3 of the mean cost is added to both. If only the denominator can be zero,
it is added to the denominator.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from depthcli.core.method import Family, Method
from depthcli.methods.confidence._curves import CostCurves
from depthcli.methods.confidence._measures import MEASURES, Map

__all__ = ["ConfidenceMeasure", "CostCurves", "Map", "MeasureName", "confidence_maps", "measure", "measures"]

_ADDED = Family("depthcli.methods.confidence")


class ConfidenceMeasure(Method):
    """Base of measures that plug-ins or files of this folder add: one number per cost curve.

    The first paragraph of a measure's docstring is its line in the documentation.
    """

    @abstractmethod
    def __call__(self, curves: CostCurves) -> Map:
        """Return the measure in the shape of the curves."""


def measures() -> dict[str, str]:
    """Return the name of every measure and a line about it, built-in measures first."""
    lines = {name: line for name, (line, _) in MEASURES.items()}
    added = {name: _ADDED.load(name).__doc__ or "" for name in _ADDED.names()}
    return lines | {name: " ".join(text.split("\n\n")[0].split()) for name, text in added.items()}


def measure(name: str) -> Callable[[CostCurves], Map]:
    """Return the function that computes the measure ``name`` of curves; errors as in :func:`measure_name`."""
    known = measure_name(name)
    return MEASURES[known][1] if known in MEASURES else cast(ConfidenceMeasure, _ADDED.load(known)())


def measure_name(name: str, *others: str) -> str:
    """Return the measure, or the entry of ``others``, called ``name``, ignoring case; ValueError if there is none.

    ConfigError: a plug-in's measure cannot be loaded.
    """
    if name.lower() in MEASURES or name.lower() in others:
        return name.lower()
    known = _ADDED.find(name)
    if known is None:
        raise ValueError(f"no confidence measure called {name!r}{_ADDED.suggestions(name, *others, *MEASURES)}")
    _ADDED.load(known)
    return known


MeasureName = Annotated[str, AfterValidator(measure_name)]
"""Name of a measure in a config."""


def confidence_maps(costs: NDArray[Any], names: Iterable[str]) -> dict[str, Map]:
    """Compute the measures ``names`` of a stereo cost volume: name -> (H, W) float32, larger = more confidence.

    ``costs`` are (H, W, D) uint8, uint16 or float32, finite, lower is better; cells with d > x are left out.
    ValueError: a name is unknown, or the costs are no volume.
    """
    if costs.ndim != 3 or 0 in costs.shape:
        raise ValueError(f"expected costs (H, W, D), got {costs.shape}")
    chosen = {name: measure(name) for name in dict.fromkeys(names)}
    valid = np.minimum(np.arange(1, costs.shape[1] + 1, dtype=np.int32), costs.shape[2])
    curves = CostCurves(costs, np.broadcast_to(valid, costs.shape[:2]))
    return {name: compute(curves) for name, compute in chosen.items()}
