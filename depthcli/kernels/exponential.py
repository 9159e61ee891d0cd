"""A single-precision exponential that vectorizes (the C library's does not)."""

from __future__ import annotations

from typing import Any

import numpy as np

from depthcli.kernels.jit import intrinsic, jit, types


def _float_bits(typingctx: Any, value: Any) -> Any:
    """The bits of a float32 as int32."""
    if value != types.float32:
        return None
    signature = types.int32(types.float32)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(sig.return_type))

    return signature, codegen


float_bits: Any = intrinsic(_float_bits)


def _bits_float(typingctx: Any, value: Any) -> Any:
    """The float32 with the given int32 bits."""
    if value != types.int32:
        return None
    signature = types.float32(types.int32)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(sig.return_type))

    return signature, codegen


bits_float: Any = intrinsic(_bits_float)


@jit
def exp_minus(x: Any) -> Any:
    """exp(-x) of a float32 x >= 0, relative error below 1e-6; x above 80 counts as 80."""
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
