"""The limits, failures and repeats of a sensor: reading a job must not load a model."""

import math
from dataclasses import dataclass, replace

REPEATS = "abcdefghij"
"""The names of measurements that a sensor may repeat at one instant."""


@dataclass(frozen=True)
class Sensing:
    """The limits, failures and repeats of a sensor; by default it has none.

    Parameters
    ----------
    low, high : float
        Values below and above are read as these.
    fails : float or tuple of float
        Probability that a measurement gives nothing, or that of each instant, (T+1,).
    repeats : int
        The largest number of measurements at one instant.
    delay : int
        Number of instants after which a value arrives.
    """

    low: float = -math.inf
    high: float = math.inf
    fails: float | tuple[float, ...] = 0.0
    repeats: int = 1
    delay: int = 0

    @property
    def is_linear(self) -> bool:
        """Whether every measurement gives y itself: no limit and no failure."""
        return replace(self, repeats=1, delay=0) == PLAIN


PLAIN = Sensing()


def names_of_repeats(name: str, repeats: int) -> list[str]:
    """The sensors that a sensor becomes; a model without sensors has the name "".

    >>> names_of_repeats("tube", 1), names_of_repeats("tube", 2), names_of_repeats("", 2)
    (['tube'], ['tube_a', 'tube_b'], ['a', 'b'])
    """
    if repeats == 1:
        return [name] * bool(name)
    return [f"{name}_{each}" if name else each for each in REPEATS[:repeats]]
