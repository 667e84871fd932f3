"""A model's formulas as compiled functions that melt into the loop that calls them."""

import ast
import contextlib
import math
import re
import types
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numba import errors
from numba.extending import is_jitted, overload

import pfdist.elementwise  # noqa: F401  registers the compiled versions of where and clip
from pfdist.common.stopping import check
from pfdist.densities import draws, log_densities, quantiles, special
from pfdist.errors import CompileError, ModelError, PfdistError
from pfdist.kernels.melting import MELTING, melted
from pfdist.kernels.overloads import CHOICES, ELEMENTARY, log_to_base
from pfdist.models.mistakes import (
    advice_on_density,
    advice_on_special,
    error_line,
    frames_of,
    is_interrupt,
    place_of,
    remedy,
)
from pfdist.models.seeing import seeing
from pfdist.models.syntax import Function, node_of

NOT_COMPILED = (errors.NumbaError, errors.UnsupportedBytecodeError)
"""Errors that Numba raises if it cannot compile a function."""

_NOT_THEIRS = re.compile(r"(^|/)(numba/|pfdist/(kernels/|models/(base|seeing)\.py|filters/))")
_REASON_LINE = re.compile(
    r"^.*(?:Untyped global name|No implementation of function|Unknown attribute|Cannot|cannot"
    r"|Invalid use|Use of unsupported|NameError).*$",
    re.MULTILINE,
)
_OPCODE = re.compile(r"unsupported opcode \((\w+)\)")
_OPCODES = {
    "STORE_GLOBAL": "a formula must not assign to a global variable",
    "IMPORT_NAME": "an import stands at the top of the file, not in a formula",
    "LOAD_BUILD_CLASS": "a class is defined at the top of the file, not in a formula",
}
_GLOBAL = re.compile(r"Untyped global name '(\w+)': (.*)")
_RECURSION = "a function that calls itself; write a loop, or the formula out"
_MISSING = re.compile(r"No implementation of function Function\(<(?:(?:built-in )?[a-z]+ )?'?(\w+)")
_SIGNATURE = re.compile(r">>> \w+\((.*)\)")
_OURS = {
    "exception_match": "`except` of one kind of error (`except Exception` it has)",
}
_OF_A_MODULE = re.compile(r"Unknown attribute '(\w+)' of type Module\(<module '([\w.]+)'")
_PLAIN_NUMPY = {
    "piecewise": "; write pfdist.where(condition, a, b), one in another",
    "vectorize": "; write the formula with NumPy's functions",
    "default_rng": "; take randomness from the noise it is given",
}


def reason_of(error: BaseException) -> str:
    """The reason why Numba could not compile, and the user's line: ``what (file:line)``."""
    text = str(error)
    places = re.findall(r'File "(.*?)", line (\d+)', text)
    places += re.findall(r"Raised from (.*?) \((\d+)\)", text)
    own = [f"{file}:{line}" for file, line in places if not _NOT_THEIRS.search(file)]
    return f"{_reason(text)}{f' ({own[0]})' if own else ''}"


def _reason(text: str) -> str:
    for pattern, describe in _REASONS:
        if match := pattern.search(text):
            return describe(match, text)
    lines = _REASON_LINE.findall(text) or [
        line for line in text.splitlines() if line.strip() and "nopython mode" not in line
    ]
    return _plain(lines[0]) if lines else "it does not say why"


def _no_opcode(match: re.Match[str], _: str) -> str:
    return _OPCODES.get(match[1], f"it knows no {match[1]} of Python's bytecode")


def _no_global(match: re.Match[str], _: str) -> str:
    reason = _RECURSION if "function" in match[2] else _plain(match[2])
    kind = re.search(r"(\w+)'>", match[2])
    advice = advice_on_density(kind[1]) if kind and "scipy" in match[2] else ""
    advice = advice_on_special(match[1]) if kind and kind[1] == "ufunc" else advice
    return f"it cannot use {match[1]}, {reason}{advice}"


def _no_function(match: re.Match[str], text: str) -> str:
    kinds = _SIGNATURE.search(text)
    arguments = "" if match[1] == "exception_match" or kinds is None else f" of ({kinds[1]})"
    return f"it has no {_OURS.get(match[1], match[1])}{arguments}"


