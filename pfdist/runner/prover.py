"""The filters behind a lower bound: the relaxation, its guard, and the sets alone."""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pfdist.analysis import Moments, Run
from pfdist.bounds.gap import UNKNOWN, Gap, contradiction
from pfdist.bounds.proof import Estimate, Proof, falls, prove
from pfdist.bounds.relaxation import Relaxation
from pfdist.errors import JobError, ModelError
from pfdist.evaluation.estimate import BOUND
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation, Work
from pfdist.kernels.estimators import FILTER_VARIANCE
from pfdist.runner.build import Built
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.progress import Reporter
from pfdist.times.constraints import Constraints
from pfdist.times.measurement_times import Times, validated

BLOCK = 24
"""Draws whose errors are added up by themselves; a figure never depends on how they are shared."""
GROUPS = 20
"""Groups of blocks; the jackknife leaves one group out."""
MOST_CELLS = 3_000_000
"""States of the relaxation times instants: the memory of a bound grows with them."""
SET_DRAWS = 20_000
"""Draws on which a set alone is filtered, by its squared error and by its variance."""
_MEAN_GAPS = 4  # the longest gap of the relaxation, in mean gaps
_FINER = 4  # times the particles, for the guard
_GUARDED = 10  # groups of draws that the guard filters again
_TOLERATED = 0.005  # fall of a variance with more particles

Array = NDArray[np.float64]


