"""How many evenly spaced measurements do as well as the plan: a quick estimate."""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import EVEN, REGULAR, Times
from pfdist.common.streams import stream_of
from pfdist.filters.work import FilterWork, Result
from pfdist.problem.even_grids import MOST, even_grids
from pfdist.problem.feasible import Feasible
from pfdist.results import Run
from pfdist.results.evenly_spaced import sign_of
from pfdist.results.moments import controlled_mse
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.store import EVEN_PHASE, schema

DRAWS = 1000  # at most: the first of the comparison
_FEW = 250  # decide, if the difference is so clear
_CLEAR = 0.999
_LOOKS = (
    (24, 64),
    (120, 12),
    (600, 1),
)  # draws of their own, and the sets of each number that stay
_GRIDS = (MOST, 300, 100, 45)  # of a number, as many as `_MOST_STEPS` allows
_MOST = 24  # numbers that are judged
_NEAR, _FAR = 40, 12  # numbers after N that are looked at, one by one and then further apart
_MOST_STEPS = 1e10  # particle-steps of the look: half a minute of a core


def is_known(built: Built) -> bool:
    """Whether a run has a single plan, and any number of its measurements can be evenly spaced."""
    problem, is_alone = built.job.problem, len(built.searches) == 1 and built.job.budget is None
    is_free = problem.feasible.counted and not problem.is_constrained
    return is_alone and is_free and problem.points.ways == 1 and built.job.criterion.is_mean


def compare_evenly_spaced(session: RunSession, run: Run) -> Generator[WorkBatch, None, None]:
    """Judge evenly spaced times of N and more measurements, and write the table ``evenly_spaced``.

    A look on draws of its own chooses the times of each number; regular times, if the job compares
    with these, are not chosen. On the draws of the comparison, each number is judged from N upwards
    until one does as well as the plan; of the larger ones, those that the look finds clearly worse.
    Each set has independent filter noise. If errors are exact, all these numbers are judged.
    Nothing is written if the plan's error is not finite, or the look would take too long.
    """
    built, name = session.built, session.built.searches[0].name
    measured, feasible = measured_of(run), built.feasible
    plan = measured[name]
    session.reporter.begin("evenly spaced times")
    given = dict[int, Times]()
    if run.references[name] == built.job.comparison.reference_name in (EVEN, REGULAR):
        given[feasible.measurements] = measured[run.references[name]]
    error = controlled_mse(run.table("comparison", DRAWS), name)
    exact = built.evaluator.expected_mse([plan])
    mean = float(np.nanmean(error) if exact is None else exact[0])
    if not math.isfinite(mean):
        return
    chosen = yield from _chosen(session, plan, mean, given)
    if not chosen:
        return
    rows, is_found = [], False
    for number, (times, looked) in chosen.items():
        difference = looked
        if exact is None:
            if is_found and sign_of(looked, mean) <= 0:
                continue
            difference = yield from _judged(session, times, error, mean)
        rows.append(
            {
                "measurements": number,
                "measurement_times": times,
                "draws": 0 if exact is not None else int(difference.degrees) + 1,
                "difference": difference.value,
                "difference_error": difference.standard_error,
                "plan_mse": mean,
            }
        )
        is_found = is_found or sign_of(difference, mean) < 0
        if len(rows) == _MOST and exact is None:
            break
    table = pa.Table.from_pylist(rows, schema=schema("evenly_spaced", "plan_mse"))
    session.store.renew("evenly_spaced", EVEN_PHASE, table)


def _numbers(feasible: Feasible) -> list[int]:
    """Numbers from N up to all instants: the next ones, and some of those beyond."""
    first, last = feasible.measurements, feasible.horizon + 1
    near = min(last, first + _NEAR)
    return sorted(
        {*range(first, near + 1), *np.geomspace(near, last, _FAR).round().astype(int).tolist()}
    )


def _chosen(
    session: RunSession, plan: Times, mean: float, given: dict[int, Times]
) -> Generator[WorkBatch, None, dict[int, tuple[Times, Estimate]]]:
    """The best times of each number, and how far their error lies above the plan's.

    Empty if a look at the fewest grids would take too long.
    """
    built = session.built
    for most in _GRIDS:
        grids = {number: _grids(built, number, most) for number in _numbers(built.feasible)}
        grids |= {number: (times,) for number, times in given.items()}
        steps = _LOOKS[0][0] * sum(map(len, grids.values())) * built.comparing.particles
        if built.evaluator.exact or steps * (built.feasible.horizon + 1) <= _MOST_STEPS:
            break
    else:
        return {}
    for draws, kept in _LOOKS:
        sets = [times for each in grids.values() for times in each]
        errors = built.evaluator.expected_mse(sets)
        if errors is None:
            differences = yield from _look(session, [plan, *sets], draws)
        else:
            differences = [*map(Estimate, (errors - mean).tolist())]
        found = dict(zip(sets, differences, strict=False))
        for number, each in grids.items():
            ranked = sorted(each, key=lambda times: np.nan_to_num(found[times].value, nan=np.inf))
            grids[number] = tuple(ranked[:kept])
    return {number: (best, found[best]) for number, (best, *_) in grids.items()}


def _grids(built: Built, number: int, most: int) -> tuple[Times, ...]:
    feasible = built.job.feasible(number)
    return even_grids(feasible, most) if built.job.comparison.is_even else (feasible.regular(),)


def _look(
    session: RunSession, sets: list[Times], draws: int
) -> Generator[WorkBatch, None, list[Estimate]]:
    """How far the error of each set lies above that of the first, on draws of their own."""
    built, errors = session.built, np.empty((draws, len(sets)))

    def learn(piece: FilterWork, result: Result) -> None:
        errors[slice(*piece.draws)] = result.mse

    work = built.evaluator.work(
        sets,
        stream_of("shortlist", built.job.seed, "numbers", "filter"),
        stream_of("shortlist", built.job.seed, "numbers", "draws"),
        (0, draws),
        built.comparing,
    )
    yield WorkBatch(session, EVEN_PHASE, [work], None, learn, part="scan")
    return [*map(Estimate.of_mean, (errors[:, 1:] - errors[:, :1]).T)]


def _judged(
    session: RunSession, times: Times, plan: NDArray[np.float64], mean: float
) -> Generator[WorkBatch, None, Estimate]:
    """How far the error of a set lies above the plan's, on the first draws of the comparison."""
    built, draws = session.built, min(DRAWS, len(plan))
    seed, purpose = built.job.seed, built.study.purpose
    even = np.empty(draws)

    def learn(piece: FilterWork, result: Result) -> None:
        errors = result.mse - result.control if piece.controlled else result.mse
        even[slice(*piece.draws)] = errors[:, 0]

    work = built.evaluator.work(
        [times],
        stream_of(purpose, seed, "filter", f"evenly spaced {len(times)}"),
        stream_of(purpose, seed, "draws"),
        (0, draws),
        built.comparing,
    )
    work = replace(work, controlled=bool(built.job.comparison.control))
    first = 0
    for last, confidence in ((min(_FEW, draws), _CLEAR), (draws, CONFIDENCE)):
        some = replace(work, draws=(first, last))
        yield WorkBatch(session, EVEN_PHASE, [some], None, learn, part="scan")
        apart = even[:last] - plan[:last]
        difference, first = Estimate.of_mean(apart[~np.isnan(apart)]), last
        if first == draws or sign_of(difference, mean, confidence):
            break
    return difference
