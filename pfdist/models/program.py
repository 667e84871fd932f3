"""Programs: formulas as lists of operations, which are plain data.

`pfdist.models.tracing` records programs, and `pfdist.kernels.blocks` compiles them. `evaluate` runs
a program on NumPy arrays: its plain twin.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

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

LOOPS = ("repeat", "state", "step", "nth", "again", "final")
"""Operations of loops; see `Operation`."""
MOST_STEPS: Final = 10_000  # of a loop
MOST_IN_STEP: Final = 10_000  # operations between "repeat" and "again"
MOST_TAKEN: Final = 10_000  # values that all loops of a program take: arguments of `_TAKING`
_TAKING = ("repeat", "nth", "again")

TAKES = (
    dict.fromkeys((*GROUPS, "t", "parameter", "constant"), "")
    | dict.fromkeys(("covariate", "take", *UNARY), "f")
    | dict.fromkeys(("power", *BINARY, *OPERATORS), "ff")
    | dict.fromkeys(LOGICAL, "mm")
    | {"logical_not": "m", "float": "m", "where": "mff"}
    | {"repeat": "f*", "state": "l", "step": "l", "nth": "lf*", "again": "lf*", "final": "e"}
)
"""What each operation takes.

"f" is a number, "m" a mask, "l" the begin of a loop, "e" its end, and "*" any number of the last.
"""


def kind_of(name: str) -> str:
    """The letter in `TAKES` for the result of an operation."""
    return {"repeat": "l", "again": "e"}.get(name, "m" if name in MASKS else "f")


class Operation(NamedTuple):
    """An operation; its arguments are the numbers of earlier operations.

    Leaves have no arguments: a component of a group of `GROUPS`, ("t",), ("parameter", (), name),
    and ("constant", (), column). ("covariate", (index,), name) is an entry of a parameter that
    varies with t, and ("take", (index,), table) an entry of a table. All others have the names of
    functions of NumPy, besides "float": a mask as 1 and 0.

    The operations between ("repeat", (count, *values), most) and ("again", (repeat, *values)) are
    computed `count` times, at least once and at most `most` times. There, ("state", (repeat,), k)
    is a value of the step before, ("step", (repeat,)) the number of the step from 0 on, and ("nth",
    (repeat, *values)) that of `most` values with this number. ("final", (again,), k) is a value of
    the last step. No other value of a step is used after its loop, and loops do not nest.
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
        """Everything but the constants, as a value that can be compared."""
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
            own = name in GROUPS or name == "repeat"  # a loop is computed for each particle
            shared.append(not own and all(shared[each] for each in arguments))
        return tuple(shared)

    @property
    def shared_divisors(self) -> tuple[int, ...]:
        """The numbers of the operations that are divisors and are the same for all particles."""
        found = (
            arguments[1]
            for name, arguments, _ in self.operations
            if name in ("divide", "floor_divide", "remainder") and self.is_shared[arguments[1]]
        )
        return tuple(dict.fromkeys(found))


def pruned(program: Program) -> Program:
    """The program without the operations that no output needs."""
    needed = [False] * len(program.operations)
    for number in program.outputs:
        needed[number] = True
    for number in range(len(needed) - 1, -1, -1):
        if needed[number]:
            for each in program.operations[number].arguments:
                needed[each] = True
    moved, columns = dict[int, int](), dict[int, int]()
    operations = list[Operation]()
    for number, (name, arguments, which) in enumerate(program.operations):
        if needed[number]:
            column = columns.setdefault(which, len(columns)) if name == "constant" else which
            moved[number] = len(operations)
            operations.append(Operation(name, tuple(moved[each] for each in arguments), column))
    outputs = tuple(moved[each] for each in program.outputs)
    return Program(tuple(operations), outputs, program.constants[:, [*columns]], program.tables)


def merged(program: Program) -> Program:
    """The program without repetitions: equal columns and operations merged, unused ones removed.

    All values stay the same.
    """
    program = pruned(program)
    numbers, columns = dict[Any, int](), dict[bytes, int]()
    moved, operations = list[int](), list[Operation]()
    for name, arguments, which in program.operations:
        attribute = which
        if name == "constant":
            attribute = columns.setdefault(program.constants[:, which].tobytes(), len(columns))
        operation = Operation(name, tuple(moved[each] for each in arguments), attribute)
        key = (operation, len(operations)) if name == "repeat" else operation  # loops differ
        moved.append(numbers.setdefault(key, len(operations)))
        if moved[-1] == len(operations):
            operations.append(operation)
    constants = np.empty((len(program.constants), len(columns)))
    for content, column in columns.items():
        constants[:, column] = np.frombuffer(content)
    outputs = tuple(moved[each] for each in program.outputs)
    return Program(tuple(operations), outputs, constants, program.tables)


def excess_of_loops(operations: Sequence[Operation]) -> str:
    """Say what is too large in the loops of a program; empty if nothing is."""
    taken = sum(len(each.arguments) for each in operations if each.name in _TAKING)
    if taken > MOST_TAKEN:
        return f"the loops of a formula must take at most {MOST_TAKEN:,} values, got {taken:,}"
    for number, (name, arguments, _) in enumerate(operations):
        if name == "again" and number - arguments[0] - 1 > MOST_IN_STEP:
            return (
                f"a step of a loop must have at most {MOST_IN_STEP:,} operations, got "
                f"{number - arguments[0] - 1:,} (the loop of operation {arguments[0]:,})"
            )
    return ""


