"""Symbols: placeholders for values in a call of a formula, which record what it computes.

NumPy dispatches its functions to symbols by two public protocols, ``__array_ufunc__`` and
``__array_function__``. Arrays of symbols have the dtype object: NumPy calls the operators and
methods of each symbol.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from pfdist.models.program import (
    BINARY,
    MASKS,
    OPERATORS,
    UNARY,
    Operation,
    Program,
    excess_of_loops,
    pruned,
    take_entries,
)

MOST_OPERATIONS: Final = 50_000
_NUMBERS = (bool, int, float, np.integer, np.floating, np.bool_)
_LARGEST_TABLE = 64  # entries of a table whose entries are symbols


_KEPT_FROM_LOOP = "a value of a step is kept from a loop: take those that it gives"
_CONDITION = (
    "a condition on a value of particles, as in if, and, or, min, max or 0 < x < 1: write "
    "pfdist.where(condition, a, b), & and |, np.minimum and np.maximum"
)
_NUMBER = (
    "a value of particles as a number of Python: write np.sin and not math.sin, "
    "pfdist.densities.lgamma and not math.lgamma, and np.array([a, b]) and not an assignment into "
    "an array of numbers"
)
_SPECIAL = {
    **dict.fromkeys(("gammaln", "loggamma"), "write pfdist.densities.lgamma"),
    **{name: f"write pfdist.densities.{name}" for name in ("erf", "erfc", "logsumexp")},
}
"""Functions of SciPy, with their replacements in formulas."""


class RefusedError(TypeError):
    """A formula used a symbol in a way that cannot be recorded; the message has the remedy."""


class Recording:
    """The operations that a formula has computed so far.

    `value_of` gives the number that a program gives without particles; None if it needs them.
    """

    def __init__(self, value_of: Callable[[Program], float | None] = lambda _: None) -> None:
        self._value_of, self._was_asked = value_of, False
        self.operations: list[Operation] = []
        self.constants: list[float] = []
        self.tables: dict[bytes, int] = {}
        self.is_open = True
        self.unrolls = False  # whether loops are written out step by step: these have derivatives
        self._loop_of: dict[int, int] = {}  # the loop of each operation that depends on its steps
        self._loop: int | None = None  # the loop that is being recorded

    def add(self, name: str, arguments: tuple[int, ...], which: Any = None) -> int:
        """Add an operation, and return its number."""
        if not self.is_open:
            raise RefusedError("a value is kept from another call: compute it again in this one")
        if len(self.operations) >= MOST_OPERATIONS:
            raise RefusedError(
                f"a formula must have at most {MOST_OPERATIONS:,} operations: a loop that never "
                "ends, or too many steps"
            )
        number = len(self.operations)
        if self._loop_of:
            loops = {self._loop_of[each] for each in arguments if each in self._loop_of}
            if loops - {self._loop}:
                raise RefusedError(_KEPT_FROM_LOOP)
            if loops:
                self._loop_of[number] = loops.pop()
        self.operations.append(Operation(name, arguments, which))
        return number

    def known(self, number: int) -> float | None:
        """The value of an operation as a number; None if it is not known."""
        self._was_asked, needed, waiting = True, set[int](), [number]
        while waiting:
            each = waiting.pop()
            if each not in needed:
                needed.add(each)
                waiting += self.operations[each].arguments
        place = {each: k for k, each in enumerate(sorted(needed))}
        operations = tuple(
            Operation(name, tuple(place[each] for each in arguments), which)
            for name, arguments, which in (self.operations[each] for each in place)
        )
        program = self._program((place[number],))
        return self._value_of(replace(program, operations=operations))

    # --- loops ------------------------------------------------------------------------------------

    @property
    def in_loop(self) -> bool:
        """Whether a step of a loop is being recorded."""
        return self._loop is not None

    def begin(self, count: int, values: tuple[int, ...], most: int) -> int:
        """Begin a loop, whose step is the next operations; return the number of this operation."""
        if self.in_loop:
            raise RefusedError("a loop in a step of another loop: give it a number of steps")
        self._loop = self.add("repeat", (count, *values), most)
        self._loop_of[self._loop] = self._loop
        return self._loop

    def end(self, loop: int, values: tuple[int, ...]) -> int:
        """End a loop, and return the number of this operation."""
        number = self.add("again", (loop, *values))
        del self._loop_of[number]
        self._loop = None
        return number

    def _in_order(self) -> list[int]:
        """Numbers of the operations, so that those of a step follow each other.

        Operations that are the same in each step stand before the loop.
        """
        order, of_step = list[int](), list[int]()
        for number, operation in enumerate(self.operations):
            if number in self._loop_of:
                of_step.append(number)
                continue
            if operation.name == "again":
                order, of_step = [*order, *of_step], []
            order.append(number)
        return order

    def operand(self, value: Any) -> int:
        """The number of a symbol, or of a new constant."""
        if type(value) is not Symbol:
            return self.number(value)
        if value.recording is not self:
            raise RefusedError("a value is kept from another call: compute it again in this one")
        return value.number

    def number(self, value: Any) -> int:
        """The number of a new constant."""
        self.constants.append(float(value))
        return self.add("constant", (), len(self.constants) - 1)

    def table(self, values: Any) -> int:
        """The number of a table."""
        content = np.ascontiguousarray(values, np.float64).tobytes()
        return self.tables.setdefault(content, len(self.tables))

    def _program(self, outputs: tuple[int, ...]) -> Program:
        constants = np.array([self.constants], np.float64).reshape(1, -1)
        tables = tuple(np.frombuffer(content) for content in self.tables)
        return Program(tuple(self.operations), outputs, constants, tables)

    def closed(self, outputs: Sequence[Any]) -> Program:
        """The finished program that gives some values, which are symbols or numbers."""
        numbers = tuple(
            each.number if isinstance(each, Symbol) else self.number(each) for each in outputs
        )
        if any(number in self._loop_of for number in numbers):
            raise RefusedError(_KEPT_FROM_LOOP)
        self.is_open = False
        program = self._program(numbers)
        if self._loop_of:
            order = self._in_order()
            place = {number: k for k, number in enumerate(order)}
            operations = (self.operations[number] for number in order)
            moved = tuple(
                Operation(name, tuple(place[each] for each in arguments), which)
                for name, arguments, which in operations
            )
            if excess := excess_of_loops(moved):
                raise RefusedError(excess)
            outputs = tuple(place[each] for each in numbers)
            program = replace(program, operations=moved, outputs=outputs)
        return pruned(program) if self._was_asked else program  # conditions leave no operations


class Symbol:
    """A value of a formula: a floating-point number, a whole number or a mask."""

    __slots__ = ("kind", "number", "recording")

    def __init__(self, recording: Recording, number: int, kind: str = "float") -> None:
        self.recording, self.number, self.kind = recording, number, kind

    def __repr__(self) -> str:
        name, _, which = self.recording.operations[self.number]
        return f"<symbol {name}{'' if which is None else f'[{which}]'}>"

    @property
    def shape(self) -> tuple[()]:
        """The shape of a single number."""
        return ()

    ndim, size = 0, 1

    # --- what a symbol cannot be, unless its value is known without particles ---------------------

    def _known(self, refusal: str) -> float:
        value = self.recording.known(self.number)
        if value is None:
            raise RefusedError(refusal)
        return value

    def __bool__(self) -> bool:
        return bool(self._known(_CONDITION))

    def __float__(self) -> float:
        return self._known(_NUMBER)

    def __int__(self) -> int:
        return int(self._known("int of a value of particles: write value.astype(int)"))

    def __index__(self) -> int:
        raise RefusedError(
            "an index, range or repetition by a value of particles: write "
            "take(table, value.astype(int))"
        )

    def __round__(self, digits: int | None = None) -> Any:
        raise RefusedError("round of a value of particles: write np.round")

    def __hash__(self) -> int:
        raise RefusedError(
            "a value of particles as a key: write take(table, value.astype(int)) or pfdist.where"
        )

    def __iter__(self) -> Any:
        raise RefusedError("a loop over, or the parts of, a value of particles: it is one number")

    def __array__(self, *arguments: Any, **keywords: Any) -> Any:
        if arguments and np.dtype(arguments[0]) != object:
            self.__float__()
        array = np.empty((), object)
        array[()] = self
        return array

    # --- operators, of which the end of the module declares most ----------------------------------

    def astype(self, kind: Any, *_: Any, **__: Any) -> Any:
        """The value as another type: ``int`` truncates towards 0."""
        wanted = np.dtype(kind)
        if wanted == np.bool_:
            return _as_mask(self)
        if wanted not in (np.float64, np.int64):
            raise RefusedError(f"astype({wanted}): write astype(int), astype(float), astype(bool)")
        if wanted == np.int64:
            whole = _record("trunc", self)
            whole.kind = "whole"
            return whole
        return as_float(self)

    # --- NumPy's protocols ------------------------------------------------------------------------

    def __array_ufunc__(self, function: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        name = function.__name__
        if method != "__call__" or keywords or name not in UFUNCS:
            called = name if method == "__call__" else f"{name}.{method}"
            given = f" with {', '.join(keywords)}" if keywords else ""
            advice = _SPECIAL.get(name, "write it with operators")
            raise RefusedError(f"{called}{given} of a value of particles: {advice}")
        if any(isinstance(each, np.ndarray | list | tuple) and np.ndim(each) for each in inputs):
            return elementwise(UFUNCS[name], *inputs)
        return UFUNCS[name](*inputs)

    def __array_function__(
        self, function: Any, kinds: Any, arguments: Sequence[Any], keywords: dict[str, Any]
    ) -> Any:
        name = function.__name__
        if name in FUNCTIONS:
            return FUNCTIONS[name](*arguments, **keywords)
        if name in _SUMS and isinstance(arguments[0], Symbol):
            raise RefusedError(
                f"np.{name} of a single value: a formula must treat each particle alone, and a "
                "component is one number"
            )
        if name in _OF_ARRAYS:
            return function(*map(_in_arrays, arguments), **keywords)
        raise RefusedError(f"np.{name} of a value of particles: write it with operators")


def _add_method(name: str, function: Callable[..., Any]) -> None:
    """Give symbols a method, which NumPy calls on arrays of objects."""

    def method(self: Symbol, *others: Any) -> Any:
        return function(self, *others)

    setattr(Symbol, name, method)


# --- operations -----------------------------------------------------------------------------------


def elementwise(function: Callable[..., Any], *inputs: Any) -> Any:
    """The values of a function for the entries of arrays, which may be symbols."""
    return np.frompyfunc(function, len(inputs), 1)(*map(_in_arrays, inputs))


def _in_arrays(argument: Any) -> Any:
    if isinstance(argument, Symbol):
        return argument.__array__()
    if isinstance(argument, list | tuple):
        return type(argument)(map(_in_arrays, argument))
    return argument


def _plain(value: Any) -> Any:
    """A symbol or a number; an array of one entry counts as it."""
    if type(value) is Symbol or type(value) is float:  # most are
        return value
    if isinstance(value, _SINGLE):
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return value[()]
    return None


def _record(name: str, *values: Any) -> Symbol:
    recording: Recording = next(each.recording for each in values if type(each) is Symbol)
    number = recording.add(name, tuple(map(recording.operand, values)))
    return Symbol(recording, number, "mask" if name in MASKS else "float")


def as_float(value: Any) -> Any:
    """A mask as 1 and 0; other values as they are."""
    return _record("float", value) if type(value) is Symbol and value.kind == "mask" else value


def _as_mask(value: Any) -> Any:
    if isinstance(value, Symbol):
        return value if value.kind == "mask" else _record("not_equal", value, 0.0)
    return bool(value)


_SINGLE = (Symbol, *_NUMBERS)
_OF_NUMBERS = frozenset({"add", "subtract"})
_WHOLE = frozenset({"add", "subtract", "multiply", "floor_divide", "remainder"})


def _binary(name: str, first: Any, second: Any) -> Any:
    a, b = _plain(first), _plain(second)
    if a is None or b is None:
        return NotImplemented
    kind, other = _kind(a), _kind(b)
    if kind == other == "mask" and name in _OF_NUMBERS:
        raise RefusedError(f"{name} of two conditions: write a.astype(int), or & and |")
    result = _record(name, as_float(a), as_float(b))
    if kind == other == "whole" and name in _WHOLE:
        result.kind = "whole"
    return result


def _kind(value: Any) -> str:
    if type(value) is Symbol:
        return value.kind
    if isinstance(value, bool | np.bool_):
        return "mask"
    return "whole" if isinstance(value, int | np.integer) else "float"


def _unary(name: str, value: Any) -> Any:
    return _record(name, as_float(value))


def _logical(name: str, *values: Any) -> Any:
    given = [_plain(each) for each in values]
    if any(each is None for each in given):
        return NotImplemented
    masks = [_as_mask(each) for each in given]
    symbol = next(each for each in masks if isinstance(each, Symbol))
    return _record(name, *(_mask_of(symbol, each) for each in masks))


def _of_conditions(name: str, *values: Any) -> Any:
    """An operation of bits, which NumPy computes otherwise for whole numbers."""
    given = [_plain(each) for each in values]
    if not all(each is None or _kind(each) == "mask" for each in given):
        raise RefusedError(
            "&, |, ^ and ~ of numbers: write n % 2 and n // 2 for bits; of conditions, put each "
            "into brackets, as in (x > 0) & (x < 1)"
        )
    return _logical(name, *values)


def _mask_of(symbol: Symbol, value: Any) -> Symbol:
    if isinstance(value, Symbol):
        return value
    recording = symbol.recording
    numbers = recording.number(value), recording.number(0.0)
    return Symbol(recording, recording.add("not_equal", numbers), "mask")


def _power(base: Any, exponent: Any) -> Any:
    """A power; squares and other simple powers are products, roots and reciprocals."""
    a, b = _plain(base), _plain(exponent)
    if a is None or b is None:
        return NotImplemented
    a, b = as_float(a), as_float(b)
    if isinstance(b, Symbol):
        return _record("power", a, b)
    simple: dict[float, Callable[[], Any]] = {
        -1.0: lambda: 1.0 / a,
        0.0: lambda: _record("power", a, 0.0),
        0.5: lambda: _record("sqrt", a),
        1.0: lambda: a,
        2.0: lambda: a * a,
        3.0: lambda: a * a * a,
        4.0: lambda: (a * a) * (a * a),
    }
    make = simple.get(float(b))
    return make() if make else _record("power", a, b)


def choose(condition: Any, if_true: Any, if_false: Any) -> Any:
    """The first value where a condition holds, and the second elsewhere."""
    if any(_plain(each) is None for each in (condition, if_true, if_false)):
        return elementwise(choose, condition, if_true, if_false)
    if not isinstance(condition, Symbol):
        return if_true if condition else if_false
    a, b = as_float(_plain(if_true)), as_float(_plain(if_false))
    return _record("where", _as_mask(condition), a, b)


def _select(conditions: Sequence[Any], choices: Sequence[Any], default: Any = 0.0) -> Any:
    result = default
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        result = choose(condition, choice, result)
    return result


def _clip(a: Any, a_min: Any = None, a_max: Any = None, out: None = None, **limits: Any) -> Any:
    low, high = limits.pop("min", a_min), limits.pop("max", a_max)
    if limits or out is not None:
        raise RefusedError(f"np.clip with the argument {min(limits, default='out')}")
    value = a if low is None else np.maximum(a, low)
    return value if high is None else np.minimum(value, high)


def take(table: Any, index: Any, axis: int | None = None) -> Any:
    """Entries of a table at whole numbers that depend on a state; NaN where these lie outside.

    In formulas, it replaces ``np.take``, which accepts only numbers as an index.

    Parameters
    ----------
    table : array of float
        With one dimension, or two.
    index : int, or array of int
    axis : int, optional
        Axis of a two-dimensional table along which a row or column is taken; by default the index
        counts all entries, row by row.

    Returns
    -------
    float or array
        A row or column is an array of its entries.

    Examples
    --------
    >>> import numpy as np
    >>> take([0.1, 0.7], np.array([1.9, 0.2, 5.0]).astype(int))
    array([0.7, 0.1, nan])
    """
    values = np.asarray(table)
    if axis is not None and values.ndim > 1:
        rows = np.moveaxis(values, axis, 0)
        columns = [take(column, index) for column in rows.reshape(len(rows), -1).T]
        taken = np.array(columns, object) if isinstance(index, Symbol) else np.array(columns)
        return taken.reshape(*rows.shape[1:], *np.shape(index))
    flat = values.ravel()
    if not isinstance(index, Symbol):
        return take_entries(flat, index)
    if _kind(index) != "whole":
        raise RefusedError("an index must be a whole number: write take(table, x.astype(int))")
    if flat.dtype == object:
        if flat.size > _LARGEST_TABLE:
            raise RefusedError(
                f"a table of values of particles must have at most {_LARGEST_TABLE} entries, got "
                f"{flat.size}"
            )
        return _select([_binary("equal", index, k) for k in range(flat.size)], list(flat), math.nan)
    recording = index.recording
    number = recording.add("take", (index.number,), recording.table(flat))
    return Symbol(recording, number)


def _interp(x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None) -> Any:
    """Linear interpolation in a table, whose place is found by bisection."""
    knots, values = (np.asarray(each, np.float64) for each in (xp, fp))
    if knots.shape != values.shape:
        raise ValueError("fp and xp are not of the same length")
    with np.errstate(all="ignore"):
        slopes = np.append(np.diff(values) / np.diff(knots), 0.0)
    place: Any = Symbol(x.recording, x.recording.number(0.0), "whole")
    step = 1 << max(0, knots.size - 1).bit_length()
    while step:
        following = place + step
        place = choose(take(knots, following) <= x, following, place)
        place.kind = "whole"
        step >>= 1
    slope, knot, value = (take(each, place) for each in (slopes, knots, values))
    found = slope * (x - knot) + value
    if not np.isfinite(slopes).all():  # as NumPy: from the other end, or the value of both
        after, next_value = (take(np.append(each[1:], each[-1]), place) for each in (knots, values))
        found = choose(np.isnan(found), slope * (x - after) + next_value, found)
        found = choose(np.isnan(found) & (value == next_value), value, found)
        found = choose(x == knot, value, choose(np.isnan(x), x, found))
    if knots.size == 1:
        found = values[0]
    found = choose(x < knots[0], values[0] if left is None else left, found)
    return choose(x > knots[-1], values[-1] if right is None else right, found)


def _round(value: Any, decimals: int = 0, **_: Any) -> Any:
    if not decimals:
        return np.rint(value)
    return np.rint(value * 10.0**decimals) / 10.0**decimals


def _heaviside(x: Any, at_zero: Any) -> Any:
    return choose(x < 0.0, 0.0, choose(x == 0.0, at_zero, choose(x > 0.0, 1.0, math.nan)))


def _recorded(name: str) -> Callable[..., Any]:
    """The function that records an operation of this name."""

    def record(*values: Any) -> Any:
        return _record(name, *(as_float(_plain(each)) for each in values))

    return record


_SAME = (*UNARY, *BINARY)
_OF_BITS = ("and", "or", "xor")
UFUNCS: dict[str, Callable[..., Any]] = {
    **{name: _recorded(name) for name in _SAME},
    **{name: partial(_binary, name) for name in OPERATORS},
    "true_divide": partial(_binary, "divide"), "power": _power, "float_power": _power,
    "divmod": lambda a, b: (_binary("floor_divide", a, b), _binary("remainder", a, b)),
    "square": lambda x: _power(x, 2.0), "reciprocal": lambda x: 1.0 / x,
    "positive": lambda x: x, "fabs": abs,
    **{f"logical_{name}": partial(_logical, f"logical_{name}") for name in _OF_BITS},
    **{f"bitwise_{name}": partial(_of_conditions, f"logical_{name}") for name in _OF_BITS},
    "logical_not": partial(_logical, "logical_not"),
    "invert": partial(_of_conditions, "logical_not"),
    "deg2rad": lambda x: x * (math.pi / 180.0), "radians": lambda x: x * (math.pi / 180.0),
    "rad2deg": lambda x: x * (180.0 / math.pi), "degrees": lambda x: x * (180.0 / math.pi),
    "heaviside": _heaviside,
}  # fmt: skip
"""The function that records each universal function of NumPy."""

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "where": choose, "select": _select, "clip": _clip, "interp": _interp,
    "round": _round, "around": _round, "ndim": lambda _: 0, "shape": lambda _: (),
    "size": lambda *_: 1, "real": lambda x: x,
}  # fmt: skip
"""The function that records each other function of NumPy."""

_SUMS = frozenset({"sum", "prod", "mean", "cumsum"})
_OF_ARRAYS = _SUMS | frozenset(
    {
        *("stack", "concatenate", "hstack", "vstack", "column_stack", "atleast_1d", "atleast_2d"),
        *("dot", "vdot", "inner", "outer", "cross", "trace"),
        *("transpose", "reshape", "ravel", "broadcast_to", "append", "diff", "copy"),
    }
)
"""Functions of NumPy that compute with arrays of objects."""

for _name in (*_SAME, "square", "reciprocal", "logical_not"):
    _add_method(_name, UFUNCS[_name])

_OF_TWO: dict[str, Callable[[Any, Any], Any]] = {
    "add": partial(_binary, "add"), "sub": partial(_binary, "subtract"),
    "mul": partial(_binary, "multiply"), "truediv": partial(_binary, "divide"),
    "floordiv": partial(_binary, "floor_divide"), "mod": partial(_binary, "remainder"),
    "divmod": lambda a, b: (a // b, a % b), "pow": _power,
}  # fmt: skip
"""The function that records each operator of two numbers in their order."""
for _name, _function in _OF_TWO.items():
    _add_method(f"__{_name}__", _function)
    _add_method(f"__r{_name}__", lambda symbol, other, record=_function: record(other, symbol))
for _name in _OF_BITS:  # the symbol comes first in any order
    _add_method(f"__{_name}__", partial(_of_conditions, f"logical_{_name}"))
    _add_method(f"__r{_name}__", partial(_of_conditions, f"logical_{_name}"))
_COMPARISONS = {"lt": "less", "le": "less_equal", "gt": "greater", "ge": "greater_equal",
                "eq": "equal", "ne": "not_equal"}  # fmt: skip
for _name, _operation in _COMPARISONS.items():
    _add_method(f"__{_name}__", partial(_binary, _operation))
_OF_ONE = {"neg": "negative", "abs": "absolute", "floor": "floor", "ceil": "ceil", "trunc": "trunc"}
for _name, _operation in _OF_ONE.items():
    _add_method(f"__{_name}__", partial(_unary, _operation))
_add_method("__pos__", lambda symbol: symbol)
_add_method("__invert__", partial(_of_conditions, "logical_not"))
