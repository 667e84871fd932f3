"""Functions of a model's author, compiled by Numba with checks.

Numba compiles ``x[i]`` without looking whether i lies in the array, and ``a + b`` without looking
whether the sum fits 64 bits. A mistake in a formula would then give a wrong number, or read foreign
memory. So this room makes a compiler that adds checks. An error names the formula, the line and the
instant.

Numba compiles a function in four steps, and three of them are extended here:

1. It translates the function's bytecode into statements, its intermediate representation (IR).
2. It finds the type of every variable.
3. It *lowers* each statement: it emits LLVM instructions for it, through a class ``Lower`` with a
   method for each kind of statement. `lowering.py` inherits from this class and emits a check in
   front of each statement that can go wrong. `integers.py` holds the checks of integer arithmetic,
   `arrays.py` those of indices and shapes.
4. LLVM translates the instructions into machine code. Checks that cannot fail disappear here.

================ =================================================================================
`guarded.py`     The compiler: Numba's passes, with the checked lowering in place of its own.
`lowering.py`    The lowering of each kind of statement, and the context of a compilation.
`errors.py`      How machine code returns an error: Numba's calling convention, extended by the
                 formula, the line and the instant. Every compiled function returns a status code;
                 the caller tests the code and returns it to its own caller.
`admitted.py`    Which functions of others may be called: those compiled with checks, and Numba's.
`in_place.py`    Compiled functions that a formula calls are recompiled with checks, where they are.
`reached.py`     All functions that a formula reaches.
================ =================================================================================

This room knows neither models nor filters. `pfdist.kernels` compiles formulas with `Guarded`.
`pfdist.models` asks for the checks of the author's own compiled functions.
"""

from pfdist.jitted.admitted import admit
from pfdist.jitted.errors import UNWRAPPED, InCallError
from pfdist.jitted.guarded import Guarded
from pfdist.jitted.in_place import guard_what_it_calls
from pfdist.jitted.reached import is_library, names_in, reached

__all__ = [
    "UNWRAPPED",
    "Guarded",
    "InCallError",
    "admit",
    "guard_what_it_calls",
    "is_library",
    "names_in",
    "reached",
]
