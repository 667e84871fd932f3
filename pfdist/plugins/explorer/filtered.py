"""Sets of times filtered on common draws: errors that are kept, and what follows from them."""

import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.changes import change_of, is_clear
from pfdist.common.component_names import Component
from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import Times
from pfdist.common.rounding import rounded
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse, exact_over_time
from pfdist.filters.work import BLOCK, Estimation
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.results.moments import Pairs
from pfdist.results.sets import typical_error
from pfdist.runner.build import Built

MOST_BYTES = 256 * 2**20  # of errors that are kept; the sets that were used last stay
_TIMED = 4  # times that the speed is measured; other programs may disturb some of them
Array = NDArray[np.float64]


class SetErrors(NamedTuple):
    """The errors of a set on the first D draws of a stream."""

    mse: NDArray[Any]  # (D,); empty with an exact engine
    degenerate: NDArray[Any]  # (D,): bool
    # (D, T+1, q): of each component of z; of an exact engine, (1, T+1, 1); of two filters empty
    at: NDArray[Any]


class FilteredSets:
    """Sets that filter the same draws under the same noise; several threads may ask.

    Parameters
    ----------
    built : Built
        The job; its own filter computes.
    stream : int
        The stream of the draws and of the filter noise.
    estimation : Estimation, optional
        By default that of the comparison.
    """

    def __init__(self, built: Built, stream: int, estimation: Estimation | None = None) -> None:
        self._built, self._stream = built, stream
        self._estimation = estimation or built.comparing
        self._evaluator = built.evaluator
        self.exact = built.evaluator.exact
        self._known, self._lock = OrderedDict[Times, SetErrors](), threading.Lock()

    @property
    def components(self) -> list[Component]:
        """The components of z; an exact engine gives only the sum of their errors."""
        components = [*self._evaluator.model.named("z")]
        is_sum = self.exact and len(components) > 1
        return [Component("", "all components")] if is_sum else components

    def seconds_a_draw(self, times: Times) -> float:
        """Measured seconds of a draw; they decide how many draws are filtered, nothing else."""
        seconds = []
        for _ in range(_TIMED):
            start = time.perf_counter()
            self._computed(times, 0, BLOCK)
            seconds.append(time.perf_counter() - start)
        return min(seconds) / BLOCK

    def errors(self, times: Times, draws: int) -> SetErrors:
        """The errors of a set on the first draws; those that are known are not computed again."""
        with self._lock:
            known = self._known.get(times)
        done = 0 if known is None else known.mse.size
        if known is None or (done < draws and not self.exact):
            more = self._computed(times, done, draws)
            both = None if known is None else zip(known, more, strict=True)
            known = more if both is None else SetErrors(*map(np.concatenate, both))
        with self._lock:
            self._known[times] = known
            self._known.move_to_end(times)
            while sum(each.at.nbytes for each in self._known.values()) > MOST_BYTES:
                self._known.popitem(last=False)
        return SetErrors(*(each[:draws] for each in known))

    def _computed(self, times: Times, first: int, end: int) -> SetErrors:
        evaluator = self._evaluator
        exact = exact_over_time(evaluator, times, self._built.job.criterion)
        if exact is not None:
            return SetErrors(np.empty(0), np.empty(0, np.bool_), exact[..., None])
        draws = (first, end)
        work = evaluator.work([times], self._stream, self._stream, draws, self._estimation)
        if self._estimation.estimator != SQUARED_ERROR.name:  # an error without trajectories
            result = evaluator.filtered(work)
            return SetErrors(result.mse[:, 0], result.degenerate[:, 0], np.empty(0))
        result = evaluator.filtered(replace(work, trajectories=True))
        deviation = result.estimates[0] - result.z
        at = np.where(evaluator.model.is_angle, 1.0 - np.cos(deviation), deviation**2)
        return SetErrors(result.mse[:, 0], result.degenerate[:, 0], at)

    def evaluations(self, sets: Sequence[Times], draws: int) -> list[Evaluation]:
        """The evaluations of sets on the first draws, of which nothing is kept."""
        if self.exact:
            return [self.evaluation(times, self._computed(times, 0, draws)) for times in sets]
        work = self._evaluator.work(sets, self._stream, self._stream, (0, draws), self._estimation)
        result = self._evaluator.filtered(work)
        found = zip(result.mse.T, result.degenerate.T, strict=True)
        return [
            self.evaluation(times, SetErrors(*each, np.empty(0)))
            for times, each in zip(sets, found, strict=True)
        ]

    def evaluation(self, times: Times, errors: SetErrors) -> Evaluation:
        """The evaluation of a set from its errors on these draws."""
        criterion = self._built.job.criterion
        exact = exact_mse(self._evaluator, [times], criterion=criterion)
        return Evaluation(
            times,
            errors.mse,
            scenarios=self._evaluator.scenarios_of(self._stream, range(errors.mse.size)),
            criterion=criterion if exact is None else criterion.exactly(float(exact[0])),
            degenerate=errors.degenerate,
        )

    def curves(self, evaluation: Evaluation, errors: SetErrors) -> Array:
        """The typical error at each instant, (T+1, q), in the unit of z."""
        return self._typical(self._mean(evaluation, errors))

    def typical(self, evaluation: Evaluation, errors: SetErrors) -> str:
        """The typical error of each component of z over all instants, in words."""
        mean = self._mean(evaluation, errors)
        typical = self._typical(np.average(mean, axis=0, weights=self._evaluator.weights))
        typical[np.isinf(typical)] = np.nan  # of an angle of which nothing is known
        parts, angles = self.components, self._evaluator.model.is_angle
        names = [each.name or f"z{each.suffix}" for each in parts] if len(parts) > 1 else [""]
        return ", ".join(
            f"{name} {rounded(error, 3)} {each.unit or 'rad' * is_angle}".strip()
            for name, each, error, is_angle in zip(names, parts, typical, angles, strict=False)
        )

    def _mean(self, evaluation: Evaluation, errors: SetErrors) -> Array:
        """The mean error at each instant, (T+1, q), over the draws that decide."""
        mean: Array = errors.at[evaluation.criterion.deciding(evaluation)].mean(axis=0)
        return mean

    def _typical(self, errors: Array) -> Array:
        angles = False if self.exact else self._evaluator.model.is_angle
        typical: Array = np.vectorize(typical_error)(errors, angles)
        return typical


