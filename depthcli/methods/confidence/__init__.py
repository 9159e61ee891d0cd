"""Confidence of the minimum of a cost curve. One file a measure, larger values are surer.

Costs -> :class:`CostCurves`, whose statistics one pass over all curves gives -> measures, computed from the statistics.
Formulas: Hu and Mordohai, "A quantitative evaluation of confidence measures for stereo vision", TPAMI 2012.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from depthcli.core.method import Family, Method
from depthcli.methods.confidence._curves import CostCurves

__all__ = ["ConfidenceMeasure", "CostCurves", "Map", "MeasureName", "confidence_maps", "measure_name", "measures"]

Map = NDArray[np.float32]
"""One value a curve, in the shape of the curves."""

_FAMILY = Family.of("depthcli.methods.confidence")


class ConfidenceMeasure(Method):
    """Computes one number a cost curve, larger where its minimum is surer.

    The first paragraph of a measure's docstring is its line in the documentation; there ``c1`` is the smallest cost, at
    ``d1``, and ``c2`` the next smallest anywhere.
    """

    @abstractmethod
    def __call__(self, curves: CostCurves) -> Map:
        """Return the measure in the shape of the curves; those that look at other pixels want curves (H, W, D)."""


def measures() -> dict[str, str]:
    """Return the name of every measure and one line about it."""
    return {name: " ".join((_FAMILY.load(name).__doc__ or "").split("\n\n")[0].split()) for name in _FAMILY.names()}


def measure_name(name: str, *others: str) -> str:
    """Return ``name`` in lower case.

    Raises
    ------
    ValueError
        It is neither a measure nor in ``others``.
    """
    known = (*others, *_FAMILY.names())
    if name.lower() not in known:
        raise ValueError(f"no confidence measure called {name!r}; one of: {', '.join(known)}")
    return name.lower()


MeasureName = Annotated[str, AfterValidator(measure_name)]
"""A measure as configs name it."""


def confidence_maps(costs: NDArray[Any], names: Iterable[str]) -> dict[str, Map]:
    """Compute measures of a stereo cost volume, all of them together.

    Parameters
    ----------
    costs : (H, W, D) uint8, uint16 or float32, finite, lower is better; cells with d > x take no part
    names : of measures

    Returns
    -------
    name -> (H, W) float32, larger is surer, in the order of ``names``

    Raises
    ------
    ValueError
        A name is unknown, or the costs are no volume.
    """
    if costs.ndim != 3 or 0 in costs.shape:
        raise ValueError(f"want costs (H, W, D), got {costs.shape}")
    valid = np.minimum(np.arange(1, costs.shape[1] + 1, dtype=np.int32), costs.shape[2])
    curves = CostCurves(costs, np.broadcast_to(valid, costs.shape[:2]))
    chosen = {name: cast(ConfidenceMeasure, _FAMILY.load(measure_name(name))()) for name in dict.fromkeys(names)}
    return {name: measure(curves) for name, measure in chosen.items()}
