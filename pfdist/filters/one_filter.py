"""A filter of one system that stops at a measurement and continues from there.

It gives the same bits as a filter with the same keys that receives all measurements at once.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import CLOCK, Lag, Times
from pfdist.common.streams import stream_key
from pfdist.errors import MeasurementsError, shown
from pfdist.filters import kalman, plain
from pfdist.filters.carried import carried_lines
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.filters.draws import Draws
from pfdist.filters.engines import COMPILED, ENGINES
from pfdist.filters.plain import step
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import FilterArrays
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.parameters import check_lengths
from pfdist.models.twin import twin_of


def formatted_instant(model: StateSpaceModel, t: int) -> str:
    """The time of an instant as text: p.time[t] for a model on a clock, else the number t."""
    on_clock = all(name in model.parameters for name in CLOCK)
    times = model.parameters["time"] if on_clock else ()
    return f"{times[t]:.10g}" if isinstance(times, tuple) and t < len(times) else str(t)


Array = NDArray[np.float64]
_PROBED = 64  # particles
_SAME = 1e-6  # of the effect of half a turn
_MOST_STEPS = 2**30  # particles times squared instants: some seconds, and megabytes


@dataclass(frozen=True)
class OneFilter:
    """The state of a filter of one system at an instant.

    The error is the squared error, because a model's own error may fail without a truth.
    """

    model: StateSpaceModel  # the filter's model
    # The prior in them is the distribution of x(t). Without a prior, the filter starts from
    # `initial`.
    settings: Estimation
    stream: int  # key of the filter's noise, 64 bits
    draw: int = 0  # index of the draw in the stream
    engine: str = COMPILED.name
    measured: bool = False  # whether the instant t was measured
    evidence: float = math.nan  # log evidence of its measurement, if particles move

    def __post_init__(self) -> None:
        if self.model.error is not squared_error:
            object.__setattr__(self, "model", replace(self.model, error=squared_error))

    @property
    def t(self) -> int:
        """The instant: 0, or the instant of the prior."""
        return 0 if self.settings.prior is None else self.settings.prior.t

    def at(self, t: int, y: Array | None = None) -> tuple["OneFilter", Array, Array]:
        """The filter at t, with weighted mean and variance of z, (K, q), at K instants up to t.

        The K instants are those from this filter's to t. t must not be before this filter's
        instant, and must be after it if both are measured. y, (m,), is the measurement at t, if it
        is measured. All components of a sensor are NaN if it did not measure.

        Raises `MeasurementsError` if no particle explains the measurement, or if a state is not
        finite. Raises `ModelError` if a formula failed.
        """
        filtered = self._filtered(t, y)
        has_particles = ENGINES[self.engine].has_particles
        if not (has_particles or np.isfinite(filtered.mse[0])):
            raise MeasurementsError(f"{self.model.name}: variances must stay finite up to t = {t}")
        if y is not None and filtered.degenerate[0]:
            raise MeasurementsError(self._unexplained(t, y))
        if np.isinf(filtered.mse[0]):
            raise MeasurementsError(self._not_finite(t))
        last = filtered.cloud[0]
        if not ENGINES[self.engine].has_particles:
            prior: Prior = Gaussian(t, last[:, 0].copy(), last[:, 1:].copy())
        else:
            weight = filtered.weight[0] if self.settings.carries else None
            draws, _ = self._draws(t, [] if y is None else [(t, y)])
            prior = Cloud(
                t, last, weight, lines=carried_lines(filtered, draws, self.model, self.settings)
            )
        measured = y is not None or (self.measured and t == self.t)
        evidence = filtered.log_likelihoods[0].sum() if filtered.noise.size else math.nan
        settings = replace(self.settings, prior=prior)
        after = replace(self, settings=settings, measured=measured, evidence=float(evidence))
        return after, filtered.estimate[0], filtered.variance[0]

    @property
    def most_smoothed(self) -> float:
        """The largest number of instants for `smoothed`: its work grows with their square."""
        kept = self.settings.particles if ENGINES[self.engine].has_particles else 0
        return math.isqrt(_MOST_STEPS // kept) if kept else np.inf

    def smoothed(self, t: int, seen: Sequence[tuple[int, Array]], lag: Lag) -> FilterArrays:
        """The estimates, with later measurements until a lag, at all instants from this one to t.

        The filter has received these measurements before: instants, and their arrays (m,).
        """
        given = self.model, *self._draws(t, seen), self.stream, replace(self.settings, lag=lag)
        if ENGINES[self.engine].has_particles:
            return plain.filter_checked_draws(*given, lines=True)
        return kalman.filter_checked_draws(*given)

    def _filtered(self, t: int, y: Array | None = None) -> FilterArrays:
        """The result of the engine's `filter_checked_draws` up to t, for this one system."""
        draws, times = self._draws(t, [] if y is None else [(t, y)])
        filtered: FilterArrays = ENGINES[self.engine].filters.filter_checked_draws(
            self.model, draws, times, self.stream, self.settings, trajectories=True
        )
        return filtered

    def _draws(self, t: int, seen: Sequence[tuple[int, Array]]) -> tuple[Draws, Times]:
        """The system up to t, of which no truth is known, and its measurement times."""
        check_lengths(self.model.parameters, t + 1)
        _, measurements, quantities = self.model.components
        y = np.zeros((1, t + 1 - self.t, measurements))
        for at, values in seen:
            y[0, at - self.t] = values
        z = np.zeros((*y.shape[:2], quantities))
        system = range(self.draw, self.draw + 1)
        times = chain.from_iterable(made(self.model, *each) for each in seen)
        return Draws(self.model, system, np.empty((1, 0, 0)), y, z, self.t), tuple(times)

    def _unexplained(self, t: int, y: Array) -> str:
        """Why no particle explains a measurement, by the log-likelihoods of predicted particles."""
        values = log_likelihood(self.model, cast(Cloud, self.at(t)[0].settings.prior), y)
        value = "without a value" if np.isposinf(y).all() else shown(y.tolist())
        at = f"{value} at t = {formatted_instant(self.model, t)}"
        if not (values < np.inf).all():  # a log-density may be infinite
            got = "NaN" if np.isnan(values).any() else "infinity"
            return f"log_likelihood of {self.model.name} must be a number, got {got} for {at}"
        why = "more particles help, or the model is wrong about this system"
        if values.max() == -np.inf:
            why = "its likelihood is 0 for every particle, so the model excludes it"
        return f"no particle of {self.settings.particles} explains the measurement {at}: {why}"

    def _not_finite(self, t: int) -> str:
        """Which formula first gives NaN or too large a value, and at which instant up to t."""
        name, got, first = "initial or quantity_of_interest", "NaN or too large a value", self.t
        if self.t < t and np.isfinite(self._filtered(self.t).mse[0]):
            at, _, _ = self.at(self.t)
            while at.t + 1 < t and np.isfinite(at._filtered(at.t + 1).mse[0]):
                at, _, _ = at.at(at.t + 1)
            model, first, last = self.model, at.t + 1, cast(Cloud, at.settings.prior).x
            draws = range(self.draw, self.draw + 1)
            twin = twin_of(model, range(at.t, at.t + 2))
            with np.errstate(all="ignore"):
                x = step(twin, tuple(last), at.t, last.shape[1], self.stream, draws)
                z = twin.quantity_of_interest(x, first, model.p)
            is_finite = all(np.isfinite(each).all() for each in x)
            name, values = ("quantity_of_interest", z) if is_finite else ("transition", x)
            got = "NaN" if any(np.isnan(each).any() for each in values) else "too large a value"
        instant = formatted_instant(self.model, first)
        return f"{name} must stay finite, got {got} at t = {instant} (model {self.model.name})"


