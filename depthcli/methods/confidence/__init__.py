"""Confidence of the best match of a cost curve: one file per measure; larger values are surer in every one.

In: a cost volume (H, W, D) of stereo, to :func:`confidence_maps`; or curves over any search space, to
:class:`CostCurves`. Out: one float32 per curve, (H, W) for a volume. One pass over all curves computes their statistics
(``_curves``), and most measures are a short formula of these. Others look at further pixels: ``apkr`` and ``da`` want
one curve per pixel, costs (H, W, K) over any search space; ``lrc``, ``lrd`` and ``dap`` want a stereo volume.

A curve has costs ``c``:

- ``c1`` is the smallest cost, at ``d1``;
- ``c2`` is the next smallest cost anywhere;
- ``c2m`` is the second smallest local minimum, at ``d2m``; in a curve without one, the largest cost;
- ``s`` is the standard deviation of all costs of the volume.

Ranges hold for costs >= 0.

| name | full name | formula | range |
|---|---|---|---|
| ``msm`` | matching score | -c1 | <= 0, costs |
| ``cur`` | curvature | c(d1 - 1) + c(d1 + 1) - 2 c1 | >= 0, costs |
| ``mm`` | maximum margin | c2m - c1 | >= 0, costs |
| ``mmn`` | naive maximum margin | c2 - c1 | >= 0, costs |
| ``pkr`` | peak ratio | c2m / c1 | >= 1 |
| ``pkrn`` | naive peak ratio | c2 / c1 | >= 1 |
| ``apkr`` | average peak ratio | mean of c(d2m) / c(d1) in 5 x 5 pixels; 1 where there is no d2m | > 0 |
| ``wmn`` | winner margin | (c2m - c1) / sum of c | 0 .. 1 |
| ``wmnn`` | naive winner margin | (c2 - c1) / sum of c | 0 .. 1 |
| ``mlm`` | maximum likelihood | 1 / sum of exp(-2 (c - c1) / s) | 0 .. 1 |
| ``aml`` | attainable maximum likelihood | 1 / sum of exp(-8 ((c - c1) / s)^2) | 0 .. 1 |
| ``nem`` | negative entropy | sum of p log p, p = softmax(-4 c / s) | -log D .. 0 |
| ``noi`` | number of inflections (Hu and Mordohai's name) | -(number of local minima of the smoothed curve) | <= -1 |
| ``lrc`` | left-right consistency | -abs(d1 - disparity of its match in the right view) | <= 0, pixels |
| ``lrd`` | left-right difference | (c2 - c1) / (c1 - smallest cost of the right pixel) | >= 0 |
| ``da`` | disparity agreement | share of 25 x 25 pixels within 1 pixel of d1 | 0 .. 1 |
| ``dap`` | disparity agreement and peak | agreement in both views, 13 x 13, times sqrt(1 - 1 / apkr) | 0 .. 1 |

Sources: Hu and Mordohai, "A quantitative evaluation of confidence measures for stereo vision", TPAMI 2012; ``apkr``:
Kim et al. 2014. A ratio of two costs has 1e-3 of the mean cost added to both of them; where only the denominator could
be zero, it is added to the denominator.
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
"""One value per curve, in the shape of the curves."""

_FAMILY = Family("depthcli.methods.confidence")


class ConfidenceMeasure(Method):
    """One number per cost curve; the first paragraph of a measure's docstring is its line in the documentation."""

    @abstractmethod
    def __call__(self, curves: CostCurves) -> Map:
        """Return the measure in the shape of the curves; the table above says which measures want certain shapes."""


def measures() -> dict[str, str]:
    """Return the name of every measure and one line about it."""
    return {name: " ".join((_FAMILY.load(name).__doc__ or "").split("\n\n")[0].split()) for name in _FAMILY.names()}


def measure_name(name: str, *others: str) -> str:
    """Return the name of the measure, or of ``others``, that ``name`` stands for in any case.

    Raises
    ------
    ValueError
        It is neither a measure nor in ``others``.
    ConfigError
        It is a plug-in's measure that cannot be loaded.
    """
    if name.lower() in others:
        return name.lower()
    known = _FAMILY.find(name)
    if known is None:
        raise ValueError(f"no confidence measure called {name!r}{_FAMILY.suggestions(name, *others)}")
    _FAMILY.load(known)
    return known


MeasureName = Annotated[str, AfterValidator(measure_name)]
"""A measure as configs name it."""


def confidence_maps(costs: NDArray[Any], names: Iterable[str]) -> dict[str, Map]:
    """Compute measures of a stereo cost volume, all of them together.

    Parameters
    ----------
    costs : (H, W, D) uint8, uint16 or float32, finite, lower is better; cells with d > x are left out
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
