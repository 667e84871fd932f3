"""A task of a backtest: one replicate, filtered with each set of times, and simulated as often.

Real and simulated measurements pass the same filters, and are judged at the same instants.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementsError
from pfdist.filters.draws import Draws
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.filter_estimate import FEW
from pfdist.filters.one_filter import seen
from pfdist.filters.proposal import PLAIN
from pfdist.filters.scenarios import stretches
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.schemes import resample_written
from pfdist.models import StateSpaceModel
from pfdist.models.base import repeated, within_half_turn
from pfdist.models.sensed import when_made
from pfdist.plugins.online.planning import Now, Planning, Replanner
from pfdist.problem.feasible import Feasible
from pfdist.runner.filter import Filter

Array = NDArray[np.float64]
_SIGNED = 2**63  # from a key of 64 bits to a seed, which may be negative
INTERVAL = (0.05, 0.95)
"""Quantiles between which a right model has 90 % of all values."""


@dataclass(frozen=True, eq=False)
class ReplicateWork:
    """One replicate, and how it is judged.

    Parameters
    ----------
    evaluator : Evaluator
        Its quantity of interest is what is judged: see `pfdist.filters.predicted`.
    y : array of float64, (T+1, R * m)
        Real measurements, with R rows for each sensor, as the models of the evaluator have.
    judged : array of float64, (T+1, q)
        Real values that are judged; NaN elsewhere.
    variances : array of float64, (q,)
        The errors of a component are divided by its variance.
    sets : tuple of tuple of int
        The measurement times of S sets; the first is the plan.
    draws : int
        Number of simulated systems.
    streams : tuple of two int
        Keys of the noise of the simulated systems, and of the filters.
    estimation : Estimation
    is_measured : bool
        Whether measurements are judged, rather than known quantities of interest.
    delays : tuple of int
        Those of the sensors. The measurements are those that arrive at an instant; they are judged
        at the instant at which they are made.
    """

    evaluator: Evaluator
    y: Array
    judged: Array
    variances: Array
    sets: tuple[Times, ...]
    draws: int
    streams: tuple[int, int]
    estimation: Estimation
    is_measured: bool
    delays: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class ReplicateErrors:
    """Errors of a replicate with each set, relative to the variance of what is judged.

    Parameters
    ----------
    real : array of float64, (S,)
    foreseen : array of float64, (S, D)
        Error of each simulated system.
    noise : float
        The part of a foreseen error that is due to the noise of the judged measurements.
    covered : array of float64, (S,)
        Share of the judged values in the model's 90 % interval.
    surprises : array of float64, (N,)
        P-value of each measurement of the plan.
    estimates, low, high : array of float64, (S, T+1, q)
        The filter's mean of what is judged, and its 90 % interval.
    impossible : int
        Number of sets with a measurement that no particle explains.
    collapsed : int
        Number of sets with which the effective sample size falls below `FEW`.
    is_angle : tuple of bool
        Whether each judged component is an angle.
    """

    real: Array
    foreseen: Array
    noise: float
    covered: Array
    surprises: Array
    estimates: Array
    low: Array
    high: Array
    impossible: int
    collapsed: int
    is_angle: tuple[bool, ...]

    @property
    def intervals(self) -> tuple[Array, Array, Array]:
        """Lower ends, means and upper ends of the predictions."""
        return self.low, self.estimates, self.high


def errors_of_replicates(work: ReplicateWork) -> ReplicateErrors:
    """Filter one replicate and its simulated systems with each set.

    Raises `MeasurementsError` if an estimate is not finite, and `ModelError` if a formula failed.
    """
    evaluator, is_angle = work.evaluator, work.evaluator.model.is_angle
    is_judged = ~np.isnan(work.judged)
    simulated, y, z = _simulated(work)
    real, impossible, collapsed = _real(work)
    made = when_made(y, evaluator.model, work.delays)[..., : z.shape[-1]]
    # Sensors with `works` give no value in some systems, and the others count for them.
    failed = np.isposinf(made) if work.is_measured else np.zeros(z.shape, np.bool_)
    counts = np.where(failed, 0.0, 1.0) / np.maximum(np.mean(~failed, axis=0), 1e-9)
    if not np.isfinite(real[:, is_judged]).all():
        raise MeasurementsError("the filter's estimates must be finite")
    residuals = _difference(z, simulated, is_angle)
    left_out = failed & ~failed.all(axis=0)
    ends = np.nanquantile(np.where(left_out, np.nan, residuals), INTERVAL, axis=1)
    low, high = (real + each for each in ends)
    noise = _difference(np.where(failed, z, made), z, is_angle) if work.is_measured else np.zeros(1)
    of_real, of_simulated, of_noise = (
        (np.broadcast_to(each, (*each.shape[:-2], *work.judged.shape)) / work.variances)[
            ..., is_judged
        ].mean(axis=-1)
        for each in (
            _difference(work.judged, real, is_angle) ** 2,
            residuals**2 * counts,
            noise**2 * counts if work.is_measured else noise,
        )
    )
    values = real + _difference(work.judged, real, is_angle)
    inside = ((low <= values) & (values <= high))[:, is_judged]
    return ReplicateErrors(
        of_real,
        of_simulated,
        float(of_noise.mean()) / 2,
        inside.mean(axis=-1),
        _surprises(evaluator, work),
        real,
        low,
        high,
        impossible,
        collapsed,
        is_angle,
    )


def _simulated(work: ReplicateWork) -> tuple[Array, Array, Array]:
    """The estimates of simulated systems, (S, D, T+1, q), their y, and their z."""
    evaluator, (stream, _) = work.evaluator, work.streams
    numbers = evaluator.scenarios_of(stream, range(work.draws))
    parts = [(evaluator, (0, work.draws))]
    if numbers is not None:
        parts = [(evaluator.of_scenarios[n], draws) for n, draws in stretches(numbers, 0)]
    estimates, y, z = [], [], []
    for each, (first, last) in parts:
        draws = each.draws(range(first, last), stream)
        lacking = np.isnan(work.y) & ~np.isnan(work.y).all(axis=1, keepdims=True)
        observed = replace(draws, y=np.where(lacking, np.nan, draws.y))
        estimates.append(_estimates(_filtered(each, observed, work)))
        y.append(draws.y)
        z.append(draws.z)
    return np.concatenate(estimates, axis=1), np.concatenate(y), np.concatenate(z)


def _real(work: ReplicateWork) -> tuple[Array, int, int]:
    """The estimates of the real system, (S, T+1, q), and how many are degenerate, and collapse."""
    model = work.evaluator.model
    shape = 1, len(work.y), model.components[2]
    draws = Draws(model, range(1), np.empty((1, 0, 0)), work.y[None], np.zeros(shape))
    filtered = _filtered(work.evaluator, draws, work)
    return (
        _estimates(filtered)[:, 0],
        sum(int(each.degenerate[0]) for each in filtered),
        sum(bool((each.sizes < FEW).any()) for each in filtered),
    )


def _estimates(filtered: Sequence[FilterArrays]) -> Array:
    return np.stack([each.estimate for each in filtered])


def _filtered(evaluator: Evaluator, draws: Draws, work: ReplicateWork) -> list[FilterArrays]:
    streams = work.streams[1:] * len(work.sets)
    return [*evaluator.filter_each(draws, work.sets, streams, work.estimation)]


def _surprises(evaluator: Evaluator, work: ReplicateWork) -> Array:
    """The p-value of each measurement of the plan, in the order of time."""
    model, points, plan = evaluator.believed, evaluator.points, work.sets[0]
    following = Filter(
        model, work.estimation.particles, work.streams[1] - _SIGNED,
        resampling=work.estimation.resampling, resample=resample_written(work.estimation.threshold),
        engine=evaluator.engine, horizon=evaluator.horizon,
        proposal=work.estimation.proposal if work.estimation.moves else PLAIN.name,
    )  # fmt: skip
    surprises = list[float]()
    for t in points.instants(plan):
        here = tuple(point for point in plan if point in points.at(t))
        try:
            estimate = following.update(t, seen(model, work.y[t], here), warn=False)
        except MeasurementsError:  # no particle explains it
            surprises.append(0.0)
            break
        surprises.append(1.0 if estimate.surprise is None else estimate.surprise)
    return np.array(surprises)


def _difference(values: Array, estimates: Array, is_angle: tuple[bool, ...]) -> Array:
    """Values less estimates, (..., q); those of angles are at most half a turn."""
    return np.asarray(within_half_turn(values, estimates, is_angle)) - estimates


# --- plans of replicates ---


def with_repeats(evaluator: Evaluator, repeats: int) -> Evaluator:
    """The evaluator with so many rows of each sensor in a measurement."""
    if repeats == 1:
        return evaluator
    model, believed = (repeated(each, repeats) for each in (evaluator.model, evaluator.believed))
    return replace(evaluator, model=model, filter_model=believed)


def points_of_rows(times: Times, y: Array, model: StateSpaceModel, repeats: int) -> Times:
    """The points of a model with repeats that have a row, given those of the model."""
    m, rows = model.components[1], list[int]()
    for time in times:
        t, way = model.points.instant(time), model.points.way(time)
        for k in range(repeats):
            own = model.ways[way].y
            if not np.isnan(y[t, k * m + own.start : k * m + own.stop]).all():
                rows.append((t * repeats + k) * model.points.ways + way)
    return tuple(sorted(rows))


@dataclass(frozen=True)
class PlanWork:
    """A replicate for which a plan is made, among the measurements that it has."""

    evaluator: Evaluator
    feasible: Feasible
    planning: Planning
    stream: int


def plan_of(work: PlanWork) -> Times:
    """The plan for one replicate, as `pfdist.Planner` makes it before anything is measured."""
    replanner = Replanner(work.evaluator, work.feasible, work.planning, work.stream)
    return replanner.plan(Now(), (), ())
