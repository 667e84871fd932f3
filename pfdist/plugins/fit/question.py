"""Fit parameters of a model to measurements of many systems, by maximum likelihood."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import minimize

from pfdist.common.nearest import must_be
from pfdist.common.parts import Facts, Page, Section, Text
from pfdist.common.rounding import rounded, with_error
from pfdist.common.section import Whole, checked
from pfdist.common.shown import Shown
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError, MeasurementsError, ModelError
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import AUTO, PROPOSALS
from pfdist.kernels.variates import generator
from pfdist.models import StateSpaceModel
from pfdist.models.base import repeated
from pfdist.models.recorded import recorded_if_it_holds
from pfdist.plugins.fit.evidence import exact_log_evidence, log_evidence, moved_log_evidence
from pfdist.pools.base import Pool
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.replicates import Replicate, read_replicates
from pfdist.questions.at_work import at_work
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.planned_run import Columns, UserTable, reading_of, table_argument
from pfdist.questions.subject import number_of
from pfdist.results.columns import records_of
from pfdist.runner.build import Built, build
from pfdist.runner.choice import moving_of
from pfdist.runner.filter import MOVED
from pfdist.runner.progress import Progress, Show
from pfdist.runner.replicates import evaluator_for, outcomes
from pfdist.store import is_job_of_run

Array = NDArray[np.float64]
Loss = Callable[[Array], float]
_STEP = 0.5  # between the first values that are tried: a factor of 1.6, or half the start
_REACH = 1.5  # of starts around the job's values: a factor of 4.5, or 1.5 times the start
_STARTS = 64  # points among which each start is the one farthest from all starts and results
_AGREE = 0.1  # of log-likelihoods: so far two results may differ that are the same maximum
_NEAR = 0.1  # of a start: so close to a bound, the bound is tried, too
_REPEATS = 8  # estimates under other noise, from which the error of the likelihood follows
_LARGE = 2.0  # an error of a log-likelihood
_FAR = 3.0  # below the maximum: so far the profile of a parameter is drawn
_NEAREST = 4  # values on each side of a profile, which give the correlation
_SMALL = 1e-2  # of a scale: a first step along a profile
_MOST_VALUES = 16  # of a profile on each side
_EACH = 80  # likelihoods for each other parameter at a value of a profile
_CONFOUNDED = 0.95  # correlation of two estimates
_TOLERANCE = {"xatol": 1e-3, "fatol": 1e-2}


@dataclass(frozen=True, repr=False)
class Fitted(Shown):
    """Result of `fit`.

    Parameters
    ----------
    parameters : dict of str to float
        The values with the largest likelihood that was found.
    log_likelihood : float
        At these values: exact, or the mean over noise that did not choose them. With few particles
        it is too low, and more so for sharp sensors.
    error : float
        0 if the log-likelihood is exact. Else its standard deviation from noise to noise, and, in
        quadrature, the Monte Carlo error of the maximum: by how much the largest value under the
        noise of the search exceeds `log_likelihood`. On average, the largest value of all lies
        between the two (Mak, Morton, Wood, Operations Research Letters 24, 1999).
    started_at : float
        The log-likelihood at the start.
    evaluations : int
        Evaluated likelihoods, all searches together.
    is_converged : bool
        Whether two searches from distant starts found the same log-likelihood: a difference of
        at most 0.1, or of one standard deviation of the difference from noise to noise.
    replicates : int
    starts : int
        Number of searches. The first starts at the values of the job.
    on_bound : tuple of str
        Parameters that lie on a bound.
    mirrored : tuple of str
        Parameters without a range whose other sign is as likely; they have that of the start.
    turned : tuple of str
        Other parameters without a range that do not have the sign of the start.
    profile : DataFrame, optional
        The largest log-likelihood at values of each parameter: columns ``parameter`` (which has a
        given value), one for each parameter, and ``below`` (how far below the maximum).
        `pfdist.plots.likelihood_profile` draws it.
    correlation : DataFrame, optional
        The correlation of each two estimates near the maximum, from the profiles; logarithms of
        parameters that cannot be negative.
    """

    parameters: dict[str, float]
    log_likelihood: float
    error: float
    started_at: float
    evaluations: int
    is_converged: bool
    replicates: int
    starts: int
    on_bound: tuple[str, ...]
    mirrored: tuple[str, ...] = ()
    turned: tuple[str, ...] = ()
    profile: pd.DataFrame | None = None
    correlation: pd.DataFrame | None = None

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON values."""
        profile = None if self.profile is None else records_of(self.profile)
        correlation = None if self.correlation is None else self.correlation.to_dict()
        return {**vars(self), "profile": profile, "correlation": correlation}

    def _page(self) -> Page:
        values = ", ".join(f"{name} = {rounded(each)}" for name, each in self.parameters.items())
        likelihood = with_error(self.log_likelihood, self.error) if self.error else (
            f"{rounded(self.log_likelihood)} (exact)"
        )  # fmt: skip
        facts = [("log-likelihood", f"{likelihood} (at the start: {rounded(self.started_at)})"),
                 ("evaluations", f"{self.evaluations:,}, from {number_of(self.starts, 'start')}"),
                 ("replicates", str(self.replicates))]  # fmt: skip
        warnings, names = list[str](), [*self.parameters]
        alarms = [
            "The search has not converged, because no two distant starts found the same maximum: "
            "start at its result, or allow more evaluations."
        ] * (not self.is_converged)
        warnings += [
            f"{name} lies on its bound, {rounded(self.parameters[name])}: the likelihood may be "
            "larger beyond it."
            for name in self.on_bound
        ]
        warnings += [
            f"{name} may have either sign, because both are equally likely; it has that of the "
            "start: give it a range."
            for name in self.mirrored
        ]
        warnings += [
            f"{name} has another sign than at the start: give it a range if that is impossible."
            for name in self.turned
        ]
        if self.correlation is not None:
            both = self.correlation.to_numpy()
            warnings += [
                f"{names[a]} and {names[b]} are hard to tell apart: the correlation of their "
                f"estimates is {both[a, b]:.2f}."
                for a, b in np.argwhere(np.triu(np.abs(both) > _CONFOUNDED, 1))
            ]
        if self.error > _LARGE:
            warnings.append(
                f"The log-likelihood has an error of {self.error:.1f}: take more particles. With "
                "too few, a fitted deviation of the measurements is too large."
            )
        section = Section("", [Text(f"{values}.", prominent=True), Facts(facts)])
        return Page("", "", [section], warnings, alarms=alarms)


