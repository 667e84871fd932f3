"""The rule which functions a formula may call: checked, admitted and library functions.

The checks are those of `pfdist.jitted.guarded`: indices, integers that do not fit, division by 0.
"""

import sys
from collections.abc import Iterable, Iterator
from typing import Any

from numba.core import types
from numba.core.typing.templates import FunctionTemplate
from numba.np.ufunc.gufunc import GUFunc

from pfdist.jitted.reached import COMPILED, is_library, python_function

MARK = "pfdist_checks"
"""Name of the attribute by which a compiler says that it adds checks."""

_admitted: set[int] = set()


def admit(*functions: Any) -> None:
    """Allow calls of functions whose code `numba.extending.overload` provides."""
    _admitted.update(map(id, functions))


def unchecked(function: Any, signature: Any) -> str | None:
    """Give the name of the first function in a call that has no checks, or None.

    Parameters
    ----------
    function : Numba's type of a function, or an operation
    signature : Numba's signature of the call
    """
    if not isinstance(function, types.Type):
        return None
    if isinstance(function, types.ClassType):  # type: ignore[attr-defined]
        return f"the jitclass {function.class_name}"
    if isinstance(function, types.Dispatcher):
        return None if is_checked(function.dispatcher) else _told(function.dispatcher)
    kinds = signature.args
    found = [*_templates(function, kinds), *_functions_in((*kinds, signature.recvr))]
    return next((name for name in map(_name_if_unchecked, found) if name), None)


def is_checked(compiled: Any) -> bool:
    """Whether a function has checks, or belongs to Python, a known library or pfdist."""
    if _is_library_function(python_function(compiled)):
        return True
    return getattr(compiler_of(compiled), MARK, False)


def compiler_of(compiled: Any) -> Any:
    """Give the compiler class of a compiled function."""
    compiler = getattr(compiled, "_compiler", None)
    if compiler is not None:
        return compiler.pipeline_class
    builder = getattr(compiled, "gufunc_builder", None)
    return type(builder.nb_func if builder else compiled._dispatcher)


def _templates(function: Any, kinds: tuple[Any, ...]) -> Iterator[Any]:
    """Give Numba's templates that may provide the code for arguments of these types."""
    if isinstance(function, types.BoundFunction):
        yield function.template
        return
    for template in getattr(function, "templates", ()):
        compiled = getattr(template, "_compiled_overloads", None)
        if compiled is None or kinds in compiled:
            yield template


def _functions_in(kinds: Iterable[Any]) -> Iterator[Any]:
    """Give the functions, or their templates, among the arguments of a call."""
    for kind in kinds:
        if isinstance(kind, types.BaseTuple):  # type: ignore[attr-defined]
            yield from _functions_in(kind)
        elif isinstance(kind, types.Dispatcher):
            yield kind.dispatcher
        elif isinstance(getattr(kind, "value", None), COMPILED):  # a default argument
            yield kind.value
        elif isinstance(kind, types.Function):
            yield from kind.templates


def _name_if_unchecked(found: Any) -> str | None:
    if isinstance(found, COMPILED):
        return None if is_checked(found) else _told(found)
    if not (isinstance(found, type) and issubclass(found, FunctionTemplate)):
        return None
    key = getattr(found, "key", None)
    if isinstance(key, GUFunc):  # Numba drops the errors inside its calls
        return _told(key)
    if isinstance(key, COMPILED):
        return None if is_checked(key) else _told(key)
    defined = getattr(found, "_overload_func", None) or getattr(found, "_definition_func", None)
    if defined is None or id(key) in _admitted:
        return None
    wraps = defined.__qualname__.startswith("register_jitable")
    written = key if wraps else defined
    return None if _is_library_function(written) else f"the extension of Numba {_told(written)}"


def _is_library_function(function: Any) -> bool:
    """Whether a function was defined in a library's module; its name alone is no proof."""
    scope = getattr(function, "__globals__", None)
    if scope is None:
        return True
    name = scope.get("__name__")
    module = sys.modules.get(str(name))
    return module is not None and vars(module) is scope and is_library(str(name))


def _told(function: Any) -> str:
    return str(getattr(function, "__name__", None) or python_function(function).__name__)