class Change(NamedTuple):
    """The gain of a set over another, and the difference of both errors, on the same draws.

    The draws count that decide. If other draws decide for each set, the gain has no interval.
    """

    gain: float  # by which share of the other expected MSE that of the set is lower
    errors: Pairs
    draws: int  # 0: exact
    difference: Estimate

    @classmethod
    def between(cls, evaluation: Evaluation, other: Evaluation) -> "Change":
        """The gain of an evaluation over another."""
        gain, errors = 1.0 - evaluation.expected_mse / other.expected_mse, Pairs()
        both = evaluation.criterion.common(evaluation, other)
        if both is not None:
            errors.add(evaluation.mse[both], other.mse[both])
        return cls(gain, errors, evaluation.draws, evaluation.difference(other))

    @property
    def ratio(self) -> Estimate:
        """The expected MSE of the set over that of the other."""
        return Estimate(1.0 - self.gain, self.errors.ratio_error if self.draws else 0.0)

    def interval(self, confidence: float = CONFIDENCE) -> tuple[float | None, float | None]:
        """The interval of the gain, by Fieller's theorem; None where it is unknown."""
        if not self.draws:
            return self.gain, self.gain
        low, high = self.errors.ratio_interval(confidence)
        return (1.0 - high, 1.0 - low) if np.isfinite(high - low) else (None, None)

    def text(self, confidence: float = CONFIDENCE) -> str:
        """The gain in words, with its interval, and the difference with its standard error."""
        interval, sign = self.interval(confidence), -1.0 if self.gain >= 0 else 1.0
        unclear = "" if is_clear(interval) else "no clear difference: "
        return f"{unclear}{change_of(self.gain, interval)}, by {self.difference.times(sign).text}"