class _Group(NamedTuple):
    """Replicates with the same clock and the same parameters."""

    model: StateSpaceModel
    y: Array  # (R, T+1, m)


class _Replicates(NamedTuple):
    """Some replicates of a group; picklable."""

    model: StateSpaceModel
    y: Array
    first: int
    particles: int  # 0: the exact likelihood
    stream: int
    is_trial: bool  # a model that fails then explains nothing
    proposal: str  # one that moves particles; empty for the plain one


@with_options
@checked
def fit(
    job: JobSource,
    data: UserTable,
    parameters: Sequence[str] | Mapping[str, tuple[float, float]],
    *,
    replicate: str = "",
    columns: Columns | None = None,
    within: float | None = None,
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] | None = None,
    evaluations: Annotated[Whole, Field(ge=1, le=100_000)] = 3000,
    profile: bool = False,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Fitted:
    """Fit parameters of the filter's model by maximum likelihood.

    The log evidence of all replicates is computed by the Kalman filter for the engine "kalman", and
    else by particles with common random numbers, which are resampled in the order of their first
    component that differs. Where components of x do not move, particles do; see
    docs/particles.md. The search is Nelder and Mead's, which needs no derivatives. It starts
    at the values of the job, and then at distant values until the best two results agree.
    Parameters that cannot be negative are sought on a logarithmic scale. If the table has a column
    train, only replicates with train = 1 are used, which `backtest` does not judge.

    Parameters
    ----------
    job : Problem, Job, str or Path
    data : str, Path or DataFrame
        As for `pfdist.backtest`; repeats count, too.
    parameters : sequence of str, or mapping of str to (float, float)
        Names of the parameters, if wanted with the lowest and the highest value.
    replicate : str, optional
        Column with the name of the replicate; by default the first.
    columns : mapping of str to str, or list of str, optional
        Names of the table's columns that have other names there, as ``{"y0": "conc"}``.
    within : float, optional
        Largest distance from a time to the instant that is used instead, if the model's step does
        not read p.dt; by default half a step.
    particles : int, optional
        Number of particles; by default filter.particles of the job, or 300 that move.
    evaluations : int
        Largest number of evaluations of the likelihood, without those of the profiles.
    profile : bool
        Whether to follow the likelihood from its maximum along each parameter, with the largest
        likelihood over the others: it shows what the data leave open.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3``.
    options
        See `Options`.

    Returns
    -------
    Fitted

    Raises
    ------
    ModelError
        The log-likelihood of the model lacks a constant (it must declare ``normalised=True``).
    ArgumentError
        A parameter is unknown, varies, or has a column in the table.
    MeasurementsError
        The table is wrong, or the measurements are impossible at the start.
    """
    chosen, table = Chosen(**options), table_argument("data", data)
    proposal = as_job(job, changes).filter.proposal
    # No times are judged, so nothing is tried.
    settings = {"execution": chosen.execution, "filter": {"proposal": PLAIN.name}}
    own = as_job(job, changes, settings=settings)
    is_of_run = is_job_of_run(own.path)  # its models remember states until values arrive
    built = build(own if is_of_run else own.without_delays())  # when values arrive, tells nothing
    believed = built.evaluator.believed
    if built.evaluator.has_particles and not believed.normalised:
        raise ModelError(
            f"a fit needs a log_likelihood with all constants (normalised=True), but the model "
            f"{believed.name} does not declare this: without, a deviation would grow without end"
        )
    start, bounds = _start(believed, parameters)
    scenarios = built.job.scenarios
    if scenarios is not None and scenarios.filter != "nominal":
        for name in {*start} & {*scenarios.names}:
            raise ArgumentError(
                f"parameters must be the same for all systems, got {name}, of which "
                f"[scenarios.parameters] has others: write {name} * {name}_factor in the model, "
                f"and let {name}_factor differ",
                argument="parameters",
            )
    parts = {**built.evaluator.model.parameters, **believed.parameters}
    names = [*built.job.problem.clock.without(parts)]
    reading = reading_of(built, columns, within, chosen.say)._replace(all_count=True)
    replicates = read_replicates(
        table, replicate, built.evaluator.model, built.job.problem.clock, [*dict.fromkeys(names)],
        reading,
    )  # fmt: skip
    used = [each for each in replicates if each.is_training] or replicates
    if both := sorted({*start} & {name for each in used for name in each.parameters}):
        raise ArgumentError(f"parameters must have no column in the table, got {both[0]}")
    groups = dict[Any, list[Replicate]]()
    for each in used:
        groups.setdefault(each.key, []).append(each)
    grouped = [_group(built, those, start) for those in groups.values()]
    moving = _moving(built, proposal)
    usual = (
        max(MOVED, built.job.filter.moved_particles or 0) if moving else built.comparing.particles
    )
    number = (particles or usual) if built.evaluator.has_particles else 0
    with (
        following(chosen.progress, chosen.say) as (show, tell),
        at_work(built.job.execution, [built.evaluator.engine], tell) as pool,
    ):
        fitting = _Fitting(grouped, number, moving, built.job.seed, pool, start, bounds)
        return fitting.fitted(evaluations, show, profile=profile)


