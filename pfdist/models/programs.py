"""Recorded formulas: callables that run the programs that tracing recorded."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.stopping import check
from pfdist.errors import ModelError, PfdistError, TraceError
from pfdist.models.checks import ARGUMENTS, ONE_NUMBER
from pfdist.models.mistakes import (
    error_line,
    is_interrupt,
    place_of,
    place_of_function,
    remedy,
)
from pfdist.models.parameters import Parameter
from pfdist.models.program import (
    GROUPS,
    LOOPS,
    MASKS,
    Array,
    Program,
    cause_of,
    evaluate_program,
    merged,
    unrolled,
)
from pfdist.models.symbols import Recording, RefusedError, Symbol, as_float
from pfdist.models.tracing import MODES, Traced, recording_of


@dataclass(frozen=True, eq=False)
class Programs:
    """A formula that runs its programs: on arrays, on numbers, and on symbols.

    Parameters
    ----------
    name : str
    model : str
        Name of the model.
    traced : Traced
        The programs for the present parameters.
    variants : tuple of Traced
        One for each set of values of the parameters that the programs contain as numbers, including
        the current one.
    place : str
        Place of the user's formula, for error messages; empty if unknown.
    """

    name: str
    model: str
    traced: Traced
    variants: tuple[Traced, ...] = ()
    place: str = field(default="", repr=False)

    def __call__(self, *arguments: Any) -> Any:
        """The values for arrays, numbers or symbols, as of the formula itself."""
        groups = dict(zip(ARGUMENTS[self.name], arguments, strict=True))
        p, t = groups.pop("p"), groups.pop("t", 0)
        recording = recording_of(p, t, *groups.values())
        if recording is None:
            values = self.traced.values(groups, t, p._asdict())
        else:
            values = _recorded_again(*self._program(t), recording, groups, t, p)
        return values[0] if self.name in ONE_NUMBER else values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Programs) and self.traced.hash == other.traced.hash

    def __hash__(self) -> int:
        return hash(self.traced.hash)

    @cached_property
    def reads_time(self) -> bool:
        """Whether the values differ between instants."""
        program = self.traced.programs[0]
        used = {*program.outputs, *chain(*(each.arguments for each in program.operations))}
        return self.traced.mode != MODES[0] or any(
            program.operations[number].name == "t" for number in used
        )

    @cached_property
    def takes_instants(self) -> bool:
        """Whether t may be an array: one program, which repeats no steps, for all instants."""
        (*_, last), mode = self.traced.programs, self.traced.mode
        return mode == MODES[0] and not any(each.name in LOOPS for each in last.operations)

    def _program(self, t: Any) -> tuple[Program, int]:
        if isinstance(t, Symbol) and self.traced.mode != MODES[0]:
            raise RefusedError("a formula recorded for single instants needs t as a number")
        return self.traced.program_at(t)

    def cause(self, *arguments: Any) -> str:
        """The operation that gives a non-finite number, and the formula's place, in words."""
        groups = dict(zip(ARGUMENTS[self.name], arguments, strict=True))
        p, t = groups.pop("p"), groups.pop("t", 0)
        program, row = self.traced.program_at(t)
        every = replace(program, outputs=(*range(len(program.operations)),))
        name = cause_of(program, evaluate_program(every, groups, t, p._asdict(), row))
        return f", in {name}{self.place}" if name else self.place

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> "Programs":
        """The formula for other values of the parameters.

        Raises
        ------
        ModelError
            The programs contain a changed parameter as a number.
        """
        every = (self.traced, *self.variants)
        for each in every:
            known = each.read.items()
            if all(name not in parameters or parameters[name] == value for name, value in known):
                return self if each is self.traced else replace(self, traced=each)
        read = self.traced.read.items()
        names = [name for name, value in read if parameters.get(name, value) != value]
        raise ModelError(
            f"model {self.model}: {', '.join(names)} cannot be changed here, because the recorded "
            f"program of {self.name} contains the value: give the job, whose model is recorded "
            "again",
            argument="parameters",
        )


