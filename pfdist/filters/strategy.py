"""Strategies: whether a system is measured is decided on the way, instant by instant."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from pfdist.filters.one_filter import Followed


class Strategy(Protocol):
    """Decides when one system is measured: `pfdist.Rule`, `pfdist.Planner`, or a class of yours.

    It keeps what it has decided, because the loop over the instants may be the user's.
    """

    def decide(self, belief: Any, t: int) -> Sequence[str]:
        """The names of the sensors that measure at an instant; none if nothing is measured.

        It is asked once about each instant, in the order of time. `belief` is the filter of the
        system, such as a `pfdist.Filter`, with all values that have arrived before t.
        """


def follow(
    strategy: Strategy,
    belief: Followed,
    look: Callable[[int, Sequence[str]], Any],
    instants: Iterable[int],
    delays: Mapping[str, int],
) -> None:
    """Filter a system that is measured when a strategy decides.

    Parameters
    ----------
    strategy : Strategy
    belief : Filter
        The filter of the system; it receives all measurements.
    look : callable
        Gives the measurement (m,) whose values arrive at an instant, from the instant and the names
        of the sensors that have measured; the components of others are NaN.
    instants : iterable of int
    delays : mapping of str to int
        The number of instants after which the value of a sensor arrives; 0 for others.

    Raises
    ------
    MeasurementsError
        No particle explains a measurement.
    """
    arriving = defaultdict[int, list[str]](list)
    for t in instants:
        for sensor in strategy.decide(belief, t):
            arriving[t + delays.get(sensor, 0)].append(sensor)
        if sensors := arriving.pop(t, None):
            belief.update(t, look(t, sensors))