def log_likelihood(model: StateSpaceModel, cloud: Cloud, y: Array) -> Array:
    """Log-likelihood of a measurement, (m,), by all sensors that measured, for particles, (P,).

    A measurement (m, P) has other values for each particle.
    """
    x, measured = tuple(cloud.x), tuple(np.broadcast_to(value, cloud.particles) for value in y)
    total = np.zeros(cloud.particles)
    twin = twin_of(model, range(cloud.t, cloud.t + 1))
    with np.errstate(all="ignore"):
        for _, sensor, of_sensor, _ in twin.ways:
            if not (model.sensors and np.isnan(y[of_sensor]).all()):  # it measured
                total += sensor.log_likelihood(measured[of_sensor], x, cloud.t, model.p)
    return total


def circular_components(model: StateSpaceModel, cloud: Cloud, y: Array) -> list[int]:
    """The components of a measurement, (m,), that are angles.

    A turn changes no particle's likelihood, but half a turn does. So an angle needs no declaration,
    and whatever uses this list is the same for y + 2 pi k.
    """
    few = replace(cloud, x=cloud.x[:, :_PROBED], weight=None)
    own, found = log_likelihood(model, few, y), list[int]()
    for component in np.flatnonzero(~np.isnan(y)):
        shift = np.where(np.arange(y.size) == component, np.pi, 0.0)
        with np.errstate(invalid="ignore"):  # infinite ones differ by NaN
            half, turn = (
                np.abs(log_likelihood(model, few, y + k * shift) - own).max() for k in (1, 2)
            )
        if turn < _SAME * half:
            found.append(int(component))
    return found