class Prover:
    """Proves the gaps of a run's sets.

    Parameters
    ----------
    run : Run
        A finished run.
    built : Built
        Its job, built again.
    draws : int
    particles : int or None
        None: as many as the job's filter has.
    window : int
    reporter : Reporter

    Attributes
    ----------
    relaxation : Relaxation
    particles, draws : int
        Settings of the bound's filter; 0 where the engine is exact.

    Raises
    ------
    JobError, ModelError
        No bound is known for the job's problem, or its relaxation is too large.
    """

    def __init__(
        self,
        run: Run,
        built: Built,
        draws: int,
        particles: int | None,
        window: int,
        reporter: Reporter,
    ) -> None:
        self._run, self._built = run, built
        rows, horizon = run.compared(), built.problem.horizon
        self._sets = {
            str(name): validated([int(t) for t in times], horizon, f"{run.path}: {name}")
            for name, times in zip(rows["name"], rows["measurement_times"], strict=True)
        }
        constraints = built.job.problem.feasible
        if not constraints.counted:
            raise JobError(
                f"{run.path}: measurements have costs, and no lower bound is known for them yet"
            )
        self._feasible = {
            name: times for name, times in self._sets.items() if _satisfies(constraints, times)
        }
        if not self._feasible:
            raise JobError(f"{run.path}: no compared set satisfies the constraints of the job")
        self.relaxation = _relaxation(constraints, window, self._feasible.values())
        self._most = max(map(len, self._feasible.values()))
        # The relaxation filters with the truth's model: a bound for the filter of any model.
        self._truth: Problem = replace(built.problem, filter_model=None)
        count = particles or built.job.filter.particles
        self._estimation = Estimation(count, "systematic", FILTER_VARIANCE.name)
        if not built.problem.exact:
            self._truth.check(self._estimation)
        self._blocks = 0 if built.problem.exact else math.ceil(draws / BLOCK)
        self.particles = self._estimation.particles if self._blocks else 0
        self.draws = self._blocks * BLOCK
        self._reporter = reporter

    def gaps(self) -> list[Gap]:
        """Give the gap of each compared set.

        Raises
        ------
        ModelError
            A draw is degenerate in the relaxation, or a formula failed.
        """
        relaxation, known = self.relaxation, list(self._feasible.values())
        sums, draws = self._sums("lower bound", self._estimation, GROUPS)
        proof = prove(relaxation, sums, draws, known, self._most)
        gaps = {
            name: self._gap(name, times, proof, slack)
            for (name, times), slack in zip(self._feasible.items(), proof.slack, strict=True)
        }
        if self._blocks:
            gaps = self._guarded(gaps, sums[:_GUARDED], draws[:_GUARDED])
        strangers = {
            name: Gap(name, times, self._mse(name, times)[0], "the set is not feasible")
            for name, times in self._sets.items()
            if name not in gaps
        }
        return [(gaps | strangers)[name] for name in self._sets]

    def _sums(self, phase: str, estimation: Estimation, groups: int) -> tuple[Array, Array]:
        """Sum the errors of all states and feasible sets over the first groups of draws.

        Raises
        ------
        ModelError
            A draw is degenerate.
        """
        relaxation, known = self.relaxation, tuple(self._feasible.values())
        sets, horizon = (*relaxation.sets, *known), self._truth.horizon
        if not self._blocks:
            return self._truth.expected_errors(sets)[None], np.ones(1)
        seed, sums = self._built.job.seed, np.zeros((groups, len(sets), horizon + 1))
        self._reporter.begin(phase)
        start, draws = self._reporter.progress.done, np.zeros(groups)
        for block in range(self._blocks):
            if (group := block % GROUPS) >= groups:
                continue
            work = Work(
                measurement_times=sets,
                ends=(*relaxation.ends, *(horizon,) * len(known)),
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
            sums[group] += errors
            draws[group] += BLOCK
            share = 0.3 * groups / GROUPS * estimation.particles / self._estimation.particles
            done = start + share * (block + 1) / self._blocks
            self._reporter.reach(done, evaluations=int(draws.sum()))
        return sums, draws

    def _gap(self, name: str, times: Times, proof: Proof, slack: Estimate) -> Gap:
        """Give the gap of a feasible set, before the guard has looked at it."""
        mse, estimate, filter_model, both = self._mse(name, times)
        if not math.isfinite(mse.value):
            return Gap(name, times, mse, "a draw is degenerate or infinite with the set itself")
        total = slack.plus(both)
        scale = 1 / mse.value if mse.value > 0 else 0.0
        at_most = total.at_most(max(1, proof.groups - 1))
        return Gap(
            name,
            times,
            mse,
            "the set costs less than the bound" if at_most < 0 and proof.groups else "",
            proof.bounds[len(times)],
            proof.paths[len(times)],
            max(0.0, total.value * scale),
            max(0.0, at_most * scale),
            slack,
            estimate,
            filter_model,
        )

    def _mse(self, name: str, times: Times) -> tuple[Estimate, Estimate, Estimate, Estimate]:
        """Expected MSE; particles and estimate, the filter's model, and both parts together.

        All are NaN if a draw is degenerate or infinite.
        """
        problem, truth, zero = self._built.problem, self._truth, Estimate(0.0)
        if not self._blocks:
            return Estimate(float(problem.expected_mse([times])[0])), zero, zero, zero
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
            if not np.isfinite(squared + by_truth + variance).all():
                return UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN
            parts = (squared, by_truth - variance, squared - by_truth, squared - variance)
            for moment, values in zip(moments, parts, strict=True):
                moment.add(values)
        mse, estimate, filter_model, both = (
            Estimate(moment.mean, moment.standard_error) for moment in moments
        )
        return mse, estimate, filter_model, both

    def _guarded(self, gaps: dict[str, Gap], sums: Array, draws: Array) -> dict[str, Gap]:
        """Withdraw bounds that more particles, or known sets, contradict."""
        finer = replace(self._estimation, particles=_FINER * self._estimation.particles)
        fine, _ = self._sums("guard of the bound", finer, _GUARDED)
        of_bounds, of_sets = falls(self.relaxation, sums, fine, draws, self._most)
        with_more = f"{finer.particles} particles in the place of {self._estimation.particles}"
        if any(gap.estimate.is_negative for gap in gaps.values()):
            everywhere = "the variance of the particles exceeds their squared error"
        elif any(fall.is_positive and fall.value > _TOLERATED for fall in of_sets):
            everywhere = f"the variance of a compared set falls with {with_more}"
        else:
            everywhere = ""
        checked = {}
        for name, gap in gaps.items():
            number = len(gap.measurement_times)
            fall = of_bounds[number]
            reason = gap.reason or everywhere
            if not reason and fall.is_positive and fall.value > _TOLERATED:
                reason = f"the bound falls by {100 * fall.value:.2g} % with {with_more}"
            if not reason:
                reason = contradiction(gap, gaps)
            if reason:
                checked[name] = Gap(name, gap.measurement_times, gap.expected_mse, reason)
            else:
                at_most = gap.gap_at_most + max(0.0, fall.value)
                checked[name] = replace(gap, gap_at_most=at_most)
        return checked


def _satisfies(constraints: Constraints, times: Times) -> bool:
    """Whether times satisfy all constraints but that on their number."""
    return constraints.compatible(times) and set(constraints.required).issubset(times)


def _relaxation(constraints: Constraints, window: int, sets: Iterable[Times]) -> Relaxation:
    """Give the relaxation for sets of typically so many times.

    Raises
    ------
    JobError
        It has more states than fit into memory.
    """
    sizes, instants = sorted(map(len, sets)), constraints.horizon + 1
    longest_gap = math.ceil(_MEAN_GAPS * instants / (sizes[len(sizes) // 2] + 1))
    longest_gap = min(longest_gap, instants)
    if instants**2 * longest_gap ** (window - 1) > MOST_CELLS:
        raise JobError(
            f"window = {window} needs about {instants * longest_gap ** (window - 1):,} states of "
            f"{instants} instants, allowed: {MOST_CELLS:,} in all; take a smaller window",
            argument="window",
        )
    return Relaxation(constraints, window, longest_gap)
