"""Programs: formulas as lists of operations, which are plain data.

A program is what `pfdist.models.tracing` records. It is compiled by `pfdist.kernels.blocks`, and
`evaluate` runs it on NumPy arrays: its plain twin.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GROUPS = ("x", "y", "z", "w", "v", "u", "estimate")
"""Names of the tuples that formulas take; a component is a value of each particle."""

UNARY = (
    *("negative", "absolute", "sqrt", "cbrt", "sign", "exp", "exp2", "expm1"),
    *("log", "log2", "log10", "log1p", "sin", "cos", "tan", "arcsin", "arccos", "arctan"),
    *("sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh"),
    *("floor", "ceil", "trunc", "rint", "isnan", "isinf", "isfinite", "signbit"),
)
"""Operations of a number that are recorded under the names of NumPy's functions."""
BINARY = (
    *("fmod", "copysign", "arctan2", "hypot", "logaddexp"),
    *("maximum", "minimum", "fmax", "fmin"),
)
"""The same of two numbers."""
OPERATORS = (
    *("add", "subtract", "multiply", "divide", "floor_divide", "remainder"),
    *("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"),
)
"""Operations of two numbers that have an operator."""
LOGICAL = ("logical_and", "logical_or", "logical_xor", "logical_not")
"""Operations of masks."""
MASKS = frozenset({*OPERATORS[6:], *LOGICAL, "isnan", "isinf", "isfinite", "signbit"})
"""Operations that give masks; all others give floating-point numbers."""

TAKES = (
    dict.fromkeys((*GROUPS, "t", "parameter", "constant"), "")
    | dict.fromkeys(("covariate", "take", *UNARY), "f")
    | dict.fromkeys(("power", *BINARY, *OPERATORS), "ff")
    | dict.fromkeys(LOGICAL, "mm")
    | {"logical_not": "m", "float": "m", "where": "mff"}
)
"""What each operation takes: "f" is a number, and "m" a mask."""


class Operation(NamedTuple):
    """An operation, whose arguments are the numbers of earlier operations.

    Leaves have no arguments: a component of a group of `GROUPS`, ("t",), ("parameter", (), name),
    and ("constant", (), column). ("covariate", (index,), name) is an entry of a parameter that
    varies with t, and ("take", (index,), table) an entry of a table. All others have the names of
    functions of NumPy, besides "float": a mask as 1 and 0.
    """

    name: str
    arguments: tuple[int, ...] = ()
    which: Any = None


@dataclass(frozen=True, eq=False)
class Program:
    """A formula as it was recorded, at one instant or at several with the same operations.

    Parameters
    ----------
    operations : tuple of Operation
    outputs : tuple of int
        Numbers of the operations that give the results.
    constants : array of float64, (rows, columns)
        A row for each instant, or a single row if t is a symbol.
    tables : tuple of array of float64
        One-dimensional arrays from which "take" takes entries.
    """

    operations: tuple[Operation, ...]
    outputs: tuple[int, ...]
    constants: Array
    tables: tuple[Array, ...] = ()

    @cached_property
    def structure(self) -> tuple[Any, ...]:
        """All but the constants, as a value that can be compared."""
        return self.operations, self.outputs, tuple(each.tobytes() for each in self.tables)

    @cached_property
    def hash(self) -> str:
        """Hash of the operations, outputs, constants and tables."""
        content = hashlib.blake2b(repr((self.operations, self.outputs)).encode(), digest_size=16)
        for array in (self.constants, *self.tables):
            content.update(repr(array.shape).encode() + array.tobytes())
        return content.hexdigest()

    @cached_property
    def is_shared(self) -> tuple[bool, ...]:
        """Whether each operation gives one value for all particles."""
        shared = list[bool]()
        for name, arguments, _ in self.operations:
            shared.append(name not in GROUPS and all(shared[each] for each in arguments))
        return tuple(shared)

    @property
    def shared_divisors(self) -> tuple[int, ...]:
        """The numbers of the operations that are divisors, and the same for all particles."""
        found = (
            arguments[1]
            for name, arguments, _ in self.operations
            if name in ("divide", "floor_divide", "remainder") and self.is_shared[arguments[1]]
        )
        return tuple(dict.fromkeys(found))


