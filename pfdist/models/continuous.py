"""Systems in continuous time: transitions that solve differential equations.

Steps follow the job's clock, which may be uneven. A step is recorded once and repeated by machine
code, so many steps compile as fast as one.
"""

import math
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from pfdist.common.measurement_times import CLOCK
from pfdist.common.section import Number, Whole, checked
from pfdist.errors import ArgumentError, ModelError, shown
from pfdist.models.base import StateSpaceModel
from pfdist.models.mistakes import place_of_function
from pfdist.models.program import MOST_STEPS
from pfdist.models.programs import Declared, Programs
from pfdist.models.repeating import repeated_steps
from pfdist.models.symbols import take
from pfdist.models.tracing import Covariate

Values = tuple[Any, ...]
Rates = Callable[[Any, Any, Any], Any]

SUBSTEPS = 10
_ROUNDING = 1e-9  # of the number of steps, so that .3 / .1 makes three
_SAME_TIME = 1e-11  # relative: an event at an instant whose time is rounded

_Substeps = Annotated[Whole, Field(ge=1, le=MOST_STEPS)] | None
_Step = Annotated[Number, Field(gt=0, allow_inf_nan=False)] | None
_Interval = Annotated[Number, Field(gt=0, allow_inf_nan=False)] | str | None


def _rows(events: Any) -> Any:
    """A table as a tuple of rows, whose component of x may be written as 1.0."""
    rows = events.tolist() if isinstance(events, np.ndarray) else events
    if not isinstance(rows, list | tuple) or any(np.shape(row) != (3,) for row in rows):
        raise ValueError(f"events must be rows (time, amount, component of x), got {shown(events)}")
    return tuple(
        (*row[:2], int(row[2])) if isinstance(row[2], float) and row[2] % 1 == 0 else tuple(row)
        for row in rows
    )


_Finite = Annotated[Number, Field(allow_inf_nan=False)]
_Event = tuple[_Finite, _Finite | str, Annotated[Whole, Field(ge=0)]]
Rows = tuple[tuple[float, float | str, int], ...]
Events = Annotated[tuple[_Event, ...], BeforeValidator(_rows)]
"""A table of events: times, amounts and components of x."""
_TABLES: ContextVar[Callable[[str], Rows] | None] = ContextVar("tables", default=None)
"""Gives the events of a name; None outside of `with_events`."""


