"""The sets of times of each replicate of a backtest, and its errors with them.

A replicate has measurements near the wanted times, or it is left out. Values that no set uses are
judged.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.rounding import rounded
from pfdist.common.streams import stream_of
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.models.sensed import known_values, when_made
from pfdist.plugins.backtest.backtesting import (
    PlanWork,
    ReplicateErrors,
    ReplicateWork,
    errors_of_replicates,
    plan_of,
    points_of_rows,
    with_repeats,
)
from pfdist.plugins.backtest.needs import PLAN_EACH
from pfdist.plugins.online.planner import first_planning
from pfdist.plugins.online.planning import planning_of
from pfdist.pools.base import Pool
from pfdist.problem.points import Points
from pfdist.problem.replicates import Replicate
from pfdist.runner.build import Built
from pfdist.runner.progress import Progress, Show
from pfdist.runner.replicates import evaluator_for, outcomes

Array = NDArray[np.float64]
PLAN, FROM_START, CENTRED = "plan", "from_start", "centred"
"""The sets that a backtest always has, in this order."""
DRAWS = 480
"""Simulated systems for each replicate."""


class Matched(NamedTuple):
    """A replicate that is judged."""

    replicate: Replicate
    sets: tuple[Times, ...]  # on the replicate's clock
    judged: Array  # (T+1, q): the values that no set uses; NaN elsewhere

    @property
    def is_predicted(self) -> bool:
        """Whether measurements are judged, and not known quantities of interest."""
        return self.replicate.z is None


Plans = Times | Mapping[str, Times | None]


def plans_of(
    built: Built, replicates: Sequence[Replicate], pool: Pool, show: Show
) -> dict[str, Times | None]:
    """The plan of each replicate on its own clock; None if it is not judged.

    It is not judged if the model was fitted to it, or if it has too few measurements.
    """
    feasible, job = built.feasible, built.job
    PLAN_EACH.check("plan_each", job)
    planning = first_planning(planning_of(job, built.evaluator.variance_is_error))
    works = dict[str, PlanWork]()
    plans: dict[str, Times | None] = dict.fromkeys(each.name for each in replicates)
    for each in replicates:
        if each.is_training:
            continue
        measured = {*each.measured(built.evaluator.model)}
        points, rest = replace(feasible.points, clock=each.clock), feasible
        if each.has_own_clock:
            rest = replace(
                feasible, horizon=each.clock.horizon, points=points, forbidden=(), required=()
            )
        with suppress(MeasurementTimesError):  # too few measurements
            barred = {*rest.forbidden} | ({*range(points.number)} - measured)
            rest = replace(rest, forbidden=tuple(sorted(barred)))
            evaluator = evaluator_for(built, each, is_predicted=False)
            stream = stream_of("backtest", job.seed, "plan", each.name)
            works[each.name] = PlanWork(evaluator, rest, planning, stream)
    names = [*works]
    for done, (place, times) in enumerate(
        outcomes(pool, plan_of, [*works.values()], "the plans"), 1
    ):
        plans[names[place]] = times
        show(
            Progress("plan", done, len(names), doing=f"Planning: {done} of {len(names)} replicates")
        )
    return plans


def matched_of(
    built: Built,
    replicates: Sequence[Replicate],
    plans: Plans,
    own: Mapping[str, Times],
    within: float,
) -> tuple[list[Matched], dict[str, str]]:
    """The replicates that are judged, and why the others are not, by name.

    `plans` is the plan on the clock of the job, or the plan of each replicate on its own clock.
    """
    points, model = built.job.problem.points, built.evaluator.model
    matched, left_out = list[Matched](), dict[str, str]()
    for each in replicates:
        plan = plans.get(each.name) if isinstance(plans, Mapping) else plans
        here = replace(points, clock=each.clock)
        on = here if isinstance(plans, Mapping) else points
        if each.is_training or plan is None:
            why = "the model was fitted to it", "it has too few measurements for a plan"
            left_out[each.name] = why[plan is None and not each.is_training]
            continue
        wanted = [_wanted(plan, on), *_grids(on, len(plan), built.feasible.cheapest)]
        wanted += [_wanted(times, points) for times in own.values()]
        sets = dict[str, Times]()
        try:
            for name, times in zip((PLAN, FROM_START, CENTRED, *own), wanted, strict=True):
                sets[name] = each.nearest(times, here, model, within)
        except MeasurementsError as error:
            left_out[each.name] = f"{error}, for the set {name}"
            continue
        judged = each.z
        if judged is None:
            y = known_values(each.y[:, : model.components[1]])
            judged = when_made(y, model, points.delays)
        used = here.made(chain(*sets.values()))
        judged = np.where(np.isin(np.arange(len(judged)), used)[:, None], np.nan, judged)
        if np.isnan(judged).all():
            left_out[each.name] = "no value is left to judge"
            continue
        matched.append(Matched(each, tuple(sets.values()), judged))
    return matched, left_out


def _wanted(times: Times, points: Points) -> list[tuple[float, int]]:
    return [(points.clock.times[points.made_at(time)], points.way(time)) for time in times]


def _grids(points: Points, number: int, way: int) -> Iterator[list[tuple[float, int]]]:
    """Yield the beginnings and the middles of equal parts of the horizon.

    On an even clock, the last instant is a step long, too. The last value arrives in time.
    """
    clock, steps = points.clock, points.clock.horizon - points.delay(way)
    first, last = clock.times[0], clock.times[steps]
    whole = (last - first) * (1 + clock.is_even / max(1, steps))
    for offset in (0.0, 0.5):
        yield [(first + whole * (part + offset) / number, way) for part in range(number)]


def judged_errors(
    built: Built, matched: Sequence[Matched], pool: Pool, show: Show
) -> list[ReplicateErrors]:
    """The errors of each replicate, relative to the variance of what is judged."""
    evaluators, works = dict[Any, Any](), list[ReplicateWork]()
    model = built.evaluator.model
    widest = max(each.replicate.y.shape[1] for each in matched)
    repeats = widest // model.components[1]
    is_predicted = matched[0].is_predicted
    for each in matched:
        if each.replicate.key not in evaluators:
            evaluator = evaluator_for(built, each.replicate, is_predicted=is_predicted)
            evaluators[each.replicate.key] = with_repeats(evaluator, repeats)
    angles = next(iter(evaluators.values())).model.is_angle
    variances = _variances(np.concatenate([each.judged for each in matched]), angles)
    for each in matched:
        seed = built.job.seed
        lacking = (0, 0), (0, widest - each.replicate.y.shape[1])
        y = np.pad(each.replicate.y, lacking, constant_values=np.nan)
        work = ReplicateWork(
            evaluators[each.replicate.key],
            y,
            each.judged,
            variances,
            tuple(points_of_rows(times, y, model, repeats) for times in each.sets),
            DRAWS,
            (
                stream_of("backtest", seed, each.replicate.name),
                stream_of("backtest", seed, each.replicate.name, "filter"),
            ),
            built.comparing,
            is_predicted,
            built.job.problem.points.delays,
        )
        works.append(work)
    errors = dict[int, ReplicateErrors]()
    for done, (place, result) in enumerate(
        outcomes(pool, errors_of_replicates, works, "the backtest"), 1
    ):
        if not np.isfinite([*result.real, *np.nanmean(result.foreseen, axis=1)]).all():
            raise MeasurementsError(
                f"replicate {shown(matched[place].replicate.name)}: errors must be finite, got "
                f"{rounded(result.real[0], 3)} with the plan, foreseen "
                f"{rounded(float(np.mean(result.foreseen[0])), 3)}: see its values and parameters"
            )
        errors[place] = result
        doing = f"Backtest: {done} of {len(works)} replicates"
        show(Progress("backtest", done, len(works), doing=doing))
    return [errors[place] for place in range(len(works))]


def _variances(values: Array, is_angle: Sequence[bool]) -> Array:
    """The variance of each component, (q,); that of angles around their mean direction."""
    variances = np.ones(values.shape[1])
    for k, (column, angle) in enumerate(zip(values.T, is_angle, strict=True)):
        known = column[~np.isnan(column)]
        if not known.size:
            continue
        centre = np.angle(np.exp(1j * known).mean()) if angle else known.mean()
        difference = known - centre
        difference = np.angle(np.exp(1j * difference)) if angle else difference
        with np.errstate(over="ignore"):
            variances[k] = np.mean(difference**2)
        if not 0.0 < variances[k] < np.inf:
            rule = "must differ from each other, by less than 1e150"
            raise MeasurementsError(
                f"judged values of component {k} {rule}, got {known.min():.4g} to {known.max():.4g}"
            )
    return variances
