"""Recompile, with checks, the functions that a model's author compiled with Numba.

The functions keep their identity: Python and other compiled code find the new machine code in the
same object.
"""

from typing import Any

from numba.core import sigutils
from numba.core.caching import NullCache
from numba.core.compiler import compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import ConfigStack
from numba.np.ufunc.dufunc import DUFunc
from numba.np.ufunc.ufuncbuilder import (
    UFuncDispatcher,
    _build_element_wise_ufunc_wrapper,
    parse_identity,
)

from pfdist.jitted.admitted import MARK, is_checked
from pfdist.jitted.guarded import Guarded
from pfdist.jitted.reached import COMPILED, reached


def guard_what_it_calls(function: Any) -> None:
    """Recompile with checks all compiled functions that a function reaches.

    Without checks they may read foreign memory, also if Python calls them.
    """
    for value in reached(function):
        if isinstance(value, COMPILED) and not is_checked(value):
            _guard(value)


def _guard(value: Any) -> None:
    if isinstance(value, CPUDispatcher):
        value.targetoptions["boundscheck"] = True
        value._cache = NullCache()  # the old cache may hold code without checks
        value._compiler.pipeline_class = Guarded
        value.recompile()
    elif isinstance(value, DUFunc):
        _guard_dufunc(value)
    else:
        _guard_gufunc(value)


class _Elementwise(UFuncDispatcher):  # type: ignore[misc]
    """Numba's compiler of elementwise functions, with checks."""

    @global_compiler_lock
    def _compile_core(self, sig, flags, locals):  # noqa: A002  Numba's name
        target = self.targetdescr
        arguments, return_type = sigutils.normalize_signature(sig)
        with ConfigStack().enter(flags.copy()):
            result = compile_extra(
                target.typing_context, target.target_context, self.py_func, args=arguments,
                return_type=return_type, flags=flags, locals=locals, pipeline_class=Guarded,
            )  # fmt: skip
        if self.overloads.get(result.signature) is None:
            self.overloads[result.signature] = result
        return result


setattr(_Elementwise, MARK, True)


def _guard_dufunc(value: Any) -> None:
    """Replace the inner function of a vectorized function, and compile it for the same types."""
    before = value._dispatcher
    guarded = _Elementwise(before.py_func, before.locals, before.targetoptions)
    identity = "reorderable" if value.reorderable and value.identity is None else value.identity
    # Numba already knows the object's name and type; only the inner function changes.
    super(DUFunc, value).__init__(guarded, identity=parse_identity(identity))
    value._lower_me.libs.clear()
    for signature in before.overloads:  # like `DUFunc.add`, which refuses if the types are fixed
        result = guarded.compile(signature)
        kinds, address, environment = _build_element_wise_ufunc_wrapper(result, signature)
        value._add_loop(int(address), kinds)
        value._keepalive.append((address, result.library, environment))
        value._lower_me.libs.append(result.library)


def _guard_gufunc(value: Any) -> None:
    builder = value.gufunc_builder
    before = builder.nb_func
    builder.nb_func = _Elementwise(before.py_func, before.locals, before.targetoptions)
    signatures, builder._sigs, builder._cres = builder._sigs, [], {}
    for signature in signatures:
        builder.add(signature)
    if signatures:
        value.ufunc = builder.build_ufunc()