@dataclass(frozen=True)
class Flow:
    """A transition that solves a differential equation: a function of (x, t, w, p).

    Parameters
    ----------
    step : callable
        ``(x, begin, h, dw, p) -> x`` after a step of length h, with the increments dw of the
        Brownian motions.
    rates : callable
        The user's formula, for error messages.
    substeps : int, optional
    largest_step : float, optional
    noises : int
        The number of Brownian motions.
    interval : float or str, optional
        Time between two instants, or the name of a parameter with this value; without a clock.
    keep : callable, optional
        ``(x, p) -> x`` after each step.
    events : tuple of (float, float or str, int), or str
        Times, amounts and components of x, in the order of time; or the name of such a table.
    """

    step: Callable[[Values, Any, Any, Values, Any], Values]
    rates: Rates
    substeps: int | None
    largest_step: float | None
    noises: int
    interval: float | str | None
    keep: Callable[[Values, Any], Any] | None
    events: Rows | str = ()

    @property
    def process_noise(self) -> tuple[str, ...]:
        """The process noise of a model with this transition."""
        return ("normal",) * (self.noises * (self.substeps or 0))

    @property
    def place(self) -> str:
        """The place of the user's formula."""
        return place_of_function(self.rates)

    def __call__(self, x: Any, t: Any, w: Any, p: Any) -> Values:
        """The state at t + 1."""
        begin, total = self._interval(t, p)
        count: Any = self.substeps
        events, tables = self.events, _TABLES.get()
        if isinstance(events, str):  # the model itself has none
            events = () if tables is None else _in_order(tables(events), self.substeps)
        most = self.substeps or MOST_STEPS - len(events)
        if self.largest_step is not None:
            count = np.maximum(np.ceil(total / self.largest_step - _ROUNDING), 1.0)
            total = np.where(count > most, np.nan, total)
        if self.noises and len(w) != len(self.process_noise):
            raise ValueError(
                f"process_noise must have {len(self.process_noise)} entries, as process_noise of "
                f"the transition has, got {len(w)}"
            )
        if (halves := _HALVES.get()) is not None:
            count, most, w = 2 * count, 2 * most, halves(self, w)
        h = total / count
        if events:
            return self._cut(events, x, begin, total, h, count, most, p)
        root = np.sqrt(h) if self.noises else None

        def step(x: Values, k: Any, noise: Values) -> Values:
            increments = tuple(root * each for each in noise)
            following = self.step(x, begin + k * h, h, increments, p)
            return self._kept(following, p)

        each = [w[c :: self.noises] for c in range(self.noises)]
        return repeated_steps(step, x, count, each, most)

    def _kept(self, x: Values, p: Any) -> Values:
        return components(self.keep(x, p), len(x), "keep") if self.keep else x

    def _cut(
        self, events: Rows, x: Values, begin: Any, total: Any, h: Any, count: Any, most: int, p: Any
    ) -> Values:
        """The state at t + 1, in steps of length h that are cut at the events.

        An event at an instant belongs to the step after it.
        """
        times = [time for time, _, _ in events]
        later = [time + _SAME_TIME * (1.0 + abs(time)) for time in times]
        first, last = _number_before(later, begin), _number_before(later, begin + total)
        tables = dict[tuple[int, str], list[float]]()
        for k, (_, amount, component) in enumerate(events):
            if component >= len(x):
                raise ValueError(
                    f"events must name components of x below {len(x)}, got {component}"
                )
            name, number = (amount, 1.0) if isinstance(amount, str) else ("", amount)
            tables.setdefault((component, name), [0.0] * len(times))[k] = number

        def step(state: Values, k: Any, _: Values) -> Values:
            *before, now, done = state
            place = done.astype(int)
            event = np.where(done < last, take(times, place), np.inf)
            grid = begin + (k - (done - first) + 1.0) * h
            is_event = event < grid
            until = np.where(is_event, event, grid)
            after = [*self.step(tuple(before), now, until - now, (), p)]
            for (component, name), table in tables.items():
                more = np.where(is_event, take(table, place), 0.0)
                after[component] = after[component] + (more * getattr(p, name) if name else more)
            return *self._kept(tuple(after), p), until, np.where(is_event, done + 1.0, done)

        steps = count + (last - first)
        return repeated_steps(step, (*x, begin, first), steps, (), most + len(times))[:-2]

    def _interval(self, t: Any, p: Any) -> tuple[Any, Any]:
        """The time of the instant t, and the time from there to the next."""
        if all(_varies(getattr(p, name, None)) for name in CLOCK):
            return p.time[t], p.dt[t]
        if self.interval is None:
            return t, 1.0
        given = self.interval
        step = getattr(p, given) if isinstance(given, str) else given
        if _varies(step):
            raise ModelError(
                f"dt of an equation must be the name of a parameter that is one number, got "
                f"{given!r}, which varies with t: uneven instants need a clock"
            )
        return t * step, step


def _varies(value: Any) -> bool:
    return isinstance(value, np.ndarray | Covariate)


def _number_before(times: list[float], time: Any) -> Any:
    """How many of some sorted times are less than a time, by bisection."""
    time = np.add(time, 0.0)  # a number as one of NumPy
    count = 0.0 * time
    for step in (2**k for k in reversed(range(len(times).bit_length()))):
        is_less = take(times, (count + (step - 1.0)).astype(int)) < time
        count = np.where(is_less, count + step, count)
    return count


