"""Evaluations by the expected errors of the instants that a search asks for."""

from collections.abc import Callable, Generator, Sequence

import numpy as np

from pfdist.evaluation.estimate import Evaluation
from pfdist.runner.block_sums import BlockSums, Counted
from pfdist.runner.door import Batch, Session
from pfdist.search.base import Candidate


def evaluated_by_errors(
    asked: Sequence[Candidate],
    session: Session,
    sums_of: Callable[[Counted], BlockSums],
    blocks: int,
    purpose: str,
) -> Generator[Batch, None, tuple[list[Evaluation], float]]:
    """Evaluations of candidates, and the particle-steps that they take.

    Errors are 0 before the instant from which they are wanted, and behind the candidate's end.

    Parameters
    ----------
    asked : sequence of Candidate
    session : Session
    sums_of : callable
        Gives the sums over blocks of draws; exact engines need none.
    blocks : int
        Number of blocks of draws.
    purpose : str
        Purpose of the draws.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    evaluator = session.built.evaluator
    exact, horizon, steps = evaluator.exact, evaluator.horizon, 0.0
    sets = tuple(candidate.measurement_times for candidate in asked)
    first = np.array([candidate.since or 0 for candidate in asked])
    ends = np.array([horizon if each.end is None else each.end for each in asked])
    counted = Counted(sets, first, ends)
    if exact:
        errors = np.where(counted.at(horizon), evaluator.expected_errors(sets), 0.0)
    else:
        sums = sums_of(counted)
        errors, steps = (yield from sums.means(blocks, session)), sums.steps(blocks)
    costs = errors.sum(axis=1) / (horizon + 1)
    evaluations = [
        Evaluation(
            candidate.measurement_times,
            cost[None],
            exact=float(cost) if exact else None,
            end=candidate.end,
            errors=row,
            purpose=purpose,
        )
        for candidate, row, cost in zip(asked, errors, costs, strict=True)
    ]
    return evaluations, steps
