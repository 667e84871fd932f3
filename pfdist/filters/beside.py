"""The errors that answers show beside that of the job; a line here registers one."""

from pfdist.common.measurement_times import Lag
from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.other_estimate import FILTERED, SMOOTHED

BESIDE: tuple[ErrorBeside, ...] = (SMOOTHED, FILTERED)


def errors_beside(lag: Lag) -> list[ErrorBeside]:
    """Those that answers to a job show whose estimate has this lag."""
    return [each for each in BESIDE if each.fits(lag)]