def _no_attribute(match: re.Match[str], _: str) -> str:
    module = "np" if match[2] == "numpy" else match[2].replace("numpy.", "np.")
    advise = {"scipy.stats": advice_on_density, "scipy.special": advice_on_special}.get(module)
    advice = advise(match[1]) if advise else _PLAIN_NUMPY.get(match[1], "")
    return f"it has no {module}.{match[1]}{advice}"


_REASONS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str], str], str]], ...] = (
    (_OPCODE, _no_opcode),
    (_GLOBAL, _no_global),
    (_MISSING, _no_function),
    (_OF_A_MODULE, _no_attribute),
)


def _plain(line: str) -> str:
    """A line without addresses of memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", line.strip())


# --- compiled formulas ----------------------------------------------------------------------------

_UNCHECKED = ("as_strided", "flat", "getitem", "setitem", "take_along_axis")
_TUPLES = ("w", "x", "v", "y", "z", "u", "estimate")
"""Arguments of formulas that are tuples, whose constant indices Numba checks when it compiles."""


@lru_cache(maxsize=128)
def formula(function: Callable[..., Any], name: str = "") -> Callable[..., Any]:
    """Compile a formula; `name` is its name in errors, by default the function's name.

    Functions that it calls by their own names are compiled with it, and NumPy's elementary
    functions are those of `pfdist.kernels.overloads`. A float divided by zero gives inf or nan as
    in NumPy: a branch to raise would stop vectorisation. Indices of arrays are checked; see
    `checks_indices`.
    """
    return _compiled(function, name or function.__name__, ())


def checks_indices(function: Callable[..., Any]) -> bool:
    """Whether a formula indexes arrays in a way that is checked for each particle.

    ``p.NAME[t]`` needs no check, because the array has an entry for each instant. A check stops
    vectorisation: such a formula takes up to 8 times the time.
    """
    node = node_of(function)
    if node is None:
        return True
    names = [each.arg for each in node.args.args[: len(node.args.args) - len(node.args.defaults)]]
    for each in ast.walk(node):
        if isinstance(each, ast.Name) and not isinstance(each.ctx, ast.Load):
            names.append(each.id)
        if each is not node:  # of `match`, `except`, `def` and `import`
            bound = (getattr(each, field, None) for field in ("name", "rest", "asname"))
            names += [name for name in bound if name]
        if isinstance(each, Function) and each is not node:
            names += [
                argument.arg for argument in ast.walk(each.args) if isinstance(argument, ast.arg)
            ]
    given = {name for name in names if names.count(name) == 1}  # arguments that are never assigned
    subscripts = (each for each in ast.walk(node) if isinstance(each, ast.Subscript))
    return not all(_cannot_fail(each, given) for each in subscripts)


def _cannot_fail(subscript: ast.Subscript, given: set[str]) -> bool:
    """Whether a subscript is ``p.NAME[t]`` or, for instance, ``x[0]``, of unchanged arguments."""
    match subscript:
        case ast.Subscript(
            value=ast.Attribute(value=ast.Name(id="p")), slice=ast.Name(id="t"), ctx=ast.Load()
        ):
            return given >= {"p", "t"}
        case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(), ctx=ast.Load()):
            return name in _TUPLES and name in given
    return False


def _compiled(function: Any, name: str, callers: tuple[Any, ...]) -> Callable[..., Any]:
    """Compile a function with all that it calls.

    A function that calls itself is left as it is written, and Numba refuses it: it might never end.
    """
    called_by = (*callers, function)
    _refuse_unchecked(function)

    def instead(value: Any) -> Any:
        value = value.py_func if is_jitted(value) else value
        if isinstance(value, types.FunctionType) and value not in called_by:
            return value if is_ours(value) else _compiled(value, name, called_by)
        return _INSTEAD.get(id(value), value)

    compilable = seeing(function, instead, name)
    # Numba stores the name of the function's module with the compiled code. Another process may not
    # be able to import the user's module, so the name is that of this module.
    compilable.__globals__["__name__"] = compilable.__module__ = __name__
    # A helper's arguments may be arrays. A function may make arrays, which the filter it melts into
    # cannot.
    checked = bool(callers) or checks_indices(function)
    return melted(compilable, _nrt=True, boundscheck=checked)


def _refuse_unchecked(function: Any) -> None:
    """Refuse operations whose indices Numba never checks, not even with `boundscheck`."""
    node = node_of(function)
    for each in ast.walk(node) if node else ():
        name = getattr(each, "attr", getattr(each, "id", ""))
        if name in _UNCHECKED:
            what = f"{name}: write array[index]"
        elif isinstance(each, ast.Call) and _is_take_of_an_axis(each):
            what = "np.take with an axis: write array[index]"
        elif isinstance(each, Function) and each is not node and _indexes_an_array(each):
            what = "index in a function that is defined in a formula: define it above"
        else:
            continue
        place = f'File "{function.__code__.co_filename}", line {getattr(each, "lineno", 0)}'
        raise errors.UnsupportedError(f"Use of unsupported {what}\n{place}")


def _is_take_of_an_axis(call: ast.Call) -> bool:
    name = getattr(call.func, "attr", getattr(call.func, "id", ""))
    return name == "take" and len(call.args) + len(call.keywords) > 2


def _indexes_an_array(node: ast.AST) -> bool:
    subscripts = (each for each in ast.walk(node) if isinstance(each, ast.Subscript))
    return not all(_cannot_fail(each, set(_TUPLES)) for each in subscripts)


def is_ours(function: types.FunctionType) -> bool:
    """Whether a function is pfdist's own, which is compiled in its own way."""
    module = str(function.__globals__.get("__name__"))
    return module == "pfdist.elementwise" or module.startswith(
        ("pfdist.kernels.", "pfdist.densities.")
    )


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
"""The replacements that a formula sees, by the identity of the original module or function."""


