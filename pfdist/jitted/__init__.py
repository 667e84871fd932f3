"""What a model's author compiles with Numba, compiled with checks.

Nothing here knows a model or a filter: `pfdist.kernels` compiles formulas with `Guarded`, and
`pfdist.models` has the author's own compiled functions checked, wherever a formula reaches them.
"""

from pfdist.jitted.admitted import admit
from pfdist.jitted.errors import UNWRAPPED, InCallError
from pfdist.jitted.guarded import Guarded
from pfdist.jitted.in_place import guard_what_it_calls
from pfdist.jitted.reached import is_library, names_in

__all__ = [
    "UNWRAPPED",
    "Guarded",
    "InCallError",
    "admit",
    "guard_what_it_calls",
    "is_library",
    "names_in",
]
