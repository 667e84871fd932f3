"""Tracing: a call of a formula with symbols, which gives a program.

The time t and the parameters are also symbols, the same for all particles. A formula that needs t
as a number, for a dictionary or a branch, is traced again for each instant; its parameters are then
symbols whose values a branch may ask for. A formula that needs them as keys or arrays gets numbers.
Programs of single instants with the same operations become one, with constants in rows of a table.
"""

import hashlib
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
from numba import errors
from numpy.typing import NDArray

from pfdist.common.stopping import check
from pfdist.common.telling import Waiting
from pfdist.errors import ModelError, TraceError
from pfdist.models.mistakes import (
    BATCHED,
    RANDOM,
    error_line,
    is_interrupt,
    place_of,
    place_of_function,
    refusal,
    remedy,
)
from pfdist.models.parameters import Parameter, named_parameters
from pfdist.models.program import GROUPS, LOOPS, Array, Program, evaluate_program, merged
from pfdist.models.symbols import Recording, RefusedError, Symbol

MOST_STRUCTURES: Final = 32
MOST_CONSTANTS: Final = 2**23  # numbers of a formula, 64 MiB
_ONE_AT_A_TIME = threading.RLock()
_CLOSE, _TINY = 1e-9, 1e-12  # differences of a formula that is called with numbers
_MOST_TRIED = 8  # instants at which a division by 0 may be an error of Python
_TRIED = np.array([[0.3, -1.7, 0.9, 2.1, -0.4], [-0.8, 0.6, 1.3, -0.2, 0.7]])

MODES: Final = ("t and parameters are symbols", "t is a number", "t and parameters are numbers")
"""Ways to call a formula, in the order in which tracing tries them."""


@dataclass(frozen=True, eq=False)
class Traced:
    """A formula, traced at successive instants.

    Parameters
    ----------
    instants : range
    programs : tuple of Program
        Programs with different operations. Each has a row of constants for each of its instants, in
        their order.
    which : array of int64, (instants,)
        The program of each instant.
    mode : str
        One of `MODES`.
    read : mapping of str to float or sequence of float
        The parameters that the programs contain as numbers, with their values.
    """

    instants: range
    programs: tuple[Program, ...]
    which: NDArray[np.int64]
    mode: str
    read: Mapping[str, Parameter] = field(default_factory=dict)

    @classmethod
    def symbolic(cls, program: Program, instants: range) -> "Traced":
        """A formula with one program for all instants."""
        return cls(instants, (program,), np.zeros(len(instants), np.int64), MODES[0])

    @cached_property
    def row(self) -> NDArray[np.int64]:
        """The row of the program's constants at each instant, (instants,)."""
        row = np.zeros(self.which.size, np.int64)
        if self.mode != MODES[0]:
            for number in range(len(self.programs)):
                is_here = self.which == number
                row[is_here] = np.arange(is_here.sum())
        return row

    def at(self, instants: range) -> "Traced":
        """The same formula at other instants.

        Raises
        ------
        ModelError
            Instants have different constants, and some of these instants were not traced.
        """
        if instants == self.instants:
            return self
        if self.mode == MODES[0]:
            return Traced.symbolic(self.programs[0], instants)
        if not (instants[0] in self.instants and instants[-1] in self.instants):
            raise ModelError(
                f"it was recorded for t = {self.instants[0]} to {self.instants[-1]}, got "
                f"t = {instants[0]} to {instants[-1]}: give the job, whose model is recorded again"
            )
        first = self.instants.index(instants[0])
        here = slice(first, first + len(instants))
        which, row = self.which[here], self.row[here]
        numbers, order = np.unique(which, return_inverse=True)
        programs = tuple(
            replace(program, constants=program.constants[row[which == number]])
            for number in numbers
            for program in self.programs[number : number + 1]
        )
        return replace(self, instants=instants, programs=programs, which=order)

    def values(
        self, groups: Mapping[str, Sequence[Any]], t: int, parameters: Mapping[str, Parameter]
    ) -> tuple[Any, ...]:
        """The values of the formula for arrays, by NumPy's functions: its plain twin."""
        program, row = self.program_at(t)
        return evaluate_program(program, groups, t, parameters, row)

    def program_at(self, t: Any) -> tuple[Program, int]:
        """The program of an instant, and the row of its constants.

        Raises
        ------
        ModelError
            The instant was not traced.
        """
        if self.mode == MODES[0]:
            return self.programs[0], 0
        if t not in self.instants:
            self.at(range(t, t + 1))
        at = self.instants.index(t)
        return self.programs[self.which[at]], int(self.row[at])

    @cached_property
    def hash(self) -> str:
        """Hash of the programs and their instants."""
        at = () if self.mode == MODES[0] else (self.instants, self.which.tolist())
        programs = [each.hash for each in self.programs]
        content = repr((self.mode, programs, at)).encode()
        return hashlib.blake2b(content, digest_size=16).hexdigest()


