"""Whether a search may believe its estimator: probes against the squared error.

A filter whose cloud has collapsed onto a wrong state has next to no variance, and a large error.
An estimator made of such a filter's variance is too small there, and a search seeks the very sets
where it is smallest. So the estimator and the squared error of the job's own filter are computed
for some sets on the same draws: the regular times, a few random sets, and those that led the
search. The estimator fails if it is much too small on any of them, or if it changes the order of
two finalists.

The draws are doubled where the decision is open, for the worse half of what is undecided.

References
----------
Karnin, Koren, Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013 (sequential
halving).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np

from pfdist.evaluation.estimate import Evaluation, ProbeEvaluation
from pfdist.search.base import Candidate
from pfdist.search.paired import CLEAR_ERRORS, difference
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

PROBE_DRAWS = 500
"""Draws of the first round of probes."""
BELOW = 0.15
"""An estimator fails that lies this share, and `CLEAR_ERRORS`, below the squared error."""

_MOST_DRAWS = 8000
_RANDOM_SETS = 3
_SURE = 2.0  # standard errors, by which a probe lies above the limit and is passed

E = TypeVar("E", bound=Evaluation)


class Verdict(NamedTuple):
    """What a probe says of an estimator.

    Parameters
    ----------
    excess : float
        By how many standard errors the estimator lies below what is allowed; negative: above.
    fails : bool
    open : bool
        Whether more draws may change that.
    known : bool
        Whether enough draws could be used to say anything.
    """

    excess: float
    fails: bool
    open: bool
    known: bool = True


def judged(estimated: Evaluation, squared: Evaluation) -> Verdict:
    """Judge an estimator by one set, on the draws in which neither filter was degenerate.

    Parameters
    ----------
    estimated, squared : Evaluation
        Of the same times, up to the same end, on the same draws: by the estimator, and by the
        squared error of the job's own filter.
    """
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    if np.sum(usable) < 2:
        return Verdict(-math.inf, fails=False, open=False, known=False)
    estimates, errors = estimated.mse[usable], squared.mse[usable]
    excess = _standard_scores((1 - BELOW) * errors - estimates)
    below = _standard_scores(errors - estimates)
    fails = excess > 0 and below > CLEAR_ERRORS
    return Verdict(excess, fails, open=not fails and excess > -_SURE)


def _standard_scores(values: np.ndarray) -> float:
    mean, error = np.mean(values), np.std(values, ddof=1) / math.sqrt(values.size)
    return float(mean / error) if error > 0 else math.copysign(math.inf, mean) if mean else 0.0


@dataclass(frozen=True)
class ProbeState:
    """How far the probes are.

    Parameters
    ----------
    undecided : tuple of Candidate
        What the next round evaluates, each by the estimator and by the squared error.
    draws : int
        Draws of the next round.
    failed : tuple of ProbeEvaluation
        By the estimator and by the squared error, for the probe on which the estimator failed.
    unknown : tuple of ProbeEvaluation
        The same for the first probe on which it could not be checked.
    """

    undecided: tuple[Candidate, ...] | None = None
    draws: int = PROBE_DRAWS
    failed: tuple[ProbeEvaluation, ...] = ()
    unknown: tuple[ProbeEvaluation, ...] = ()


@dataclass(frozen=True)
class Probe:
    """Compare an estimator with the squared error of the job's own filter.

    Parameters
    ----------
    feasible : Feasible
    sought : tuple of Candidate
        What led the search: sets, and prefixes with their ends.
    dearer : float
        How many evaluations by the estimator take as long as one by the squared error.
    """

    feasible: Feasible
    sought: tuple[Candidate, ...] = ()
    dearer: float = 1.0

    @property
    def generations(self) -> int:
        """How many rounds, if no probe is close to the limit."""
        return 1

    @property
    def evaluations(self) -> float:
        """About how many whole evaluations by the estimator its work amounts to.

        There is a leader for each number of measurements. Prefixes have half of the horizon, and
        share half of that.
        """
        return (1 + _RANDOM_SETS + self.feasible.total / 4) * (1 + self.dearer)

    def init(self) -> ProbeState:
        """Give the state before the first asking."""
        return ProbeState()

    def ask(self, state: ProbeState, rng: np.random.Generator) -> list[Candidate]:
        """Give each probe twice: to be estimated, and for its squared error."""
        probes = state.undecided
        if probes is None:
            others = (self.feasible.regular(), *self.feasible.random(_RANDOM_SETS, rng))
            probes = tuple(dict.fromkeys((*map(Candidate, others), *self.sought)))
        return [
            probe._replace(draws=state.draws, squared=squared)
            for probe in probes
            for squared in (False, True)
        ]

    def tell(self, state: ProbeState, evaluations: Sequence[ProbeEvaluation]) -> ProbeState:
        """Decide where the draws suffice; go on with the worse half of the others."""
        pairs = list(zip(evaluations[::2], evaluations[1::2], strict=True))
        verdicts = [judged(*pair) for pair in pairs]
        order = sorted(range(len(pairs)), key=lambda place: -verdicts[place].excess)
        failed = [place for place in order if verdicts[place].fails]
        if failed:  # a whole set, if there is any: its figures say most to a reader
            told = min(failed, key=lambda place: pairs[place][0].end is not None)
            return replace(state, undecided=(), failed=pairs[told])
        unknown = [pair for pair, verdict in zip(pairs, verdicts, strict=True) if not verdict.known]
        undecided = [place for place in order if verdicts[place].open]
        if 2 * state.draws > _MOST_DRAWS:
            undecided = []
        worse = undecided[: (len(order) + 1) // 2]
        probes = (pairs[place][0] for place in worse)
        return replace(
            state,
            undecided=tuple(Candidate(probe.measurement_times, probe.end) for probe in probes),
            draws=2 * state.draws,
            unknown=state.unknown or (unknown[0] if unknown else ()),
        )

    def done(self, state: ProbeState) -> bool:
        """Whether the estimator has failed, or nothing is undecided."""
        return state.undecided == ()

    def finalists(self, state: ProbeState) -> tuple[ProbeEvaluation, ...]:
        """Give both evaluations of the probe on which it failed, or could not be checked."""
        return state.failed or state.unknown


def new_leaders(told: Iterable[E], before: Iterable[E]) -> list[E]:
    """Give the evaluations of a generation that are better than all before, of each kind.

    Sets of as many measurements are of one kind, and so are prefixes. A prefix is as good as the
    mean of its costs over the instants up to its end.

    Parameters
    ----------
    told : iterable of Evaluation
        What a search was told in this generation.
    before : iterable of Evaluation
        The leaders of former generations.
    """
    best = {_kind(leader): leader for leader in before}
    new: dict[tuple[int, bool], E] = {}
    for evaluation in told:
        kind = _kind(evaluation)
        leader = new.get(kind, best.get(kind))
        if math.isfinite(evaluation.cost) and (
            leader is None or _mean_cost(evaluation) < _mean_cost(leader)
        ):
            new[kind] = evaluation
    return list(new.values())


def _kind(evaluation: Evaluation) -> tuple[int, bool]:
    return len(evaluation.measurement_times), evaluation.end is None


def _mean_cost(evaluation: Evaluation) -> float:
    return evaluation.cost / (1 if evaluation.end is None else evaluation.end + 1)


def misordered(
    believed: Mapping[Times, Evaluation], squared: Sequence[Evaluation]
) -> tuple[Evaluation, Evaluation] | None:
    """Give two finalists, the better first, that an estimator puts in the wrong order, if any.

    The squared error must tell the two apart, and the estimator must contradict it: the differences
    that both see have other signs, and are further apart than their errors explain.

    Parameters
    ----------
    believed : mapping of tuple of int to Evaluation
        By the estimator, of each finalist.
    squared : sequence of Evaluation
        By the squared error of the job's own filter, on common draws.
    """
    for first, second in combinations(squared, 2):
        real = difference(first, second)
        better, worse = (first, second) if real.mean < 0 else (second, first)
        told_apart = real.is_worse(CLEAR_ERRORS) or real.is_better(CLEAR_ERRORS)
        if not math.isfinite(real.mean) or not told_apart:
            continue
        seen = difference(*(believed[each.measurement_times] for each in (better, worse)))
        apart = seen.mean + abs(real.mean)
        if seen.mean > 0 and apart > CLEAR_ERRORS * math.hypot(
            real.standard_error, seen.standard_error
        ):
            return better, worse
    return None


def failed_probe(estimated: Evaluation, squared: Evaluation) -> str:
    """Say in words how far an estimator is too small on a probe.

    Parameters
    ----------
    estimated, squared : Evaluation
        As `judged` takes them.
    """
    usable = np.isfinite(estimated.mse) & np.isfinite(squared.mse)
    estimate, error = np.mean(estimated.mse[usable]), np.mean(squared.mse[usable])
    spread = np.std(squared.mse[usable], ddof=1) / math.sqrt(np.sum(usable))
    upto = "" if estimated.end is None else f" up to t = {estimated.end}"
    return (
        f"it gives {estimate:.4g} for {_text(estimated.measurement_times)}{upto}, where the "
        f"squared error of the job's own filter is {error:.4g} ± {spread:.2g}"
    )


def unchecked_probe(estimated: Evaluation, squared: Evaluation) -> str:
    """Say in words on which probe an estimator could not be checked.

    Parameters
    ----------
    estimated, squared : Evaluation
        As `judged` takes them.
    """
    usable = int(np.sum(np.isfinite(estimated.mse) & np.isfinite(squared.mse)))
    return (
        f"in {_text(estimated.measurement_times)} only {usable} of {estimated.mse.size} draws had "
        "no degenerate filter, and 2 are needed; more filter.particles would help"
    )


def wrong_order(better: Evaluation, worse: Evaluation) -> str:
    """Say in words which two finalists an estimator puts in the wrong order.

    Parameters
    ----------
    better, worse : Evaluation
        By the squared error, on common draws.
    """
    apart = difference(worse, better)
    return (
        f"it prefers {_text(worse.measurement_times)} to {_text(better.measurement_times)}, where "
        f"the squared error of the job's own filter is larger by {apart.mean:.4g} ± "
        f"{apart.standard_error:.2g}"
    )


def _text(times: Times) -> str:
    return f"{{{', '.join(map(str, times))}}}"
