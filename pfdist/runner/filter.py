"""A filter for real measurements, one after another."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from pfdist.common.measurement_times import Lag
from pfdist.common.section import Whole, checked
from pfdist.common.streams import stream_of
from pfdist.errors import (
    ArgumentError,
    MeasurementsError,
    ModelError,
    PfdistWarning,
    shown,
)
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.filters.constants import constants_of, different_values
from pfdist.filters.draws import check_prior
from pfdist.filters.engines import (
    AUTO,
    COMPILED,
    ENGINES,
    EngineName,
    is_exact,
)
from pfdist.filters.filter_estimate import (
    Belief,
    FilterEstimate,
    Normal,
    Particles,
    estimate_of,
    explained_by_normal,
    few_particles,
    quantity,
    surprise_of_particles,
    weights_given,
)
from pfdist.filters.kalman import matrices_of
from pfdist.filters.one_filter import (
    Followed,
    OneFilter,
    checked_instant,
    checked_measurement,
    formatted_instant,
    log_likelihood,
)
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import FEW_VALUES, PROPOSALS, THAT_MOVES
from pfdist.filters.settings import check_filter_settings
from pfdist.filters.user_prior import as_prior
from pfdist.filters.work import Estimation
from pfdist.kernels.schemes import threshold_of
from pfdist.models import StateSpaceModel, installed_models, load_model
from pfdist.models.base import within_half_turn
from pfdist.models.recorded import declared
from pfdist.models.sensed import sensed
from pfdist.problem.job import Job
from pfdist.problem.needs import REAL_DATA
from pfdist.problem.problem import JobSource, Problem, as_job
from pfdist.problem.sensing_section import Sensings
from pfdist.runner.build import Built, build
from pfdist.store import holds_run

if TYPE_CHECKING:
    OfOneFilter = str
else:
    _OF_ONE = PLAIN.name, *(each.name for each in PROPOSALS.values() if each.moves)
    OfOneFilter = Literal[(AUTO, *_OF_ONE)]
Array = NDArray[np.float64]

LAST = 32_000  # the largest horizon of a job
# A surprise below `SUSPICIOUS` is computed again with `MANY` particles: 2 / 200,001 times 1,000
# measurements is 1 %, the level of the alarm.
SUSPICIOUS = 1e-3
MANY = 200_000
_UNMOVED, MOVED = 500, 300
"""Particles of the filter of one system by default, of which the second ones move."""
LEAST = 2 / MANY  # p-values below it cannot be told apart


class Filter(Followed):
    """A particle filter of one real system, which receives its measurements in the order of time.

    It is bit for bit the filter of a run with the same noise key.

    Parameters
    ----------
    model : StateSpaceModel, str, Path, Problem or Job
        The model, or a name that `pfdist.load_model` takes. If formulas read ``p.time`` or
        ``p.dt``, give ``model.on_clock(times)``. The filter counts instants.
        Or a job, its file or the folder of its run: then the model has the job's clock, parameters
        and sensors, and the job gives each argument that is left out.
    particles : int, optional
        Number of particles, by default 500, or 300 that move; the engine "kalman" has none.
    seed : int, optional
        Seed of the filter's noise, by default 0.
    resampling : {"systematic", "stratified", "multinomial"}, optional
    resample : str, optional
        "always" (the default), or "below 0.5" to resample only if the effective sample size falls
        below this share of the particles.
    engine : {"auto", "compiled", "batched", "numpy", "kalman"}, optional
        "auto" (the default) is the compiled engine, or the batched one for a batched model.
        "kalman" is exact, for models that declare themselves linear-Gaussian.
    proposal : {"auto", "plain", "moving"}, optional
        "moving" moves whole lines of particles at each measurement, so that constants are learned;
        see docs/particles.md. "auto" (the default) takes it if components of x do not move. After
        2,000 instants they no longer move.
    prior : Cloud, Gaussian, array or DataFrame, optional
        The distribution of x(s), instead of the model's `initial`; the filter then starts at s. An
        array (n, M) holds M particles of x(0); a DataFrame has a row for each. The `cloud` of
        another filter is also accepted. Components of a user's own particles do not move.
    draw : int
        Index of the filter in the stream of its noise.
    horizon : int, optional
        The last instant T that is allowed, by default 32,000.
    limits : tuple of sequences of float, (m,), optional
        For each component of y, the values below the first and above the second that its sensor
        reads as these: such a number is the censored reading. By default those of the job.

    Raises
    ------
    JobError
        The job is wrong.
    ModelError
        The model cannot be loaded or does not fit a setting, or a formula failed.
    PriorError
        The prior does not fit the model.
    ArgumentError
        A setting has a value that is not allowed.

    Examples
    --------
    >>> import pfdist
    >>> walk = pfdist.Filter("random_walk", engine="kalman")
    >>> walk.update(0, 3.0).mean.round(2).tolist()
    [2.88]
    >>> walk.predict(4).quantiles([0.25, 0.75]).round(2).tolist()
    [[1.38], [4.39]]
    >>> walk.now.t, round(walk.log_evidence, 3)
    (0, -2.721)
    """

    @checked
    def __init__(
        self,
        model: StateSpaceModel | JobSource,
        particles: int | None = None,
        seed: Annotated[Whole, Field(ge=-(2**63), lt=2**63)] | None = None,
        *,
        resampling: str | None = None,
        resample: str | None = None,
        engine: Annotated[EngineName, Field()] | None = None,
        proposal: Annotated[OfOneFilter, Field()] | None = None,
        prior: Prior | ArrayLike | None = None,
        draw: Annotated[Whole, Field(ge=0, lt=2**32)] = 0,
        horizon: Annotated[Whole, Field(ge=0, le=LAST)] | None = None,
        limits: tuple[Sequence[float], Sequence[float]] | None = None,
    ) -> None:
        given: dict[str, Any] = {"particles": particles, "seed": seed, "resampling": resampling}
        given |= {"resample": resample, "engine": engine, "horizon": horizon, "limits": limits}
        given["proposal"] = proposal
        own: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        if not isinstance(model, StateSpaceModel) and _is_job(model):
            job = as_job(model)
            built = build(job, follows=True)
            own = settings_of_job(built) | own
            clock = built.job.problem.clock
            prior = as_prior(prior, own["model"], clock.readers(), clock.instant_of_t)
        elif isinstance(model, StateSpaceModel | str):
            own["model"] = sensed(load_model(model) if isinstance(model, str) else model)
        else:
            rule = "a StateSpaceModel, a name, or a job"
            raise ModelError(f"a model must be {rule}, got {shown(model)}")
        if proposal is None and own.get("resample", "always") != "always":
            own["proposal"] = PLAIN.name  # moved particles have equal weights
        self._start(**own, prior=prior, draw=draw)

    def _start(
        self,
        model: StateSpaceModel,
        particles: int | None = None,
        seed: int = 0,
        resampling: str = "systematic",
        resample: str = "always",
        engine: EngineName = AUTO,
        proposal: str = AUTO,
        horizon: int = LAST,
        limits: tuple[Sequence[float], Sequence[float]] = ((-math.inf,), (math.inf,)),
        *,
        prior: Prior | ArrayLike | None,
        draw: int,
    ) -> None:
        self.model, self.horizon = _at_each_instant(model, horizon), horizon
        repeats = self.model.components[1] // len(limits[0])  # those of a sensor have the same
        low, high = (np.tile(ends, repeats) for ends in limits)
        self._limits: tuple[Any, Any] = low, high
        self.stream = stream_of("filter", seed)
        """The 64-bit key of the filter's noise."""
        start = as_prior(prior, self.model)
        if start is not None:
            check_prior(start, self.model, horizon, by_particles=not is_exact(engine))
        try:
            threshold = threshold_of(resample)
        except ValueError as error:
            raise ArgumentError(str(error)) from error
        name = COMPILED.name if engine == AUTO else engine
        proposal = _proposal_of(proposal, self.model, name, resample, horizon)
        moves = PROPOSALS[proposal].moves
        if particles is None:
            particles = MOVED if moves else _UNMOVED
        settings = Estimation(
            particles, resampling, prior=start, threshold=threshold, proposal=proposal
        )
        check_filter_settings(self.model, self.model, settings)
        PROPOSALS[proposal].check(name, self.model, carries=settings.carries)
        if engine == COMPILED.name:
            for formula in declared(self.model).values():
                raise formula.why
        if name == "kalman":
            matrices_of(self.model, 0)
        lines = start.lines_for(self.model) if moves and isinstance(start, Cloud) else None
        measured = lines is not None and lines.has_measured
        super().__init__(OneFilter(self.model, settings, self.stream, draw, name, measured))
        self._filter, mean, variance = self.unmeasured.at(self.unmeasured.t)
        self._ahead = self._filter
        # A filter with many particles is slow, so it does not follow each measurement. It stays at
        # the last suspicious one, and `_unseen_by_many` has all measurements since then.
        many = replace(settings, particles=4 * particles if moves else max(particles, MANY))
        self._many = replace(self.unmeasured, settings=many)
        self._unseen_by_many: list[tuple[int, Array]] = []
        self._evidence = 0.0
        tried = range(horizon + 1)
        knows = name != "kalman" and not declared(self.model)
        self._constants = constants_of(self.model, tried) if knows else ()
        self._collapsed: int | None = None
        self._now = self._estimate(mean[-1], variance[-1])

    @property
    def now(self) -> FilterEstimate:
        """The current estimate of z: that at the last update."""
        return self._now

    @property
    def log_evidence(self) -> float | None:
        """Logarithm of the density or probability of all measurements so far, by this model.

        None if the model does not declare its log-likelihood normalised; see `why_no_evidence`.
        """
        return None if self.why_no_evidence else self._evidence

    @property
    def why_no_evidence(self) -> str:
        """The reason why there is no log evidence; empty if there is."""
        if self.model.normalised or not ENGINES[self._filter.engine].has_particles:
            return ""
        return (
            f"the model {self.model.name} does not declare normalised=True, so its log_likelihood "
            "may lack a constant"
        )

    def update(
        self,
        t: int,
        y: float | Sequence[float] | Array,
        *,
        warn: bool = True,
        **given: float | None,
    ) -> FilterEstimate:
        """Move the filter to t and give it the measurement there.

        Parameters
        ----------
        t : int
            An instant after the last measurement.
        y : float or sequence of float, (m,)
            The measurement. NaN marks a missing component; the model must declare
            `missing_components`. If all components are missing, t was not measured. If the model
            has `works`, the measurement failed then; with several sensors, inf marks those that
            failed.
        warn : bool
            Whether to warn if the effective sample size falls below 5 for the first time. The
            estimate says so, too.
        given
            Values of parameters at this instant that come with the reading, such as its standard
            error: ``sd=0.2``. The model reads them as ``p.sd[t]``. None leaves the model's value.

        Returns
        -------
        Estimate

        Raises
        ------
        MeasurementsError
            The instant or the measurement is wrong, or no particle explains the measurement. The
            filter is unchanged.
        """
        t = self._instant(t)
        if t < self._filter.t or (t == self._filter.t and self._filter.measured):
            after = "after" if self._filter.measured else "not before"
            raise MeasurementsError(
                f"measurements must be given in the order of time, each instant once: t must be "
                f"{after} {self._formatted(self._filter.t)}, got {self._formatted(t)}"
            )
        measurement = checked_measurement(y, self.model, self._formatted(t), limits=self._limits)
        if measurement is None and self.model.works:
            measurement = np.full(self.model.components[1], np.inf)
        before = self.model
        if given:
            self._follow(self._with(t, given))
        if measurement is None:
            return self.wait(t)
        predicted, mean, variance = self._moved(t)
        try:
            moved, mean, variance = predicted.at(t, measurement)
        except MeasurementsError:
            self._follow(before)
            raise
        belief, log_density, surprise = self._explained(predicted, measurement, mean, variance)
        cloud, has_lost = _prior(moved), False
        if isinstance(cloud, Cloud) and cloud.lines is not None:
            z = quantity(self.model, cloud, mean[-1])
            belief, log_density = Particles(z, np.ones(cloud.particles), moved=True), moved.evidence
        if isinstance(cloud, Cloud) and cloud.particles >= FEW_VALUES and self._constants:
            expected = cast(Cloud, _prior(predicted))
            possible = np.isfinite(log_likelihood(self.model, expected, measurement)).sum()
            # Moves from few possible particles are too short to find the others.
            lost = min(possible, different_values(cloud.x, self._constants))
            has_lost = bool(lost < FEW_VALUES)
        now = estimate_of(
            t, mean[-1], variance[-1], self.model.is_angle, belief, surprise, self._collapsed,
            has_lost=has_lost,
        )  # fmt: skip
        if warn and now.collapsed == t:
            line = few_particles(f"at t = {self._formatted(t)}")
            warnings.warn(line, PfdistWarning, stacklevel=2)
        # The filter moves only here, after everything that may raise an error. So it stays where it
        # was if a measurement is refused.
        self._filter = self._ahead = moved
        self.seen.append((t, measurement))
        self._unseen_by_many.append((t, measurement))
        self._evidence += log_density
        self._now, self._collapsed = now, now.collapsed
        return now

    def wait(self, t: int) -> FilterEstimate:
        """Move the filter to t, where nothing was measured.

        Parameters
        ----------
        t : int
            An instant not before the last measurement.

        Returns
        -------
        Estimate

        Raises
        ------
        MeasurementsError
            The instant is wrong.
        """
        t = self._not_before_last(t)
        self._filter, mean, variance = self._moved(t)
        self._ahead, self._now = self._filter, self._estimate(mean[-1], variance[-1])
        return self._now

    def _with(self, t: int, given: Mapping[str, float | None]) -> StateSpaceModel:
        """The model with values of parameters at an instant."""
        values = dict[str, Any]()
        for name, value in given.items():
            own, at = self.model.parameters.get(name), f"at t = {self._formatted(t)}"
            if not (isinstance(own, tuple) and t < len(own)):
                raise MeasurementsError(
                    f"{name} must be a parameter of the model with a value for each instant, to be "
                    f"given with a measurement {at}"
                )
            number = own[t] if value is None else value if isinstance(value, Real) else math.nan
            if not math.isfinite(number):
                raise MeasurementsError(f"{name} must be a finite number, got {shown(value)} {at}")
            values[name] = (*own[:t], float(number), *own[t + 1 :])
        return self.model.with_parameters(values)

    def _follow(self, model: StateSpaceModel) -> None:
        """Continue with a model, as do the filters that follow the same measurements."""
        if model is self.model:
            return
        self.model = model
        self.unmeasured = replace(self.unmeasured, model=model)
        self._filter = self._ahead = replace(self._filter, model=model)
        self._many = replace(self._many, model=model)

    def predict(self, t: int) -> FilterEstimate:
        """The estimate of z(t); the filter does not move.

        Parameters
        ----------
        t : int
            An instant not before the last measurement.

        Returns
        -------
        Estimate

        Raises
        ------
        MeasurementsError
            The instant is wrong.
        """
        t = self._not_before_last(t)
        if t == self._now.t:
            return self._now
        self._ahead, mean, variance = self._moved(t)
        return self._estimate(mean[-1], variance[-1], self._ahead)

    def smoothed(self, t: int | None = None, lag: Lag | None = None) -> list[FilterEstimate]:
        """The estimates of z from all measurements so far, at each instant; the filter stays.

        The filter runs once more from its first instant, in NumPy, with the same noise, and keeps
        all particles of all instants. A particle has the weight of its descendants. Long before the
        last measurement these have few ancestors: see `FilterEstimate.effective_sample_size`.

        Parameters
        ----------
        t : int, optional
            The last instant, not before the last measurement; by default that of `now`.
        lag : int, or tuple of int, optional
            If given, the estimate of z(t) uses measurements until t + lag only. A tuple has a lag
            for each instant of the clock.

        Returns
        -------
        list of FilterEstimate
            For each instant from the first; without surprises.

        Raises
        ------
        MeasurementsError
            The instant is wrong.
        ArgumentError
            The lag is below 1; or there are too many instants, more than 1,465 with 500 particles.
        """
        start, is_angle = self.unmeasured, self.model.is_angle
        last = self.predict(self._now.t if t is None else t).t
        instants, measured = last + 1 - start.t, {at for at, _ in self.seen}
        if instants > start.most_smoothed:
            raise ArgumentError(
                f"the estimate of {start.settings.particles:,} particles can be smoothed at "
                f"{start.most_smoothed:,.0f} instants at most, got {instants:,}"
            )
        if lag is not None and not np.max(lag) >= 1:
            raise ArgumentError(f"lag must be at least 1, got {shown(lag)}", argument="lag")
        found, estimates = start.smoothed(last, self.seen, lag or instants), []
        moved = start.settings.moves
        for k, (mean, variance) in enumerate(
            zip(found.estimate[0], found.variance[0], strict=True)
        ):
            belief: Belief = Normal(mean, np.sqrt(variance))
            if found.line_z.size:
                z = within_half_turn(found.line_z[0, k].T, mean, is_angle).T
                belief = Particles(z, found.line_weight[0, k], moved)
            each = estimate_of(start.t + k, mean, variance, is_angle, belief)
            estimates.append(replace(each, measured=each.t in measured))
        return estimates

    def _instant(self, t: Any) -> int:
        try:
            return checked_instant(t, 0, self.horizon)
        except MeasurementsError as error:
            if not isinstance(t, float) or not t % 1:
                raise
            raise MeasurementsError(
                f"{error}: a filter counts instants, and model.on_clock(times) has their times, "
                "which may be any"
            ) from error

    def _not_before_last(self, t: Any) -> int:
        instant = self._instant(t)
        if instant < self._filter.t:
            first = self._formatted(self._filter.t)
            raise MeasurementsError(f"t must not be before {first}, got {self._formatted(instant)}")
        return instant

    def _formatted(self, t: int) -> str:
        return formatted_instant(self.model, t)

    def _moved(self, t: int) -> tuple[OneFilter, Array, Array]:
        """Predict up to t, from the last prediction if that is on the way."""
        return (self._ahead if self._ahead.t <= t else self._filter).at(t)

    def _estimate(
        self, mean: Array, variance: Array, at: OneFilter | None = None
    ) -> FilterEstimate:
        prior = _prior(self._filter if at is None else at)
        belief: Belief = Normal(mean, np.sqrt(variance))
        if isinstance(prior, Cloud):
            weight = np.ones(prior.particles) if prior.weight is None else prior.weight
            z, moved = quantity(self.model, prior, mean), prior.lines is not None
            belief = Particles(z, weight, moved)
        is_angle, collapsed = self.model.is_angle, self._collapsed
        return estimate_of(prior.t, mean, variance, is_angle, belief, collapsed=collapsed)

    def _explained(
        self, predicted: OneFilter, y: Array, mean: Array, variance: Array
    ) -> tuple[Belief, float, float]:
        """The belief after a measurement, the measurement's log-density, and its surprise."""
        prior = _prior(predicted)
        if isinstance(prior, Gaussian):
            log_density, surprise = explained_by_normal(self.model, prior, y)
            return Normal(mean[-1], np.sqrt(variance[-1])), log_density, surprise
        share, log_density = weights_given(self.model, prior, y)
        surprise = surprise_of_particles(self.model, prior, y, self.stream, predicted.draw)
        if surprise < SUSPICIOUS:
            surprise = self._confirmed(surprise, prior.t, y)
        belief = Particles(quantity(self.model, prior, mean[-1]), share)
        return belief, log_density, surprise

    def _confirmed(self, surprise: float, t: int, y: Array) -> float:
        """Surprise of a measurement for the filter with many particles.

        Few particles miss the tails of x(t), and few simulated measurements put a floor under the
        p-value. The choice of measurements adds no false alarms: a result below `SUSPICIOUS` is
        always a p-value of this filter, and a result above it follows a smaller p-value (Besag,
        Clifford, "Sequential Monte Carlo p-values", Biometrika 78, 1991).
        """
        try:
            # A measurement is forgotten after the filter has moved past it. If it raises an error,
            # the filter stays there, and every later surprise is that of few particles.
            while self._unseen_by_many:
                self._many = self._many.at(*self._unseen_by_many[0])[0]
                del self._unseen_by_many[0]
            self._many = self._many.at(t)[0]
        except MeasurementsError:  # one of many states may overflow
            return surprise
        cloud = cast(Cloud, _prior(self._many))
        return surprise_of_particles(self.model, cloud, y, self.stream, self._many.draw)