@dataclass(frozen=True)
class Formula:
    """A formula to be traced.

    Parameters
    ----------
    function : callable
    name : str
        Name in error messages.
    arguments : mapping of str to int
        Number of components of each argument that is a tuple, in the order of the arguments; 0 for
        t and p.
    parameters : mapping of str to float or sequence of float
        Those that vary with t have an entry for each instant 0..T.
    model : str
        Name of the model.
    results : int
        The required number of results at each instant; 0 if any number is right.
    """

    function: Callable[..., Any]
    name: str
    arguments: Mapping[str, int]
    parameters: Mapping[str, Parameter]
    model: str
    results: int = 0

    @cached_property
    def _numbers(self) -> "_Numbers":
        return _Numbers(named_parameters(self.parameters))

    @property
    def read(self) -> dict[str, Parameter]:
        """The parameters that the formula has read as numbers so far, in the model's order."""
        read = self._numbers.read
        return {name: value for name, value in self.parameters.items() if name in read}

    def recorded(self, mode: str, t: int) -> Program:
        """The program of one call at the instant t."""
        recording = Recording(partial(self._value, t)) if mode == MODES[1] else Recording()
        given = [
            self._given(name, count, recording, mode, t) for name, count in self.arguments.items()
        ]
        with np.errstate(all="ignore"):  # as in the compiled program
            value = self.function(*given)
        return recording.closed(self._outputs(value))

    def _value(self, t: int, program: Program) -> float | None:
        """The value of a program, whose parameters are then read; None if it needs particles."""
        if {each.name for each in program.operations} & {*GROUPS, *LOOPS}:
            return None
        self._numbers.read.update(
            each.which for each in program.operations if each.name in ("parameter", "covariate")
        )
        return float(*evaluate_program(program, {}, t, self.parameters))

    def with_numbers(self, groups: Mapping[str, tuple[Any, ...]], t: int) -> tuple[Any, ...]:
        """The values of the formula for one particle; empty if it fails or needs symbols."""
        given = {**groups, "t": t, "p": self._numbers.numbers}
        try:
            with np.errstate(all="ignore"):
                value = self.function(*(given[name] for name in self.arguments))
                values = value if isinstance(value, tuple) else np.atleast_1d(value)
                return tuple(np.float64(each) for each in values)
        except BaseException as error:  # a formula may raise any exception
            if is_interrupt(error):
                raise
            return ()

    def _given(self, name: str, count: int, recording: Recording, mode: str, t: int) -> Any:
        if name == "t":
            if mode != MODES[0]:
                return t
            return Symbol(recording, recording.add("t", ()), "whole")
        if name == "p":
            numbers = mode == MODES[2]
            return self._numbers if numbers else _Parameters(recording, self.parameters)
        return tuple(Symbol(recording, recording.add(name, (), i)) for i in range(count))

    def _outputs(self, value: Any) -> list[Any]:
        components = [value]
        if isinstance(value, tuple) or (isinstance(value, np.ndarray) and value.ndim):
            components = list(value)
        outputs = [_result(each) for each in components]
        if not outputs or any(each is None for each in outputs):
            pairs = zip(components, outputs, strict=True)
            wrong = next((each for each, output in pairs if output is None), value)
            raise RefusedError(f"{self.name} must give numbers, got {type(wrong).__name__}")
        return outputs


