"""Bit counting that compiles to the processor's own instruction."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from depthcli.kernels.jit import intrinsic, types


@intrinsic
def popcount(typingctx: Any, value: Any) -> Any:
    """Number of set bits of an unsigned integer (LLVM ``ctpop``; vectorizes)."""
    if not isinstance(value, types.Integer):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = ir.IntType(signature.args[0].bitwidth)
        function = builder.module.declare_intrinsic("llvm.ctpop", [kind])
        return builder.call(function, args)

    return value(value), codegen