class Followed:
    """A system that a filter follows, from one measurement to the next.

    A second filter follows it, too. Its particles are the truths of simulated systems, whose
    filters start from the particles of the first. These truths must not depend on those particles:
    a filter that contains its truth looks too good. A filter that excludes it looks too bad, and in
    a finite state space is certainly wrong. Given the measurements, the particles of a filter with
    independent noise are independent of those of the first.
    """

    def __init__(self, unmeasured: OneFilter) -> None:
        self.unmeasured = unmeasured
        """The filter before its first instant, from which other filters of the system start."""
        self.seen: list[tuple[int, Array]] = []
        """The measurements so far: instants, and arrays (m,)."""
        self._filter = unmeasured
        second = replace(unmeasured, stream=stream_key(unmeasured.stream, "truths"))
        self._second, self._seen_by_second = second, 0

    @property
    def cloud(self) -> Prior:
        """The particles at the instant of `now`, from which another filter can start.

        They include the measurement at this instant. For "kalman", a normal distribution.
        """
        return cast(Prior, self._filter.settings.prior)  # there is one after the first instant

    def update(self, t: int, y: Array) -> Any:
        """Move the filter to t, and give it the measurement there, as `OneFilter.at` has it."""
        self._filter, *_ = self._filter.at(t, y)
        self.seen.append((t, y))

    def with_truths(self) -> Prior:
        """The cloud, with its truths; a normal distribution needs none.

        If no particle of the second filter explains a measurement, it starts again from the cloud.
        """
        first, second = self.cloud, replace(self._second, model=self.unmeasured.model)
        if not isinstance(first, Cloud):
            return first
        try:
            for each in self.seen[self._seen_by_second :]:
                second, *_ = second.at(*each)
            if not self.seen or self.seen[-1][0] < first.t:
                second, *_ = second.at(first.t)
        except MeasurementsError:
            settings = replace(second.settings, prior=first)
            second = replace(second, settings=settings, measured=self._filter.measured)
        self._second, self._seen_by_second = second, len(self.seen)
        return replace(first, truths=cast(Cloud, second.settings.prior))

    def again(self, number: int) -> Prior:
        """The cloud, with truths, of an independent filter of the same system.

        As in a degenerate draw, it leaves out a measurement that no particle explains.
        """
        stream = stream_key(self.unmeasured.stream, "again", number)
        other = Followed(replace(self.unmeasured, stream=stream))
        for each in self.seen:
            with suppress(MeasurementsError):
                other.update(*each)
        other._filter, *_ = other._filter.at(self.cloud.t)
        return other.with_truths()


