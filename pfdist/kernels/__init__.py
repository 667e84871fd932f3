"""The pieces the simulation and the filter are fused from: noise, resampling, components.

Here only NumPy and Numba, and nothing here knows a model. Noise and weights are written once and
run twice, compiled a value at a time and as they stand on NumPy arrays; all else that is compiled
has a plain twin, or NumPy's own function, to be held against.
"""

import os

from pfdist.errors import CompileError, shown

_without = os.environ.get("NUMBA_DISABLE_JIT", "")
if _without not in ("", "0"):
    raise CompileError(
        "the environment variable NUMBA_DISABLE_JIT must be 0 or unset, because filters are "
        f"compiled, got {shown(_without)}"
    )
