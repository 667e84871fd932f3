"""What LLVM has to be told: to inline, to multiply and add at once, which number is larger.

The functions marked `inlined` are written once and run twice: compiled on scalars, and as they
stand on NumPy arrays. This is the only file with LLVM instructions of ours; both are portable.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload, register_jitable

inlined = register_jitable(forceinline=True)  # a call left standing stops vectorisation: 15 times


def fma(a, b, c):
    """``a * b + c``, rounded once.

    One instruction in the place of two, and the same result wherever it runs: a compiler that may
    fuse or not would give other noise on another machine. In plain NumPy float32 only, by way of
    float64, which holds the product exactly: that rounds twice, which would tell in one of 2^29
    cases; of all arguments that noise and weights have, none is such a case.

    Parameters
    ----------
    a, b, c : float32, or arrays of it; compiled also float64
    """
    return np.float32(np.float64(a) * b + c)


@intrinsic
def _llvm_fma(typing_context, a, b, c):
    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return a(a, b, c), generate


@overload(fma, jit_options={"forceinline": True})
def _fma_compiled(a, b, c):
    if a == b == c and a in (types.float32, types.float64):
        return lambda a, b, c: _llvm_fma(a, b, c)  # noqa: PLW0108
    return None


@intrinsic
def _llvm_maxnum(typing_context, a, b):
    def generate(context, builder, signature, arguments):
        kind = arguments[0].type
        signature = ir.FunctionType(kind, [kind, kind])
        function = builder.module.declare_intrinsic("llvm.maxnum", [kind], signature)
        return builder.call(function, arguments, fastmath=("nnan", "nsz"))

    return a(a, b), generate


def larger(a, b):
    """The larger of two floats, neither of them NaN; Python's `max` is not vectorised."""
    return np.maximum(a, b)


@overload(larger, jit_options={"forceinline": True})
def _larger_compiled(a, b):
    return lambda a, b: _llvm_maxnum(a, b)  # noqa: PLW0108
