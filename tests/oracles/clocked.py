"""A clock for models that read it, where a test has no job."""

from itertools import accumulate, cycle, islice

from pfdist import StateSpaceModel

_STEPS = (0.25, 0.5, 1.0)


def times_of(horizon: int) -> tuple[float, ...]:
    """The times of the instants 0..T, at irregular distances."""
    return tuple(accumulate(islice(cycle(_STEPS), horizon), initial=0.0))


def with_clock(model: StateSpaceModel, horizon: int) -> StateSpaceModel:
    """The model on an irregular clock if its formulas read a clock, otherwise the model itself."""
    return model.on_clock(times_of(horizon)) if model.reads_clock else model