def seen(model: StateSpaceModel, y: NDArray[np.float64], times: Times) -> NDArray[np.float64]:
    """The measurement y, (m,), with NaN for what is not measured at these times of an instant."""
    measured = np.full_like(y, np.nan)
    for each in (model.ways[model.points.way(time)] for time in times):
        measured[each.y] = y[each.y]
    return measured


def made(model: StateSpaceModel, t: int, y: Array) -> Times:
    """The possible measurements in y(t), (m,): those of sensors with a component."""
    here = zip(model.points.at(t), model.ways, strict=True)
    return tuple(point for point, each in here if not np.isnan(y[each.y]).all())


# --- what a user gives ----------------------------------------------------------------------------


def checked_instant(t: Any, start: int, horizon: int) -> int:
    """A checked instant as an int.

    Raises `MeasurementsError` if it is not a whole number, or lies outside start..horizon.
    """
    number = isinstance(t, int | float | np.integer | np.floating) and not isinstance(t, bool)
    if not number or t != t // 1:
        raise MeasurementsError(f"t must be an integer, got {shown(plain_number(t))}")
    if not start <= t <= horizon:
        raise MeasurementsError(f"t must lie in {start}..{horizon}, got {shown(int(t))}")
    return int(t)


def checked_measurement(
    y: float | Sequence[float] | Array,
    model: StateSpaceModel,
    t: str,
    names: Sequence[str] = (),
    limits: tuple[Any, Any] = (-math.inf, math.inf),
) -> Array | None:
    """A checked measurement as an array (m,); None if every component is missing.

    A number beyond the limits of its sensor is the censored reading: the limit. `t` and `names` are
    the time and the components in error messages. Raises `MeasurementsError` if the number of
    components is wrong, if one is not a finite number, or if one is missing and the model does not
    declare `missing_components`. A sensor with `works` may have failed: all its components are inf.
    """
    components = model.components[1]
    try:
        values = np.atleast_1d(np.array(y, np.float64))
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0)
    if y is None or values.shape != (components,):
        raise MeasurementsError(
            f"a measurement must have as many numbers as y of the model {model.name}, "
            f"{components}, got {shown(y)} at t = {t}"
        )
    names = names or [f"y[{component}]" for component in range(components)]
    failed = [
        each.y for each in model.ways if each.model.works and (values[each.y] == np.inf).all()
    ]
    given = values.copy()
    for each in failed:
        given[each] = np.nan
    infinite = np.flatnonzero(np.isinf(given))
    if infinite.size:
        raise MeasurementsError(
            f"a measurement must be finite, or NaN where a component is missing, got "
            f"{names[infinite[0]]} = {values[infinite[0]]} at t = {t}"
        )
    missing = np.flatnonzero(np.isnan(values))
    if missing.size == components:
        return None
    # A sensor that lacks all of its components did not measure.
    idle = [each.y for each in model.ways if np.isnan(values[each.y]).all()]
    partly = [k for k in missing.tolist() if not any(y.start <= k < y.stop for y in idle)]
    if partly and model.missing_components is not True:
        raise MeasurementsError(
            f"all components of y must be measured or none, got {names[partly[0]]} missing at "
            f"t = {t}: the model {model.name} does not declare missing_components=True, that is, "
            "that its log_likelihood takes NaN"
        )
    return np.where(np.isinf(values), values, values.clip(*limits))


def plain_number(value: Any) -> Any:
    """A number of NumPy as Python writes it."""
    return value.item() if isinstance(value, np.generic) else value
