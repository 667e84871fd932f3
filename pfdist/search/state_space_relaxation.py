"""Decremental state-space relaxation: a dynamic programme over windows of the last measurements.

The error at an instant depends most on the last measurements. The programme finds the sets that
would be best if the error depended only on these, as if everything before had been measured. Then
the windows of these sets grow by a measurement each, and the programme is solved again. The search
ends when no set of the relaxation is better than the best set that was evaluated, when no window
can grow, or after the last round. See `pfdist.search.relaxation` and `pfdist.search.programme`.

If the errors are exact and the filter has the true model, a search that ends before the last round
has proved that its best set is optimal.

References
----------
Christofides, Mingozzi, Toth, "State-space relaxation procedures for the computation of bounds to
routing problems", Networks 11, 1981. Righini, Salani, "New dynamic programming algorithms for the
resource constrained elementary shortest path problem", Networks 51, 2008.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import CommonNoiseSettings, Count
from pfdist.search.base import Candidate, best_of
from pfdist.search.first_windows import relaxation_within
from pfdist.search.gaps import LOOKAHEAD, gaps_for
from pfdist.search.programme import Programme, longer, near_optimal, with_multipliers
from pfdist.search.relaxation import Relaxation, Window

MOST_CELLS = 3_000_000
"""Largest number of errors in the first windows of two measurements."""

_ROUNDING = 1e-11  # relative rounding error of a proof
_SCREENING = (16, 4)  # the first programmes have a 16th and a 4th of the draws
_SCREENED_EACH, _PATHS_EACH = 8, 2  # least numbers of sets for each sum that is sought
# Exact errors take no time, and a proof is worth many rounds:
_PATHS_IF_EXACT = 64
_ROUNDS_IF_EXACT = 500
Array = NDArray[np.float64]


@dataclass(frozen=True)
class RelaxationState:
    """Progress of the search."""

    relaxation: Relaxation  # its windows have errors, or are candidates of the next generation
    # The mean errors of each window at the instants at which they count; NaN if a draw is infinite.
    errors: Mapping[Window, Array] = field(default_factory=dict)
    level: int = 0  # number of programmes on few draws that were solved
    sets: tuple[Times, ...] = ()  # to be evaluated next
    whole: tuple[Evaluation, ...] = ()  # evaluated sets
    round: int = 0  # number of rounds in which windows have grown
    done: bool = False

    @property
    def lacking(self) -> list[int]:
        """Indices of the windows whose errors are missing, at all or at the last instants."""
        sizes = np.diff(self.relaxation.offsets).tolist()
        return [
            number
            for number, window in enumerate(self.relaxation.windows)
            if sizes[number] > (self.errors[window].size if window in self.errors else 0)
        ]

    @property
    def infinite(self) -> set[Window]:
        """The windows without usable errors, because a draw is infinite."""
        return {window for window, errors in self.errors.items() if np.isnan(errors).any()}

    def programmes(self, sums: Sequence[int]) -> dict[int, Programme]:
        """The programme for each sum; a single one if no limit has a largest number."""
        relaxation = self.relaxation
        counted = np.flatnonzero(np.diff(relaxation.offsets)).tolist()
        errors = np.concatenate([self.errors[relaxation.windows[number]] for number in counted])
        if not relaxation.constraints.most:
            return dict.fromkeys(sums, Programme(relaxation, errors, max(sums)))
        return {s: with_multipliers(relaxation, errors, s, self.least(s)) for s in sums}

    def least(self, spent: int) -> float:
        """Least error of the evaluated sets for which this sum's bound holds; inf for none."""
        return min(
            (each.expected_mse for each in self.whole
             if self.relaxation.is_within(each.measurement_times, spent)),
            default=np.inf,
        )  # fmt: skip


