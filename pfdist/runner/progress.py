"""What a run says of itself while it goes on."""

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    phase : str
        A search's name, or ``comparison``.
    done, total : int
        Draws filtered, over all phases and sets of times: the measure of work.
    evaluations : int
        Evaluations finished in this phase, copies counted; in the comparison, draws.
    generation, generations : int
        Of the search; 0 in the comparison.
    best : float or None
        Cost of the set the search would return now.
    mean : float or None
        Mean cost of the last finished generation.
    """

    phase: str
    done: int
    total: int
    evaluations: int = 0
    generation: int = 0
    generations: int = 0
    best: float | None = None
    mean: float | None = None


Report = Callable[[Progress], None]
