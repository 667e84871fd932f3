"""The linearized design: exchanges by linearized errors, which take no filter.

Sources: Fedorov, "Theory of optimal experiments", 1972 (exchange); see `pfdist.filters.linearized`
for the errors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count
from pfdist.search.base import FINALISTS, Candidate, best_of

Found = tuple[Evaluation, ...]
LinearizedErrors = Callable[[Sequence[Times]], NDArray[np.float64]]
"""The linearized errors of sets, (S,)."""


def designs(
    feasible: Feasible, errors: LinearizedErrors, starts: Sequence[Times], most: float
) -> list[Times]:
    """The sets at which exchanges from some feasible sets end, the lowest linearized error first.

    One time after another is exchanged for the best other one, until none lowers the error, or so
    many sets were looked at.
    """
    ends, left = dict[Times, float](), most
    for start in dict.fromkeys(starts):
        best, error, since = start, float(_rounded(errors([start]))[0]), 0
        while since < len(best) and left > 0:
            # With money, what the rest buys differs: then all exchanges at once.
            moved = best[since] if feasible.counted else None
            others = feasible.exchanges(best, moved=moved)
            since = since + 1 if feasible.counted else len(best)
            left -= len(others)
            found = _rounded(errors(others)) if others else np.empty(0)
            if found.size and found.min() < error:
                best, error, since = others[int(found.argmin())], float(found.min()), 0
        ends[feasible.canonical(best)] = error
        if left <= 0:
            break
    return sorted(ends, key=lambda times: ends[times])


def _rounded(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The errors with seven digits, so that no rounding of a processor decides."""
    scale = 10.0 ** np.floor(np.log10(np.maximum(np.abs(errors), 1e-300)))
    return np.where(np.isfinite(errors), np.round(errors / scale, 6) * scale, np.inf)


@method("linearized", online=False)
@dataclass(frozen=True)
class LinearizedDesign:
    """Linearized design: exchanges by the derivatives of the model, as PopED and PFIM.

    The sets at which they end are then evaluated by filters.

    Parameters
    ----------
    feasible : Feasible
    errors : callable
        The linearized errors of sets, `LinearizedErrors`, which whoever searches must give.
    starts : int
        Number of sets from which exchanges begin: regular times, then random ones.
    """

    feasible: Feasible
    errors: Any = field(default=None, compare=False)
    starts: Count = 5

    @property
    def generations(self) -> int:
        """One: exchanges take no filter."""
        return 1

    @property
    def evaluations(self) -> float:
        """The number of sets that filters evaluate, at most."""
        return min(self.starts, FINALISTS)

    def init(self) -> Found:
        """The state before the exchanges."""
        return ()

    def ask(self, state: Found, rng: np.random.Generator) -> list[Candidate]:
        """The sets at which exchanges end."""
        starts = [self.feasible.regular(), *self.feasible.random(self.starts - 1, rng)]
        found = designs(self.feasible, self.errors, starts, np.inf)
        return [Candidate(times) for times in found[:FINALISTS]]

    def tell(self, state: Found, evaluations: Sequence[Evaluation]) -> Found:
        """Keep the evaluations."""
        return best_of(evaluations)

    def done(self, state: Found) -> bool:
        """Whether the sets were evaluated."""
        return bool(state)

    def finalists(self, state: Found) -> Found:
        """The evaluated sets."""
        return state