def merged(program: Program) -> Program:
    """The program without repetitions: equal columns and operations become one, others go.

    No value changes.
    """
    needed = [False] * len(program.operations)
    for number in program.outputs:
        needed[number] = True
    for number in range(len(needed) - 1, -1, -1):
        if needed[number]:
            for each in program.operations[number].arguments:
                needed[each] = True
    numbers, columns = dict[Any, int](), dict[bytes, int]()
    moved, operations = list[int](), list[Operation]()
    for is_needed, (name, arguments, which) in zip(needed, program.operations, strict=True):
        if not is_needed:
            moved.append(-1)
            continue
        attribute = which
        if name == "constant":
            attribute = columns.setdefault(program.constants[:, which].tobytes(), len(columns))
        operation = Operation(name, tuple(moved[each] for each in arguments), attribute)
        moved.append(numbers.setdefault(operation, len(operations)))
        if moved[-1] == len(operations):
            operations.append(operation)
    constants = np.empty((len(program.constants), len(columns)))
    for content, column in columns.items():
        constants[:, column] = np.frombuffer(content)
    outputs = tuple(moved[each] for each in program.outputs)
    return Program(tuple(operations), outputs, constants, program.tables)


def cause_of(program: Program, values: Sequence[Any]) -> str:
    """The first operation that gives a number that is not finite from finite ones.

    `values` has that of each operation. The name is empty if there is none.
    """
    finite = [bool(np.isfinite(each).all()) for each in values]
    for number, (name, arguments, _) in enumerate(program.operations):
        if arguments and not finite[number] and all(finite[each] for each in arguments):
            return name
    return ""


# --- the plain twin -------------------------------------------------------------------------------


def take(table: Array, index: Any) -> Any:
    """Entries of a table; NaN where the index lies outside or is no number."""
    inside = (index >= 0) & (index < table.size)
    return np.where(inside, table[np.where(inside, index, 0).astype(np.int64)], np.nan)


def as_float(mask: Any) -> Any:
    """1 where a mask holds, and 0 elsewhere."""
    return np.where(mask, 1.0, 0.0)


_FUNCTIONS: dict[str, Callable[..., Any]] = {"float": as_float}


def evaluate(
    program: Program,
    groups: Mapping[str, Sequence[Any]],
    t: Any,
    parameters: Mapping[str, Any],
    rows: Any = 0,
) -> tuple[Any, ...]:
    """Run a program on NumPy arrays, by NumPy's functions.

    Parameters
    ----------
    program : Program
    groups : mapping of str to sequence of array
        Components of x, w and so on.
    t : int or array
        The instant.
    parameters : mapping of str to float or sequence of float
        Those that vary with t have an entry for each instant 0..T.
    rows : int or array
        Row of the constants.

    Returns
    -------
    tuple of array or float
        A value for each output.
    """
    values = list[Any]()
    with np.errstate(all="ignore"):
        for name, arguments, which in program.operations:
            given = [values[each] for each in arguments]
            if name in GROUPS:
                values.append(groups[name][which])
            elif name == "t":
                values.append(np.float64(t) if np.ndim(t) == 0 else np.asarray(t, np.float64))
            elif name == "parameter":
                values.append(np.float64(parameters[which]))
            elif name == "covariate":
                entries = np.asarray(parameters[which], np.float64)
                values.append(entries[np.asarray(given[0], np.int64)])
            elif name == "constant":
                values.append(program.constants[rows, which])
            elif name == "take":
                values.append(take(program.tables[which], *given))
            else:
                function = _FUNCTIONS.get(name) or getattr(np, name)
                values.append(function(*given))
    return tuple(
        as_float(values[each]) if program.operations[each].name in MASKS else values[each]
        for each in program.outputs
    )
