"""A model's formulas as compiled functions that melt into the loop that calls them."""

import contextlib
import math
import re
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

import pfdist.elementwise  # noqa: F401  how Numba is to take what formulas may call
from pfdist.errors import CompileError, ModelError, PfdistError
from pfdist.kernels.melting import melted
from pfdist.kernels.multiply_add import MultiplyAdd
from pfdist.kernels.overloads import ELEMENTARY, log_to_base


def formula(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a formula.

    Functions it calls by their own names are compiled with it, and NumPy's elementary functions
    are those of `pfdist.kernels.overloads`. Division by zero gives inf or nan as in NumPy: a
    branch to raise would stop vectorisation.
    """
    return melted(_seeing(function), passes=(MultiplyAdd,))


def _seeing(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, seeing what can be compiled where it sees what its author wrote."""

    def seen(value: Any) -> Any:
        if isinstance(value, types.FunctionType) and value is not function:
            return value if is_ours(value) else formula(value)
        return _INSTEAD.get(id(value), value)

    scope = function.__globals__
    used = {name: seen(scope[name]) for name in names_in(function.__code__) if name in scope}
    cells = [types.CellType(seen(cell.cell_contents)) for cell in function.__closure__ or ()]
    # Its module's name would be kept with the compiled code, and be unknown to another process.
    return types.FunctionType(
        function.__code__,
        scope | used | {"__name__": __name__},
        function.__name__,
        function.__defaults__,
        tuple(cells),
    )


def is_ours(function: types.FunctionType) -> bool:
    """Whether it is one of those that a formula may call and that know how they are compiled."""
    module = str(function.__globals__.get("__name__"))
    return module == "pfdist.elementwise" or module.startswith("pfdist.kernels.")


def names_in(code: types.CodeType) -> set[str]:
    """Names of globals and attributes in a function and in those it defines."""
    inner = [
        names_in(constant) for constant in code.co_consts if isinstance(constant, types.CodeType)
    ]
    return set(code.co_names).union(*inner)


def _replaced(module: types.ModuleType, by: Mapping[str, Any]) -> types.ModuleType:
    copy = types.ModuleType(module.__name__)
    copy.__dict__.update({**module.__dict__, **by})
    return copy


_MATH = {name.replace("arc", "a"): function for name, function in ELEMENTARY.items()}
_MATH["log"] = log_to_base
_INSTEAD: dict[int, Any] = {
    id(np): _replaced(np, ELEMENTARY),
    id(math): _replaced(math, _MATH),
    **{id(getattr(np, name)): function for name, function in ELEMENTARY.items()},
    **{id(getattr(math, name)): function for name, function in _MATH.items()},
}
"""By its identity, what a formula sees instead of a module or function that it names."""


# --- what goes wrong in them --------------------------------------------------------------------

_NOT_THEIRS = re.compile(r"(^|/)(numba/|pfdist/(kernels/|models/base\.py|draws\.py))")
_REASON = re.compile(
    r"^.*(?:Untyped global name|No implementation of function|Unknown attribute|Cannot|cannot"
    r"|Invalid use|Use of unsupported).*$",
    re.MULTILINE,
)


@contextlib.contextmanager
def formulas_of(model: str) -> Iterator[None]:
    """Turn what goes wrong in a model's formulas into one line.

    Raises
    ------
    CompileError
        A formula cannot be compiled, with the reason and the line at fault.
    ModelError
        A formula raised.
    """
    try:
        yield
    except NumbaError as error:
        text = str(error)
        reason = (_REASON.findall(text) or text.strip().splitlines())[0].strip()
        places = re.findall(r'File "(.*?)", line (\d+)', text)
        own = [f"{file}:{line}" for file, line in places if not _NOT_THEIRS.search(file)]
        place = f" ({own[0]})" if own else ""
        raise CompileError(
            f"model {model} cannot be compiled by Numba: {reason}{place}; formulas may use "
            "operators, NumPy's elementwise functions on numbers, pfdist.where and pfdist.clip"
        ) from error
    except (MemoryError, PfdistError):
        raise
    except Exception as error:  # a formula may raise whatever it likes
        raise ModelError(
            f"model {model}: a formula failed: {type(error).__name__}: {error}"
        ) from error
