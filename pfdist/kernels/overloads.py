"""Replacements in formulas for elementary functions of NumPy and the standard library."""

import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from pfdist.kernels import elementary
from pfdist.kernels.melting import MELTING


def _in_the_place_of(original: np.ufunc, scalar: Callable[..., Any]) -> Callable[..., Any]:
    """A function that compiles to `scalar` on numbers and to NumPy's own on arrays."""
    arguments = inspect.signature(scalar).parameters  # the names must be the same
    names = ", ".join(arguments)
    floats = ", ".join(f"float64({name})" for name in arguments)
    scope: dict[str, Any] = {"scalar": scalar, "original": original, "float64": np.float64}
    source = (
        f"def stub({names}):\n    return original({names})\n"
        f"def on_numbers({names}):\n    return scalar({floats})\n"
        f"def on_arrays({names}):\n    return original({names})\n"
        "def chosen(kinds):\n"
        "    on_any_numbers = scalar if are_floats(kinds) else on_numbers\n"
        "    return on_any_numbers if all(map(is_number, kinds)) else on_arrays\n"
        f"def overloaded({names}):\n    return chosen(({names},))\n"
    )
    scope["is_number"] = lambda kind: isinstance(kind, types.Float | types.Integer | types.Boolean)
    scope["are_floats"] = lambda kinds: all(kind == types.float64 for kind in kinds)
    exec(source, scope)  # noqa: S102  the source above depends on a number only
    overload(scope["stub"], jit_options=MELTING)(scope["overloaded"])
    return scope["stub"]


ELEMENTARY: dict[str, Callable[..., Any]] = {
    function.__name__: _in_the_place_of(function, scalar)
    for function, scalar in (
        (np.sin, elementary.sin),
        (np.cos, elementary.cos),
        (np.tan, elementary.tan),
        (np.exp, elementary.exp),
        (np.expm1, elementary.expm1),
        (np.log, elementary.log),
        (np.log1p, elementary.log1p),
        (np.log2, elementary.log2),
        (np.log10, elementary.log10),
        (np.sinh, elementary.sinh),
        (np.cosh, elementary.cosh),
        (np.tanh, elementary.tanh),
        (np.arcsin, elementary.arcsin),
        (np.arccos, elementary.arccos),
        (np.arctan, elementary.arctan),
        (np.arctan2, elementary.arctan2),
        (np.hypot, elementary.hypot),
    )
}
"""Replacements for NumPy's functions in formulas, by their names."""


def log_to_base(x: Any, base: Any = None) -> Any:
    """Replace `math.log`."""
    return math.log(x) if base is None else math.log(x, base)


@overload(log_to_base, jit_options=MELTING)
def _log_to_base_compiled(x, base=None):
    log = ELEMENTARY["log"]
    if isinstance(base, types.NoneType | types.Omitted) or base is None:
        return lambda x, base=None: log(x)
    return lambda x, base=None: log(x) / log(base)
