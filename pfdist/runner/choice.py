"""The choice that ``filter.proposal = "auto"`` leaves: by trying proposals on a few draws."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.errors import ModelError, StoreError
from pfdist.filters.constants import constants_of
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.proposal import PLAIN, Proposal
from pfdist.filters.proposals import MOST_INSTANTS, PROPOSALS, RIVALS, THAT_MOVES
from pfdist.filters.variants import knowing_truth, self_consistent
from pfdist.filters.work import Estimation, with_truth
from pfdist.kernels.estimators import ESTIMATORS, FILTER_NOISE
from pfdist.kernels.variates import generator
from pfdist.models.recorded import declared
from pfdist.problem.job import Job
from pfdist.problem.sections import MOVED_PARTICLES
from pfdist.runner.built import Built

_MOST_TRIED = 200  # feasible sets, for one with a long gap
_PILOT_DRAWS = 8
_A_CONSTANT = 20  # moved particles for each, if that is more than the usual number

_choices: dict[str, dict[str, str]] = {}
"""Proposals chosen in this process, by problem and comparison; "" has the last choice."""


def _draws_of(built: Built) -> float:
    """The draws that a run filters at least, counted for each set, with the job's particles."""
    steps = sum(
        search.optimiser.evaluations
        * search.settings.draws
        * search.settings.estimation.steps_an_instant
        for search in built.searches
    )
    compared = len(built.names) * built.job.comparison.draws
    return steps / built.comparing.steps_an_instant + compared


def choices_of(built: Built) -> dict[str, str]:
    """The choices of this process for a problem: its models, its filter and its constraints.

    "" is the last one.
    """
    plain = replace(built.comparing, proposal=PLAIN.name)
    problem = built.job.problem.model_dump(mode="json")
    return _choices.setdefault(built.evaluator.id_of(plain, problem), {})


def choice(built: Built, asked: float | None, *, follows: bool) -> str:
    """The proposal of a job that was built with the plain filter.

    A run's choice depends on its job alone, so it can be repeated. A question, which asks for so
    many draws, takes the last choice of the process. A work too small for a comparison is plain,
    unless the plain filter loses constants. A filter that `follows` one system moves particles if
    it may.
    """
    # Imported here, so that workers, which know the proposal, need no pandas.
    from pfdist.runner.particles import compared_draws  # noqa: PLC0415

    evaluator, plain = self_consistent(built.evaluator), built.comparing
    rivals = [each for each in RIVALS if evaluator.engine in each.engines]
    rivals *= evaluator.has_particle_loss
    moving = None if plain.carries else moving_of(built)
    if follows or not (rivals or moving):
        return moving.proposal if follows and moving else PLAIN.name
    choices = choices_of(built)
    if asked is not None and "" in choices:
        return choices[""]
    draws = compared_draws(_draws_of(built) if asked is None else asked)
    comparison = f"{draws} of {built.job.seed}"
    if comparison not in choices:
        if moving and _should_move(evaluator, built, moving, draws):
            choices[comparison] = moving.proposal
        elif draws == 0 or not rivals:
            return PLAIN.name
        else:
            better = (each.name for each in rivals if _is_better(built, each, draws))
            choices[comparison] = next(better, PLAIN.name)
    choices[""] = choices[comparison]
    return choices[""]


def _is_better(built: Built, rival: Proposal, draws: int) -> bool:
    """Whether a proposal loses less than the plain one in the same time."""
    from pfdist.runner.particles import why_plain  # noqa: PLC0415

    evaluator, plain = self_consistent(built.evaluator), built.comparing
    try:
        # The rival is compiled only if the plain filter loses too much.
        sets = built.job.problem.feasible.regular(), with_long_gap(built.job)
        why = why_plain(evaluator, sets, built.job.seed, plain, rival, draws, in_words=False)
        if not why:
            check_beside_truth(built.evaluator, replace(plain, proposal=rival.name))
    except ModelError:
        return False
    return not why


# --- particles that move --------------------------------------------------------------------------