def _compile_like_formulas(module: types.ModuleType) -> None:
    """Let Numba compile the functions of a module as formulas, wherever a formula calls them."""
    for function in vars(module).values():
        if isinstance(function, types.FunctionType) and function.__module__ == module.__name__:
            compilable = seeing(function, lambda value: _INSTEAD.get(id(value), value))
            options = MELTING | {"error_model": "numpy"}
            overload(function, jit_options=options, strict=False)(
                lambda *_, compilable=compilable, **__: compilable
            )


for _module in (special, log_densities, quantiles, draws):
    _compile_like_formulas(_module)


# --- errors of formulas -------------------------------------------------------------------------


@contextlib.contextmanager
def compiled_formulas(model: str, again: Callable[[], Any]) -> Iterator[None]:
    """Turn an error of compiled formulas into a `CompileError` or `ModelError` of one line.

    If compiled code failed, `again` computes the same in NumPy, so that Python's own traceback has
    the formula, the line and the instant. If NumPy does not fail, `again` describes what it
    computed.

    A signal that was received ends the command here: before the next formulas are compiled.
    """
    check()
    try:
        yield
    except NOT_COMPILED as error:
        raise CompileError(
            f"model {model} cannot be compiled by Numba: {reason_of(error)}; formulas may use "
            "operators, NumPy's elementwise functions on numbers, pfdist.where, pfdist.clip and "
            "pfdist.densities"
        ) from error
    except (MemoryError, PfdistError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a formula may raise whatever it likes
        what = again()
        raise ModelError(
            f"model {model}: a compiled formula failed in {what}: {error_line(error)}; it does not "
            "fail in NumPy"
        ) from error


@contextlib.contextmanager
def formulas_of(model: str, formulas: Mapping[str, Callable[..., Any]]) -> Iterator[None]:
    """Turn an error of a model's formulas in NumPy into a `ModelError` of one line.

    It has the formula's name, the instant if it is known, and the line.
    """
    check()
    try:
        yield
    except (MemoryError, PfdistError):
        raise
    except BaseException as error:  # a formula may raise whatever it likes
        place = place_of(error)
        if is_interrupt(error) or not (isinstance(error, Exception) or place):
            raise
        name, instant = _formula_at_fault(error, formulas)
        at = "" if instant is None else f" at t = {instant}"
        raise ModelError(
            f"model {model}: {name} failed: {error_line(error)}{at}{remedy(error)}{place}"
        ) from error


def _formula_at_fault(
    error: BaseException, formulas: Mapping[str, Callable[..., Any]]
) -> tuple[str, int | None]:
    """Name of the formula that an error passed through, and the value of its t if it has one."""
    names = {function.__code__: name for name, function in formulas.items()}
    for frame, _ in frames_of(error):
        if frame.f_code in names:
            return names[frame.f_code], frame.f_locals.get("t")
    return "a formula", None