def components(value: Any, count: int, name: str) -> Values:
    """The components that a function gives; raises `ValueError` if their number is wrong."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    values = tuple(value) if isinstance(value, tuple | list | np.ndarray) else (value,)
    if len(values) != count:
        raise ValueError(
            f"{name} must give {count} components, one for each of x, got {len(values)}"
        )
    return values


def _plus(x: Values, h: Any, rates: Values) -> Values:
    return tuple(value + h * rate for value, rate in zip(x, rates, strict=True))


# --- events of a job ------------------------------------------------------------------------------


def with_events(
    tables: Mapping[str, Rows], *models: StateSpaceModel
) -> tuple[StateSpaceModel, ...]:
    """Models whose equations have the events of the tables that they name.

    Raises
    ------
    ModelError
        An equation names another table, none names one, or one has too many events.
    """
    named = list[str]()

    def rows(name: str) -> Rows:
        named.append(name)
        if name not in tables:
            raise ValueError(
                f"events={name!r} must name a table, got {', '.join(tables) or 'none'}"
            )
        return tables[name]

    def changed(model: StateSpaceModel) -> StateSpaceModel:
        def transition(x: Any, t: Any, w: Any, p: Any) -> Any:
            before = _TABLES.set(rows)
            try:
                return model.transition(x, t, w, p)
            finally:
                _TABLES.reset(before)

        if isinstance(model.transition, Programs | Declared):
            return model
        before, with_tables = len(named), replace(model, transition=transition)  # which calls it
        return with_tables if len(named) > before else model

    given = tuple(map(changed, models))
    for name in tables:
        if name not in named:
            others = f"; they name {', '.join(sorted({*named}))}" * bool(named)
            raise ModelError(f"no equation of the model has events={name!r}{others}")
    return given


# --- twice as many steps --------------------------------------------------------------------------

_HALVES: ContextVar[Callable[[Flow, Any], Any] | None] = ContextVar("halves", default=None)
"""Gives the variates of a flow with twice as many steps; None outside of `doubled`."""


def doubled(model: StateSpaceModel) -> StateSpaceModel:
    """The model with twice as many steps of its equations; the model itself if it has none.

    Both have the same Brownian motions in draws of the same stream: further variates divide the
    increments (the construction of Levy).

    """
    transition, own, flows = model.transition, len(model.process_noise), list[Flow]()
    if isinstance(transition, Programs | Declared):
        return model

    def twice(x: Any, t: Any, w: Any, p: Any) -> Any:
        further = iter(w[own:])
        flows.clear()

        def halves(flow: Flow, w: Any) -> Any:
            flows.append(flow)
            n, root = flow.noises or 1, math.sqrt(0.5)
            pairs = [(root * a, root * next(further, 0.0)) for a in w[: len(flow.process_noise)]]
            steps = (pairs[k : k + n] for k in range(0, len(pairs), n))
            return [a + sign * b for step in steps for sign in (1.0, -1.0) for a, b in step]

        before = _HALVES.set(halves)
        try:
            return transition(x, t, w[:own], p)
        finally:
            _HALVES.reset(before)

    replace(model, transition=twice)  # which calls it
    noise = sum((flow.process_noise for flow in flows), model.process_noise)
    return replace(model, transition=twice, process_noise=noise) if flows else model


# --- ordinary differential equations --------------------------------------------------------------


@checked
def ode(
    rhs: Callable[..., Any],
    *,
    method: Annotated[Literal["rk4", "heun"], Field()] = "rk4",
    substeps: _Substeps = None,
    largest_step: _Step = None,
    dt: _Interval = None,
    keep: Callable[..., Any] | None = None,
    events: Events | str = (),
) -> Flow:
    """A transition that solves an ordinary differential equation, dx/dt = rhs(x, t, p).

    Parameters
    ----------
    rhs : callable
        ``(x, t, p) -> dx/dt``, a tuple or an array with as many components as x. t is the time on
        the job's clock.
    method : {"rk4", "heun"}
        The classical method of Runge and Kutta, of order 4, or that of Heun, of order 2.
    substeps : int, optional
        Number of steps between two instants; by default 10. `pfdist.check_model` doubles it, and
        says what changes.
    largest_step : float, optional
        Alternatively, the largest step in the unit of time: instants that are further apart have
        more steps, at most 10,000.
    dt : float or str, optional
        The time between two instants, or the name of the parameter that has it, if the job has no
        clock; by default 1.
    keep : callable, optional
        ``(x, p) -> x`` after each step, for instance to keep amounts positive.
    events : sequence of (float, float or str, int), or array, (k, 3), or str
        Doses and other jumps: a time, an amount and a component of x, which becomes larger by the
        amount then; or the name of a parameter that has the amount. Steps are cut at the times,
        which may lie between instants. x at the time of an event is the state before it. A text
        is the name of a table in the section ``model.events`` of the job; the model alone has no
        events then.

    Returns
    -------
    callable
        A transition ``(x, t, w, p) -> x``, which ignores w. A model may call it in its own
        transition and add noise to the result.

    Raises
    ------
    ArgumentError
        An argument is wrong.

    References
    ----------
    Hairer, Norsett, Wanner, "Solving ordinary differential equations I", 1993, table II.1.2.

    Examples
    --------
    >>> decay = ode(lambda x, t, p: (-x[0],))
    >>> f"{decay((1.0,), 0, (), None)[0]:.4f}"
    '0.3679'
    """

    def derivative(x: Values, t: Any, p: Any) -> Values:
        return components(rhs(x, t, p), len(x), "rhs")

    def heun(x: Values, begin: Any, h: Any, _: Values, p: Any) -> Values:
        first = derivative(x, begin, p)
        second = derivative(_plus(x, h, first), begin + h, p)
        return _plus(x, h / 2, _plus(first, 1.0, second))

    def rk4(x: Values, begin: Any, h: Any, _: Values, p: Any) -> Values:
        first = derivative(x, begin, p)
        second = derivative(_plus(x, h / 2, first), begin + h / 2, p)
        third = derivative(_plus(x, h / 2, second), begin + h / 2, p)
        fourth = derivative(_plus(x, h, third), begin + h, p)
        middle = _plus(second, 1.0, third)
        return _plus(x, h / 6, _plus(_plus(first, 1.0, fourth), 2.0, middle))

    if substeps is not None and largest_step is not None:
        raise ArgumentError("ode takes substeps or largest_step, got both", argument="largest_step")
    if largest_step is None:
        substeps = SUBSTEPS if substeps is None else substeps
    solve = rk4 if method == "rk4" else heun
    events = events if isinstance(events, str) else _in_order(events, substeps)
    return Flow(solve, rhs, substeps, largest_step, 0, dt, keep, events)


def _in_order(events: Rows, substeps: int | None) -> Rows:
    if (substeps or 1) + len(events) > MOST_STEPS:
        most = f"at most {MOST_STEPS:,} substeps and events together"
        raise ArgumentError(f"ode takes {most}, got {len(events):,} events", argument="events")
    return tuple(sorted(events, key=itemgetter(0)))


# --- stochastic differential equations ------------------------------------------------------------


@checked
def sde(
    drift: Callable[..., Any],
    diffusion: Callable[..., Any],
    *,
    noises: Annotated[Whole, Field(ge=1)],
    method: Annotated[Literal["euler", "heun"], Field()] = "euler",
    substeps: Annotated[Whole, Field(ge=1, le=MOST_STEPS)] = SUBSTEPS,
    dt: _Interval = None,
    keep: Callable[..., Any] | None = None,
) -> Flow:
    """A transition that solves a stochastic differential equation, dx = drift dt + diffusion dW.

    Parameters
    ----------
    drift : callable
        ``(x, t, p) -> rates``, a tuple or an array with as many components as x. t is the time on
        the job's clock.
    diffusion : callable
        ``(x, t, p)`` to a number for each component of x, with an independent Brownian motion for
        each; or to a row for each component, with a number for each Brownian motion.
    noises : int
        The number of independent Brownian motions W.
    method : {"euler", "heun"}
        Euler-Maruyama solves the equation in the sense of Ito, and Heun in the sense of
        Stratonovich. Both agree if the diffusion does not depend on x.
    substeps : int
        Number of steps between two instants. `pfdist.check_model` doubles it, and says what
        changes.
    dt : float or str, optional
        The time between two instants, or the name of the parameter that has it, if the job has no
        clock; by default 1.
    keep : callable, optional
        ``(x, p) -> x`` after each step, for instance to keep populations positive.

    Returns
    -------
    callable
        A transition ``(x, t, w, p) -> x``. Its attribute `process_noise` is the model's: `noises`
        normal variates for each step.

    Raises
    ------
    ArgumentError
        An argument is wrong.

    References
    ----------
    Kloeden, Platen, "Numerical solution of stochastic differential equations", 1992, sections 10.2
    and 11.1.
    """

    def change(x: Values, t: Any, h: Any, dw: Values, p: Any) -> Values:
        """The sum of drift and noise in a step, with rates at x."""
        steady = components(drift(x, t, p), len(x), "drift")
        return _plus(_noise_of(diffusion(x, t, p), len(x), dw), h, steady)

    def euler(x: Values, begin: Any, h: Any, dw: Values, p: Any) -> Values:
        return _plus(x, 1.0, change(x, begin, h, dw, p))

    def heun(x: Values, begin: Any, h: Any, dw: Values, p: Any) -> Values:
        first = change(x, begin, h, dw, p)
        second = change(_plus(x, 1.0, first), begin + h, h, dw, p)
        return _plus(x, 0.5, _plus(first, 1.0, second))

    return Flow(euler if method == "euler" else heun, drift, substeps, None, noises, dt, keep)


def _noise_of(diffusion: Any, count: int, dw: Values) -> Values:
    """The noise of each component, by its row of the diffusion or by its own number."""
    rows = components(diffusion, count, "diffusion")
    has_rows = any(isinstance(row, tuple | list) or np.ndim(row) > np.ndim(dw[0]) for row in rows)
    if isinstance(diffusion, np.ndarray):
        has_rows = diffusion.ndim > 1 and diffusion.shape[1] == len(dw)
    if not has_rows and count == len(dw):
        return tuple(row * each for row, each in zip(rows, dw, strict=True))
    if not has_rows or any(not hasattr(row, "__len__") or len(row) != len(dw) for row in rows):
        raise ValueError(
            f"diffusion must give a row of noises = {len(dw)} numbers for each component"
        )
    return tuple(sum(part * each for part, each in zip(row, dw, strict=True)) for row in rows)
