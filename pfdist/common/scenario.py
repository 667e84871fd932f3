"""A scenario of a job. It stands here because reading a run must not load a compiler."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Scenario:
    """Parameters that the truth may have, their probability, and what divides squared errors."""

    share: float
    parameters: Mapping[str, float | Sequence[float]]
    scale: float = 1.0
