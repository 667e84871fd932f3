"""What a run says of itself while it goes on."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Found:
    """What a comparison has found of a set of times so far.

    Parameters
    ----------
    name : str
    mean_relative_gain : float
    interval : (float, float)
        Of the mean relative gain, 95 %.
    positive_fraction : float
    gain_of_means : float
        1 - E[mse] / E[mse of the reference].
    gain_of_means_interval : (float, float)
        95 %.
    """

    name: str
    mean_relative_gain: float
    interval: tuple[float, float]
    positive_fraction: float
    gain_of_means: float
    gain_of_means_interval: tuple[float, float]


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    phase : str
        A search's name, or ``comparison``.
    done, total : float
        Particle-steps, over all phases and sets of times, as far as they can be foreseen.
    evaluations : int
        Evaluations finished in this phase, copies counted; in the comparison, draws.
    generation, generations : int
        Of the search; 0 in the comparison.
    best : float or None
        Cost of the set the search would return now.
    mean : float or None
        Mean cost of the last finished generation.
    found : tuple of Found
        Of the comparison, a set each but the reference.
    """

    phase: str
    done: float
    total: float
    evaluations: int = 0
    generation: int = 0
    generations: int = 0
    best: float | None = None
    mean: float | None = None
    found: tuple[Found, ...] = ()


Report = Callable[[Progress], None]
