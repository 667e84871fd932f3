"""The errors that answers show beside that of the job; a line here registers one."""

from collections.abc import Sequence

from pfdist.common.measurement_times import Lag
from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.other_estimate import FILTERED, SMOOTHED

BESIDE: tuple[ErrorBeside, ...] = (SMOOTHED, FILTERED)


def errors_beside(
    lag: Lag, weights: Sequence[float] | None, delays: Sequence[int]
) -> list[ErrorBeside]:
    """Those that answers to a job show, by the lag of its estimate, its weights and its delays.

    Where only the error of the last instant counts, and all values are there, no estimate differs.
    """
    is_same = weights is not None and not any(weights[:-1]) and not delays
    return [] if is_same else [each for each in BESIDE if each.fits(lag)]
