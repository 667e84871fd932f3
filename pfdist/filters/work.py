"""A unit of work, and its result: a range of draws, filtered with sets of measurement times."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, reduce
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from pfdist.common.measurement_times import Lag, ManySets, Times
from pfdist.common.section import Whole
from pfdist.common.streams import stream_key
from pfdist.filters.cloud import Prior
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import PROPOSALS
from pfdist.kernels.estimators import (
    CONTROL,
    ESTIMATORS,
    EVIDENCE,
    FILTER_VARIANCE,
    SQUARED_ERROR,
)
from pfdist.kernels.prefixes import plan_prefixes
from pfdist.kernels.rules import Applied
from pfdist.kernels.schemes import ALWAYS, CONDITIONAL, MULTINOMIAL, Resampling

BLOCK = 24
"""Draws over which errors are added up.

One task adds up a whole block, so results do not depend on workers.
"""


@dataclass(frozen=True)
class Estimation:
    """The estimation of a draw's MSE: the settings of the filter, and the estimator."""

    particles: Annotated[Whole, Field(ge=1, lt=2**31)]  # an index of a particle has 32 bits
    resampling: Annotated[Resampling, Field()] = MULTINOMIAL.name
    estimator: str = SQUARED_ERROR.name  # see `pfdist.filters.interface`
    threshold: float = ALWAYS  # see `pfdist.kernels.schemes.threshold_of`
    prior: Prior | None = None  # in the place of `initial`
    proposal: str = PLAIN.name  # see `pfdist.filters.proposals`
    # instants: the estimate of z(t) uses measurements until t + lag; see `pfdist.kernels.lines`. A
    # tuple, (T+1,), has the lag of each instant
    lag: Lag = 0
    rule: Applied | None = None  # decides at which of the given times each draw is measured
    penalty: float | None = None  # its factor, in errors; see `pfdist.kernels.replicates`
    # particle-steps of a particle at an instant, about: more than 1 if it moves
    steps_a_particle: float = 1.0

    @property
    def moves(self) -> bool:
        """Whether lines of particles move, so that constants are learned."""
        return PROPOSALS[self.proposal].moves

    @property
    def carries(self) -> bool:
        """Whether the filter may carry weights from one measurement to the next."""
        return self.threshold < ALWAYS

    @property
    def recorded(self) -> dict[str, Any]:
        """The fields by name, without those of an evaluator, unused fields and defaults."""
        recorded = {name: value for name, value in vars(self).items() if value is not None}
        recorded.pop("prior", None)
        del recorded["lag"], recorded["steps_a_particle"]
        if not self.carries:
            del recorded["threshold"]
        if self.proposal == PLAIN.name:
            del recorded["proposal"]
        if self.rule is not None:
            recorded |= recorded.pop("rule").recorded
        return recorded

    def another(self, estimator: str, resampling: str) -> "Estimation":
        """Another estimation with as many particles, and defaults in the place of the rest."""
        return Estimation(self.particles, resampling, estimator)

    def with_truth(self, resampling: str, estimator: str) -> "Estimation":
        """The estimation by a filter that has the truth among its particles.

        No moves are known that leave the truth where it is: then the filter is the plain one.
        """
        proposal = PROPOSALS[self.proposal]
        particles = self.particles * proposal.times_beside_truth
        return Estimation(particles, resampling, estimator, proposal=proposal.beside_truth)

    @property
    def steps_an_instant(self) -> int:
        """Particle-steps of one instant, summed over all filters of the estimator."""
        steps = round(self.particles * self.steps_a_particle)
        return steps * ESTIMATORS[self.estimator].filters


def filter_streams(stream: int, estimator: str) -> list[int]:
    """Keys of the noise of each filter that an estimator needs; the first is the given key."""
    return [stream, stream_key(stream, "second filter")][: ESTIMATORS[estimator].filters]


def with_truth(particles: int, proposal: str = PLAIN.name) -> Estimation:
    """The estimation by the variance of particles, one of which is the truth.

    The expectation is at most the error of the exact filter, for any number of particles.
    """
    own = Estimation(particles, proposal=PROPOSALS[proposal].beside_truth)
    return own.with_truth(CONDITIONAL.name, FILTER_VARIANCE.name)


def control_of(given: Estimation) -> Estimation:
    """The estimation of a filter's control variate, with the truth among its particles.

    Beside a log evidence, which is a lower side, it is the upper side.
    """
    estimator = EVIDENCE if given.estimator == EVIDENCE.name else CONTROL
    return given.with_truth(CONDITIONAL.name, estimator.name)


