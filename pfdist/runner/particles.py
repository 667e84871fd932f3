"""The number of particles that a filter needs: particle losses, and effective sample sizes.

Where the filter's model is not the truth, the draws are those of the filter's model
(`pfdist.filters.variants.self_consistent`): the error due to a wrong model does not
depend on the number of particles.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.constants import constants_of, different_values
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.proposal import PLAIN, Proposal
from pfdist.filters.proposals import FEW_VALUES
from pfdist.filters.work import Estimation, FilterWork, Result, cut, with_truth
from pfdist.kernels.estimators import FILTER_NOISE
from pfdist.results import Moments
from pfdist.results.particle_loss import SMALL, ParticleLoss, particle_loss

NUMBERS = (50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000)
"""Numbers of particles among which `enough_particles` finds one."""
_DRAWS = (1000, 4000, 16_000)  # more are filtered only if fewer leave it open
_TRIED = 480  # draws with which proposals are compared, or fewer: at most 5 % of the work, where
_LEAST_TRIED = 24
_TIMES_A_DRAW = 2 * 2 * (1 + 1)  # two sets, two filters in the same time
_SHARE = 0.05
LOST_DRAWS = 24  # of which a share is known
_FILTERS = 4  # of a draw behind a loss
_SECONDS = 2.0  # of draws in memory at once
_SIZE_DRAWS = 100  # behind a mean effective sample size
_LINE_DRAWS = 24  # behind a mean number of lines
_FEW_LINES = 20  # fewer make a smoothed estimate uncertain
_PARTICLES = 1_000_000  # of draws whose last particles are in memory at once


def work_of_loss(
    evaluator: Evaluator,
    times: Times,
    seed: int,
    estimation: Estimation,
    draws: int,
    purpose: str = "particles",
) -> FilterWork:
    """The work that measures the particle loss of a set of times.

    All numbers of particles share the draws.
    """
    streams = {role: stream_of(purpose, seed, role) for role in ("draws", "filter")}
    ends = (evaluator.horizon,)
    return FilterWork(
        (times,), ends, (streams["filter"],), streams["draws"], (0, draws), estimation,
        sensors=evaluator.points.ways,
    )  # fmt: skip


def measured_loss(
    evaluator: Evaluator, work: FilterWork, *, by_two_filters: bool = True
) -> tuple[ParticleLoss, Moments]:
    """The particle loss on the draws of a work, and moments of the MSE.

    The limit of the loss needs no two filters, which take half of the time; without, the loss by
    two filters is 0.
    """

    def errors(estimation: Estimation) -> NDArray[np.float64]:
        pieces = evaluator.pieces(replace(work, estimation=estimation), _SECONDS)
        return np.concatenate([evaluator.filtered(piece).mse[:, 0] for piece in pieces])

    own = work.estimation
    squared, variance = errors(own), errors(with_truth(own.particles, own.proposal))
    distance = np.zeros_like(squared)
    if by_two_filters:
        distance = errors(replace(own, estimator=FILTER_NOISE.name))
    whole = Moments.of_values(squared)
    loss = particle_loss(own.particles, whole, squared, distance, variance, moves=own.moves)
    return loss, whole


def compared_draws(asked: float) -> int:
    """The draws with which proposals are compared for the work of filtering so many draws.

    It is 0 if too few draws are asked for.
    """
    draws = min(_TRIED, int(_SHARE * asked / _TIMES_A_DRAW))
    return draws if draws >= _LEAST_TRIED else 0


def why_plain(
    evaluator: Evaluator,
    sets: Sequence[Times],
    seed: int,
    plain: Estimation,
    rival: Proposal,
    draws: int = _TRIED,
    *,
    in_words: bool = True,
) -> str:
    """Why ``filter.proposal = "auto"`` takes the plain filter; empty if it takes the rival.

    In the same time, that is with fewer particles by its cost, the upper 95 % limit of the rival's
    loss must lie below that of the plain filter on the same draws, with each set. A plain
    filter whose loss is not proved to exceed 1 % is not replaced. Unless `in_words`, the text has
    no losses, and half of the work is saved.
    """
    fewer = replace(plain, particles=-(-plain.particles // rival.cost), proposal=rival.name)
    for times in sets:
        work = work_of_loss(evaluator, times, seed, plain, min(draws, _TRIED), "proposal")
        loss, _ = measured_loss(evaluator, work, by_two_filters=in_words)
        is_enough = loss.at_least <= SMALL
        if is_enough and not in_words:
            return PLAIN.name
        again = replace(work, estimation=fewer)
        other, _ = measured_loss(evaluator, again, by_two_filters=in_words)
        if is_enough or other.limit >= loss.limit:
            found = f"{loss.particles:,} plain particles lose {loss.text}"
            return f"{found}; {other.particles:,} {rival.name} ones lose {other.text}"
    return ""


def lost_constants(
    evaluator: Evaluator, times: Times, seed: int, estimation: Estimation, draws: int
) -> float:
    """The share of draws that end with few different values of a component that does not move.

    Resampling copies such values, and nothing renews them, unless particles move.
    """
    evaluator = (evaluator.of_scenarios or (evaluator,))[0]
    constants = constants_of(evaluator.believed, range(evaluator.horizon + 1))
    if not constants or estimation.moves:
        return 0.0
    streams = [stream_of("particles", seed, "constants", role) for role in ("draws", "filter")]
    simulated = evaluator.draws(range(draws), streams[0])
    (found,) = evaluator.filter_each(simulated, [times], streams[1:], estimation)
    return float(np.mean([different_values(x, constants) < FEW_VALUES for x in found.cloud]))


def mean_effective_sizes(evaluator: Evaluator, work: FilterWork) -> "pd.Series[float]":
    """Mean effective sample size after each measurement of a work with one set, by instant.

    It is a mean over the first draws, without those in which no particle explains the measurement;
    NaN if no draw is left.
    """
    (times,) = work.measurement_times
    sizes = np.concatenate([each.sizes[0] for each in _filtered(evaluator, work, _SIZE_DRAWS)])
    at = [t - evaluator.start for t in evaluator.points.instants(times)]
    return pd.DataFrame(sizes).mean()[at].rename(lambda k: k + evaluator.start)


def fewest_lines(
    evaluator: Evaluator, work: FilterWork, formatted: Callable[[int], str]
) -> tuple[str, bool]:
    """From how many particles a smoothed estimate comes at worst, and whether these are few.

    They are the particles that have descendants at the last measurement that the estimate uses.
    The number is a mean over the first draws, at the instant where this mean is lowest, without
    those of weight 0. `formatted` gives the time of an instant as text.
    """
    if not (evaluator.lag and evaluator.has_particles):
        return "", False
    lines = np.concatenate([each.lines[0] for each in _filtered(evaluator, work, _LINE_DRAWS)])
    numbers = np.where(np.isnan(lines), work.estimation.particles, lines).mean(axis=0)
    if evaluator.instant_weights is not None:
        numbers[evaluator.instant_weights == 0.0] = np.inf
    t, number = formatted(int(numbers.argmin()) + evaluator.start), float(numbers.min())
    is_few = number < _FEW_LINES
    text = (
        f"Behind the smoothed estimate at t = {t} stand {number:.1f} of "
        f"{work.estimation.particles:,} particles: only these have descendants at the last "
        "measurement that it uses."
    )
    return text + " More particles help (filter.particles)." * is_few, is_few


def _filtered(evaluator: Evaluator, work: FilterWork, most: int) -> Iterator[Result]:
    """The first draws of a work, with trajectories, in parts that fit into memory."""
    first, last = work.draws
    at_once = max(1, _PARTICLES // work.estimation.particles)
    for draws in cut(range(first, min(last, first + most)), at_once):
        yield evaluator.filtered(replace(work, draws=draws, trajectories=True))


def enough_particles(
    evaluator: Evaluator,
    times: Times,
    seed: int,
    estimation: Estimation,
    most_steps: float = math.inf,
    known: ParticleLoss | None = None,
) -> ParticleLoss:
    """The particle loss with the smallest of `NUMBERS` for which it is small.

    A loss must be small on all draws of `_DRAWS`. If it is small on few draws, and rare failures of
    the filter appear on more, this loss is the result: more particles only make failures rarer. If
    the loss is small with no number, the result is that with the largest number, or with the
    largest within a limit of particle-steps. If the loss is known to be large with some number,
    only larger numbers are tried. The result depends on the arguments alone, so the same job gets
    the same number.
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
