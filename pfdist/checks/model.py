"""Finds mistakes in a model before a long run on a cluster does."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from pfdist.checks.contract import Look, few_draws, look_at_formulas, looked
from pfdist.checks.formulas import compiled_as_in_numpy, likelihood, speed
from pfdist.checks.measured import missing_components, normalised, proposal
from pfdist.checks.particles import (
    enough_particles,
    has_particle_loss,
    mean_effective_sizes,
    measured_loss,
)
from pfdist.common.estimate import Estimate
from pfdist.common.rounding import rounded
from pfdist.errors import CompileError, ModelError
from pfdist.filters.draws import Draws
from pfdist.filters.engines import ENGINES, NUMPY_TIMES_SLOWER
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.kalman import matrices_of
from pfdist.filters.work import Estimation, Work
from pfdist.models import StateSpaceModel, carried_model
from pfdist.models.parameters import check_lengths
from pfdist.sequential.one_filter import formatted_instant
from pfdist.times.measurement_times import regular

_DRAWS = 1000
_FEW = 10  # draws, for checks that go from instant to instant in NumPy
_FEW_PARTICLES = 50
_FEW_EFFECTIVE = 5.0  # particles that count, on average over draws
_LONGEST = 30.0  # seconds of the search for a number of particles that is enough
_SECONDS = 4.0  # longest evaluation; a slow model has fewer draws than a thousand


def _same_bytes(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: whether compiled formulas give the same bytes on other processors."""
    called = Evaluator(model, draws.instants[-1], estimations=(Estimation(1),)).libm_functions
    if not called:
        return "ok", "the compiled formulas give the same bytes on all processors"
    return "note", (
        f"the formulas call {', '.join(called)} of the C library: results may differ in the last "
        "digits between machines"
    )


_LOOKS: dict[str, Look] = {
    "compiled as in NumPy": compiled_as_in_numpy,
    "same bytes": _same_bytes,
    "speed": speed,
    "log_likelihood": likelihood,
}
_COMPILED = ("compiled as in NumPy", "same bytes", "speed")


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Parameters
    ----------
    name : str
    state : {"ok", "note", "wrong"}
        A note is worth knowing; what is wrong makes every figure wrong or ends the run.
    text : str
        The finding, and what to do.
    """

    name: str
    state: str
    text: str


def check_model(
    name: str,
    horizon: int = 60,
    particles: int = 500,
    folder: Path = Path(),
    times: Sequence[float] = (),
) -> Iterator[Check]:
    """Yield the result of each check of a model as soon as it is known.

    The name is as a job has it: a model that ships, an entry point, or ``path/file.py:object``,
    with a path relative to the folder. The draws have instants 0..horizon; a clock replaces the
    horizon. `particles` is the number of particles of the filter that is timed. `times`, (T+1,), is
    the clock: the time of each instant. By default it is 0..T for a model that reads a clock, and
    other models have none.
    """
    return check_loaded(lambda: carried_model(name, folder).model, horizon, particles, times)


def check_loaded(
    load: Callable[[], StateSpaceModel], horizon: int, particles: int, times: Sequence[float] = ()
) -> Iterator[Check]:
    """Yield the result of each check of the model that a function loads; see `check_model`."""
    try:
        model = load()
    except ModelError as error:
        yield Check("load", "wrong", str(error))
    else:
        yield from check_object(model, horizon, particles, times)


def check_object(
    model: StateSpaceModel, horizon: int, particles: int, times: Sequence[float] = ()
) -> Iterator[Check]:
    """Yield the result of each check of a model that is loaded; arguments as of `check_model`."""
    states, measurements, quantities = model.components
    sizes = f"{states} of x, {measurements} of y, {quantities} of z"
    yield Check("load", "ok", f"{model.name}: components {sizes}")
    for part in model.parts if model.sensors else ():  # the system with each sensor alone
        yield from check_object(part.model, horizon, particles, times)
    if model.sensors:
        return
    if times or model.reads_clock:
        clock = tuple(times) or tuple(map(float, range(horizon + 1)))
        horizon = len(clock) - 1
        try:
            model = model.on_clock(clock)
        except ModelError as error:
            yield Check("clock", "wrong", str(error))
            return
        yield Check("clock", *_clock(clock, not times))
    try:
        check_lengths(model.parameters, horizon + 1)
    except ModelError as error:
        text = f"{error}; give them in the model, or in a job, and check the job"
        yield Check("simulate", "wrong", text)
        return
    state = ""
    try:
        for look, state, text in look_at_formulas(model, few_draws(model, horizon)):
            yield Check(look, state, text)
        if state != "wrong":
            yield from _computed(model, horizon, Estimation(particles))
    except ModelError as error:
        yield Check("simulate", "wrong", str(error))


def _computed(model: StateSpaceModel, horizon: int, estimation: Estimation) -> Iterator[Check]:
    """Yield checks of a model whose formulas are right in NumPy, as an engine computes it.

    Raises `ModelError` if a formula fails in a simulation.
    """
    engine = "compiled"
    try:
        Evaluator(model, horizon).compile(estimation)
        yield Check("compile", "ok", "Numba compiles every formula")
    except CompileError as error:
        engine = "numpy"
        yield Check("compile", "note", f"{error}: it runs about {NUMPY_TIMES_SLOWER} times slower")
    draws = ENGINES[engine].simulate(model, horizon, range(_DRAWS), 0)
    yield Check(
        "simulate", "ok", f"x, y and z are finite in {_DRAWS} draws of {horizon + 1} instants"
    )
    declared = (
        ("linear_gaussian", model.linear_gaussian, _linear_gaussian),
        ("normalised", model.normalised, normalised),
        ("missing components", model.missing_components, missing_components),
        ("proposal", model.guided, proposal),
    )
    looks = _LOOKS | {name: look for name, is_declared, look in declared if is_declared}
    if engine == "numpy":
        looks = {look: looks[look] for look in looks if look not in _COMPILED}
    looks["every instant"] = partial(_every_instant, engine)
    for look, function in looks.items():
        yield Check(look, *looked(function, model, draws))
    try:
        yield from _filtered(Evaluator(model, horizon, engine=engine), estimation)
    except ModelError as error:
        yield Check("filter", "wrong", str(error))


def _clock(clock: Sequence[float], is_assumed: bool) -> tuple[str, str]:
    text = f"p.time is {clock[0]:g} to {clock[-1]:g} in {len(clock)} instants"
    if not is_assumed:
        return "ok", text
    return "note", f"{text}, assumed because formulas read a clock: a job must have one"


def _every_instant(engine: str, model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: both engines call every formula at every instant, measured or not."""
    few, instants = draws[:_FEW], range(draws.x.shape[1])
    for name in dict.fromkeys([engine, "numpy"]):
        ENGINES[name].simulate(model, instants[-1], few.index, 0)
        for times in ((), tuple(instants)):
            ENGINES[name].filters.filter_draws(model, few, times, _FEW_PARTICLES, 0)
    return "ok", "no formula fails at any instant, measured or not"


