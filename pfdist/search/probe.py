"""A probe of an estimator: a comparison with the squared error on a few sets.

The sets are the regular times, a few random sets, the leaders of the search, and its best sets.
Estimator and squared error use the same filter, so they have equal numbers of particles. Only sets
whose estimate is near the smallest are judged, because a search ends with one of them. The
estimator fails if its estimate is clearly too small for one of them. Undecided sets enter the next
round with twice as many draws, but at most half of the sets of a round: those for which the
estimate looks worst. The others pass. This is sequential halving (Karnin, Koren, Somekh, "Almost
optimal exploration in multi-armed bandits", ICML 2013).

If the particles of a filter have collapsed onto a wrong state, their variance is tiny and the error
is large. An estimator that uses this variance is too small there, and a search prefers exactly the
sets where it is smallest. Two tests detect this: the estimate lies far below the squared error on
some set, or it reverses the order of two sets.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from pfdist.common.clock import Clock
from pfdist.common.estimate import CLEAR_ERRORS, Estimate
from pfdist.common.formatted_times import formatted_times
from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation, difference
from pfdist.problem.feasible import Feasible
from pfdist.search.base import Candidate

PROBE_DRAWS = 500
"""Number of draws of the first round."""

_MOST_DRAWS = 8000  # of the last round: sets that are still open after it pass
_RANDOM_SETS = 3


@dataclass(frozen=True)
class ProbeState:
    """Progress of a probe."""

    undecided: tuple[Candidate, ...] | None = None  # sets of the next round; None before the first
    draws: int = PROBE_DRAWS  # number of draws of the next round
    # The two evaluations, by the estimator and by the squared error, of the set on which the
    # estimator failed, or the two of `misordered`; empty if it failed on none.
    failed: tuple[Evaluation, ...] = ()


@dataclass(frozen=True)
class Probe:
    """An optimiser that compares an estimator with the squared error of the same filter.

    `sought` are the leaders and best sets of the search: sets, and prefixes with their ends.
    `dearer` is the ratio of the time of an evaluation by the squared error to that of one by the
    estimator. `orders` is whether the estimator decides between the best sets.
    """

    feasible: Feasible
    sought: tuple[Candidate, ...] = ()
    dearer: float = 1.0
    orders: bool = True

    @property
    def generations(self) -> int:
        """Number of rounds, if no set lies close to the limit."""
        return 1

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets by the estimator.

        A search by prefixes has a leader for each number of measurements. On average, a prefix
        covers half of the horizon, and half of that is shared with other prefixes.
        """
        return (1 + _RANDOM_SETS + self.feasible.total / 4) * (1 + self.dearer)

    def init(self) -> ProbeState:
        """The state before the first round."""
        return ProbeState()

    def ask(self, state: ProbeState, rng: np.random.Generator) -> list[Candidate]:
        """Each undecided set twice: by the estimator, and by the squared error."""
        probes = state.undecided
        if probes is None:
            others = (self.feasible.regular(), *self.feasible.random(_RANDOM_SETS, rng))
            probes = tuple(dict.fromkeys((*map(Candidate, others), *self.sought)))
        return [
            probe._replace(draws=state.draws, squared=squared)
            for probe in probes
            for squared in (False, True)
        ]

    def tell(self, state: ProbeState, evaluations: Sequence[Evaluation]) -> ProbeState:
        """Decide where the draws suffice; keep the worst undecided sets, at most half of all."""
        pairs = _near_the_best(list(zip(evaluations[::2], evaluations[1::2], strict=True)))
        verdicts = [judged(*pair) for pair in pairs]
        order = sorted(range(len(pairs)), key=lambda index: -verdicts[index].excess)
        failed = [index for index in order if verdicts[index].fails]
        if failed:  # report a whole set if there is any: readers understand it more easily
            reported = min(failed, key=lambda index: pairs[index][0].end is not None)
            return replace(state, undecided=(), failed=pairs[reported])
        whole = [pair for pair in pairs if self.orders and pair[0].end is None]
        believed = {estimated.measurement_times: estimated for estimated, _ in whole}
        if wrong := misordered(believed, [squared for _, squared in whole]):
            return replace(state, undecided=(), failed=wrong)
        undecided = [index for index in order if verdicts[index].open]
        if 2 * state.draws > _MOST_DRAWS:
            undecided = []
        worse = undecided[: (len(order) + 1) // 2]
        probes = (pairs[index][0] for index in worse)
        return replace(
            state,
            undecided=tuple(Candidate(probe.measurement_times, probe.end) for probe in probes),
            draws=2 * state.draws,
        )

    def done(self, state: ProbeState) -> bool:
        """Whether the estimator has failed, or nothing is undecided."""
        return state.undecided == ()

    def finalists(self, state: ProbeState) -> tuple[Evaluation, ...]:
        """The two evaluations that show the failure (`failed_probe`); empty if all sets pass."""
        return state.failed


def new_leaders(
    evaluations: Iterable[Evaluation], before: Iterable[Evaluation]
) -> list[Evaluation]:
    """The best evaluation of each kind in a generation, if it beats the last leader of that kind.

    Whole sets with the same number of measurements are one kind, and prefixes with the same number
    of measurements another. Prefixes are compared by their mean error up to their ends.
    """
    best = {_kind(leader): leader for leader in before}
    new: dict[tuple[int, bool], Evaluation] = {}
    for evaluation in evaluations:
        kind = _kind(evaluation)
        leader = new.get(kind, best.get(kind))
        if math.isfinite(evaluation.expected_mse) and (
            leader is None or _mean_error(evaluation) < _mean_error(leader)
        ):
            new[kind] = evaluation
    return list(new.values())


def _near_the_best(
    pairs: list[tuple[Evaluation, Evaluation]],
) -> list[tuple[Evaluation, Evaluation]]:
    """The pairs of an estimate and an error whose estimate is near the least of its kind."""
    least = dict[tuple[int, bool], float]()
    for estimated, _ in pairs:
        error = least.setdefault(_kind(estimated), math.inf)
        least[_kind(estimated)] = min(error, _mean_error(estimated))
    return [each for each in pairs if _mean_error(each[0]) * (1 - BELOW) <= least[_kind(each[0])]]


def _kind(evaluation: Evaluation) -> tuple[int, bool]:
    return len(evaluation.measurement_times), evaluation.end is None


def _mean_error(evaluation: Evaluation) -> float:
    return evaluation.expected_mse / (1 if evaluation.end is None else evaluation.end + 1)


BELOW = 0.15
"""An estimator fails if it is this share, and `CLEAR_ERRORS`, below the squared error."""

_SURE = 2.0  # standard errors above the limit, from which an estimator passes


class Verdict(NamedTuple):
    """Result of the test of an estimator on one set."""

    # Number of standard errors by which the estimate lies below the limit; negative if above.
    excess: float
    fails: bool
    open: bool  # whether more draws may change the result


def judged(estimated: Evaluation, squared: Evaluation) -> Verdict:
    """The verdict on an estimator for one set, from draws in which neither filter became infinite.

    `squared` is the evaluation by the squared error. Both have the same times, end and draws.
    """
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    if np.sum(usable) < 2:
        return Verdict(-math.inf, fails=False, open=False)
    estimates, errors = estimated.mse[usable], squared.mse[usable]
    excess = _standard_scores((1 - BELOW) * errors - estimates)
    below = _standard_scores(errors - estimates)
    fails = excess > 0 and below > CLEAR_ERRORS
    return Verdict(excess, fails, open=not fails and excess > -_SURE)


def _standard_scores(values: np.ndarray) -> float:
    mean = Estimate.of_mean(values)
    if mean.standard_error > 0:
        return mean.value / mean.standard_error
    return math.copysign(math.inf, mean.value) if mean.value else 0.0


def misordered(
    believed: Mapping[Times, Evaluation], squared: Sequence[Evaluation]
) -> tuple[Evaluation, Evaluation] | None:
    """Two sets that an estimator puts in the wrong order, the better first; None if there are none.

    `believed` has the evaluations by the estimator, and `squared` those by the squared error of the
    same filter on common draws. The squared error must distinguish the two sets significantly, and
    the estimator must significantly contradict this order.
    """
    for first, second in combinations(squared, 2):
        real = difference(first, second)
        better, worse = (first, second) if real.value < 0 else (second, first)
        is_clear = real.is_positive() or real.is_negative()
        if not math.isfinite(real.value) or not is_clear:
            continue
        seen = difference(*(believed[each.measurement_times] for each in (better, worse)))
        contradiction = seen.plus(real.times(math.copysign(1.0, real.value)))
        if seen.value > 0 and contradiction.is_positive():
            return better, worse
    return None


def failed_probe(estimated: Evaluation, squared: Evaluation, *, clock: Clock) -> str:
    """A sentence about an estimate that is too small on a set, or about a wrong order.

    The evaluations are those of `judged`, or those of `misordered`, whose times differ. Sets have
    times on the clock.
    """
    if estimated.measurement_times != squared.measurement_times:
        apart = difference(squared, estimated)
        return (
            f"it prefers {_text(squared, clock)} to {_text(estimated, clock)}, where the squared "
            f"error of the same filter is larger by {apart.value:.4g} ± {apart.standard_error:.2g}"
        )
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    estimate, error = np.mean(estimated.mse[usable]), Estimate.of_mean(squared.mse[usable])
    up_to = "" if estimated.end is None else f" up to t = {clock.formatted(estimated.end)}"
    return (
        f"it gives {estimate:.4g} for {_text(estimated, clock)}{up_to}, where the squared "
        f"error of the same filter is {error.value:.4g} ± {error.standard_error:.2g}"
    )


def _text(evaluation: Evaluation, clock: Clock) -> str:
    return f"{{{formatted_times(clock.written_of(evaluation.measurement_times))}}}"
