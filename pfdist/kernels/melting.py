"""Functions that exist only inlined into the compiled functions that call them.

Numba usually optimises each function on its own, translates it to machine code, and adds entry
points for Python and C. A function that is inlined into all its callers needs none of this, because
each caller is optimised as a whole. Without this work a filter compiles in at most 0.6 of the time.
"""

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

from numba import njit
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import register_jitable

_CONSTANTS = "NumbaEnv"  # in the name of the variable that holds their address


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """The library of a function that is only inlined: its module is linked, and nothing else."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self._finalized = self._translated = False

    def _optimize_final_module(self) -> None:
        """Do nothing: the callers are optimised."""

    def _finalize_final_module(self) -> None:
        """Translate to machine code only functions that use their constants in Python's memory.

        Numba writes the address of these constants into the machine code. Formulas that print, or
        raise an error with a value, use them.
        """
        self._translated = any(_CONSTANTS in str(each) for each in self._final_module.functions)
        if self._translated:
            super()._finalize_final_module()
        else:
            self._finalize_dynamic_globals()
            self._finalized = True

    @property
    def codegen(self) -> Any:
        """The object that receives the address of the constants."""
        return super().codegen if self._translated else _NoCode


class _NoCode:
    @staticmethod
    def set_env(name: str, constants: Any) -> None:
        """Do nothing."""


class _Melting(Compiler):  # type: ignore[misc]
    """A compiler of functions that are only inlined."""

    def define_pipelines(self) -> Any:
        library = _Library(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        library.enable_object_caching()  # as Numba's own
        self.state.library = library
        return super().define_pipelines()


# A call that is not inlined stops vectorisation, and takes 15 times the time.
_STANDING = {"forceinline": True, "nogil": True}
MELTING = {
    **_STANDING,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "pipeline_class": _Melting,
}
"""Numba's options for a function that is only inlined."""

inlined = register_jitable(**MELTING)
"""Decorator of a function that is written once and used twice: inlined into compiled code, and
unchanged on NumPy arrays."""


class Melted:
    """A function that is inlined into compiled functions, with options of `numba.njit`.

    Python calls a copy that is compiled on its own.
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        self.py_func = function
        self._options = options
        self._melting = njit(function, **MELTING | options)
        self._numba_type_ = self._melting._numba_type_  # so Numba treats the object as a function

    @cached_property
    def _standing(self) -> Any:
        return njit(self.py_func, **_STANDING, **self._options)

    def __call__(self, *arguments: Any) -> Any:
        """Call the copy."""
        return self._standing(*arguments)


melted = partial(Melted, error_model="numpy")
"""Decorator of a function for compiled code only; it divides by zero as NumPy does."""