def _linear_gaussian(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    try:
        matrices_of(model, draws.x.shape[1] - 1)
    except ModelError as error:
        return "wrong", str(error)
    return "ok", "as it declares: filter.engine = 'kalman' computes it exactly"


def _effective_sizes(evaluator: Evaluator, work: Work) -> tuple[str, str]:
    """State and text: how many particles count after the measurements of regular times."""
    (times,), sizes = work.measurement_times, mean_effective_sizes(evaluator, work)
    if sizes.isna().all():
        return "note", "all filters fail by their first measurement"
    least = sizes.min()
    at = formatted_instant(evaluator.model, times[int(np.nanargmin(sizes))])
    text = (
        f"at least {rounded(least, 2)} at t = {at}, median {rounded(sizes.median(), 2)}, of "
        f"{work.estimation.particles} particles after {len(sizes)} measurements"
    )
    if least < _FEW_EFFECTIVE:
        return "note", f"{text}: so few count that estimates are uncertain"
    return "ok", text


def _particles(evaluator: Evaluator, work: Work, seconds: float) -> tuple[str, str]:
    """State and text: the loss by the number of particles, and a number that is enough.

    The work itself takes so many seconds.
    """
    loss, _ = measured_loss(evaluator, work)
    text = f"{loss.particles:,} particles lose {loss.text}"
    if not loss.warning:
        return "ok", text
    text += f". {loss.rare}".rstrip(". ")
    (times,), steps = work.measurement_times, _LONGEST * work.steps / seconds
    found = enough_particles(evaluator, times, 0, work.estimation, steps)
    if found.is_small:
        return "note", f"{text}; {found.particles:,} are enough"
    return "note", f"{text}; {found.particles:,} are still too few: they lose {found.text}"


def _filtered(evaluator: Evaluator, estimation: Estimation) -> Iterator[Check]:
    """Yield checks of an evaluation: its time, its cost, and its degenerate draws."""
    times = regular(evaluator.horizon, max(2, (evaluator.horizon + 1) // 3))
    work = Work((times,), (evaluator.horizon,), (3,), 3, (0, 1), estimation)
    seconds_a_draw = evaluator.seconds_a_step * work.steps_a_draw
    draws = min(_DRAWS, max(1, int(_SECONDS / seconds_a_draw)))
    start = time.perf_counter()
    with np.errstate(over="ignore", invalid="ignore"):  # the check below reports infinite errors
        result = evaluator(replace(work, draws=(0, draws)))
    seconds = (time.perf_counter() - start) * _DRAWS / draws
    share = result.degenerate.mean()
    text = (
        f"{share:.2%} of draws with {len(times)} regular times and {estimation.particles} particles"
    )
    yield Check("degenerate draws", "note" if share else "ok", text)
    mean = Estimate.of_mean(result.mse[:, 0])
    text = f"{mean.text} with these times"
    if math.isfinite(mean.value) and math.isfinite(mean.standard_error):
        yield Check("expected MSE", "ok", text)
    else:
        yield Check("expected MSE", "wrong", f"it must be finite, and its error, got {text}")
    work = replace(work, draws=(0, draws))
    yield Check("effective sample size", *_effective_sizes(evaluator, work))
    if has_particle_loss(evaluator):
        yield Check("particles", *_particles(evaluator, work, seconds * draws / _DRAWS))
    yield Check("an evaluation", "ok", f"{rounded(seconds, 2)} s for {_DRAWS:,} draws on one core")
