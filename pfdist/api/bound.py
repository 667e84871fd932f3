"""A lower bound of the expected MSE of every feasible set, and the gap of a run's sets."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.analysis import Moments, Run, finite
from pfdist.api.finished_run import built_again, finished_run
from pfdist.bounds.proof import Known, Proof, paired, prove
from pfdist.bounds.relaxation import Relaxation
from pfdist.errors import JobError, ModelError, shown
from pfdist.evaluation.estimate import BOUND
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation, Work
from pfdist.kernels.estimators import FILTER_VARIANCE
from pfdist.runner.build import Built
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.progress import Report, Reporter
from pfdist.times.measurement_times import Times, validated

DRAWS, WINDOW = 1920, 2
BLOCK = 24
"""Draws whose errors are added up by themselves; a figure never depends on how they are shared."""
GROUPS = 40
LEAST_DRAWS = 20 * BLOCK  # the jackknife wants 20 groups
MOST_DRAWS = 10_000_000
MOST_WINDOW = 6  # the number of states grows as the longest gap to this power
SET_DRAWS = 20_000
"""Draws on which a set alone is filtered, by its squared error and by its variance."""
_MEAN_GAPS = 4  # the longest gap of the relaxation, in mean gaps
_FINER = 4  # times the particles, for the guard
_APART, _TOO_LOW = 4.0, 0.005  # standard errors, and a fraction: what the guard tolerates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gap:
    """How much lower the expected MSE of other times can be, for one set of a run.

    Parameters
    ----------
    name : str
    measurement_times : tuple of int
    expected_mse : Known
        With the job's own filter, on draws that neither chose the set nor gave the bound.
    bound : Known
        Lower bound of the expected MSE of every feasible set of so many times, by any filter.
    path : tuple of int
        The times that reach the bound in the relaxation.
    gap : float
        1 - bound / expected_mse.
    gap_at_most : float
        One-sided 95 % limit of the gap.
    relaxation, estimate, filter_model : Known
        The parts of the difference: relaxation and chance; number of particles and bias of the
        estimate; wrong model of the filter.
    reason : str
        Why there is no bound; else empty, as the bound holds.
    """

    name: str
    measurement_times: Times
    expected_mse: Known
    bound: Known
    path: Times
    gap: float
    gap_at_most: float
    relaxation: Known
    estimate: Known
    filter_model: Known
    reason: str = ""


@dataclass(frozen=True)
class Bound:
    """Result of `bound`.

    Parameters
    ----------
    run : Path
    window, longest_gap : int
        Settings of the relaxation.
    particles, draws : int
        Settings of the bound's filter; 0 where the engine is exact.
    gaps : list of Gap
        One for each compared set of the run.
    """

    run: Path
    window: int
    longest_gap: int
    particles: int
    draws: int
    gaps: list[Gap]

    def as_json(self) -> dict[str, Any]:
        """The whole result as JSON values; an unknown value is None."""
        sets = {}
        for gap in self.gaps:
            row: dict[str, Any] = {}
            for key, value in vars(gap).items():
                if isinstance(value, Known):
                    row |= {key: value.value, f"{key}_error": value.standard_error}
                elif key != "name":
                    row[key] = list(value) if isinstance(value, tuple) else value
            sets[gap.name] = row
        own = {key: value for key, value in vars(self).items() if key not in ("run", "gaps")}
        answer: dict[str, Any] = finite({"run": str(self.run), **own, "sets": sets})
        return answer

    def as_frame(self) -> pd.DataFrame:
        """A row for each set, with the columns of `as_json`."""
        rows = self.as_json()["sets"]
        return pd.DataFrame([{"name": name, **row} for name, row in rows.items()])


def bound(
    run: str | Path,
    draws: int = DRAWS,
    *,
    particles: int | None = None,
    window: int = WINDOW,
    model: str = "",
    filter_model: str = "",
    report: Report = lambda progress: None,
    say: Callable[[str], Any] = lambda line: None,
) -> Bound:
    """Prove how much lower the expected MSE of any other feasible times can be.

    The function runs the model, on draws that neither chose the times nor compared them. It runs a
    model file that the run's folder names only if the file is unchanged since the run, and if the
    user has run the file on this machine before.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run.
    draws : int
        Number of draws of the bound, computed in this process. With more draws the bound is
        higher, because the least of many noisy costs is too low.
    particles : int, optional
        Number of particles of the bound's filter; by default that of the job's filter.
    window : int
        Number of last measurements that the relaxation keeps. A larger window gives a higher
        bound, and takes several times as long.
    model, filter_model : str, optional
        ``path/file.py:object``: replaces the file that the run names for the model or for the
        filter's model. It is run without question, and must mean the same as the run's model.
    report : callable, optional
        Receives the progress.
    say : callable, optional
        Receives a line for each model file before the file is run.

    Returns
    -------
    Bound

    Raises
    ------
    StoreError
        The folder holds no finished run, or the model has changed since, or the run names a model
        file that is not run without the user's word.
    JobError, ModelError
        An argument is out of its range; the measurements of the job have costs; the model defines
        an error of its own; or the model cannot be loaded.
    """
    for name, value, least, most in (
        ("draws", draws, LEAST_DRAWS, MOST_DRAWS),
        ("particles", 1 if particles is None else particles, 1, 10**9),
        ("window", window, 1, MOST_WINDOW),
    ):
        if not least <= value <= most:
            raise JobError(
                f"{name} must be {least:,} to {most:,}, got {shown(value)}", argument=name
            )
    opened = finished_run(run)
    built = built_again(opened, {"model": model, "filter_model": filter_model}, say)
    return _Prover(opened, built, draws, particles, window, report).prove()


class _Prover:
    """Computes a `Bound`; the parameters are those of `bound`."""

    def __init__(
        self,
        run: Run,
        built: Built,
        draws: int,
        particles: int | None,
        window: int,
        report: Report,
    ) -> None:
        self._run, self._built = run, built
        rows, horizon = run.compared(), built.problem.horizon
        self._sets = {
            str(name): validated([int(t) for t in times], horizon, f"{run.path}: {name}")
            for name, times in zip(rows["name"], rows["measurement_times"], strict=True)
        }
        constraints, sizes = built.job.problem.feasible, [len(s) for s in self._sets.values()]
        if not constraints.counted:
            raise JobError(
                f"{run.path}: measurements have costs, and no lower bound is known for them yet"
            )
        gap = math.ceil(_MEAN_GAPS * (horizon + 1) / (min(sizes) + 1))
        self._relaxation = Relaxation(constraints, window, min(gap, horizon + 1))
        self._most = max(sizes)
        # The relaxation filters with the truth's model: a bound for the filter of any model.
        self._truth: Problem = replace(built.problem, filter_model=None)
        count = particles or built.job.filter.particles
        self._estimation = Estimation(count, "systematic", FILTER_VARIANCE.name)
        if not built.problem.exact:
            self._truth.check(self._estimation)
        self._blocks = 0 if built.problem.exact else math.ceil(draws / BLOCK)
        self._reporter = Reporter(report, 1.0)

    def prove(self) -> Bound:
        """Compute everything."""
        relaxation, known = self._relaxation, list(self._sets.values())
        sets, ends = [*relaxation.sets, *known], [*relaxation.ends, *self._whole(known)]
        sums, draws = self._sums("lower bound", sets, ends, self._estimation)
        proof = prove(relaxation, sums, draws, known, self._most)
        gaps = [
            self._gap(name, times, proof, proof.slack[number])
            for number, (name, times) in enumerate(self._sets.items())
        ]
        if self._blocks:
            gaps = self._guarded(gaps, sums, draws)
        return Bound(
            self._run.path,
            relaxation.window,
            relaxation.longest_gap,
            self._estimation.particles if self._blocks else 0,
            self._blocks * BLOCK,
            gaps,
        )

    def _whole(self, sets: Sequence[Times]) -> list[int]:
        return [self._truth.horizon] * len(sets)

    def _sums(
        self, phase: str, sets: Sequence[Times], ends: Sequence[int], estimation: Estimation
    ) -> tuple[Array, Array]:
        """Sums of the errors of each set over groups of draws, and the draws of each group.

        Raises
        ------
        ModelError
            A draw is degenerate.
        """
        if not self._blocks:
            return self._truth.expected_errors(sets)[None], np.ones(1)
        seed, groups = self._built.job.seed, min(GROUPS, self._blocks)
        sums = np.zeros((groups, len(sets), self._truth.horizon + 1))
        self._reporter.begin(phase)
        start = self._reporter.progress.done
        for block in range(self._blocks):
            work = Work(
                measurement_times=tuple(sets),
                ends=tuple(ends),
                filter_streams=(BOUND.stream(seed, "filter"),) * len(sets),
                draws_stream=BOUND.stream(seed, "draws"),
                draws=(block * BLOCK, (block + 1) * BLOCK),
                estimation=estimation,
            )
            errors = self._truth.sum_errors(work)
            if not np.isfinite(errors[0, 0]):
                raise ModelError(
                    f"{self._run.path}: there is no lower bound, because a draw is degenerate or "
                    f"infinite with {estimation.particles} particles of the true model; more "
                    "particles may help"
                )
            sums[block % groups] += errors
            share = 0.45 * (block + 1) / self._blocks
            self._reporter.reach(start + share, evaluations=(block + 1) * BLOCK)
        counts = np.bincount(np.arange(self._blocks) % groups).astype(np.float64) * BLOCK
        return sums, counts

    def _gap(self, name: str, times: Times, proof: Proof, slack: Known) -> Gap:
        number = len(times)
        mse, estimate, filter_model, both = self._of_set(name, times)
        total = slack.plus(both)
        at_most = total.at_most(max(1, proof.groups - 1))
        return Gap(
            name,
            times,
            mse,
            proof.bounds[number],
            proof.paths[number],
            total.value / mse.value,
            at_most / mse.value,
            slack,
            estimate,
            filter_model,
        )

    def _of_set(self, name: str, times: Times) -> tuple[Known, Known, Known, Known]:
        """Expected MSE; particles and estimate, the filter's model, and both parts together."""
        problem, truth = self._built.problem, self._truth
        if not self._blocks:
            return (
                Known(float(problem.expected_mse([times])[0])),
                Known(0.0),
                Known(0.0),
                Known(0.0),
            )
        moments, seed = [Moments() for _ in range(4)], self._built.job.seed
        work = Work(
            measurement_times=(times,),
            ends=(truth.horizon,),
            filter_streams=(BOUND.stream(seed, "filter", name),),
            draws_stream=BOUND.stream(seed, "draws of a set"),
            draws=(0, SET_DRAWS),
            estimation=self._built.comparing,
        )
        for piece in problem.pieces(work, MOST_SECONDS):
            squared = problem.filtered(piece).mse[:, 0]
            knows_the_truth = problem.believed == truth.model
            by_truth = squared if knows_the_truth else truth.filtered(piece).mse[:, 0]
            variance = truth.filtered(replace(piece, estimation=self._estimation)).mse[:, 0]
            parts = (squared, by_truth - variance, squared - by_truth, squared - variance)
            for moment, values in zip(moments, parts, strict=True):
                moment.add(values[~np.isnan(values)])
        mse, estimate, filter_model, both = (
            Known(moment.mean, moment.standard_error) for moment in moments
        )
        return mse, estimate, filter_model, both

    def _guarded(self, gaps: list[Gap], sums: Array, draws: Array) -> list[Gap]:
        """Withdraw bounds that more particles, or known sets, contradict."""
        relaxation = self._relaxation
        paths = list(dict.fromkeys(gap.path for gap in gaps))
        visited = list(
            dict.fromkeys(state for path in paths for state in relaxation.states_of(path))
        )
        places = [relaxation.index[state] for state in visited]
        known = list(self._sets.values())
        sets = [relaxation.sets[place] for place in places] + known
        ends = [relaxation.ends[place] for place in places] + self._whole(known)
        finer = replace(self._estimation, particles=_FINER * self._estimation.particles)
        finer_sums, _ = self._sums("guard of the bound", sets, ends, finer)
        instants = range(relaxation.horizon + 1)
        checked = []
        for number, gap in enumerate(gaps):
            states = relaxation.states_of(gap.path)
            at = [relaxation.index[state] for state in states]
            at_finer = [visited.index(state) for state in states]
            pairs = {
                "the relaxed filter": (
                    sums[:, at, instants].sum(axis=1),
                    finer_sums[:, at_finer, instants].sum(axis=1),
                ),
                "the set's own filter": (
                    sums[:, len(relaxation.states) + number].sum(axis=1),
                    finer_sums[:, len(visited) + number].sum(axis=1),
                ),
            }
            reason = next(
                (
                    f"the variance of {who} is {shrunk:.2g} % lower with {finer.particles} "
                    f"particles than with {self._estimation.particles}"
                    for who, (coarse, fine) in pairs.items()
                    if (shrunk := _shrunk(coarse, fine, draws)) > 0
                ),
                "",
            )
            checked.append(replace(gap, reason=reason or self._contradiction(gap, gaps)))
        return checked

    @staticmethod
    def _contradiction(gap: Gap, gaps: list[Gap]) -> str:
        """Say which known set of as many times costs less than the bound; empty if none does."""
        for other in gaps:
            error = math.hypot(other.expected_mse.standard_error, gap.bound.standard_error)
            low = other.expected_mse.value + _APART * error
            if len(other.path) == len(gap.path) and low < gap.bound.value:
                return f"the set {other.name} costs less than the bound"
        return ""


def _shrunk(coarse: Array, fine: Array, draws: Array) -> float:
    """Per cent by which more particles lower a variance; 0 if that is tolerated."""
    difference, whole = paired(coarse, fine, draws), coarse.sum() / draws.sum()
    fraction = difference.value / whole if whole else 0.0
    clear = difference.value > _APART * difference.standard_error
    return 100 * fraction if clear and fraction > _TOO_LOW else 0.0