def _is_job(source: Any) -> bool:
    """Whether this is a job, its file or the folder of its run, and not a model or its name."""
    if isinstance(source, str):
        is_run = source not in installed_models() and holds_run(Path(source))
        return source.endswith(".toml") or is_run
    return isinstance(source, Problem | Job | Path)


def _at_each_instant(model: StateSpaceModel, horizon: int) -> StateSpaceModel:
    """The model whose sequences of a single value have it at each instant, as a warning says."""
    series = {name: value for name, value in model.parameters.items() if isinstance(value, tuple)}
    single = {name: value for name, value in series.items() if len(value) == 1}
    if not (single and horizon):
        return model
    most = max(map(len, series.values()))
    warnings.warn(f"{', '.join(single)} of the model: one value, which holds at each instant",
                  PfdistWarning, stacklevel=5)  # fmt: skip
    instants = most if most > 1 else horizon + 1
    return model.with_parameters({name: value * instants for name, value in single.items()})


def _proposal_of(
    wanted: str, model: StateSpaceModel, engine: str, resample: str, horizon: int
) -> str:
    """The proposal of a filter of one system: "auto" moves particles if components of x do not."""
    if wanted != AUTO:
        return wanted
    if THAT_MOVES is None or engine not in THAT_MOVES.engines or resample != "always":
        return PLAIN.name
    has_constants = not declared(model) and constants_of(model, range(horizon + 1))
    return THAT_MOVES.name if has_constants else PLAIN.name


def settings_of_job(built: Built) -> dict[str, Any]:
    """The arguments of a `Filter` with a job's model, [filter], clock and seed."""
    job, evaluator = built.job, built.evaluator
    own = job.filter
    REAL_DATA.check("a real system", job)
    return {
        "model": evaluator.believed,
        "particles": max(MOVED, own.compared_particles) if own.moves else own.particles,
        "proposal": own.proposal if own.moves else PLAIN.name,
        "seed": job.seed,
        "resampling": job.filter.resampling,
        "resample": own.resample or "always",
        "engine": evaluator.engine,
        "horizon": evaluator.horizon,
        "limits": _limits(evaluator.believed, job.problem.sensed),
    }


def _limits(model: StateSpaceModel, sensed: Sensings) -> tuple[list[float], list[float]]:
    """The limits of each component of y."""
    each = [
        sensed.by_way(way)
        for way, each in enumerate(model.ways)
        for _ in range(each.y.start, each.y.stop)
    ]
    return [sensing.low for sensing in each], [sensing.high for sensing in each]


def _prior(at: OneFilter) -> Prior:
    return cast(Prior, at.settings.prior)  # every filter has one after its first instant
