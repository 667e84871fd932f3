"""The pieces from which the simulation and the filter are fused: noise, weights, resampling.

This room uses only NumPy and Numba, and knows no model. Noise and weights are written once and used
twice: compiled for one value at a time, and unchanged on NumPy arrays. Every other compiled
function is tested against a plain twin or against NumPy's own function.
"""

import os

from pfdist.errors import CompileError, shown

_without = os.environ.get("NUMBA_DISABLE_JIT", "")
if _without not in ("", "0"):
    raise CompileError(
        "the environment variable NUMBA_DISABLE_JIT must be 0 or unset, because filters are "
        f"compiled, got {shown(_without)}"
    )