def _recorded_again(
    program: Program, row: int, recording: Recording, groups: Mapping[str, Any], t: Any, p: Any
) -> tuple[Symbol, ...]:
    if recording.unrolls:
        program = unrolled(program, _counts(program, row, t, p))
    numbers = list[int]()

    def number_of(value: Any) -> int:
        value = as_float(value)
        return value.number if isinstance(value, Symbol) else recording.number(value)

    for name, arguments, which in program.operations:
        if name in GROUPS:
            number = number_of(groups[name][which])
        elif name == "t":
            number = number_of(t)
        elif name == "constant":
            number = recording.number(program.constants[row, which])
        elif name == "parameter":
            number = number_of(getattr(p, which))
        elif name == "covariate":
            index, _, column = program.operations[arguments[0]]
            at = t if index == "t" else int(program.constants[row, column])
            number = number_of(getattr(p, which)[at])
        else:
            entry = recording.table(program.tables[which]) if name == "take" else which
            given = tuple(numbers[each] for each in arguments)
            number = _added(recording, name, given, entry)
        numbers.append(number)
    return tuple(
        as_float(Symbol(recording, numbers[each], _kind(program, each))) for each in program.outputs
    )


def _added(recording: Recording, name: str, given: tuple[int, ...], which: Any) -> int:
    """The number of an operation on others."""
    if name == "repeat":
        return recording.begin(given[0], given[1:], which)
    if name == "again":
        return recording.end(given[0], given[1:])
    return recording.add(name, given, which)


def _counts(program: Program, row: int, t: Any, p: Any) -> dict[int, float]:
    """The number of steps of each loop, which must be a number."""
    loops = [k for k, each in enumerate(program.operations) if each.name == "repeat"]
    counts = tuple(program.operations[k].arguments[0] for k in loops)
    pruned = merged(replace(program, outputs=counts))
    varies = any(each.arguments or each.name != "constant" for each in pruned.operations)
    if varies and recording_of(p, t) is not None:
        raise RefusedError("a loop whose number of steps varies has no derivative")
    values = evaluate_program(pruned, {}, t if varies else 0, p._asdict() if varies else {}, row)
    return dict(zip(loops, map(float, values), strict=True))


def _kind(program: Program, number: int) -> str:
    return "mask" if program.operations[number].name in MASKS else "float"


