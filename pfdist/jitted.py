"""Functions that a model's author has compiled with Numba, as a formula's helpers."""

from types import CodeType, FunctionType
from typing import Any

from numba.core.registry import CPUDispatcher


def check_bounds_in(function: Any) -> None:
    """Have Numba check the indices in all compiled functions that a function calls.

    Without it they read memory that is not theirs, also where Python calls them.
    """
    waiting, seen = [function], set()
    while waiting:
        value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, CPUDispatcher):
            if not value.targetoptions.get("boundscheck"):
                value.targetoptions["boundscheck"] = True
                value.recompile()
            value = value.py_func
        if isinstance(value, FunctionType):
            names = _names_in(value.__code__)
            waiting += [found for name, found in value.__globals__.items() if name in names]
            waiting += [cell.cell_contents for cell in value.__closure__ or () if _is_full(cell)]


def _names_in(code: CodeType) -> set[str]:
    inner = [_names_in(part) for part in code.co_consts if isinstance(part, CodeType)]
    return set(code.co_names).union(*inner)


def _is_full(cell: Any) -> bool:
    try:
        cell.cell_contents  # noqa: B018  it raises where a function inside is not defined yet
    except ValueError:
        return False
    return True
