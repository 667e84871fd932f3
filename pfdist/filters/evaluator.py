"""The Monte Carlo estimate of the expected MSE (paper, section 2.3, equation 6).

A result is a pure function of its arguments. A work may be cut between any two draws: the MSE of
each draw stays the same, and so does every number computed from the draws in their order.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common import stopping
from pfdist.common.measurement_times import Lag, ManySets, Times
from pfdist.common.points import PointNumbers
from pfdist.common.scenario import Scenario
from pfdist.common.streams import stream_key
from pfdist.filters.cloud import Gaussian, Indices, Prior
from pfdist.filters.draws import Draws, check_prior
from pfdist.filters.engine import Engine
from pfdist.filters.engines import COMPILED, ENGINES, NUMPY
from pfdist.filters.interface import EACH_DRAW, SUMS, validated_from
from pfdist.filters.kalman import cached_matrices
from pfdist.filters.particle_filter import KERNEL_VERSION, filter_checked_draws
from pfdist.filters.proposals import PROPOSALS
from pfdist.filters.scenarios import scenarios_of_draws, stretches
from pfdist.filters.settings import check_filter_settings, check_fits
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, FilterWork, Result, columns, control_of, cut, joined
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.by_value import by_value, models_made
from pfdist.models.parameters import Parameter, check_lengths
from pfdist.models.recorded import check_same_functions, declared, recorded
from pfdist.models.written import key_of_model


@dataclass(frozen=True)
class Evaluator:
    """A function that computes the MSE of sets of times, for a model and a filter's model.

    The evaluator of a job holds recorded models; see `recorded_evaluator`. It is sent to the
    workers, and each process compiles its formulas once. Raises `PriorError` if the prior does not
    fit a model or the horizon, and `ModelError` if an estimation or the filter's model does not
    fit, or if the engine "kalman" needs another model.
    """

    model: StateSpaceModel  # the true model: it draws x, y and z, and defines the error
    horizon: int  # T
    filter_model: StateSpaceModel | None = None  # by default the true model
    engine: str = "compiled"  # "auto" here means the compiled engine
    # Distribution of x(s), in the place of `initial`: draws and filters start at s. A normal
    # distribution is only for the engine "kalman".
    prior: Prior | None = None
    # (T+1,): of each instant's error; by default all are equal
    weights: tuple[float, ...] | None = None
    # those that will be wanted: they are checked here, and compiled by `compile`
    estimations: tuple[Estimation, ...] = ()
    # (T+1,): the time of each instant, if formulas may read it
    times: tuple[float, ...] | None = None
    # Each draw has the parameters of one of these scenarios; none: of the model. If the filter is
    # told, it has the parameters of the draw's scenario, too.
    scenarios: tuple[Scenario, ...] = ()
    knows_scenario: bool = False
    scale: float = 1.0  # the squared errors are divided by it; see `Scenario`
    # The estimate of z(t) uses measurements until t + lag, in instants: 0 for that of the filter, T
    # for that from all measurements. See `Estimation`.
    lag: Lag = 0
    # (ways,): the instants after which a value arrives, of an estimate that waits for all values,
    # and of that at the moment, see `at_the_moment`. Otherwise a point is that of the arrival.
    delays: tuple[int, ...] = ()
    # whether its error is minus the information, in nats
    gives_information: bool = False
    # those that were made of this one, see `pfdist.filters.variants`
    variants: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.computed_by.check()
        check_fits(self.believed, self.model)
        if self.prior is not None:
            for each in (self.model, self.believed):
                check_prior(self.prior, each, self.horizon, by_particles=self.has_particles)
        if self.exact and not self.of_scenarios:
            for each in (self.model, self.believed):
                cached_matrices(each, self.horizon)
        for estimation in self.estimations:
            self.check(estimation)

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel as the models' programs; functions of a batched model travel by value."""
        names = {each.name for each in fields(self) if each.init} - {"model", "filter_model"}
        return _arrived, (self._content, {name: getattr(self, name) for name in names})

    @cached_property
    def _content(self) -> bytes:
        return by_value((self.model, self.filter_model))

    @cached_property
    def keys(self) -> tuple[str, str]:
        """Hashes of the true model and of the filter's model."""
        instants = range(self.horizon + 1)
        model, believed = (
            key_of_model(recorded(each, instants)) for each in (self.model, self.believed)
        )
        return model, believed

    @property
    def start(self) -> int:
        """The first instant: 0, or the instant of the prior."""
        return 0 if self.prior is None else self.prior.t

    @cached_property
    def instant_weights(self) -> NDArray[np.float64] | None:
        """Weight of each instant's error from the first instant on; None if all are 1.

        The mean is 1, or 1 / scale.
        """
        if self.weights is None and self.scale == 1.0:
            return None
        weights = np.array((self.weights or (1.0,) * (self.horizon + 1))[self.start :])
        return weights / (self.scale * weights.mean()) if weights.any() else weights

    @property
    def relative_weights(self) -> NDArray[np.float64]:
        """Weight of each instant's error, (T+1,), whose mean is 1."""
        weights = np.array(self.weights or (1.0,) * (self.horizon + 1))
        relative: NDArray[np.float64] = weights / weights.mean()
        return relative

    @property
    def believed(self) -> StateSpaceModel:
        """The model that the filter uses."""
        return self.filter_model or self.model

    def arriving(self, sets: Sequence[Times]) -> Sequence[Times]:
        """Sets of the points at which values arrive, until T, for an estimate at the moment."""
        if not self.delays or self.lag:
            return sets
        ways, end = self.points.ways, self.points.first(self.horizon + 1)
        later = [[point + ways * self.delays[point % ways] for point in times] for times in sets]
        return [tuple(sorted(point for point in times if point < end)) for times in later]

    @cached_property
    def of_scenarios(self) -> tuple["Evaluator", ...]:
        """The evaluator of each scenario; empty without scenarios.

        They share the formulas of this evaluator, which are compiled once.
        """
        evaluators = []
        for scenario in self.scenarios:
            model, believed = self.model.with_parameters(scenario.parameters), self.believed
            check_lengths(scenario.parameters, self.horizon + 1, "", exactly=True)
            if self.knows_scenario:
                believed = believed.with_parameters(scenario.parameters)
            alone = replace(
                self,
                model=model,
                filter_model=believed,
                scenarios=(),
                knows_scenario=False,
                scale=self.scale if self.gives_information else scenario.scale,
            )
            evaluators.append(alone)
        return tuple(evaluators)

    def scenarios_of(self, stream: int, draws: range) -> Indices | None:
        """The number of each draw's scenario, (D,); None without scenarios."""
        if not self.scenarios:
            return None
        return scenarios_of_draws(self.shares, stream, draws)

    @property
    def shares(self) -> list[float]:
        """The share of each scenario; 1 without scenarios."""
        return [each.share for each in self.scenarios] or [1.0]

    @property
    def computed_by(self) -> Engine:
        """The engine that computes."""
        return ENGINES.get(self.engine, COMPILED)

    @property
    def points(self) -> PointNumbers:
        """The numbers of possible measurements."""
        return self.model.points

    @property
    def exact(self) -> bool:
        """Whether the engine computes the expected MSE without draws; see `exact_mse`.

        That of a smoothed estimate takes draws if the filter believes another model.
        """
        return self.computed_by.exact and not (
            self.lag and any(e.believed != e.model for e in self.of_scenarios or (self,))
        )

    @property
    def has_particles(self) -> bool:
        """Whether the engine filters with particles."""
        return self.computed_by.has_particles

    @property
    def has_squared_error(self) -> bool:
        """Whether the error is the squared norm, not one that the model defines."""
        return self.model.error is squared_error

    @property
    def has_particle_loss(self) -> bool:
        """Whether the particle loss is known: of filters, if the error is the squared norm."""
        return self.has_particles and self.has_squared_error

    def sum_errors(self, work: FilterWork) -> NDArray[np.float64]:
        """Sum the weighted errors of each instant over the draws of a work, (S, T+1).

        All sets of the work have the same filter noise. Values after a set's end are arbitrary. A
        set has NaN if a draw is infinite with it, or degenerate although the truth is among the
        particles. Raises `ModelError` if a formula failed.
        """
        return self._summed(work).errors

    def _summed(self, work: FilterWork) -> FilterArrays:
        draws = self.draws(range(*work.draws), work.draws_stream)
        sets, ends, (stream, *_) = work.measurement_times, work.ends, work.filter_streams
        return self.filter_sets(draws, sets, ends, stream, work.estimation, SUMS)

    def work(
        self,
        sets: Sequence[Times],
        stream: int,
        draws_stream: int,
        draws: tuple[int, int],
        estimation: Estimation,
        **others: Any,
    ) -> FilterWork:
        """The work of filtering S sets up to T under the same noise, and other fields."""
        same: dict[str, Any] = {
            "ends": (self.horizon,) * len(sets),
            "filter_streams": (stream,) * len(sets),
            "sensors": self.points.ways,
            "together": max(1, self.most_together // estimation.particles),
        }
        return FilterWork(
            measurement_times=sets if isinstance(sets, ManySets) else tuple(sets),
            draws_stream=draws_stream,
            draws=draws,
            estimation=estimation,
            **(same | others),
        )

    @cached_property
    def most_together(self) -> int:
        """The largest number of particles in an array that a declared function gets, or 0."""
        functions = declared(self.model) | declared(self.believed)
        return max((function.together for function in functions.values()), default=0)

    @property
    def variance_is_error(self) -> bool:
        """Whether the variance of the particles estimates the error, which varies more.

        The filter must have the true model, and be told the scenario if there are several. The
        error must be the squared norm.
        """
        is_told = self.knows_scenario or not self.scenarios
        return is_told and self.believed == self.model and self.has_squared_error

    def id_of(self, estimation: Estimation, *parts: Any) -> str:
        """A hash of the evaluator, an estimation, and further parts with JSON values.

        With the times, the end and the stream it is the id of an evaluation: a hash of everything
        on which the MSE of a draw depends.
        """
        key = stream_key(
            KERNEL_VERSION,
            *self.keys,
            self.horizon,
            self.engine,
            estimation.recorded,
            *(part for part in (self.times, self.weights) if part is not None),
            *([[*map(vars, self.scenarios)], self.knows_scenario] if self.scenarios else []),
            *(["lag", self.lag] if self.lag else []),
            *parts,
        )
        return f"{key:016x}"

    def compile(self, *estimations: Estimation) -> None:
        """Compile the simulation, and the filter of each estimation, by an empty range of draws.

        Raises `TraceError` if a formula cannot be traced.
        """
        stopping.check()
        if self.engine == NUMPY.name or not estimations:
            return
        if self.computed_by.compiled:
            for formula in (declared(self.model) | declared(self.believed)).values():
                raise formula.why
        prior = None if isinstance(self.prior, Gaussian) else self.prior
        draws = simulate(self.model, self.horizon, range(0), 0, prior)
        for estimation in estimations:
            stopping.check()
            if self.has_particles:
                settings = self.settings(replace(estimation, particles=1))
                filter_checked_draws(self.believed, draws, (), 0, settings)
        stopping.check()
        for each in self.of_scenarios:
            each.compile(*estimations)

    def check(self, estimation: Estimation) -> None:
        """Raise `ModelError` if the filter's settings do not fit the models.

        Exact engines ignore the number of particles.
        """
        for each in self.of_scenarios:
            each.check(estimation)
        proposal, engine = PROPOSALS[estimation.proposal], self.computed_by.name
        proposal.check(engine, self.believed, carries=estimation.carries)
        if self.has_particles and not ALL_SCHEMES[estimation.resampling].holds_truth:
            check_filter_settings(self.believed, self.model, estimation)

    @property
    def seconds_a_step(self) -> float:
        """A rough guess of the seconds of a particle-step; models differ."""
        return self.computed_by.seconds_a_step

    def __call__(self, work: FilterWork) -> Result:
        """Per-draw MSE of every set of times in a work, after a check of its settings and times.

        Errors are those of `check`, a ModelError if a formula failed, and a MeasurementTimesError
        about times that do not lie in 0..end or are given twice.
        """
        self.check(work.estimation)
        for times, end in zip(work.measurement_times, work.ends, strict=True):
            validated_from(self.start, times, end, self.points)
        return self.filtered(work)

    def draws(self, index: range, stream: int) -> Draws:
        """Simulated draws of a stream; raises `ModelError` if a formula failed."""
        draws: Draws = self.computed_by.simulate(
            self.model, self.horizon, index, stream, self.prior
        )
        weights = self.instant_weights
        return draws if weights is None else replace(draws, weights=weights)

    def filter_sets(
        self,
        draws: Draws,
        sets: Sequence[Times],
        ends: Sequence[int],
        stream: int,
        estimation: Estimation,
        errors: str = "",
    ) -> FilterArrays:
        """Filter draws with several checked sets under the same noise: MSE, degenerate draws.

        The MSE, (D, S), is the sum of the errors up to each set's end, divided by the number of
        instants. For `errors`, see `pfdist.filters.particle_filter.filter_checked_sets`; those of
        each draw are also divided by the scale. Raises `ModelError` if a formula failed.
        """
        found: FilterArrays = self.computed_by.filters.filter_checked_sets(
            self.believed,
            draws,
            self.arriving(sets),
            ends,
            stream,
            self.settings(estimation),
            errors,
        )
        return found._replace(errors=found.errors / self.scale) if errors == EACH_DRAW else found

    def filter_each(
        self,
        draws: Draws,
        sets: Sequence[Times],
        streams: Sequence[int],
        estimation: Estimation,
    ) -> Iterator[FilterArrays]:
        """Filter draws with checked sets, each under noise of its own, with trajectories."""
        filters, settings = self.computed_by.filters, self.settings(estimation)
        for times, stream in zip(self.arriving(sets), streams, strict=True):
            yield filters.filter_checked_draws(self.believed, draws, times, stream, settings, True)

    def pieces(self, work: FilterWork, seconds: float) -> list[FilterWork]:
        """The parts of a work, cut between draws, each of about this many seconds."""
        draws = max(1, int(seconds / self.seconds_a_step / work.steps_a_draw))
        return [replace(work, draws=piece) for piece in cut(range(*work.draws), draws)]

    def filtered(self, work: FilterWork) -> Result:
        """Per-draw MSE as from `__call__`, for a work that the caller has checked."""
        numbers = self.scenarios_of(work.draws_stream, range(*work.draws))
        if numbers is not None:
            parts = stretches(numbers, work.draws[0])
            if work.summed and work.together == 1:
                singles = [(draw, draw + 1) for draw in range(*work.draws)]
                parts = zip(numbers, singles, strict=True)
            return joined([work.piece(draws).result(self.of_scenarios[n]) for n, draws in parts])
        if work.summed:
            first, ends = np.array([work.since, work.ends])[:, :, None]
            t = np.arange(self.start, self.horizon + 1)
            found = self._summed(work)
            sums = found.errors[(first <= t) & (t <= ends)]
            return Result(np.empty(0), sums=sums, work=found.work)
        draws = self.draws(range(*work.draws), work.draws_stream)
        if work.trajectories:
            streams, estimation = work.filter_streams, work.estimation
            each_set = [*self.filter_each(draws, work.measurement_times, streams, estimation)]
            mse, degenerate = (
                np.stack([getattr(each, name) for each in each_set], axis=1)
                for name in ("mse", "degenerate")
            )
            estimates, sizes, lines = (
                np.stack([getattr(each, name) for each in each_set])
                for name in ("estimate", "sizes", "lines")
            )
            steps = np.concatenate([each.work for each in each_set])
            return Result(
                mse, draws.z, draws.y, estimates, sizes, lines, degenerate=degenerate, work=steps
            )
        values = np.empty((len(draws.index), len(work.measurement_times)))
        control = np.zeros(values.shape if work.controlled else 0)
        degenerate = np.zeros(values.shape, np.bool_)
        errors = np.empty((*values.shape, draws.z.shape[1] if work.over_time else 0))
        taken = list[NDArray[np.float64]]()
        for stream, same_noise in columns(work.filter_streams).items():
            sets = [work.measurement_times[column] for column in same_noise]
            ends = [work.ends[column] for column in same_noise]
            wanted = EACH_DRAW if work.over_time else ""
            found = self.filter_sets(draws, sets, ends, stream, work.estimation, wanted)
            values[:, same_noise], degenerate[:, same_noise] = found[:2]
            errors[:, same_noise] = found.errors
            taken.append(found.work)
            if work.controlled:  # by the same noise, so that both errors have much in common
                estimation = control_of(work.estimation)
                found = self.filter_sets(draws, sets, ends, stream, estimation, wanted)
                control[:, same_noise] = np.where(np.isfinite(found.mse), found.mse, 0.0)
                errors[:, same_noise] -= np.where(np.isfinite(found.errors), found.errors, 0.0)
                degenerate[:, same_noise] |= found.degenerate
        steps = np.concatenate(taken)
        return Result(values, degenerate=degenerate, control=control, errors=errors, work=steps)

    def settings(self, estimation: Estimation) -> Estimation:
        """The estimation, with filters that start from the prior, and the lag of their error.

        The control of an own error is that of the filter, whose expectation is 0, too.
        """
        by_error = ESTIMATORS[estimation.estimator].by_error
        is_of_filter = by_error and not self.has_squared_error
        return replace(estimation, prior=self.prior, lag=0 if is_of_filter else self.lag)


def recorded_evaluator(
    model: StateSpaceModel,
    filter_model: StateSpaceModel,
    *,
    horizon: int,
    times: tuple[float, ...] | None = None,
    dates: Mapping[str, tuple[float, ...]] = MappingProxyType({}),
    others: Iterable[Mapping[str, Parameter]] = (),
    knows_scenario: bool = False,
    **settings: Any,
) -> Evaluator:
    """The evaluator of recorded models, which fit the times and each other.

    Parameters
    ----------
    model, filter_model : StateSpaceModel
        The true model, and the model that the filter uses.
    horizon : int
    times : tuple of float, (T+1,), optional
        The time of each instant, which formulas read.
    dates : mapping of str to tuple of float, optional
        The dates that formulas read at each instant; see `StateSpaceModel.on_clock`.
    others : iterable of mapping
        Further values of the truth's parameters: those of scenarios.
    knows_scenario : bool
        Whether the filter's model also has these values.
    settings
        Further fields of `Evaluator`.

    Raises
    ------
    ModelError
        A model does not fit the job, or has a formula that fails.
    """
    if times is not None:
        model, filter_model = (each.on_clock(times, dates) for each in (model, filter_model))
    for part, each in (("model", model), ("model.filter", filter_model)):
        check_lengths(each.parameters, horizon + 1, f"{part}.parameters.", exactly=True)
    check_fits(filter_model, model)
    filter_model, instants = filter_model.named_as(model), range(horizon + 1)
    is_same, known = filter_model == model, [*others]
    if is_same:
        check_same_functions(model, filter_model, instants)
    model = recorded(model, instants, known)
    if not is_same:
        filter_model = recorded(filter_model, instants, known if knows_scenario else ())
    return Evaluator(model, horizon, model if is_same else filter_model, times=times, **settings)


def _arrived(content: bytes, settings: dict[str, Any]) -> Evaluator:
    """An evaluator that has travelled to this process.

    It is compiled before its first task, because the time of tasks is limited.
    """
    model, filter_model = models_made(content)
    evaluator = Evaluator(model=model, filter_model=filter_model, **settings)
    evaluator.compile(*evaluator.estimations)
    return evaluator
