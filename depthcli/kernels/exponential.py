"""Accurate and fast exponentials in single precision; unlike the C library's, the compiler can vectorize them."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import intrinsic, jit, types


def _bits_as(source: Any, target: Any) -> Any:
    # Return an intrinsic that reinterprets the bits of a ``source`` as a ``target``.

    def cast(typingctx: Any, value: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.bitcast(args[0], context.get_value_type(signature.return_type))

        return (target(source), codegen) if value == source else None

    return intrinsic(cast)


float_bits = _bits_as(types.float32, types.int32)
bits_float = _bits_as(types.int32, types.float32)


@jit
def exp_minus(x):
    """Return exp(-x) of a float32 x >= 0, relative error below 1e-6; x above 80 counts as 80."""
    x = min(x, np.float32(80.0)) * np.float32(-1.4426950408889634)
    whole = np.int32(x)
    t = (x - np.float32(whole)) * np.float32(0.6931471805599453)
    # Taylor series of exp on (-0.694, 0]
    p: Any = np.float32(1.0 / 5040.0)
    p = p * t + np.float32(1.0 / 720.0)
    p = p * t + np.float32(1.0 / 120.0)
    p = p * t + np.float32(1.0 / 24.0)
    p = p * t + np.float32(1.0 / 6.0)
    p = p * t + np.float32(0.5)
    p = p * t + np.float32(1.0)
    p = p * t + np.float32(1.0)
    return p * bits_float(np.int32((whole + np.int32(127)) << np.int32(23)))


@jit
def exp_minus_16(z):
    """Return exp(-16 z) of a float32 z >= 0, absolute error below 1e-4; z above 1 counts as 1.

    Computed as the 16th power of a cubic, the Taylor polynomial of exp(-z).
    """
    half, sixth, one = np.float32(0.5), np.float32(1.0 / 6.0), np.float32(1.0)
    z = z if z < one else one
    power = one - z * (one - z * (half - z * sixth))
    power *= power
    power *= power
    power *= power
    power *= power
    return power


# Terms of confidence measures on cost curves, over disparities (stereo) and over displacements (registration).


@jit
def likelihood(distance):
    """Return exp(-2 t), a candidate's term of the maximum likelihood measure (Hu and Mordohai, PAMI 2012).

    ``t`` is the ``distance`` >= 0 of the candidate's cost from the smallest cost.
    """
    return exp_minus(np.float32(2.0) * distance)


@jit
def attainable_likelihood(distance):
    """Return exp(-8 t^2), a candidate's term of the attainable maximum likelihood (Hu and Mordohai, PAMI 2012).

    ``t`` is the ``distance`` of the candidate's cost from the smallest cost.
    """
    return exp_minus(np.float32(8.0) * distance * distance)