def groups_of(program: Program, outputs: Sequence[int]) -> set[str]:
    """The names of the groups on which some results depend, given the numbers of the results."""
    wanted = tuple(program.outputs[each] for each in outputs)
    needed = merged(replace(program, outputs=wanted)).operations
    return {each.name for each in needed} & {*GROUPS}


def unrolled(program: Program, counts: Mapping[int, float]) -> Program:
    """The program with each step of its loops written out.

    `counts` has the number of steps of each loop, by the number of its operation "repeat". The
    constants have further columns, for the numbers of the steps.
    """
    operations, numbers = list[Operation](), dict[int, int]()
    constants, ends = [*program.constants.T], dict[int, list[int]]()
    number, begin, step, states = 0, 0, 0, list[int]()
    while number < len(program.operations):
        name, arguments, which = program.operations[number]
        given = [numbers[each] for each in arguments if each in numbers]
        if name == "repeat":
            begin, step, states = number, 0, given[1:]
        elif name == "again":
            states = ends[number] = given
            if step + 1 < steps_of(counts[begin], program.operations[begin].which):
                number, step = begin, step + 1
        elif name == "state":
            numbers[number] = states[which]
        elif name == "final":
            numbers[number] = ends[arguments[0]][which]
        elif name == "nth":
            numbers[number] = given[step]
        else:
            if name == "step":
                name, given, which = "constant", [], len(constants)
                constants.append(np.full(len(program.constants), float(step)))
            numbers[number] = len(operations)
            operations.append(Operation(name, tuple(given), which))
        number += 1
    outputs = tuple(numbers[each] for each in program.outputs)
    columns = np.array(constants).reshape(-1, len(program.constants)).T
    return Program(tuple(operations), outputs, np.ascontiguousarray(columns), program.tables)


def cause_of(program: Program, values: Sequence[Any]) -> str:
    """The first operation that gives a number that is not finite from finite ones.

    `values` has the value of each operation. The name is empty if there is none.
    """
    finite = [bool(np.isfinite(each).all()) for each in values]
    for number, (name, arguments, _) in enumerate(program.operations):
        if arguments and not finite[number] and all(finite[each] for each in arguments):
            return name
    return ""


# --- the plain twin -------------------------------------------------------------------------------


def take_entries(table: Array, index: Any) -> Any:
    """Entries of a table; NaN where the index is outside or NaN."""
    inside = (index >= 0) & (index < table.size)
    return np.where(inside, table[np.where(inside, index, 0).astype(np.int64)], np.nan)


def as_numbers(mask: Any) -> Any:
    """1 where a mask holds, and 0 elsewhere."""
    return np.where(mask, 1.0, 0.0)


def evaluate_program(
    program: Program,
    groups: Mapping[str, Sequence[Any]],
    t: Any,
    parameters: Mapping[str, Any],
    rows: Any = 0,
    most: int = MOST_STEPS,
) -> tuple[Any, ...]:
    """The values of a program on NumPy arrays, by NumPy's functions.

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
    most : int
        The largest number of steps of a loop that are computed.

    Returns
    -------
    tuple of array or float
        A value for each output.
    """
    values = list[Any]([None] * len(program.operations))
    number, begin, step, steps, states = 0, 0, 0, 0, list[Any]()
    with np.errstate(all="ignore"):
        while number < len(values):
            name, arguments, which = program.operations[number]
            given = [values[each] for each in arguments]
            if name in LOOPS:
                if name == "repeat":
                    values[number], *states = given
                    begin, step, steps = number, 0, steps_of(given[0], min(which, most))
                elif name == "again" and step + 1 < steps:
                    number, step, states = begin, step + 1, given[1:]
                else:
                    values[number] = _of_loop(name, given, which, step, states)
            elif arguments and name not in ("covariate", "take"):
                function = as_numbers if name == "float" else getattr(np, name)
                values[number] = function(*given)
            else:
                values[number] = _read(program, name, which, given, groups, t, parameters, rows)
            number += 1
    return tuple(
        as_numbers(values[each]) if program.operations[each].name in MASKS else values[each]
        for each in program.outputs
    )


def steps_of(count: float, most: int) -> int:
    """The number of steps of a loop; 1 if the count is NaN."""
    return int(min(count, most)) if count >= 1.0 else 1


def _of_loop(name: str, given: list[Any], which: Any, step: int, states: list[Any]) -> Any:
    if name == "state":
        return states[which]
    if name == "step":
        return np.float64(step)
    if name == "nth":
        return given[1 + step]
    return given[1:] if name == "again" else given[0][which]


def _read(
    program: Program,
    name: str,
    which: Any,
    given: list[Any],
    groups: Mapping[str, Sequence[Any]],
    t: Any,
    parameters: Mapping[str, Any],
    rows: Any,
) -> Any:
    """The value of an operation that reads an argument of the formula, or a table."""
    if name in GROUPS:
        return groups[name][which]
    if name == "t":
        return np.float64(t) if np.ndim(t) == 0 else np.asarray(t, np.float64)
    if name == "parameter":
        return np.float64(parameters[which])
    if name == "covariate":
        entries = np.asarray(parameters[which], np.float64)
        return entries[np.asarray(given[0], np.int64)]
    if name == "constant":
        return program.constants[rows, which]
    return take_entries(program.tables[which], *given)
