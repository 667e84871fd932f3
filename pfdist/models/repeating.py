"""Loops in formulas: steps, each of which starts from the values of the step before.

A loop of Python is recorded step by step, and a long program compiles slowly. `repeated_steps`
records one step, and machine code repeats it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pfdist.models.program import MOST_STEPS, steps_of
from pfdist.models.symbols import Recording, Symbol, as_float

Step = Callable[[tuple[Any, ...], Any, tuple[Any, ...]], Sequence[Any]]


def repeated_steps(
    step: Step,
    x: Sequence[Any],
    count: Any,
    each: Sequence[Sequence[Any]] = (),
    most: int = MOST_STEPS,
) -> tuple[Any, ...]:
    """The values after a number of steps.

    Parameters
    ----------
    step : callable
        ``(x, k, entries) -> x`` with the number k of the step, and its entries of `each`.
    x : sequence
        The first values.
    count : float
        The number of steps, from 1 to `most`; it must be the same for all particles.
    each : sequence of sequence
        Sequences of `most` values; step k takes entry k of each.
    most : int

    Returns
    -------
    tuple
        The values after the last step, as many as x has.

    Examples
    --------
    >>> repeated_steps(lambda x, k, entries: (x[0] + k,), (0,), 4)
    (6,)
    """
    recording = next(
        (value.recording for value in (*x, count, *sum(map(tuple, each), ())) if _is_symbol(value)),
        None,
    )
    if recording is None or ((recording.in_loop or recording.unrolls) and not _is_symbol(count)):
        values = tuple(x)
        for k in range(steps_of(count, most)):
            values = _checked(step(values, k, tuple(entries[k] for entries in each)), x)
        return values
    return _recorded(recording, step, x, count, each, most)


def _recorded(
    recording: Recording,
    step: Step,
    x: Sequence[Any],
    count: Any,
    each: Sequence[Sequence[Any]],
    most: int,
) -> tuple[Any, ...]:

    def operand(value: Any) -> int:
        return recording.operand(as_float(np.asarray(value)[()]))

    loop = recording.begin(operand(count), tuple(map(operand, x)), most)
    states = tuple(Symbol(recording, recording.add("state", (loop,), k)) for k in range(len(x)))
    k = Symbol(recording, recording.add("step", (loop,)))
    entries = tuple(
        Symbol(recording, recording.add("nth", (loop, *map(operand, values)))) for values in each
    )
    following = _checked(step(states, k, entries), x)
    again = recording.end(loop, tuple(map(operand, following)))
    return tuple(Symbol(recording, recording.add("final", (again,), k)) for k in range(len(x)))


def _checked(values: Any, x: Sequence[Any]) -> tuple[Any, ...]:
    """The values of a step, of which there must be as many as before."""
    if len(values) != len(x):
        raise ValueError(f"a step must give {len(x)} values, got {len(values)}")
    return tuple(values)


def _is_symbol(value: Any) -> bool:
    return isinstance(value, Symbol)
