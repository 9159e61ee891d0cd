"""Terms of confidence measures on cost curves, over disparities (stereo) and over displacements (registration)."""

from __future__ import annotations

import numpy as np

from depthcli.kernels.exponential import exp_minus
from depthcli.kernels.jit import jit


@jit
def likelihood(distance):
    """Return exp(-2 t), a candidate's term of the maximum likelihood measure (Hu and Mordohai, PAMI 2012).

    ``t`` is the ``distance`` >= 0 of the candidate's cost from the smallest one.
    """
    return exp_minus(np.float32(2.0) * distance)


@jit
def attainable_likelihood(distance):
    """Return exp(-8 t^2), a candidate's term of the attainable maximum likelihood (Hu and Mordohai, PAMI 2012).

    ``t`` is the ``distance`` of the candidate's cost from the smallest one.
    """
    return exp_minus(np.float32(8.0) * distance * distance)


@jit
def peak_ratio(lowest, second, eps):
    """Return the ratio of a curve's ``second`` cost to its ``lowest`` one; ``eps`` > 0 avoids a division by 0.

    Which cost is the second one is the measure's choice: that of another minimum, or the second smallest of all.
    """
    return (second + eps) / (lowest + eps)