def _result(value: Any) -> Any:
    """A component of a result; None if it is no number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, Symbol):
        return value
    numbers = bool | int | float | np.integer | np.floating | np.bool_
    return value if isinstance(value, numbers) else None


class _Numbers:
    """Parameters as numbers, which remember which of them were read."""

    def __init__(self, numbers: Any) -> None:
        self.numbers, self.read = numbers, set[str]()

    def __getattr__(self, name: str) -> Any:
        self.read.update(self.numbers._fields if name.startswith("_") else (name,))
        return getattr(self.numbers, name)


class _Parameters:
    """Parameters as symbols, which a formula reads as ``p.sd`` and ``p.rate[t]``."""

    def __init__(self, recording: Recording, parameters: Mapping[str, Parameter]) -> None:
        self._recording, self._parameters = recording, parameters

    def __getattr__(self, name: str) -> Any:
        if name not in self._parameters:
            raise AttributeError(f"'Parameters' object has no attribute '{name}'")
        value = self._parameters[name]
        if isinstance(value, tuple):
            return Covariate(self._recording, name, len(value))
        return Symbol(self._recording, self._recording.add("parameter", (), name))


class Covariate:
    """A parameter with an entry for each instant."""

    def __init__(self, recording: Recording, name: str, size: int) -> None:
        self._recording, self._name, self._size = recording, name, size

    def __getitem__(self, index: Any) -> Symbol:
        """The entry of an instant: of t itself, or of a number."""
        recording = self._recording
        if isinstance(index, Symbol):
            if recording.operations[index.number].name != "t":
                raise RefusedError("an entry of a parameter at another instant than t")
            number = index.number
        else:
            number = recording.number(range(self._size)[index])
        return Symbol(recording, recording.add("covariate", (number,), self._name))

    def __getattr__(self, name: str) -> Any:
        raise RefusedError(f"{self._name} as an array of numbers")


def recording_of(p: Any, *arguments: Any) -> Recording | None:
    """The recording of the symbols among the arguments of a call; None if all are numbers."""
    if isinstance(p, _Parameters):
        recording: Recording = vars(p)["_recording"]
        return recording
    parts = (each for group in arguments for each in (group if type(group) is tuple else (group,)))
    return next((each.recording for each in parts if isinstance(each, Symbol)), None)


def trace(formula: Formula, instants: range, earlier: Traced | None = None) -> Traced:
    """A formula traced at successive instants, with as many symbols as possible.

    If it was traced at other instants earlier, and has one program for all, this is only checked.

    Raises
    ------
    TraceError
        The formula is not deterministic, uses a symbol in a way that cannot be recorded, or is too
        large. The error names the formula, t and the user's line.
    ModelError
        The formula also fails with numbers.
    """
    for mode in MODES:
        try:
            with _ONE_AT_A_TIME:  # a formula may keep values in an object while it computes
                if mode == MODES[0]:
                    return _symbolic(formula, instants, earlier)
                return _by_instants(formula, mode, instants)
        except ModelError:
            raise
        except BaseException as error:  # a formula may raise any exception
            if is_interrupt(error):
                raise
            if mode == MODES[-1]:
                raise untraceable(formula.model, formula.name, error) from error
    raise AssertionError


class _DiffersError(Exception):
    """A formula computes something else with numbers than with symbols."""

    def __str__(self) -> str:
        return "it computes something else with numbers than with symbols"


def _symbolic(formula: Formula, instants: range, earlier: Traced | None) -> Traced:
    if earlier and earlier.mode == MODES[0]:
        program = earlier.programs[0]
    else:
        program = _recorded_at(formula, MODES[0], instants[0])
        _check_same(formula, program, formula.recorded(MODES[0], instants[0]), None)
    _check_numbers(formula, instants, lambda t: (program, 0))
    for t in _divisions_by_zero(formula, program, instants):
        _recorded_at(formula, MODES[-1], t)  # raises the error of Python, if it is one
    return Traced.symbolic(program, instants)


def _by_instants(formula: Formula, mode: str, instants: range) -> Traced:
    """Trace each instant by itself; equal programs become one."""
    structures, which = dict[Any, int](), list[int]()
    firsts, constants, size = list[Program](), list[list[Any]](), 0
    waiting = Waiting(f"Tracing {formula.name} of {formula.model}", len(instants))
    for done, t in enumerate(instants):
        check()
        waiting.step(done)
        program = _recorded_at(formula, mode, t)
        number = structures.setdefault(program.structure, len(structures))
        if number == len(firsts):
            firsts.append(program)
            constants.append([])
        which.append(number)
        constants[number].append(program.constants[0])
        size += program.constants.size
        _check_limits(formula, len(firsts), size)
    programs = tuple(
        Program(first.operations, first.outputs, np.array(rows), first.tables)
        for first, rows in zip(firsts, constants, strict=True)
    )
    read = formula.read
    traced = Traced(instants, programs, np.array(which), MODES[2] if read else mode, read)
    for t in _few(instants):
        (before,) = traced.at(range(t, t + 1)).programs
        _check_same(formula, before, _recorded_at(formula, mode, t), t)
    _check_numbers(formula, instants, traced.program_at)
    return traced


def check_results(formula: str, program: Program, results: int, t: int) -> None:
    """Raise `ModelError` unless a program gives the right number of results.

    Compiled code writes them into arrays of this length.
    """
    if results and len(program.outputs) != results:
        raise ModelError(
            f"{formula} must give {results} result{'s' * (results > 1)} at each instant, got "
            f"{len(program.outputs)} at t = {t}"
        )


def _recorded_at(formula: Formula, mode: str, t: int) -> Program:
    """The program of an instant; with numbers alone, an error names t."""
    try:
        program = formula.recorded(mode, t)
        check_results(f"model {formula.model}: {formula.name}", program, formula.results, t)
        return program
    except ModelError:
        raise
    except BaseException as error:  # a formula may raise any exception
        if mode == MODES[-1] and not is_interrupt(error):
            groups = _groups(formula).items()
            single = {
                name: tuple(values[0] for values in components) for name, components in groups
            }
            fails = not isinstance(error, RefusedError) and not formula.with_numbers(single, t)
            raise untraceable(formula.model, formula.name, error, t, fails=fails) from error
        raise


def _divisions_by_zero(formula: Formula, program: Program, instants: range) -> list[int]:
    """The first instants at which a divisor that all particles share is 0."""
    shared = merged(replace(program, outputs=program.shared_divisors))
    values = evaluate_program(shared, {}, np.array(instants), formula.parameters)
    zero = np.zeros(len(instants), np.bool_)
    for value in values:
        zero |= value == 0.0
    return [instants[place] for place in np.flatnonzero(zero)[:_MOST_TRIED]]


def _few(instants: range) -> list[int]:
    return sorted({instants[0], instants[len(instants) // 2], instants[-1]})


def _check_same(formula: Formula, first: Program, second: Program, t: int | None) -> None:
    """Raise a `TraceError` if two calls did not compute the same."""
    if first.hash != second.hash:
        at = "" if t is None else f" at t = {t}"
        raise TraceError(
            f"model {formula.model}: {formula.name} must compute the same whenever it is called, "
            f"got two different programs{at}: {RANDOM}; a simulator that takes its noise from w "
            f"is a pfdist.BatchedModel, see docs/simulators.md{place_of_function(formula.function)}"
        )


def _groups(formula: Formula) -> dict[str, list[Array]]:
    """Components of a few particles, for each argument that is a tuple."""
    return {
        name: [np.roll(_TRIED[i % 2], i // 2) for i in range(count)]
        for name, count in formula.arguments.items()
        if name not in "tp"
    }


def _check_numbers(
    formula: Formula, instants: range, program_at: Callable[[int], tuple[Program, int]]
) -> None:
    """Raise an error if a program gives something else than its formula for a single particle."""
    groups = _groups(formula)
    for t in _few(instants):
        program, row = program_at(t)
        tried = _TRIED.shape[1]
        values = evaluate_program(program, groups, t, formula.parameters, row)
        found = [np.broadcast_to(each, tried) for each in values]
        for k in range(tried):
            single = {name: tuple(each[k] for each in parts) for name, parts in groups.items()}
            expected = formula.with_numbers(single, t)
            for a, b in zip(found, expected, strict=True) if expected else ():
                same = math.isclose(a[k], b, rel_tol=_CLOSE, abs_tol=_TINY)
                if not same and not (math.isnan(a[k]) and math.isnan(b)):
                    raise _DiffersError


def _check_limits(formula: Formula, structures: int, size: int) -> None:
    if structures > MOST_STRUCTURES:
        raise TraceError(
            f"model {formula.model}: {formula.name} must compute at most {MOST_STRUCTURES} "
            "different things at different instants, got more: write pfdist.where, or a parameter "
            "with a value for each instant, and not a branch on t"
        )
    if size > MOST_CONSTANTS:
        raise TraceError(
            f"model {formula.model}: {formula.name} must have at most {MOST_CONSTANTS:,} constants "
            "over all instants, got more: a smaller horizon helps"
        )


def untraceable(
    model: str, formula: str, error: BaseException, t: int | None = None, *, fails: bool = False
) -> ModelError:
    """The error of a formula in one line, with t, the user's line and what to write instead.

    It is a `TraceError` unless the formula also fails with numbers.
    """
    if isinstance(error, errors.NumbaError):
        return ModelError(
            f"model {model}: {formula} must call functions of Python, got one that numba.njit "
            f"compiled; write f.py_func instead of f{place_of(error)}"
        )
    known = isinstance(error, RefusedError | _DiffersError)
    what = refusal(error) if known else f"{error_line(error)}{remedy(error)}"
    at = "" if t is None else f" at t = {t}"
    if fails:
        return ModelError(f"model {model}: {formula} failed: {what}{at}{place_of(error)}")
    if isinstance(error, IndexError) and "only integers" in str(error):
        what = f"{error_line(error)}: by a value of particles it is take(table, value.astype(int))"
    advice = "" if BATCHED in what else f"; {BATCHED}"
    return TraceError(
        f"model {model}: {formula} cannot be traced{at}: {what}{place_of(error)}{advice}"
    )