def moving_of(built: Built) -> Estimation | None:
    """The estimation by particles that move, in a job that leaves the choice; None without need.

    It takes components of x that do not move, a horizon that is not too long, and an engine that
    knows it.
    """
    evaluator = self_consistent(built.evaluator)
    if THAT_MOVES is None or evaluator.engine not in THAT_MOVES.engines:
        return None
    if evaluator.horizon > MOST_INSTANTS or declared(evaluator.believed):
        return None
    constants = constants_of(evaluator.believed, range(evaluator.horizon + 1))
    number = moved_particles(built.job, len(constants))
    return (
        replace(built.comparing, particles=number, proposal=THAT_MOVES.name) if constants else None
    )


def moved_particles(job: Job, constants: int) -> int:
    """The number of particles of a job, if they move."""
    return job.filter.moved_particles or max(MOVED_PARTICLES, _A_CONSTANT * constants)


def steps_a_particle(evaluator: Evaluator, times: Times, moving: Estimation) -> float:
    """Particle-steps of a moved particle at an instant, from a few draws: the same everywhere."""
    evaluator = (evaluator.of_scenarios or (evaluator,))[0]
    stream = stream_of("proposal", 0, "pilot")
    draws = evaluator.draws(range(_PILOT_DRAWS), stream)
    found = evaluator.filter_sets(draws, [times], [evaluator.horizon], stream, moving)
    filters = ESTIMATORS[moving.estimator].filters
    taken = float(found.work[0]) if found.work.size else 0.0
    instants = moving.particles * filters * (evaluator.horizon + 1 - evaluator.start)
    return max(1.0, taken / (_PILOT_DRAWS * instants))


def _should_move(evaluator: Evaluator, built: Built, moving: Estimation, draws: int) -> bool:
    """Whether a plain filter loses a constant, or differs more from another for what it costs."""
    from pfdist.results.particle_loss import LOST  # noqa: PLC0415
    from pfdist.runner.particles import (  # noqa: PLC0415  needs pandas
        LOST_DRAWS,
        lost_constants,
        work_of_loss,
    )

    times, seed, plain = built.job.problem.feasible.regular(), built.job.seed, built.comparing
    if lost_constants(evaluator, times, seed, plain, LOST_DRAWS) > LOST:
        return True
    if draws == 0:
        return False

    def noise(own: Estimation, steps: float) -> float:
        twice = replace(own, estimator=FILTER_NOISE.name)
        work = work_of_loss(evaluator, times, seed, twice, LOST_DRAWS, "proposal")
        return float(evaluator.filtered(work).mse.mean()) * own.particles * steps

    steps = steps_a_particle(evaluator, times, moving)
    return noise(moving, steps) < noise(plain, 1.0)


def choice_of_run(run: Path) -> str:
    """The proposal of a run; empty if there is no run, or none that can be read."""
    from pfdist.store import has_models, read_run  # noqa: PLC0415  workers need no pyarrow

    try:
        section = read_run(run)[1].get("filter", {}) if has_models(run) else {}
    except StoreError:  # whoever opens the run reports what is damaged
        return ""
    proposal = section.get("proposal", "")
    return proposal if proposal in PROPOSALS else ""


def with_long_gap(job: Job) -> Times:
    """A feasible set with a long gap, if possible at most twice the longest of regular times."""
    feasible = job.problem.feasible

    def longest(times: Times) -> int:
        return int(np.diff(feasible.points.instants(times)).max(initial=0))

    most = 2 * longest(feasible.regular())
    sets = feasible.random(_MOST_TRIED, generator("proposal", job.seed))
    short = [times for times in sets if longest(times) <= most]
    return max(short, key=longest) if short else min(sets, key=longest)


def check_beside_truth(evaluator: Evaluator, own: Estimation) -> None:
    """Raise a `ModelError` if the filter that knows the truth, too, cannot have the proposal."""
    is_own = PROPOSALS[own.proposal].beside_truth == own.proposal != PLAIN.name
    if is_own and knowing_truth(evaluator) is not evaluator:
        knowing_truth(evaluator).compile(with_truth(1, own.proposal))
