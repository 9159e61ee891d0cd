"""What measures of cost curves share, whatever the curves are over: disparities or displacements."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit


@jit
def likelihood(distance: Any) -> Any:
    """exp(-2 t), t >= 0: distance from the smallest cost in deviations (maximum likelihood, Hu & Mordohai 2012)."""
    return exp_minus(np.float32(2.0) * distance)


@jit
def attainable_likelihood(distance: Any) -> Any:
    """exp(-8 t^2): the same where the smallest cost is the best attainable one (Hu & Mordohai 2012)."""
    return exp_minus(np.float32(8.0) * distance * distance)


@jit
def peak_ratio(lowest: Any, second: Any, eps: Any) -> Any:
    """Second smallest cost over the smallest one; ``eps`` guards the ratio."""
    return (second + eps) / (lowest + eps)
