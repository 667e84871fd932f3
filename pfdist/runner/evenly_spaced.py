"""The number of evenly spaced measurements with the plan's error: a quick estimate."""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np
import pyarrow as pa

from pfdist.common.estimate import Estimate
from pfdist.common.streams import stream_of
from pfdist.filters.work import FilterWork, Result
from pfdist.results import Run
from pfdist.results.evenly_spaced import sign_of
from pfdist.results.moments import controlled_mse
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.store import EVEN_PHASE, schema

DRAWS = 1000  # at most: the first of the comparison
_MOST = 24  # numbers that are tried


def is_known(built: Built) -> bool:
    """Whether a run has a single plan, and any number of its measurements can be evenly spaced."""
    problem, is_alone = built.job.problem, len(built.searches) == 1 and built.job.budget is None
    is_alone = is_alone and not built.job.comparison.is_even  # other numbers are regular times
    is_free = problem.feasible.counted and not problem.is_constrained
    return is_alone and is_free and problem.points.ways == 1 and built.job.criterion.additive


def compare_evenly_spaced(session: RunSession, run: Run) -> Generator[WorkBatch, None, None]:
    """Find the numbers with about the error of the plan, and write the table ``evenly_spaced``.

    Bisection finds the number at which the error crosses that of the plan, as if the error fell
    with each measurement. From there, numbers on both sides are tried until one differs clearly.
    Each set has independent filter noise. Nothing is written if too many numbers do not differ.
    """
    built = session.built
    tried = _Tried(session, run, measured_of(run)[built.searches[0].name])
    worse, better = 0, built.feasible.horizon + 1  # no measurement, and one at every instant
    number = built.feasible.measurements
    session.reporter.begin("evenly spaced times")
    while better - worse > 1:
        difference = yield from tried.difference(number)
        worse, better = (number, better) if difference.value > 0.0 else (worse, number)
        number = (worse + better) // 2
    for first, step in ((worse, -1), (better, 1)):
        number = first
        while 0 < number <= built.feasible.horizon + 1:
            difference = yield from tried.difference(number)
            if sign_of(difference):
                break
            if len(tried) >= _MOST or not math.isfinite(difference.value):
                return
            number += step
    session.store.renew("evenly_spaced", EVEN_PHASE, tried.rows())


class _Tried:
    """The evenly spaced times that were tried, and how far their error lies above the plan's."""

    def __init__(self, session: RunSession, run: Run, plan: tuple[int, ...]) -> None:
        self._session, self._plan = session, plan
        self._draws = min(DRAWS, run.draws_compared)
        self._name = session.built.searches[0].name
        self._differences = dict[int, Estimate]()
        self._is_exact = session.built.evaluator.expected_mse([plan]) is not None
        self._errors = controlled_mse(run.table("comparison", self._draws), self._name)

    def __len__(self) -> int:
        return len(self._differences)

    def difference(self, number: int) -> Generator[WorkBatch, None, Estimate]:
        """The expected MSE of so many evenly spaced measurements, less that of the plan."""
        if number not in self._differences:
            self._differences[number] = yield from self._computed(number)
        return self._differences[number]

    def rows(self) -> pa.Table:
        """Rows of the table ``evenly_spaced``."""
        rows = [
            {
                "measurements": number,
                "measurement_times": self._times(number),
                "draws": 0 if self._is_exact else self._draws,
                "difference": difference.value,
                "difference_error": difference.standard_error,
            }
            for number, difference in sorted(self._differences.items())
        ]
        return pa.Table.from_pylist(rows, schema=schema("evenly_spaced"))

    def _times(self, number: int) -> tuple[int, ...]:
        return self._session.built.job.feasible(number).regular()

    def _computed(self, number: int) -> Generator[WorkBatch, None, Estimate]:
        built, times = self._session.built, self._times(number)
        exact = built.evaluator.expected_mse([times, self._plan])
        if exact is not None:
            return Estimate(float(exact[0] - exact[1]))
        seed, purpose = built.job.seed, built.study.purpose
        work = built.evaluator.work(
            [times],
            stream_of(purpose, seed, "filter", f"evenly spaced {number}"),
            stream_of(purpose, seed, "draws"),
            (0, self._draws),
            built.comparing,
        )
        even = np.empty(self._draws)

        def learn(piece: FilterWork, result: Result) -> None:
            errors = result.mse - result.control if piece.controlled else result.mse
            even[slice(*piece.draws)] = errors[:, 0]

        works = [replace(work, controlled=bool(built.job.comparison.control))]
        yield WorkBatch(self._session, EVEN_PHASE, works, None, learn)
        difference = even - self._errors
        return Estimate.of_mean(difference[~np.isnan(difference)])