class Declared:
    """A function of a batched model: from arrays (components, particles) to such an array.

    Parameters
    ----------
    function : callable, optional
        None if only the identity was kept.
    identity : mapping
        Plain data by which the user identifies what the function computes.
    name, model : str
        As errors name them.
    results : int
        Number of its components, if the function is missing.
    """

    reads_time, takes_instants = True, False

    def __init__(
        self,
        name: str,
        model: str,
        identity: Mapping[str, Any],
        function: Callable[..., Any] | None = None,
        results: int = 1,
    ) -> None:
        self.name, self.model, self.identity = name, model, identity
        self.function, self.results = function, results
        if function is not None:
            self.__wrapped__ = function

    @property
    def example(self) -> Any:
        """Values of the right type and number, if only the identity was kept."""
        if self.function is not None:
            return None
        return np.zeros(2) if self.name in ONE_NUMBER else (np.zeros(2),) * self.results

    @property
    def place(self) -> str:
        """The place of the function."""
        return place_of_function(self.function) if self.function else ""

    @property
    def why(self) -> TraceError:
        """Why the function has no program."""
        return TraceError(
            f"model {self.model} is a batched model, which is not traced: the engine 'batched' "
            "calls its functions"
        )

    @property
    def declaration(self) -> str:
        """The identity in one line."""
        hashes = {name: text[:8] for name, text in self.identity["files"].items()}
        parts = {**hashes, **self.identity["libraries"]}
        named = "".join(f", {name} {text}" for name, text in parts.items())
        coupled = ", coupled" * self.is_coupled
        return f"version {self.identity['version']}{named}{coupled}"

    @property
    def is_coupled(self) -> bool:
        """Whether a particle's value depends on the others in the array."""
        return bool(self.identity["coupled"])

    @property
    def together(self) -> int:
        """Approximate number of particles in an array; 1 means those of one draw."""
        return 1 if self.is_coupled else int(self.identity["together"])

    def __call__(self, *arguments: Any) -> Any:
        """The rows of the function's array; arguments may be tuples of rows."""
        if recording_of(arguments[-1], *arguments[:-1]) is not None:
            raise RefusedError("a function of a batched model takes arrays")
        given = [_as_array(each) for each in arguments[:-1]]
        sizes = {each.shape[1] for each in given if isinstance(each, np.ndarray)}
        if self.function is None:
            raise ModelError(
                f"model {self.model}: a run does not contain the functions of a batched model: "
                "give the job"
            )
        function, size = self.function, max(sizes)
        array = self._called(lambda *each: _stacked(function(*each), size), (*given, arguments[-1]))
        rows = self._rows(array, size)
        if isinstance(arguments[0], tuple) and not arguments[0] and sizes == {1}:  # without noise
            return tuple(row[0] for row in rows)
        return rows[0] if self.name in ONE_NUMBER else tuple(rows)

    def tried(self, *arguments: Any) -> Any:
        """The rows, after a check that a second call gives the same."""
        first = self(*arguments)
        if not np.array_equal(first, self(*arguments), equal_nan=True):
            raise ModelError(
                f"model {self.model}: {self.name} must compute the same whenever it is called, got "
                f"two different results: randomness comes from w and v alone, as sd * w[0]"
                f"{self.place}"
            )
        return first

    def _called(self, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
        """The values of the function; a `ModelError` says that it failed."""
        check()
        try:
            return function(*arguments)
        except (MemoryError, PfdistError):
            raise
        except BaseException as error:  # a formula may raise any exception
            place = place_of(error)
            if is_interrupt(error) or not (isinstance(error, Exception) or place):
                raise
            given = dict(zip(ARGUMENTS[self.name], arguments, strict=True))
            at = f" at t = {given['t']}" if "t" in given else ""
            raise ModelError(
                f"model {self.model}: {self.name} failed: {error_line(error)}{at}"
                f"{remedy(error)}{place}"
            ) from error

    def _rows(self, array: NDArray[Any], size: int) -> Array:
        """The values of the function as an array (components, particles)."""
        is_number = self.name in ONE_NUMBER
        rows = array[None] if is_number and array.ndim == 1 else array
        right = (1, size) if is_number else (*rows.shape[:1], size)
        if rows.dtype != np.float64 or rows.shape != right:
            wanted = "(particles,)" if is_number else "(components, particles)"
            raise ModelError(
                f"model {self.model}: {self.name} must give an array {wanted} of float64 for "
                f"{size:,} particles, got {array.dtype} of shape {array.shape}"
                f"{_IN_DOUBLES if array.dtype == np.float32 else ''}"
            )
        return rows

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Declared) and self.identity == other.identity

    def __hash__(self) -> int:
        return hash(self.name)


_IN_DOUBLES = (
    ": JAX computes in float64 after jax.config.update('jax_enable_x64', True), and PyTorch after "
    "torch.set_default_dtype(torch.float64); or convert what you give"
)


def _stacked(value: Any, size: int) -> NDArray[Any]:
    """The value of a function as an array; a row of a tuple may be a number."""
    if isinstance(value, tuple | list):
        value = np.stack([np.broadcast_to(np.asarray(each), size) for each in value])
    return np.asarray(value)


def _as_array(argument: Any) -> Any:
    """A group of components as an array (components, particles); numbers remain."""
    if not isinstance(argument, tuple):
        return argument
    if not argument:
        return np.empty((0, 1))
    array = np.stack(np.broadcast_arrays(*(np.atleast_1d(each) for each in argument)))
    array.flags.writeable = False  # a function may not change its arguments
    return array
