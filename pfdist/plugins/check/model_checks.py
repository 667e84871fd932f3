"""Checks that find mistakes in a model before a long run does."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CLEAR_ERRORS, Estimate
from pfdist.common.formatted_sizes import formatted_seconds
from pfdist.common.measurement_times import Times, regular
from pfdist.common.percent import percent
from pfdist.common.rounding import rounded
from pfdist.errors import JobError, ModelError
from pfdist.filters.constants import constants_of
from pfdist.filters.draws import Draws
from pfdist.filters.engines import BATCHED, ENGINES, WITHOUT_FMA
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.filter_estimate import FEW
from pfdist.filters.kalman import matrices_of
from pfdist.filters.one_filter import formatted_instant
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import PROPOSALS, RIVALS
from pfdist.filters.variants import self_consistent
from pfdist.filters.work import Estimation, FilterWork
from pfdist.kernels.lowering import MOST_TOGETHER, has_fused_multiply_add
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.batched import BatchedModel
from pfdist.models.checks import own_formulas
from pfdist.models.continuous import doubled
from pfdist.models.parameters import check_lengths
from pfdist.models.program import Program, merged
from pfdist.models.recorded import declarations, recorded
from pfdist.models.twin import traced
from pfdist.plugins.check.measured import missing_components, normalised
from pfdist.questions.foreseen import seconds_a_step
from pfdist.results.particle_loss import lost_text, top_percent_share
from pfdist.runner.contract import few_draws, looked
from pfdist.runner.likelihood import Within, likelihood
from pfdist.runner.particles import (
    LOST_DRAWS,
    NUMBERS,
    enough_particles,
    fewest_lines,
    lost_constants,
    mean_effective_sizes,
    measured_loss,
    why_plain,
)

Array = NDArray[np.float64]
_Make = Callable[..., Evaluator]

EVERY_INSTANT = "every instant"  # the last check of formulas
_DRAWS = 1000
_LONGEST = 20.0  # seconds of a check, about; a slow model has fewer draws, states or particles
_RARE = 0.5  # of all changes of an error, in 1 % of the draws
_SAME = 1e-6  # relative difference of errors by two engines
_LITTLE = 0.2  # % of the expected MSE that is little
_MOST_STEPS = 1_000_000  # of draws; a tenth for particles of a draw
_WEIGHED = ": give the components of quantity_of_interest weights, as (x[0] / 10, x[1])"
_UNNAMED = 'answers call it z; name it with its unit: z_names=("concentration [mg/L]",)'


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Parameters
    ----------
    name : str
    state : {"ok", "note", "wrong"}
        A note is useful information; what is wrong makes every result wrong or ends the run.
    text : str
        The finding, and what to do.
    """

    name: str
    state: str
    text: str


