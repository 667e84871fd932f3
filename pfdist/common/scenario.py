"""A scenario of a job, in this room because reading a run must not load a compiler."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Scenario:
    """Possible parameters of the truth, their probability, and the divisor of squared errors."""

    share: float
    parameters: Mapping[str, float | Sequence[float]]
    scale: float = 1.0
