"""A model's formulas as compiled functions that melt into the loop that calls them."""

import contextlib
import inspect
import math
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

import pfdist.elementwise  # noqa: F401  how Numba is to take what formulas may call
from pfdist.errors import CompileError, ModelError, PfdistError
from pfdist.jitted import Guarded, InCallError, admit, is_library, names_in
from pfdist.kernels.choices import CHOICES
from pfdist.kernels.compile_errors import NOT_COMPILED, reason_of
from pfdist.kernels.melting import melted
from pfdist.kernels.overloads import ELEMENTARY, log_to_base
from pfdist.mistakes.endings import is_interrupt, kept_alive, told
from pfdist.mistakes.places import frames_of, is_a_models, place_of
from pfdist.mistakes.remedies import remedy

__all__ = ["formula", "formulas_of", "is_ours", "names_in"]

admit(*ELEMENTARY.values(), log_to_base, *CHOICES.values())


def formula(function: Callable[..., Any], name: str = "") -> Callable[..., Any]:
    """Compile a formula.

    Functions it calls by their own names are compiled with it, and NumPy's elementary functions
    are those of `pfdist.kernels.overloads`. A float divided by zero gives inf or nan as in NumPy:
    a branch to raise would stop vectorisation. Indices and integers are checked, see
    `pfdist.jitted.guarded`.

    Parameters
    ----------
    function : callable
    name : str
        Name of the formula in errors; by default the function's name.
    """
    return _compiled(function, name or function.__name__, ())


def _compiled(
    function: Callable[..., Any], name: str, callers: tuple[Callable[..., Any], ...]
) -> Callable[..., Any]:
    seen = _seeing(function, name, (*callers, function))
    # It may make arrays, which the filter it melts into cannot.
    return melted(seen, Guarded, _nrt=True)


def _seeing(
    function: Callable[..., Any], name: str, callers: tuple[Callable[..., Any], ...]
) -> Callable[..., Any]:
    """The same function, seeing what can be compiled where it sees what its author wrote.

    A function that calls itself stays as it is written, and Numba refuses it: it might never end.
    """
    scope, names = function.__globals__, names_in(function.__code__)
    modules: dict[int, types.ModuleType] = {}

    def seen(value: Any) -> Any:
        if isinstance(value, CPUDispatcher):  # compiled by its author: here as a formula is
            value = value.py_func
        if isinstance(value, types.FunctionType) and value not in callers:
            return value if is_ours(value) else _compiled(value, name, callers)
        if type(value) is tuple:
            return tuple(map(seen, value))
        if isinstance(value, types.ModuleType) and not is_library(value.__name__):
            return seen_in(value)
        return _INSTEAD.get(id(value), value)

    def seen_in(module: types.ModuleType) -> types.ModuleType:
        if id(module) not in modules:
            modules[id(module)] = copy = _replaced(module, {})
            own = vars(module)
            copy.__dict__.update({key: seen(own[key]) for key in names if key in own})
        return modules[id(module)]

    used = {key: seen(scope[key]) for key in names if key in scope}
    cells = [types.CellType(seen(cell.cell_contents)) for cell in function.__closure__ or ()]
    # Its module's name would be kept with the compiled code, and be unknown to another process.
    compilable: Any = types.FunctionType(
        function.__code__,
        scope | used | {"__name__": __name__},
        name,
        function.__defaults__ and tuple(map(seen, function.__defaults__)),
        tuple(cells),
    )
    compilable.__qualname__ = name
    compilable.takes_t = len(callers) == 1 and "t" in inspect.signature(function).parameters
    return compilable


def is_ours(function: types.FunctionType) -> bool:
    """Whether a function is pfdist's own, which is compiled in its own way."""
    module = str(function.__globals__.get("__name__"))
    return module == "pfdist.elementwise" or module.startswith("pfdist.kernels.")


def _replaced(module: types.ModuleType, others: Mapping[str, Any]) -> types.ModuleType:
    copy = types.ModuleType(module.__name__)
    copy.__dict__.update({**module.__dict__, **others})
    return copy


_MATH = {name.replace("arc", "a"): function for name, function in ELEMENTARY.items()}
_MATH["log"] = log_to_base
_NUMPY = {**ELEMENTARY, **CHOICES}
_INSTEAD: dict[int, Any] = {
    id(np): _replaced(np, _NUMPY),
    id(math): _replaced(math, _MATH),
    **{id(getattr(np, name)): function for name, function in _NUMPY.items()},
    **{id(getattr(math, name)): function for name, function in _MATH.items()},
}
"""What a formula gets in place of a module or function, by the identity of the latter."""


# --- what goes wrong in them --------------------------------------------------------------------


@contextlib.contextmanager
def formulas_of(model: str, formulas: Mapping[str, Callable[..., Any]]) -> Iterator[None]:
    """Turn what goes wrong in a model's formulas into one line.

    Parameters
    ----------
    model : str
        The model's name.
    formulas : mapping of str to callable
        The model's formulas by their names.

    Raises
    ------
    CompileError
        A formula cannot be compiled, with the reason and the line at fault.
    ModelError
        A formula raised, with the formula's name, the instant if it is known, and the line.
    """
    try:
        with kept_alive():
            yield
    except NOT_COMPILED as error:
        raise CompileError(
            f"model {model} cannot be compiled by Numba: {reason_of(error)}; formulas may use "
            "operators, NumPy's elementwise functions on numbers, pfdist.where and pfdist.clip"
        ) from error
    except (MemoryError, PfdistError):
        raise
    except BaseException as error:  # a formula may raise whatever it likes
        name, instant = _formula_at_fault(error, formulas)
        message, ending = _message_and_ending(error)
        if not message:
            raise
        at = f" at t = {instant}" if instant is not None and " at t = " not in message else ""
        raise ModelError(f"model {model}: {name} failed: {message}{at}{ending}") from error


def _formula_at_fault(
    error: BaseException, formulas: Mapping[str, Callable[..., Any]]
) -> tuple[str, int | None]:
    """Name of the formula that an error passed through, and t in it where it is known."""
    instant = error.t if isinstance(error, InCallError) else None
    names = {function.__code__: name for name, function in formulas.items()}
    for frame, _ in frames_of(error):
        name = names.get(frame.f_code, frame.f_code.co_name)  # compiled code tells it by its name
        if name in formulas:
            return name, instant if instant is not None else frame.f_locals.get("t")
    return "a formula", instant


def _message_and_ending(error: BaseException) -> tuple[str, str]:
    """The error of a formula; what to write instead, and where. Empty if no formula raised it.

    Only text is returned: a local variable that holds the error would keep the filter's arrays
    alive, by way of the error's traceback.
    """
    cause, place = _cause_of(error)
    if is_interrupt(cause) or not (isinstance(error, Exception) or place):
        return "", ""
    return told(cause), f"{remedy(cause)}{place}"


def _cause_of(error: BaseException) -> tuple[BaseException, str]:
    """The error that was raised first, and its innermost place in a model as `` (file:line)``."""
    if not isinstance(error, InCallError):
        return error, place_of(error)
    layers = list(error.layers())
    places = [place_of(error)]
    places += [f" ({at[1]}:{at[2]})" for _, _, at in layers if at and is_a_models(at[1])]
    kind, arguments, _ = layers[-1]
    return kind(*arguments), places[-1]
