"""The compared sets on separate draws: the expected MSE of each, and its particles' variance.

Both use draws that neither chose the sets nor gave the bound: the first of the comparison, or
separate draws if it has too few. With several references, the draws of the comparison always
suffice.
"""

import math
from collections.abc import Generator, Mapping

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_key, stream_of
from pfdist.filters.exact import exact_mse
from pfdist.filters.variants import knowing_truth
from pfdist.filters.work import Estimation, FilterWork, Result
from pfdist.results import Moments, Run
from pfdist.results.moments import controlled_mse
from pfdist.results.particle_loss import less
from pfdist.results.stored_run import statistics_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.proof import UNKNOWN, ZERO, GapTerms
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import BOUND_PHASE

SET_DRAWS = 20_000
"""Largest number of draws on which a set is filtered alone."""

_FOR_EACH = 12  # draws of a set alone for each draw of the bound

Array = NDArray[np.float64]


def _draws(built: Built, compared: int, of_bound: int) -> int:
    """Number of draws of a set alone.

    A comparison with half as many draws is enough, because its squared errors are known. With
    several references, a comparison is always enough.
    """
    most = min(SET_DRAWS, _FOR_EACH * of_bound)
    is_enough = 2 * compared >= most or len(built.study.references) > 1
    return min(most, compared) if is_enough else most


def steps_of_sets(built: Built, sets: int, estimation: Estimation, of_bound: int) -> int:
    """Approximate number of particle-steps to filter so many sets alone.

    `of_bound` is the number of draws of the bound.
    """
    if not built.evaluator.has_particles:
        return 0
    compared = built.job.comparison.draws
    draws = _draws(built, compared, of_bound)
    kinds = _kinds(built, estimation, are_compared=draws <= compared).values()
    instants = draws * sets * (built.evaluator.horizon + 1)
    return sum(instants * own.steps_an_instant for own, _ in kinds)


def gap_terms(
    session: RunSession, run: Run, sets: Mapping[str, Times], estimation: Estimation, of_bound: int
) -> Generator[WorkBatch, None, dict[str, GapTerms]]:
    """The expected MSE of each compared set, and the parts of its gap.

    The run must be finished. The estimation uses the variance of the particles. `of_bound` is the
    number of draws of the bound.
    """
    built = session.built
    given = [*sets.values()]
    exact, right = (
        exact_mse(built.evaluator, given),
        exact_mse(knowing_truth(built.evaluator), given),
    )
    if exact is not None and right is not None:
        pairs = zip(exact.tolist(), map(Estimate, (exact - right).tolist()), strict=True)
        parts = [GapTerms(Estimate(mse), ZERO, wrong, wrong) for mse, wrong in pairs]
        return dict(zip(sets, parts, strict=True))
    draws = _draws(built, run.draws_compared, of_bound)
    # The compared draws have the job's shares of scenarios, and not those of the bound.
    are_compared = draws <= run.draws_compared and built.job.criterion.bound == "mean"
    kinds = _kinds(built, estimation, are_compared=are_compared)
    seed = built.job.seed
    if "squared" in kinds:
        draws_stream = stream_of("bound", seed, "draws of a set")
    else:
        draws_stream = stream_of(built.study.purpose, seed, "draws")
    session.reporter.begin("proof, step 1 of 3")
    errors = dict[str, dict[str, Array]]()
    for name, kind in kinds.items():
        errors[name] = yield from _per_draw(session, sets, *kind, draws_stream, draws)
    if (squared := errors.get("squared")) is None:
        rows, whole = run.table("comparison", draws), statistics_of(run).mse
        squared = {name: controlled_mse(rows, name) for name in sets}
    else:
        whole = {name: Moments.of_values(values) for name, values in squared.items()}
    by_truth, variance = errors.get("by_truth", squared), errors["variance"]
    return {
        name: parts_of(whole[name], squared[name], by_truth[name], variance[name]) for name in sets
    }


def _kinds(
    built: Built, estimation: Estimation, *, are_compared: bool
) -> dict[str, tuple[Estimation, bool]]:
    """The filters of the sets: how each estimates, and whether it uses the true model.

    The squared error is there only if the draws were not compared.
    """
    kinds = {"variance": (estimation, True)}
    if knowing_truth(built.evaluator) is not built.evaluator:
        kinds["by_truth"] = built.comparing, True
    if not are_compared:
        kinds["squared"] = built.comparing, False
    return kinds


def _per_draw(
    session: RunSession,
    sets: Mapping[str, Times],
    estimation: Estimation,
    knows_truth: bool,
    draws_stream: int,
    draws: int,
) -> Generator[WorkBatch, None, dict[str, Array]]:
    """Errors of so many draws, (draws,), by the name of the set."""
    built, reporter = session.built, session.reporter
    horizon, noise = built.evaluator.horizon, stream_of("bound", built.job.seed, "filter of a set")
    evaluator = knowing_truth(built.evaluator) if knows_truth else built.evaluator
    evaluator.compile(estimation)  # before the first task, whose time is limited
    key = stream_key(noise, draws_stream)
    ids = {name: evaluator.id_of(estimation, times, horizon, key) for name, times in sets.items()}
    work = evaluator.work(
        [*sets.values()],
        noise,
        draws_stream,
        (0, draws),
        estimation,
        ids=tuple(ids.values()),
        knows_truth=knows_truth,
    )
    errors = {id_: np.full(draws, math.nan) for id_ in work.ids}
    start, done = reporter.progress.done, 0

    def learn(piece: FilterWork, result: Result) -> None:
        nonlocal done
        for id_, mse in piece.by_id(result).items():
            errors[id_][slice(*piece.draws)] = mse
        done += result.mse.size
        reporter.reach(
            start + done * work.steps / (draws * len(sets)), evaluations=done // len(sets)
        )

    phase = f"{BOUND_PHASE}.{stream_key(work.ids):016x}"
    yield WorkBatch(session, phase, [work], PER_DRAW, learn, part="proof")
    return {name: errors[id_] for name, id_ in ids.items()}


def parts_of(whole: Moments, squared: Array, by_truth: Array, variance: Array) -> GapTerms:
    """The parts for one set, from errors of the same D draws.

    `squared` and `by_truth` are the squared errors with the filter's model and with the true model,
    and `variance` is that of the particles with the true model. `whole` has the moments of the
    squared errors of all draws, the first of which are `squared`.
    """
    if not (math.isfinite(whole.mean) and np.isfinite(squared + by_truth + variance).all()):
        return GapTerms(UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN)
    if by_truth is squared:
        both = less(whole, squared, variance)
        return GapTerms(whole.estimate, both, ZERO, both)
    return GapTerms(
        whole.estimate,
        Moments.of_values(by_truth - variance).estimate,
        less(whole, squared, by_truth),
        less(whole, squared, variance),
    )