@dataclass(frozen=True)
class FilterWork:
    """S sets of measurement times with which the same draws are filtered."""

    measurement_times: tuple[Times, ...] | ManySets
    ends: tuple[int, ...]  # (S,): last instant of each set whose error counts
    filter_streams: tuple[int, ...]  # (S,): key of each filter's noise
    draws_stream: int  # key of the draws
    draws: tuple[int, int]  # first draw, and the draw after the last
    estimation: Estimation
    trajectories: bool = False  # whether z, y and the estimates are wanted
    # (S,): the id of each set's evaluation, under which its results come back. Sums have one id for
    # all sets.
    ids: tuple[str, ...] = ()
    # (S,): If given, the errors of each set at the instants from this one to its end are wanted, as
    # sums over a block of draws. Such a work is cut into single draws or not at all, because the
    # rounding of a sum depends on its order; see `sum_of_draws`.
    since: tuple[int, ...] = ()
    # whether the filter uses the true model, whatever the evaluator's filter model is
    knows_truth: bool = False
    beside: str = ""  # an error of `filters.beside` that is wanted; empty for that of the job
    sensors: int = 1  # a time is the number of a possible measurement, t * sensors + sensor
    # whether the control variate of each error is wanted, too; the filter must know the truth
    controlled: bool = False
    # If not 0, the errors at each instant are wanted, too: of each draw, or as sums over ranges of
    # at most so many draws, a power of 2, from `variants.results`; see `ranges_of_draws`.
    over_time: int = 0
    together: int = 1  # draws whose particles a function of arrays gets in one array

    def result(self, evaluator: Any) -> "Result":
        """The result of an `Evaluator`, with arguments that the caller has checked.

        Raises `ModelError` if a formula failed.
        """
        result: Result = evaluator.filtered(self)
        return result

    def piece(self, draws: tuple[int, int], sets: Sequence[int] = ()) -> "FilterWork":
        """The same work on other draws, with all sets or only those at the given places."""
        if len(sets) in (0, len(self.measurement_times)):
            return replace(self, draws=draws)
        return replace(
            self,
            measurement_times=tuple(self.measurement_times[place] for place in sets),
            ends=tuple(self.ends[place] for place in sets),
            filter_streams=tuple(self.filter_streams[place] for place in sets),
            ids=tuple(self.ids[place] for place in sets) if self.ids else (),
            draws=draws,
        )

    def by_id(self, result: "Result", field: str = "mse") -> dict[str, NDArray[Any]]:
        """A field of the result for each set, (D,), by the id of its evaluation."""
        return dict(zip(self.ids, getattr(result, field).T, strict=True))

    @property
    def summed(self) -> bool:
        """Whether the result has sums over the draws."""
        return bool(self.since)

    @property
    def is_part_of_block(self) -> bool:
        """Whether the result has sums over fewer draws than a block."""
        return self.summed and self.draws[1] - self.draws[0] < BLOCK

    @property
    def steps_a_draw(self) -> int:
        """Particle-steps of one draw; instants that sets share count once."""
        instants = _instants(self.measurement_times, self.ends, self.filter_streams, self.sensors)
        steps = self.estimation.steps_an_instant
        if self.controlled:
            steps += control_of(self.estimation).steps_an_instant
        return instants * steps

    @property
    def steps(self) -> int:
        """Particle-steps of all draws."""
        return (self.draws[1] - self.draws[0]) * self.steps_a_draw

    def steps_of(self, result: "Result") -> int:
        """The particle-steps that a result took: of particles that move, those that were counted.

        Before, their number is a guess; see `Estimation.steps_a_particle`.
        """
        counted = int(result.work.sum())
        return (
            counted + self.steps - replace(self, controlled=False).steps if counted else self.steps
        )


def columns(streams: Sequence[int]) -> dict[int, list[int]]:
    """For each stream, the columns of the sets that use it."""
    found = dict[int, list[int]]()
    for column, stream in enumerate(streams):
        found.setdefault(stream, []).append(column)
    return found


