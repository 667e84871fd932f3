"""Fit parameters of a model to measurements of many systems, by maximum likelihood."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
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
from pfdist.filters.evidence import exact_log_evidence, log_evidence
from pfdist.filters.replicates import Replicate, read_replicates
from pfdist.models import StateSpaceModel
from pfdist.pools.base import Pool
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.at_work import at_work
from pfdist.questions.options import Chosen, Options, following, with_options
from pfdist.questions.planned_run import UserTable, table_argument
from pfdist.runner.backtesting import evaluator_for, outcomes
from pfdist.runner.build import build
from pfdist.runner.progress import Progress, Show

Array = NDArray[np.float64]
_STEP = 0.2  # of the first values that are tried: a fifth of the start
_REPEATS = 8  # estimates under other noise, from which the error of the likelihood follows
_LARGE = 2.0  # an error of a log-likelihood
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
        Standard deviation of the log-likelihood from noise to noise; 0 if it is exact.
    started_at : float
        The log-likelihood at the start.
    evaluations : int
    is_converged : bool
    replicates : int
    """

    parameters: dict[str, float]
    log_likelihood: float
    error: float
    started_at: float
    evaluations: int
    is_converged: bool
    replicates: int

    def as_json(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return vars(self)

    def _page(self) -> Page:
        values = ", ".join(f"{name} = {rounded(each)}" for name, each in self.parameters.items())
        likelihood = with_error(self.log_likelihood, self.error) if self.error else (
            f"{rounded(self.log_likelihood)} (exact)"
        )  # fmt: skip
        facts = [("log-likelihood", f"{likelihood} (at the start: {rounded(self.started_at)})"),
                 ("evaluations", f"{self.evaluations:,}"),
                 ("replicates", str(self.replicates))]  # fmt: skip
        warnings = list[str]()
        alarms = ["The search has not converged: start at its result."] * (not self.is_converged)
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


class _Part(NamedTuple):
    """Some replicates of a group; picklable."""

    model: StateSpaceModel
    y: Array
    first: int
    particles: int  # 0: the exact likelihood
    stream: int


@with_options
@checked
def fit(
    job: JobSource,
    data: UserTable,
    parameters: Sequence[str] | Mapping[str, tuple[float, float]],
    *,
    replicate: str = "",
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] | None = None,
    evaluations: Annotated[Whole, Field(ge=1, le=100_000)] = 1000,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Fitted:
    """Fit parameters of the filter's model by maximum likelihood.

    The log evidence of all replicates is computed by the Kalman filter for the engine "kalman", and
    else by particles with common random numbers, which are resampled in the order of their first
    component. The search is Nelder and Mead's, which needs no derivatives. It starts at the values
    of the job; parameters that cannot be negative are sought on a logarithmic scale. If the table
    has a column train, only replicates with train = 1 are used, which `backtest` does not judge.

    Parameters
    ----------
    job : Problem, Job, str or Path
    data : str, Path or DataFrame
        As for `pfdist.backtest`.
    parameters : sequence of str, or mapping of str to (float, float)
        Names of the parameters, if wanted with the lowest and the highest value.
    replicate : str, optional
        Column with the name of the replicate; by default the first.
    particles : int, optional
        Number of particles; by default filter.particles of the job.
    evaluations : int
        Largest number of evaluations of the likelihood.
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
    built = build(as_job(job, changes, settings={"execution": chosen.execution}))
    believed = built.evaluator.believed
    if not (believed.normalised or built.evaluator.exact):
        raise ModelError(
            f"a fit needs a log_likelihood with all constants (normalised=True), but the model "
            f"{believed.name} does not declare this: without, a deviation would grow without end"
        )
    start, bounds = _start(believed, parameters)
    names = [*built.evaluator.model.parameters, *believed.parameters]
    replicates = read_replicates(
        table, replicate, built.evaluator.model, built.job.problem.clock, [*dict.fromkeys(names)]
    )
    used = [each for each in replicates if each.is_training] or replicates
    if both := sorted({*start} & {name for each in used for name in each.parameters}):
        raise ArgumentError(f"parameters must have no column in the table, got {both[0]}")
    groups = dict[Any, list[Replicate]]()
    for each in used:
        groups.setdefault(each.key, []).append(each)
    grouped = [
        _Group(evaluator_for(built, those[0], is_predicted=False).believed,
               np.stack([each.y for each in those]))
        for those in groups.values()
    ]  # fmt: skip
    number = 0 if built.evaluator.exact else particles or built.comparing.particles
    is_log = (np.array([*start.values()]) > 0.0) & (bounds[:, 0] >= 0.0)
    with (
        following(chosen.progress, chosen.say) as (show, tell),
        at_work(built.job.execution, [built.evaluator.engine], tell) as pool,
    ):
        fitting = _Fitting(grouped, number, built.job.seed, pool, [*start], is_log)
        return fitting.fitted(start, bounds, evaluations, show)


@dataclass(frozen=True)
class _Fitting:
    """The likelihood of parameters, and its largest value."""

    groups: Sequence[_Group]
    particles: int  # 0: the exact likelihood
    seed: int
    pool: Pool
    names: Sequence[str]
    is_log: NDArray[np.bool_]  # which parameters are sought on a logarithmic scale

    def fitted(
        self, start: Mapping[str, float], bounds: Array, evaluations: int, show: Show
    ) -> Fitted:
        """The result of a search that begins at the start."""
        tried = 0

        def loss(point: Array) -> float:
            nonlocal tried
            tried += 1
            doing = f"Fit: {tried:,} of at most {evaluations:,} likelihoods"
            show(Progress("fit", tried, evaluations, doing=doing))
            try:
                return -self._likelihood(self._values(point))
            except ModelError:  # a value that the model does not allow
                return math.inf

        begin, *ends = (self._point(each) for each in ([*start.values()], *bounds.T))
        started_at = self._likelihood(start)
        if started_at == -math.inf:
            raise MeasurementsError(f"the measurements are impossible at the start, {start}")
        steps = np.where(self.is_log, _STEP, _STEP * np.maximum(np.abs(begin), 1.0))
        simplex = np.clip(np.vstack([begin, begin + np.diag(steps)]), *ends)
        options: Any = {"initial_simplex": simplex, "maxfev": evaluations, **_TOLERANCE}
        found = minimize(loss, begin, method="Nelder-Mead", bounds=[*zip(*ends, strict=True)],
                         options=options)  # fmt: skip
        best, likelihood, error = self._values(found.x), -float(found.fun), 0.0
        if self.particles:
            others = [self._likelihood(best, repeat) for repeat in range(1, _REPEATS + 1)]
            likelihood, error = float(np.mean(others)), float(np.std(others, ddof=1))
        replicates = sum(len(group.y) for group in self.groups)
        converged = bool(found.success)
        return Fitted(best, likelihood, error, started_at, tried, converged, replicates)

    def _point(self, values: Sequence[float]) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.is_log, np.log(values), values)

    def _values(self, point: Array) -> dict[str, float]:
        values = np.where(self.is_log, np.exp(np.where(self.is_log, point, 0.0)), point)
        return dict(zip(self.names, values.tolist(), strict=True))

    def _likelihood(self, values: Mapping[str, float], repeat: int = 0) -> float:
        """The log evidence of all replicates, which are shared out to the workers."""
        parts, stream = list[_Part](), stream_of("fit", self.seed, repeat)
        for model, y in self.groups:
            changed, size = model.with_parameters(values), -(-len(y) // self.pool.workers)
            for first in range(0, len(y), size):
                some = y[first : first + size]
                parts.append(_Part(changed, some, first, self.particles, stream))
        totals = dict(outcomes(self.pool, _evidence, parts, "the fit"))
        return math.fsum(totals.values())


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


def _evidence(part: _Part) -> float:
    if not part.particles:
        return float(exact_log_evidence(part.model, part.y).sum())
    given = part.model, part.y, part.particles, part.stream, part.first
    return float(log_evidence(*given).sum())
