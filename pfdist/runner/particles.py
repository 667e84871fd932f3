"""How many particles a filter needs: the loss by their number, and effective sample sizes.

Where the filter's model is not the truth, the draws are those of the filter's model
(`pfdist.filters.evaluator.Evaluator.self_consistent`): the price of a wrong model does not depend
on the number of particles.
"""

import math
from dataclasses import replace

import numpy as np
import pandas as pd

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, Work, cut, with_truth
from pfdist.kernels.estimators import FILTER_NOISE
from pfdist.models import squared_error
from pfdist.results import Moments
from pfdist.results.particle_loss import ParticleLoss, particle_loss

NUMBERS = (50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000)
"""Numbers of particles among which `enough_particles` finds one."""
_DRAWS = (1000, 4000, 16_000)  # more are filtered only if fewer leave it open
_FILTERS = 4  # of a draw behind a loss
_SECONDS = 2.0  # of draws in memory at once
_SIZE_DRAWS = 100  # behind a mean effective sample size
_PARTICLES = 1_000_000  # of draws whose last particles are in memory at once


def work_of_loss(
    evaluator: Evaluator, times: Times, seed: int, estimation: Estimation, draws: int
) -> Work:
    """The work by which the loss of a set of times is measured.

    All numbers of particles share the draws.
    """
    streams = {role: stream_of("particles", seed, role) for role in ("draws", "filter")}
    ends = (evaluator.horizon,)
    return Work(
        (times,), ends, (streams["filter"],), streams["draws"], (0, draws), estimation,
        sensors=evaluator.sensors,
    )  # fmt: skip


def has_particle_loss(evaluator: Evaluator) -> bool:
    """Whether the engine has particles, and the error is the squared norm."""
    return not evaluator.exact and evaluator.model.error is squared_error


def measured_loss(evaluator: Evaluator, work: Work) -> tuple[ParticleLoss, Moments]:
    """The loss by the number of particles on the draws of a work, and moments of the MSE."""
    particles, errors = work.estimation.particles, []
    for estimation in (
        work.estimation,
        replace(work.estimation, estimator=FILTER_NOISE.name),
        with_truth(particles),
    ):
        pieces = evaluator.pieces(replace(work, estimation=estimation), _SECONDS)
        errors.append(np.concatenate([evaluator.filtered(piece).mse[:, 0] for piece in pieces]))
    squared, distance, variance = errors
    whole = Moments()
    whole.add(squared)
    return particle_loss(particles, whole, squared, distance, variance), whole


def mean_effective_sizes(evaluator: Evaluator, work: Work) -> "pd.Series[float]":
    """Mean effective sample size after each measurement of a work of one set, by its instant.

    It is a mean over the first draws, without those of which no particle explains the measurement;
    NaN if none is left.
    """
    (times,), (first, last) = work.measurement_times, work.draws
    at_once = max(1, _PARTICLES // work.estimation.particles)
    pieces = [
        replace(work, draws=draws, trajectories=True)
        for draws in cut(range(first, min(last, first + _SIZE_DRAWS)), at_once)
    ]
    sizes = np.concatenate([evaluator.filtered(piece).sizes[0] for piece in pieces])
    at = sorted({time // work.sensors - evaluator.start for time in times})
    return pd.DataFrame(sizes).mean()[at].rename(lambda k: k + evaluator.start)


def enough_particles(
    evaluator: Evaluator,
    times: Times,
    seed: int,
    estimation: Estimation,
    most_steps: float = math.inf,
    known: ParticleLoss | None = None,
) -> ParticleLoss:
    """The loss with the least of `NUMBERS` with which it is small.

    A loss must be small on all draws of `_DRAWS`. If it is small on few draws, and rare failures of
    the filter appear on more, this loss is the result: more particles make failures rarer, until no
    number of draws shows them. If the loss is small with no number, the result is that with the
    largest number, or with the largest for which at most so many particle-steps are enough. If the
    loss is known to be large with some number, only larger numbers are tried. The result depends on
    the arguments alone, so the same job gets the same number.
    """
    losses, steps = [known] if known else [], 0
    for number in NUMBERS:
        for draws in _DRAWS if known is None or number > known.particles else ():
            chosen = replace(estimation, particles=number)
            work = work_of_loss(evaluator, times, seed, chosen, draws)
            steps += _FILTERS * work.steps
            if losses and steps > most_steps:
                return losses[-1]
            loss, _ = measured_loss(evaluator, work)
            few_draws_mislead = draws > _DRAWS[0] and losses[-1].is_small and loss.rare
            losses.append(loss)
            if few_draws_mislead or (loss.is_small and draws == _DRAWS[-1]):
                return loss
            if not loss.may_be_small:
                break
    return losses[-1]