def _moving(built: Built, wanted: str) -> str:
    """The proposal that moves particles, as the job says or for constants; else nothing."""
    evaluator, carries = built.evaluator, built.comparing.carries
    if wanted != AUTO:
        named = PROPOSALS[wanted]
        if named.moves:
            named.check(evaluator.engine, evaluator.believed, carries=carries)
        return named.name * named.moves
    found = None if carries else moving_of(built)
    return found.proposal if found else ""


def _group(built: Built, replicates: Sequence[Replicate], fitted: Iterable[str]) -> _Group:
    """Replicates of the same key, whose measurements have as many rows of each sensor."""
    most = max(each.y.shape[1] for each in replicates)
    y = [np.pad(each.y, ((0, 0), (0, most - each.y.shape[1])), constant_values=np.nan)
         for each in replicates]  # fmt: skip
    believed = evaluator_for(built, replicates[0], is_predicted=False).believed
    model = repeated(believed, most // believed.components[1])
    return _Group(recorded_if_it_holds(model, range(len(y[0])), fitted), np.stack(y))


class _Found(NamedTuple):
    """Result of the search from one start."""

    judged: Array  # log-likelihoods under noise that did not choose the point; one if it is exact
    own: float  # the log-likelihood under the noise of the search
    point: Array


@dataclass(frozen=True)
class _Fitting:
    """The likelihood of parameters, and its largest value.

    A search moves points: values, or their logarithms, in units of a scale for each parameter.
    """

    groups: Sequence[_Group]
    particles: int  # 0: the exact likelihood
    proposal: str
    seed: int
    pool: Pool
    start: Mapping[str, float]
    bounds: Array  # (K, 2)

    def fitted(self, evaluations: int, show: Show, *, profile: bool) -> Fitted:
        """The best result of searches from distant starts, until the best two agree."""
        tried, found = 0, list[_Found]()

        def loss(point: Array, repeat: int) -> float:
            nonlocal tried
            tried += 1
            doing = f"Fit: {tried:,} of at most {evaluations:,} likelihoods"
            show(Progress("fit", tried, evaluations, doing=doing))
            try:
                return -self._likelihood(self._values(point), repeat, is_trial=True)
            except ModelError:  # a value that the model does not allow
                return math.inf

        started_at = self._likelihood(self.start)
        if started_at == -math.inf:
            raise MeasurementsError(f"the measurements are impossible at the start, {self.start}")
        begin, *ends = (self._point(each) for each in (self._begin, *self.bounds.T))
        low, high = np.maximum(ends[0], begin - _REACH), np.minimum(ends[1], begin + _REACH)
        uniform = generator(stream_of("fit", self.seed, "starts")).random((_STARTS, begin.size))
        starts, known = low + uniform * (high - low), [begin]
        while not _agree(found) and tried < evaluations and len(starts):
            repeat, start = len(found) and _REPEATS + len(found), begin
            if found:
                distances = np.linalg.norm(starts[:, None] - np.array(known), axis=2).min(axis=1)
                start, starts = (
                    starts[distances.argmax()],
                    np.delete(starts, distances.argmax(), axis=0),
                )
                if loss(start, repeat) == math.inf:
                    continue
            left = evaluations - tried
            point, least = _least(partial(loss, repeat=repeat), start, ends, _STEP, left)
            away = np.abs(self.bounds.T - [*self._values(point).values()])
            for side, k in np.argwhere(away <= _NEAR * np.abs(self._begin)):
                there = np.where(np.arange(point.size) == k, ends[side], point)
                if tried < evaluations and (value := loss(there, repeat)) <= least:
                    point, least = there, value  # a logarithm comes only near 0
            others = range(1, _REPEATS + 1) if self.particles else [0]
            judged = [self._likelihood(self._values(point), each) for each in others]
            found.append(_Found(np.array(judged), -least, point))
            found.sort(key=lambda each: -each.judged.mean())
            known += [start, point]
        again, own, point = found[0]
        likelihood, error = float(again.mean()), 0.0
        if self.particles:  # under its own noise, the largest value is too large on average
            error = math.hypot(again.std(ddof=1), max(0.0, own - likelihood))
        is_on_bound = (point == np.array(ends)).any(axis=0)
        on_bound = tuple(np.array([*self.start])[is_on_bound].tolist())
        replicates = sum(len(group.y) for group in self.groups)
        point, mirrored, turned = self._with_signs(point, again, others)
        fitted = Fitted(self._values(point), likelihood, error, started_at, tried, _agree(found),
                        replicates, len(found), on_bound, mirrored, turned)  # fmt: skip
        return self._profiled(fitted, point, ends, partial(loss, repeat=0)) if profile else fitted

    def _with_signs(
        self, point: Array, own: Array, repeats: Iterable[int]
    ) -> tuple[Array, tuple[str, ...], tuple[str, ...]]:
        """A point with the signs of the start where both are as likely, these, and other signs.

        `own` has the log-likelihoods of the point, under the noise of `repeats`.
        """
        mirrored, turned = list[str](), list[str]()
        for k, name in enumerate(self.start):
            if not -self.bounds[k, 0] == self.bounds[k, 1] == math.inf or not point[k]:
                continue
            other = np.where(np.arange(point.size) == k, -point, point)
            values = self._values(other)
            there = np.array([self._likelihood(values, each, is_trial=True) for each in repeats])
            is_turned = self._begin[k] * point[k] < 0.0
            if _are_alike(own, there):
                mirrored.append(name)
                point = other if is_turned else point
            elif is_turned:
                turned.append(name)
        return point, tuple(mirrored), tuple(turned)

    def _profiled(self, fitted: Fitted, best: Array, ends: Sequence[Array], loss: Loss) -> Fitted:
        """A result with its profiles, and the correlation that follows from them.

        Where the profile of k is a parabola, the others move along it by cov(j, k) / var(k).
        """
        names, rows = [*self.start], list[dict[str, Any]]()
        slopes, least = np.eye(best.size), loss(best)
        for k, name in enumerate(names):
            sides = [[*_along(k, way, best, least, ends, loss)] for way in (-_SMALL, _SMALL)]
            points = [*reversed(sides[0]), (best, least), *sides[1]]
            rows += [
                {"parameter": name, **self._values(point), "below": value - least}
                for point, value in points
            ]
            number = len(points) if self.particles else _NEAREST  # near ones drown in the noise
            near = [point - best for side in sides for point, _ in side[:number]]
            moved = np.array([*near, np.zeros(best.size)])
            with np.errstate(invalid="ignore"):
                slopes[:, k] = moved[:, k] @ moved / (moved[:, k] @ moved[:, k])
        both = np.sqrt(np.maximum(slopes * slopes.T, 0.0)) * np.sign(slopes + slopes.T)
        correlation = pd.DataFrame(both.clip(-1.0, 1.0), names, names)
        return replace(fitted, profile=pd.DataFrame(rows), correlation=correlation)

    @cached_property
    def _begin(self) -> Array:
        return np.array([*self.start.values()])

    @cached_property
    def _is_log(self) -> NDArray[np.bool_]:
        """Which parameters are sought on a logarithmic scale."""
        return (self._begin > 0.0) & (self.bounds[:, 0] >= 0.0)

    @cached_property
    def _scale(self) -> Array:
        """The unit of points: of a logarithm 1, else the start, at most the bounds' distance."""
        size, width = np.where(self._begin, np.abs(self._begin), 1.0), np.ptp(self.bounds, axis=1)
        return np.where(self._is_log, 1.0, np.minimum(size, np.where(width > 0.0, width, size)))

    def _point(self, values: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self._is_log, np.log(values), values) / self._scale

    def _values(self, point: Array) -> dict[str, float]:
        at = point * self._scale
        values = np.where(self._is_log, np.exp(np.where(self._is_log, at, 0.0)), at)
        return dict(zip(self.start, values.clip(*self.bounds.T).tolist(), strict=True))

    def _likelihood(
        self, values: Mapping[str, float], repeat: int = 0, *, is_trial: bool = False
    ) -> float:
        """The log evidence of all replicates, which are shared out to the workers."""
        parts, stream = list[_Replicates](), stream_of("fit", self.seed, repeat)
        for model, y in self.groups:
            changed, size = model.with_parameters(values), -(-len(y) // self.pool.workers)
            for first in range(0, len(y), size):
                some = y[first : first + size]
                how = self.particles, stream, is_trial, self.proposal
                parts.append(_Replicates(changed, some, first, *how))
        totals = dict(outcomes(self.pool, _evidence, parts, "the fit"))
        return math.fsum(totals.values())


def _least(
    loss: Loss, start: Array, ends: Sequence[Array], step: float | Array, evaluations: int
) -> tuple[Array, float]:
    """The least value of a function between two ends, and where it is, by Nelder and Mead."""
    up, down = ends[1] - start, start - ends[0]
    steps = np.clip(np.where(up >= down, up, -down), -step, step)  # to the larger side
    options: Any = {"initial_simplex": np.vstack([start, start + np.diag(steps)]),
                    "maxfev": evaluations, **_TOLERANCE}  # fmt: skip
    found = minimize(loss, start, method="Nelder-Mead", bounds=[*zip(*ends, strict=True)],
                     options=options)  # fmt: skip
    return found.x, float(found.fun)


def _along(
    k: int, way: float, best: Array, least: float, ends: Sequence[Array], loss: Loss
) -> Iterator[tuple[Array, float]]:
    """Points with values of a parameter on one side of the best, and their least losses."""
    others, point = np.arange(best.size) != k, best
    near = np.where(others, best, np.clip(best + way, *ends))
    rise = loss(near) - least
    way *= 0.5 / math.sqrt(2 * rise) if 0.0 < rise < math.inf else 10.0  # half a deviation
    for _ in range(_MOST_VALUES):
        # The others begin where the way so far points.
        start = np.clip(best + math.sqrt(2) * (point - best), *ends)
        start[k] = np.clip(best[k] + way, ends[0][k], ends[1][k])
        if start[k] == point[k]:  # an end
            return

        def rest(moved: Array, start: Array = start) -> float:
            return loss(np.insert(moved, k, start[k]))

        point, value = start, loss(start)
        if others.any():
            between, count = [end[others] for end in ends], _EACH * int(others.sum())
            moved, value = _least(rest, start[others], between, abs(way) / 8, count)
            point = np.insert(moved, k, start[k])
        yield point, value
        if value - least >= _FAR:
            return
        way *= math.sqrt(2)


def _agree(found: Sequence[_Found]) -> bool:
    """Whether the best two results, which are the first, are the same maximum up to the noise."""
    if len(found) < 2:
        return False
    return _are_alike(found[0].judged, found[1].judged)


def _are_alike(better: Array, other: Array) -> bool:
    """Whether log-likelihoods under the same noise differ by no more than the noise."""
    with np.errstate(invalid="ignore"):  # other noise may make the measurements impossible
        difference = better - other
        return bool(difference.mean() <= max(_AGREE, difference.std()))


def _start(
    model: StateSpaceModel, parameters: Sequence[str] | Mapping[str, tuple[float, float]]
) -> tuple[dict[str, float], Array]:
    """The value of each parameter in the job, and the lowest and highest values, (K, 2)."""
    given = parameters if isinstance(parameters, Mapping) else dict.fromkeys(parameters)
    start, bounds = dict[str, float](), list[tuple[float, float]]()
    for name, wanted in given.items():
        value = model.parameters.get(name)
        if not isinstance(value, int | float):
            known = [each for each, held in model.parameters.items() if not isinstance(held, tuple)]
            rule = f"names of parameters of the model {model.name}, {', '.join(known) or 'none'}"
            raise ArgumentError(must_be("parameters", rule, name, known), argument="parameters")
        allowed = model.parameter_ranges.get(name, (-math.inf, math.inf))
        low, high = wanted or allowed
        if not max(low, allowed[0]) <= value <= min(high, allowed[1]):
            raise ArgumentError(
                f"parameters: {name} must start in {low:g}..{high:g}, got {value:g}; "
                f"model.parameters.{name} of the job is the start",
                argument="parameters",
            )
        start[name] = float(value)
        bounds.append((max(low, allowed[0]), min(high, allowed[1])))
    if not start:
        raise ArgumentError("parameters must name at least one, got none", argument="parameters")
    return start, np.array(bounds)


def _evidence(part: _Replicates) -> float:
    try:
        if not part.particles:
            return float(exact_log_evidence(part.model, part.y).sum())
        given = part.model, part.y, part.particles, part.stream, part.first
        found = moved_log_evidence(*given, part.proposal) if part.proposal else log_evidence(*given)
        return float(found.sum())
    except ModelError:  # a formula is not finite at these values
        if part.is_trial:
            return -math.inf
        raise
