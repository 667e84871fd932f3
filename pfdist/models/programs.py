"""Recorded formulas: callables that compute with the programs that tracing recorded."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pfdist.common.stopping import check
from pfdist.errors import ModelError, PfdistError, TraceError
from pfdist.models.checks import ARGUMENTS, ONE_NUMBER
from pfdist.models.mistakes import error_line, is_interrupt, place_of, remedy
from pfdist.models.parameters import Parameter
from pfdist.models.program import GROUPS, MASKS, Array, Program, cause_of, evaluate
from pfdist.models.symbols import Recording, RefusedError, Symbol, as_float
from pfdist.models.tracing import MODES, Traced, recording_of


@dataclass(frozen=True, eq=False)
class Programs:
    """A formula that computes by its programs: on arrays, on numbers, and on symbols.

    Parameters
    ----------
    name : str
    model : str
        Name of the model.
    traced : Traced
        The programs for the present parameters.
    variants : tuple of Traced
        One for each set of values of the parameters that the programs contain as numbers, the
        current one included.
    place : str
        Where the user's formula is, for errors; empty if that is not known.
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

    def _program(self, t: Any) -> tuple[Program, int]:
        if isinstance(t, Symbol) and self.traced.mode != MODES[0]:
            raise RefusedError("a formula that was recorded for each instant needs t as a number")
        return self.traced.program_at(t)

    def cause(self, *arguments: Any) -> str:
        """The operation that gives a number that is not finite, and the formula's place."""
        groups = dict(zip(ARGUMENTS[self.name], arguments, strict=True))
        p, t = groups.pop("p"), groups.pop("t", 0)
        program, row = self.traced.program_at(t)
        every = replace(program, outputs=(*range(len(program.operations)),))
        name = cause_of(program, evaluate(every, groups, t, p._asdict(), row))
        return f", in {name}{self.place}" if name else self.place

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> "Programs":
        """The formula for other values of the parameters.

        Raises
        ------
        ModelError
            The programs have a changed parameter as a number.
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
    """Record what a program computes on symbols."""
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
            number = recording.add(name, tuple(numbers[each] for each in arguments), entry)
        numbers.append(number)
    return tuple(
        as_float(Symbol(recording, numbers[each], _kind(program, each))) for each in program.outputs
    )


def _kind(program: Program, number: int) -> str:
    return "mask" if program.operations[number].name in MASKS else "float"


class Untraced:
    """A formula that cannot be traced, with its values at test points, which identify it.

    Parameters
    ----------
    function : callable, optional
        The formula; it is missing where only the values were kept.
    values : array, (instants, components, numbers)
        NaN if the formula failed.
    name, model : str
        As errors name them.
    refused : TraceError, optional
        Why it cannot be traced.
    """

    def __init__(
        self,
        name: str,
        model: str,
        values: Array,
        function: Callable[..., Any] | None = None,
        refused: TraceError | None = None,
    ) -> None:
        self.name, self.model, self.values = name, model, values
        self.function, self.refused = function, refused
        if function is not None:
            self.__wrapped__ = function

    @property
    def example(self) -> Any:
        """Values of the right kind and number, if only these were kept."""
        if self.function is not None:
            return None
        numbers = tuple(np.zeros(2) for _ in self.values[0])
        return numbers[0] if self.name in ONE_NUMBER else numbers

    def __call__(self, *arguments: Any) -> Any:
        """The values of the formula itself."""
        if self.function is None:
            raise ModelError(
                f"model {self.model}: {self.name} could not be traced, so the run's folder does "
                "not contain it: give the job"
            )
        check()
        if recording_of(arguments[-1], *arguments[:-1]) is not None:
            return self.function(*arguments)  # the symbols refuse what is wrong
        try:
            value = self.function(*arguments)
        except (MemoryError, PfdistError):
            raise
        except BaseException as error:  # a formula may raise any exception
            place = place_of(error)
            if is_interrupt(error) or not (isinstance(error, Exception) or place):
                raise
            given = dict(zip(ARGUMENTS[self.name], arguments, strict=True))
            at = f" at t = {given['t']}" if "t" in given else ""
            advice = self.refused.advice if self.refused else ""
            raise ModelError(
                f"model {self.model}: {self.name} failed: {error_line(error)}{at}"
                f"{f'; {advice}' if advice else remedy(error)}{place}"
            ) from error
        return tuple(value) if isinstance(value, np.ndarray) and value.ndim > 1 else value

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Untraced):
            return False
        if self.function is None and other.function is None:
            return np.array_equal(self.values, other.values, equal_nan=True)
        return self.function == other.function

    def __hash__(self) -> int:
        return hash(self.name)
