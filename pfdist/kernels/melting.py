"""Functions that melt into the compiled ones that call them.

Numba usually optimises each function by itself, translates it to machine code, and adds entries
for Python and C. A function that melts into its callers needs none of this: each caller optimises
it again. Without this work a filter compiles in 0.6 of the time.
"""

from collections.abc import Callable
from functools import cache, cached_property, partial
from typing import Any

from numba import njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import register_jitable


class _Library(JITCodeLibrary):  # type: ignore[misc]
    def _optimize_final_module(self) -> None:
        """Leave it to the callers."""


@cache
def melting(compiler: type) -> type:
    """Give the same compiler for functions that melt."""

    class Melting(compiler):  # type: ignore[misc]
        def define_pipelines(self) -> Any:
            library = _Library(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
            library.enable_object_caching()  # as Numba's own
            self.state.library = library
            return super().define_pipelines()

    return Melting


# A call left standing stops vectorisation: 15 times the time.
_STANDING = {"forceinline": True, "nogil": True}
MELTING = {
    **_STANDING,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": melting(Compiler),
}
"""How Numba is to take a function that melts."""

inlined = register_jitable(**MELTING)
"""Decorator of a function that is written once and runs twice: melted where compiled code calls it,
and as it stands on NumPy arrays."""


class Melted:
    """A function that compiled ones can call; called from Python it is compiled by itself.

    Parameters
    ----------
    function : callable
    compiler : type
        One of Numba's.
    **options
        Of `numba.njit`.
    """

    def __init__(
        self, function: Callable[..., Any], compiler: type = Compiler, **options: Any
    ) -> None:
        self.py_func = function
        self._options = options | {"pipeline_class": compiler}
        self._melting = njit(function, **MELTING | options | {"pipeline_class": melting(compiler)})
        self._numba_type_ = self._melting._numba_type_  # by which Numba takes it for a function

    @cached_property
    def _standing(self) -> Any:
        return njit(self.py_func, **_STANDING, **self._options)

    def __call__(self, *arguments: Any) -> Any:
        """Compile it as a whole, and call that."""
        return self._standing(*arguments)


melted = partial(Melted, error_model="numpy")
"""Decorator of a function that compiled code alone calls; by zero it divides as NumPy does."""