@lru_cache(maxsize=64)
def _instants(
    sets: tuple[Times, ...] | ManySets,
    ends: tuple[int, ...],
    streams: tuple[int, ...],
    sensors: int,
) -> int:
    """The number of instants that are filtered for one draw, over all sets."""
    if len(sets) == 1:
        return ends[0] + 1
    total = 0
    for same_noise in columns(streams).values():
        stops = tuple(ends[column] + 1 for column in same_noise)
        has_all = len(same_noise) == len(sets)
        same = sets if has_all else tuple(sets[column] for column in same_noise)
        planned = plan_prefixes(same, max(stops), stops, sensors).plan
        total += int(np.sum(planned.ends - planned.begins))
    return total


@dataclass(frozen=True)
class Result:
    """The result of a `FilterWork` of D draws and S sets."""

    mse: NDArray[np.float64]  # (D, S)
    # (D, T+1, q), with trajectories; else empty
    z: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (D, T+1, m), with trajectories; else empty
    y: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (S, D, T+1, q), with trajectories; else empty
    estimates: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (S, D, T+1), with trajectories of particles; else empty. See `pfdist.filters.interface`.
    sizes: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (S, D, T+1), the same, with a lag; see `FilterArrays`
    lines: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (E,): Sums of the errors over the draws, set by set, if they are wanted; then everything else
    # is empty. NaN for each set with which a draw is infinite, or degenerate beside the truth.
    sums: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (D,): the times of each draw, if each draw has times of its own
    measurement_times: tuple[Times, ...] = ()
    # (D, S): whether each draw is degenerate with each set
    degenerate: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    # (D, S): control variate of each error, a number of expectation 0, if it is wanted; else empty.
    # 0 where the truth itself does not explain a measurement, or where a particle is infinite
    control: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (D, S, T+1): error of each draw at each instant, not weighted, less its control variate if it
    # is wanted, or (R, S, T+1): sums over ranges of draws; if they are wanted; else empty
    errors: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # particle-steps of particles that move, in parts; see `FilterArrays`
    work: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def in_ranges(self, work: FilterWork) -> "Result":
        """The same result with sums over ranges of draws, if the work wants them."""
        if not work.over_time:
            return self
        first, sums = work.draws[0], list[NDArray[np.float64]]()
        for start, draws in ranges_of_draws(*work.draws, work.over_time):
            errors = self.errors[start - first : start - first + draws]
            while len(errors) > 1:
                errors = errors[::2] + errors[1::2]
            sums.append(errors[0])
        return replace(self, errors=np.stack(sums))


def ranges_of_draws(first: int, end: int, most: int) -> list[tuple[int, int]]:
    """Cut draws into ranges, each with its first draw and its number of draws.

    The number is a power of 2 of at most `most`, and divides the first draw. A sum over a range is
    that over its first half plus that over its second. So its bits do not depend on the tasks.

    >>> ranges_of_draws(5, 24, most=8)
    [(5, 1), (6, 2), (8, 8), (16, 8)]
    """
    ranges = []
    while first < end:
        draws = min(most, first & -first or most, 1 << (end - first).bit_length() - 1)
        ranges.append((first, draws))
        first += draws
    return ranges


def whole_block(draw: int) -> tuple[int, int]:
    """The first draw of a draw's block, and the draw after its last."""
    first = draw - draw % BLOCK
    return first, first + BLOCK


def sum_of_draws(sums: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The sums over a block from those of its single draws, in order, with the same bits."""
    return reduce(np.add, sums)


def joined(results: Sequence[Result]) -> Result:
    """The result of successive ranges of draws with the same sets; sums are of single draws."""

    def all_of(name: str) -> Any:
        arrays = [getattr(result, name) for result in results]
        axis = 1 if name in ("estimates", "sizes", "lines") and arrays[0].ndim > 1 else 0
        return np.concatenate(arrays, axis)

    names = {each.name for each in fields(Result)} - {"measurement_times", "sums"}
    sums = sum_of_draws(result.sums for result in results)
    return Result(**{name: all_of(name) for name in names}, sums=sums)


def cut(draws: ArrayLike, block: int) -> list[tuple[int, int]]:
    """Ranges of consecutive draws that contain exactly the given draws: first, and after the last.

    The draws are sorted, without repetition. No range crosses a multiple of `block`.

    >>> cut([0, 1, 2, 3, 4, 7, 8], block=3)
    [(0, 3), (3, 5), (7, 9)]
    """
    index = np.asarray(draws)
    if not index.size:
        return []
    starts = np.flatnonzero((np.diff(index) > 1) | (index[1:] % block == 0)) + 1
    return [(int(piece[0]), int(piece[-1]) + 1) for piece in np.split(index, starts)]