def check_loaded(
    load: Callable[[], StateSpaceModel],
    horizon: int,
    particles: int,
    times: Sequence[float] = (),
    *,
    filtered: bool = True,
) -> Iterator[Check]:
    """Yield the result of each check of the model that a function loads, as the check ends.

    The draws have instants 0..horizon; a clock replaces the horizon. `particles` is the number of
    particles of the filter that is timed. `times`, (T+1,), is the clock: the time of each instant.
    By default it is 0..T for a model that reads a clock, and other models have none. If not
    `filtered`, the checks of an evaluation are left out, and the last check of formulas that can be
    filtered is `EVERY_INSTANT`.
    """
    name, advice = "load", ""
    try:
        model = load()
        states, measurements, quantities = model.components
        sizes = f"{states} of x, {measurements} of y, {quantities} of z"
        yield Check("load", "ok", f"{model.name}: components {sizes}")
        if times or model.reads_clock:
            name, clock = "clock", tuple(times) or tuple(map(float, range(horizon + 1)))
            horizon, model = len(clock) - 1, model.on_clock(clock)
            yield Check("clock", *_clock(clock, not times))
        name, advice = "simulate", "; give them in the model, or in a job, and check the job"
        check_lengths(model.parameters, horizon + 1)
    except ModelError as error:
        yield Check(name, "wrong", f"{error}{advice}")
        return
    for way in model.ways:  # the system with each sensor alone
        if way.name:
            yield Check("load", "ok", way.model.name)
        for check in _computed(way.model, horizon, Estimation(particles)):
            yield check
        if check.name != EVERY_INSTANT:
            return
    if filtered:  # the sensors measure in turn
        spread = regular(horizon, max(2, (horizon + 1) // 3))
        in_turn = tuple(model.points.at(t)[k % len(model.ways)] for k, t in enumerate(spread))
        made = partial(Evaluator, horizon=horizon)
        yield from check_filter_model(made, (model,), in_turn, Estimation(particles))


def _compiled(evaluator: Evaluator, estimation: Estimation) -> tuple[Evaluator, Check]:
    """The evaluator, which calls the functions of a batched model, and the check."""
    if declarations(evaluator.model, evaluator.believed):
        called = replace(evaluator, engine=BATCHED.name)
        return called, Check("compile", "ok", "functions are called on arrays of particles")
    evaluator.compile(estimation)
    text = f"every formula is traced and compiled{_in_pieces(evaluator.model, evaluator.horizon)}"
    slower = "" if has_fused_multiply_add() else f"; {WITHOUT_FMA}"
    return evaluator, Check("compile", "note" if slower else "ok", text + slower)


def _in_pieces(model: StateSpaceModel, horizon: int) -> str:
    """The longest formula, if it is compiled in pieces."""
    programs = {
        name: traced(model, name, range(horizon + 1)).programs for name in own_formulas(model)
    }
    sizes = {
        name: max(_size(merged(each)) for each in several) for name, several in programs.items()
    }
    name = max(sizes, key=lambda each: sizes[each])
    if sizes[name] <= MOST_TOGETHER:
        return ""
    return f"; {name} has {sizes[name]:,} operations and is compiled in pieces"


def _size(program: Program) -> int:
    """The number of operations that are computed for each particle."""
    operations = zip(program.operations, program.is_shared, strict=True)
    return sum(bool(each.arguments) and not shared for each, shared in operations)


def _computed(model: StateSpaceModel, horizon: int, estimation: Estimation) -> Iterator[Check]:
    """Yield checks of formulas in NumPy and, if these are right, as an engine computes them."""
    try:
        model = recorded(model, range(horizon + 1))
        few_draws(model, horizon)
        evaluator, check = _compiled(Evaluator(model, horizon), estimation)
        yield check
        count = min(_DRAWS, _MOST_STEPS // (horizon + 1))
        draws = evaluator.draws(range(count), 0)
    except ModelError as error:
        yield Check("simulate", "wrong", str(error))
        return
    text = f"x, y and z are finite in {count} draws of {horizon + 1} instants"
    yield Check("simulate", "ok", text)
    if not model.z_names:
        yield Check("names", "note", _UNNAMED)
    first, names = draws.z[:, 0], model.named("z")
    units = dict.fromkeys(filter(None, (each.unit for each in names)))
    if len(units) > 1 and model.error is squared_error:
        text = f"the squared errors of z, in {' and '.join(units)}, are added up{_WEIGHED}"
        yield Check("units", "note", text)
    spread = np.subtract(*np.quantile(first, (0.75, 0.25), axis=0))
    for k in np.flatnonzero(model.is_angle & (spread > 2.0 * np.pi)):
        lies = f"lies in {first[:, k].min():.3g} to {first[:, k].max():.3g} at the first instant"
        text = f"{names[k].label or f'z[{k}]'} is circular, so in radians, but {lies}: if these are"
        yield Check("angles", "note", f"{text} degrees, convert them by np.radians")
    if model.linear_gaussian:
        yield Check("linear_gaussian", *looked(_linear_gaussian, model, draws))
    for look, is_declared, patient in (
        ("log_likelihood", True, likelihood),
        ("normalised", model.normalised, normalised),
        ("missing components", model.missing_components is True, missing_components),
    ):
        if is_declared:
            within = Within(_LONGEST)
            state, text = looked(partial(patient, within=within), model, draws)
            yield Check(look, state, text + within.text)
    every_instant = partial(_every_instant, evaluator.computed_by.name)
    yield Check(EVERY_INSTANT, *looked(every_instant, model, draws))


def _clock(clock: Sequence[float], is_assumed: bool) -> tuple[str, str]:
    text = f"p.time is {clock[0]:g} to {clock[-1]:g} in {len(clock)} instants"
    if not is_assumed:
        return "ok", text
    return "note", f"{text}, assumed because formulas read a clock: a job must have one"


def _every_instant(engine: str, model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    """State and text: the engine calls every formula at every instant, measured or not."""
    instants = range(draws.x.shape[1])
    particles = max(1, min(500, _MOST_STEPS // 10 // len(instants)))  # ten draws have 50 each
    few = draws[: max(1, particles // 50)]
    ENGINES[engine].simulate(model, instants[-1], few.index, 0)
    for times in ((), tuple(instants)):
        ENGINES[engine].filters.filter_draws(model, few, times, min(particles, 50), 0)
    return "ok", "no formula fails at any instant, measured or not"


def _linear_gaussian(model: StateSpaceModel, draws: Draws) -> tuple[str, str]:
    matrices_of(model, draws.x.shape[1] - 1)
    return "ok", "as it declares: filter.engine = 'kalman' computes it exactly"


def _effective_sizes(evaluator: Evaluator, work: FilterWork) -> tuple[str, str]:
    """State and text: how many particles count after the measurements of regular times."""
    sizes = mean_effective_sizes(evaluator, work)
    if sizes.isna().all():
        return "note", "all filters fail by their first measurement"
    least = sizes.min()
    at = formatted_instant(evaluator.model, sizes.index.to_numpy()[sizes.argmin()])
    text = (
        f"at least {rounded(least, 2)} at t = {at}, median {rounded(sizes.median(), 2)}, of "
        f"{work.estimation.particles} particles after {len(sizes)} measurements"
    )
    if least < FEW:
        return "note", f"{text}: so few count that estimates are uncertain"
    return "ok", text


def _particles(evaluator: Evaluator, work: FilterWork, seconds: float) -> tuple[str, str]:
    """State and text: the particle loss, and a number of particles that is enough.

    A particle-step takes so many seconds.
    """
    loss, _ = measured_loss(evaluator, work)
    text = f"{loss.particles:,} particles lose {loss.text}"
    if not loss.warning:
        return "ok", text
    text += f". {loss.rare}".rstrip(". ")
    (times,), steps = work.measurement_times, _LONGEST / seconds
    found = enough_particles(evaluator, times, 0, work.estimation, steps, loss)
    if found is loss:
        return "note", f"{text}; no more, up to {NUMBERS[-1]:,}, can be tried in {_LONGEST:.0f} s"
    if found.is_small:
        return "note", f"{text}; {found.particles:,} are enough"
    few = "may be enough" if found.may_be_small and not found.rare else "are still too few"
    return "note", f"{text}; {found.particles:,} {few}: they lose {found.text}"


def _constants(evaluator: Evaluator, work: FilterWork) -> Iterator[Check]:
    """How many values of constants are left to plain particles."""
    constants = constants_of(evaluator.believed, range(evaluator.horizon + 1))
    if not constants or work.estimation.moves:
        return
    names = ", ".join(f"x[{c}]" for c in constants)
    share = lost_constants(evaluator, work.measurement_times[0], 0, work.estimation, LOST_DRAWS)
    said = lost_text(share).replace("the filter", "a plain filter")
    text = f"{names}: no step changes {'them' if len(constants) > 1 else 'it'}. {said}"
    yield Check("constants", "note" if said else "ok", text.strip())


def _rival(evaluator: Evaluator, work: FilterWork) -> Iterator[Check]:
    """Compare a proposal that redraws noise with the choice of "auto", by its own measurement."""
    rival = PROPOSALS[work.estimation.proposal]
    if rival in RIVALS:
        plain = replace(work.estimation, proposal=PLAIN.name)
        why = why_plain(evaluator, work.measurement_times, 0, plain, rival, work.draws[1])
        text = f"plain': {why}" if why else f"{rival.name}': in the same time it loses less"
        yield Check("filter.proposal", "note" if why else "ok", f"'auto' takes '{text}")


def check_filter_model(
    make: _Make, models: Sequence[StateSpaceModel], times: Times, estimation: Estimation
) -> Iterator[Check]:
    """Yield checks of an evaluation with some times: its degenerate draws, its error and its time.

    A slow model has fewer draws than a thousand. `make` gives the evaluator of the models.
    """
    try:
        evaluator, _ = _compiled(make(*models), estimation)
        yield from _filtered(evaluator, times, estimation, partial(_substeps, make, models))
    except (JobError, ModelError) as error:
        yield Check("filter", "wrong", str(error))


def _substeps(
    make: _Make,
    models: Sequence[StateSpaceModel],
    evaluator: Evaluator,
    work: FilterWork,
    mse: Array,
) -> Iterator[Check]:
    """A check of differential equations: what changes with twice as many steps.

    `mse`, (D,), are the errors of the work's draws. With more steps these have the same Brownian
    motions, and the filter has the same noise.
    """

    def states(each: Evaluator) -> Array:
        every, draws = each.of_scenarios or (each,), range(*work.draws)
        return np.concatenate([system.draws(draws, work.draws_stream).x for system in every])

    try:
        first, last = doubled(models[0]), doubled(models[-1])
        if first is models[0] and last is models[-1]:
            return
        twice = (first, first if models[0] == models[-1] else last)[: len(models)]
        finer, _ = _compiled(make(*twice), work.estimation)
        changes, x, to = finer(work).mse[:, 0] - mse, states(evaluator), states(finer)
    except ModelError as error:
        yield Check("substeps", "note", f"not checked with twice as many steps: {error}")
        return
    with np.errstate(all="ignore"):  # errors may be infinite, and components constant
        moves, scale = np.nan_to_num(np.abs(to - x) / x.std((0, 1))), 100 / mse.mean()
        size, most = np.sqrt((moves**2).mean((0, 1)).max()), moves.max()
        change, own = (Estimate.of_mean(each).times(scale) for each in (changes, mse))
        # Other particles are resampled where x moves, so the errors of all draws change by chance.
        rare = top_percent_share(np.abs(changes))
    by_chance = abs(change.value) <= CLEAR_ERRORS * change.standard_error and not rare > _RARE
    is_small = by_chance or abs(change.value) <= max(_LITTLE, own.standard_error / 2)
    text = (
        f"twice as many steps change the expected MSE by {change.text} % (same draws and noise), x "
        f"by {percent(size, 1)} of its standard deviation (root mean square; at most "
        f"{percent(most, 0)})"
    )
    advice = "" if is_small else ": give twice the substeps= (half the largest_step=), check again"
    yield Check("substeps", "ok" if is_small else "note", text + advice)


def _filtered(
    evaluator: Evaluator,
    times: Times,
    estimation: Estimation,
    substeps: Callable[..., Iterator[Check]],
) -> Iterator[Check]:
    seconds_of_a_step = seconds_a_step(evaluator, times, estimation)
    work = evaluator.work((times,), 3, 3, (0, 1), estimation)
    seconds = seconds_of_a_step * work.steps_a_draw
    draws = min(_DRAWS, int(_LONGEST / 4 / seconds))  # four filters of each give the loss
    an_evaluation = f"{rounded(seconds * _DRAWS, 2)} s for {_DRAWS:,} draws on one core"
    if draws < 2:
        yield Check("an evaluation", "note", f"{an_evaluation}; so nothing else is filtered here")
        return
    fewer = f" (only {draws} draws: each takes {formatted_seconds(seconds)} s)" * (draws < _DRAWS)
    work = replace(work, draws=(0, draws))
    with np.errstate(over="ignore", invalid="ignore"):  # a check reports infinite errors
        result = evaluator(work)
    share, number = result.degenerate.mean(), len(times)
    particles = f" and {work.estimation.particles} particles" * evaluator.has_particles
    text = f"{share:.2%} of draws with {number} regular times{particles}{fewer}"
    yield Check("degenerate draws", "note" if share else "ok", text)
    mean = Estimate.of_mean(result.mse[:, 0])
    is_finite = math.isfinite(mean.value + mean.standard_error)
    got = "it must be finite, and its error, got " * (not is_finite)
    yield Check(
        "expected MSE", "ok" if is_finite else "wrong", f"{got}{mean.text} with these times"
    )
    yield from substeps(evaluator, work, result.mse[:, 0])
    believed, model = self_consistent(evaluator), evaluator.model
    if evaluator.has_particles:
        yield Check("effective sample size", *_effective_sizes(believed, work))
    text, is_few = fewest_lines(believed, work, partial(formatted_instant, model))
    if text:
        yield Check("ancestral lines", "note" if is_few else "ok", text)
    if believed.has_particle_loss:
        yield Check("particles", *_particles(believed, work, seconds_of_a_step))
        yield from _rival(believed, work)
        yield from _constants(believed, work)
    yield Check("an evaluation", "ok", an_evaluation)
    if isinstance(model, BatchedModel) and evaluator.believed == model:
        found = _engines(evaluator, model.as_formulas, times, estimation, seconds_of_a_step)
        yield Check("engines", *found)
        if not model.coupled and model.together > work.estimation.particles:
            yield from _together(evaluator, model, times, estimation, seconds_of_a_step)


def _together(
    evaluator: Evaluator, model: BatchedModel, times: Times, estimation: Estimation, seconds: float
) -> Iterator[Check]:
    """A note if arrays with the particles of one draw are filtered in half the time."""
    small = replace(model, together=estimation.particles)
    fewer = seconds_a_step(replace(evaluator, model=small, filter_model=None), times, estimation)
    if fewer < seconds / 2:
        now, then = (f"{rounded(1e9 * each, 2)} ns" for each in (seconds, fewer))
        yield Check(
            "together",
            "note",
            f"{now} a particle-step with few draws, because arrays always have about "
            f"{model.together:,} particles; {then} with BatchedModel(..., "
            f"together={small.together}), the particles of a draw",
        )


def _engines(
    evaluator: Evaluator,
    as_formulas: Callable[[], StateSpaceModel],
    times: Times,
    estimation: Estimation,
    seconds: float,
) -> tuple[str, str]:
    """State and text: whether the functions of a batched model can be traced, and are faster then.

    A particle-step takes so many seconds as it is.
    """
    nanoseconds = f"{rounded(1e9 * seconds, 2)} ns"
    try:
        formulas = recorded(as_formulas(), range(evaluator.horizon + 1))
        compiled = replace(evaluator, model=formulas, filter_model=None, engine="compiled")
        compiled.compile(estimation)
    except ModelError:
        return "ok", f"{nanoseconds} a particle-step on arrays; the functions cannot be traced"
    work = evaluator.work((times,), 3, 3, (0, 10), estimation)
    if not np.allclose(evaluator(work).mse, compiled(work).mse, rtol=_SAME):
        return "ok", f"{nanoseconds} a particle-step on arrays; traced, it computes something else"
    faster = f"{rounded(1e9 * seconds_a_step(compiled, times, estimation), 2)} ns"
    return "note", (
        f"the functions can be traced: {faster} a particle-step instead of {nanoseconds}; "
        "write model.as_formulas()"
    )
