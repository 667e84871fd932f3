"""The expected errors of sets at the instants that a search asks for."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pfdist.runner.block_sums import BlockSums, Counted
from pfdist.runner.build import Built
from pfdist.runner.collect import Collector
from pfdist.search.base import Candidate


def errors_of(
    asked: Sequence[Candidate],
    built: Built,
    sums_of: Callable[[Counted], BlockSums],
    blocks: int,
    collector: Collector,
) -> tuple[NDArray[np.float64], float]:
    """Give the expected errors of candidates, (S, T+1), and the particle-steps they take.

    The errors are 0 before the instant from which they are wanted, and behind the candidate's end.

    Parameters
    ----------
    asked : sequence of Candidate, (S,)
    built : Built
    sums_of : callable
        Gives the sums over blocks of draws; exact engines need none.
    blocks : int
        Number of blocks of draws.
    collector : Collector

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    horizon = built.problem.horizon
    sets = tuple(candidate.measurement_times for candidate in asked)
    first = np.array([candidate.since or 0 for candidate in asked])
    ends = np.array([horizon if each.end is None else each.end for each in asked])
    counted = Counted(sets, first, ends)
    if built.problem.exact:
        return np.where(counted.at(horizon), built.problem.expected_errors(sets), 0.0), 0.0
    sums = sums_of(counted)
    return sums.means(blocks, collector), sums.steps(blocks)
