"""Criteria of the errors of instants: sets in groups of draws, and the shares of a bound.

Sums over blocks of draws give the errors of each instant, in groups, with no row for each draw.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import replace

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.criterion import Criterion
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.runner.block_sums import CHOICE_BLOCKS, Array, BlockSums, GroupSums
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.proof import best_shares
from pfdist.search import Candidate, Counted
from pfdist.search.relaxation import Relaxation

_MOST_GROUPS = 64  # of instants, each with a share in the bound for the worst instant


def evaluated_in_groups(
    criterion: Criterion,
    candidates: Sequence[Candidate],
    session: RunSession,
    sums_of: Callable[[Counted], BlockSums],
    blocks: int,
    purpose: str,
) -> Generator[WorkBatch, None, tuple[list[Evaluation], float]]:
    """Evaluations of whole sets, in groups of blocks, and the particle-steps spent."""
    evaluator, weights = session.built.evaluator, session.built.evaluator.relative_weights
    sets, first = [times for times, *_ in candidates], np.zeros(len(candidates), np.int64)
    counted = Counted(tuple(sets), first, first + evaluator.horizon)
    sums, groups = sums_of(counted), GroupSums(counted)
    yield from sums.added(session, range(blocks), groups.add, more_follows=True)
    means = groups.sums[:blocks] / groups.draws[:blocks, None]  # block b is in group b, modulo 20
    errors = means.reshape(-1, len(sets), weights.size) / np.where(weights > 0.0, weights, 1.0)
    found = evaluations_of_groups(criterion, sets, errors[:, :, weights > 0.0], purpose)
    return found, sums.steps(blocks)


def evaluations_of_groups(
    criterion: Criterion, sets: Sequence[Times], errors: Array, purpose: str = "search"
) -> list[Evaluation]:
    """Evaluations of sets from mean errors of groups at the instants that count, (G, S, I)."""
    return [
        Evaluation(times, np.empty(0), groups=groups, purpose=purpose, criterion=criterion)
        for times, groups in zip(sets, errors.swapaxes(0, 1), strict=True)
    ]


def weighted_instants(
    relaxation: Relaxation,
    spent: int,
    evaluator: Evaluator,
    windows: Callable[[Evaluator, int], Generator[WorkBatch, None, Array]],
) -> Generator[WorkBatch, None, Evaluator]:
    """The evaluator with the weights of instants, whose sum is 1, for which the bound is largest.

    Instants of a group have equal weights. Few groups keep the memory small; on a short horizon,
    each instant is a group. `windows` gives the errors of all windows by an evaluator.
    """
    counts = evaluator.relative_weights > 0.0
    number = counts.sum()
    groups = (np.cumsum(counts) - 1) * min(number, _MOST_GROUPS) // number
    groups, sizes = np.where(counts, groups, -1), np.bincount(groups[counts])
    alone = replace(evaluator, weights=tuple(counts.astype(float).tolist()), estimations=())
    errors = yield from windows(alone, CHOICE_BLOCKS)
    ends = zip(relaxation.first.tolist(), relaxation.ends.tolist(), strict=True)
    at = groups[np.concatenate([np.arange(first, last + 1) for first, last in ends])]
    parts = enumerate(number / sizes)
    means = np.stack([np.where(at == g, errors * part, 0.0) for g, part in parts])
    shares = np.array(best_shares(relaxation, means, spent)) / sizes
    weights = np.where(counts, shares[groups], 0.0).tolist()
    return replace(alone, weights=tuple(weights))
