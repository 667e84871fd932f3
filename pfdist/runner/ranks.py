"""The test of the likelihood by the rank of the truth among the particles.

Given the cloud and y, the truth is each particle with the probability of its weight, if the
likelihood is that of the measurement's noise (`pfdist.kernels.schemes.CONDITIONAL`). So at each
measured instant, before the particles are resampled, u = (weight of the particles whose z lies
below that of the truth) + U (weight of those with the same z) is uniform on 0..1, for any number of
particles, where U is uniform. A wrong likelihood shifts the truth, or pushes it to the ends.

Each draw gives the means of u - 1/2 and of (u - 1/2)^2 - 1/12 over its instants, components and
sets. Both are bounded, so rare draws cannot reject a right model.

Source: Talts, Betancourt, Simpson, Vehtari, Gelman, "Validating Bayesian inference algorithms with
simulation-based calibration", arXiv 1804.06788, 2018.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CLEAR_ERRORS
from pfdist.common.percent import RANKS_FAIL
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork, Result, sum_of_draws
from pfdist.kernels.variates import TRUTH_RANK, variates

Array = NDArray[np.float64]

_FINDINGS = (
    ("below most particles", "above most particles"),
    (
        "in the middle of the particles, so the likelihood is too wide",
        "at the ends of the cloud of particles, so the likelihood is too narrow",
    ),
)
"""The position of the truth if a statistic is too small, and if it is too large."""


@dataclass(frozen=True)
class RankWork(FilterWork):
    """The ranks of the truth among the particles of each set, summed over draws."""

    def result(self, evaluator: Evaluator) -> Result:
        """Sums over the draws, (4,): of both statistics, and of their squares."""
        if evaluator.of_scenarios:
            return evaluator.filtered(self)  # gives each scenario its draws
        statistics = self._statistics(evaluator)
        return Result(np.empty(0), sums=sum_of_draws(np.hstack([statistics, statistics**2])))

    def _statistics(self, evaluator: Evaluator) -> Array:
        """Both statistics of each draw, (D, 2)."""
        draws = evaluator.draws(range(*self.draws), self.draws_stream)
        sets, streams, centred = self.measurement_times, self.filter_streams, list[Array]()
        each_set = evaluator.filter_each(draws, sets, streams, self.estimation)
        for times, stream, found in zip(sets, streams, each_set, strict=True):
            below, equal = found.ranks
            for t in evaluator.points.instants(times):
                for c in range(below.shape[2]):
                    index = np.array(draws.index)
                    uniform = variates("uniform", 1, stream, index, t, TRUTH_RANK, c)[:, 0]
                    centred.append(below[:, t, c] + uniform * equal[:, t, c] - 0.5)
        u = np.stack(centred, axis=1)  # so the bits of a mean do not depend on the draws beside it
        return np.stack([u.mean(axis=1), (u**2 - 1 / 12).mean(axis=1)], axis=1)


def wrong_likelihood(sums: Array, draws: int) -> str:
    """A reason why the likelihood is wrong, from sums of `RankWork`; empty if it may be right."""
    means, squares = sums.reshape(2, 2) / draws
    errors = np.sqrt(np.maximum(squares - means**2, 0.0) / (draws - 1))
    for mean, error, places in zip(means, errors, _FINDINGS, strict=True):
        if not abs(mean) <= CLEAR_ERRORS * error:
            distance = abs(mean) / error if error else math.inf
            return (
                f"{RANKS_FAIL}: the true z lies too often "
                f"{places[int(mean > 0)]} ({distance:.1f} standard errors on {draws:,} draws)"
            )
    return ""