@method(
    "relaxation",
    evaluation=CommonNoiseSettings(draws=720),
    polish=True,
    curve="best so far",
    online=False,
    additive=True,
)
@dataclass(frozen=True)
class StateSpaceRelaxation:
    """Decremental state-space relaxation: dynamic programming over the last measurements.

    Parameters
    ----------
    feasible : Feasible
    draws : int
        Number of draws of an evaluation. Two programmes with fewer draws come first and leave few
        windows for the others. The best sets of the first programme with all draws are always
        evaluated, because its relaxed errors are random. With 0, the search begins with all draws,
        and its first programme may already end it.
    paths : int
        Number of sets in a round that are evaluated and whose windows grow.
    rounds : int
        Number of rounds in which windows grow.
    screened : int
        Number of sets whose windows remain after the first programme. After the second, those of
        half as many remain.
    sought : tuple of int, optional
        Numbers of measurements, or sums of money, for which the best sets are found. By default,
        those of the feasible sets.
    known_sets : tuple of tuples of int
        Good sets to begin with; by default regular times, and the empty set if it is feasible.
    gap : float
        The search ends when the lowest relaxed errors are below the errors of the best sets by at
        most this share.
    start : Relaxation, optional
        The relaxation of the first round; by default that of `first_relaxation`.
    most_grown : int
        Largest number of windows that are added to those of the first round.
    lag : int or tuple of int
        Instants after t whose measurements the estimate of z(t) uses; see `pfdist.search.gaps`.
    """

    feasible: Feasible
    draws: int = 0
    paths: Count = 8
    rounds: Count = 1
    screened: Count = 96
    sought: tuple[int, ...] = ()
    known_sets: tuple[Times, ...] = ()
    gap: float = _ROUNDING
    start: Relaxation | None = None
    most_grown: int = 20_000
    lag: Lag = 0

    @property
    def generations(self) -> int:
        """Approximate number of generations."""
        return len(_SCREENING) + min(self.rounds, 5) + 1

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets.

        The first programme needs the errors of all windows, on a sixteenth of the draws. The few
        windows of later programmes are not counted.
        """
        cells, instants = int(self._start.offsets[-1]), self.feasible.horizon + 1
        few = cells / instants / _SCREENING[0] if self.draws else cells / instants
        return few + (self.rounds + 1) * self.paths

    @property
    def usual_evaluations(self) -> float:
        """Usual work: about half of the windows of the sets that remain are those of other sets."""
        screened = self.screened / _SCREENING[1] + self.screened / 2 if self.draws else 0
        return self.evaluations + (screened + self.rounds * self.paths) / 2

    def init(self) -> RelaxationState:
        """The state before the first generation."""
        nothing = ((),) if self.feasible.accepts(()) else ()
        first_sets = self.known_sets or (self.feasible.regular(), *nothing)
        return RelaxationState(
            self._start, level=0 if self.draws else len(_SCREENING), sets=first_sets
        )

    def ask(self, state: RelaxationState, rng: np.random.Generator) -> list[Candidate]:
        """The windows whose errors are missing, and the best sets of the last programme."""
        relaxation, draws = state.relaxation, None  # the number of the search's settings
        if state.level < len(_SCREENING):
            draws = max(1, self.draws // _SCREENING[state.level])
        candidates = [*map(Candidate, state.sets)]
        if lacking := state.lacking:
            windows = relaxation.counted(lacking)
            candidates.insert(0, Candidate((), relaxation.horizon, draws, counted=windows))
        return candidates

    def tell(self, state: RelaxationState, evaluations: Sequence[Evaluation]) -> RelaxationState:
        """Solve the programme, and extend the windows along its best sets."""
        state = _with_evaluations(state, evaluations)
        if any(len(window) == 1 for window in state.infinite):
            # No relaxed error is known. Exchanges may still improve the sets that were evaluated.
            return replace(state, done=True)
        exact = not self.lag and any(not evaluation.draws for evaluation in state.whole)
        relaxation = state.relaxation
        rounds = max(_ROUNDS_IF_EXACT, self.rounds) if exact else self.rounds
        if state.round > rounds:
            return replace(state, done=True)
        programmes = state.programmes(self._sought)
        least = {spent: state.least(spent) for spent in self._sought}
        lower = {spent: programmes[spent].mse[spent] for spent in self._sought}
        screening = state.level < len(_SCREENING) and not exact
        by_draws = bool(self.draws) and not exact and state.round == 0
        # Sums whose search goes on. Only a later programme on all draws may end it: few draws err,
        # and the first relaxed errors may be high by chance.
        left = [
            spent for spent in self._sought if np.isfinite(lower[spent])
            and (screening or by_draws or lower[spent] < least[spent] * (1 - self.gap))
        ]  # fmt: skip
        if not left:
            return replace(state, done=True)
        # First programmes on few draws drop windows that no good set passes. The errors are
        # forgotten: the remaining windows are evaluated again on more draws.
        if screening:
            share = max(_SCREENED_EACH, self.screened // len(left)) // (1 + state.level)
            best_sets = [t for s in left for t in near_optimal(programmes[s], s, share, np.inf)]
            return replace(
                state, relaxation=relaxation.restricted(best_sets), errors={}, level=state.level + 1
            )
        together = max(_PATHS_IF_EXACT, self.paths) if exact else self.paths
        share = max(_PATHS_EACH, together // len(left))
        below = {spent: np.inf if by_draws else least[spent] for spent in left}
        paths_of = {s: near_optimal(programmes[s], s, share, below[s]) for s in left}
        paths = [*chain.from_iterable(paths_of.values())]
        evaluated = {evaluation.measurement_times for evaluation in state.whole}
        whole = dict.fromkeys(t for s in left for t in self._whole(programmes[s], s, paths_of[s]))
        sets = tuple(times for times in whole if times not in evaluated)
        # The new windows have no errors yet: the next generation asks for them, and for the sets.
        grown = relaxation.grown(*longer(relaxation, paths)).without(state.infinite)
        added = len(grown.windows) - len(self._start.windows)
        if state.round == rounds or added > self.most_grown or grown == relaxation:
            # Nothing grows any more: only the sets are evaluated, in a last generation.
            return replace(state, done=not sets, sets=sets, round=rounds + 1)
        return replace(state, relaxation=grown, sets=sets, round=state.round + 1)

    def done(self, state: RelaxationState) -> bool:
        """Whether the search has ended."""
        return state.done

    def finalists(self, state: RelaxationState) -> tuple[Evaluation, ...]:
        """The best sets by their own errors; with `sought`, the best of each number or price."""
        if not self.sought:
            return best_of(state.whole)
        found, unit = dict[Times, Evaluation](), self._start.unit
        prices = {
            each.measurement_times: self._price(each.measurement_times) for each in state.whole
        }
        ranked = sorted(state.whole, key=lambda evaluation: evaluation.expected_mse)
        for spent in sorted(self.sought, reverse=not self.feasible.counted):
            # Each price that is rounded down to the sum may be the one that is sought.
            for most in range(spent * unit, (spent + 1) * unit):
                for each in ranked:
                    price = prices[each.measurement_times]
                    if price == most or (price < most and not self.feasible.counted):
                        found[each.measurement_times] = each
                        break
        return tuple(found.values())

    def _price(self, times: Times) -> int:
        return len(times) if self.feasible.counted else self.feasible.spent(times)

    def _whole(self, programme: Programme, spent: int, paths: list[Times]) -> list[Times]:
        """The paths of a sum that can be paid for, completed to feasible sets.

        Paths may break limits; then they are repaired.

        Where prices are rounded down, all paths may be too expensive. Then paths of smaller and
        smaller sums are tried, until one can be paid for.
        """
        feasible, unit, whole, tried = self.feasible, self._start.unit, list[Times](), paths
        if feasible.counted and self.sought:
            feasible = replace(feasible, measurement_budget=spent)
        if feasible.counted and not feasible.shared:
            return paths
        most = min(feasible.total, spent * unit) if self.sought else feasible.total
        while True:
            if feasible.shared:
                whole += [feasible.repair(times, np.random.default_rng(0)) for times in tried]
            else:
                whole += map(feasible.completed, filter(feasible.allows, tried))
            if unit == 1 or spent == 0 or any(feasible.spent(times) <= most for times in whole):
                return whole
            spent -= 1
            tried = near_optimal(programme, spent, len(paths), np.inf)

    @cached_property
    def _sought(self) -> tuple[int, ...]:
        return self.sought or (self._start.total,)

    @cached_property
    def _start(self) -> Relaxation:
        if self.start is not None:
            return self.start
        return first_relaxation(self.feasible, self.feasible.measurements, self.lag)


def _with_evaluations(state: RelaxationState, evaluations: Sequence[Evaluation]) -> RelaxationState:
    """The state after the last candidates were evaluated, without windows of infinite error."""
    lacking, relaxation, errors = state.lacking, state.relaxation, {**state.errors}
    if lacking:
        sizes = np.diff(relaxation.offsets)[lacking]
        each = np.split(evaluations[0].errors_of_instants, np.cumsum(sizes)[:-1])
        errors.update(zip((relaxation.windows[number] for number in lacking), each, strict=True))
    whole = (*state.whole, *evaluations[bool(lacking) :])
    updated = replace(state, errors=errors, whole=whole, sets=())
    return replace(updated, relaxation=relaxation.without(updated.infinite))


def first_relaxation(
    feasible: Feasible, measurements: int, lag: Lag, most_cells: int | None = None
) -> Relaxation:
    """The relaxation with which a search begins, for a usual number of measurements and a lag."""
    most_cells = most_cells or MOST_CELLS
    if lag:
        return gaps_for(feasible, measurements, lag, most_cells, LOOKAHEAD)
    return relaxation_within(feasible, measurements, most_cells)
