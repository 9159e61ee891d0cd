"""Confidence terms of cost curves, shared by curves over disparities and over displacements."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit


@jit
def likelihood(distance: Any) -> Any:
    """Return exp(-2 t), t >= 0 the distance from the smallest cost (maximum likelihood, Hu & Mordohai 2012)."""
    return exp_minus(np.float32(2.0) * distance)


@jit
def attainable_likelihood(distance: Any) -> Any:
    """Return exp(-8 t^2), the likelihood if the smallest cost is the attainable one (Hu & Mordohai 2012)."""
    return exp_minus(np.float32(8.0) * distance * distance)


@jit
def peak_ratio(lowest: Any, second: Any, eps: Any) -> Any:
    """Return the ratio of the second smallest cost to the smallest one; ``eps`` avoids a division by 0."""
    return (second + eps) / (lowest + eps)
