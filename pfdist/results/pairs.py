"""Pairs of compared sets on the same draws, and the ranks that follow from all pairs.

References
----------
Wilson, "Probable inference, the law of succession, and statistical inference", 1927. Mogstad,
Romano, Shaikh, Wilhelm, "Inference for ranks with applications to mobility across neighbourhoods
and academic achievement across countries", Review of Economic Studies 91, 2024 (intervals of ranks
from simultaneous intervals of all differences; here Bonferroni's).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.common.estimate import CONFIDENCE, wilson_interval
from pfdist.results.moments import Array, Moments, Pairs, columns_of
from pfdist.results.stored_run import StoredRun, errors_of, exact_errors, statistics_of

if TYPE_CHECKING:
    import pandas as pd

_ROUNDING = 1e-12  # relative difference of two exact expected MSEs that counts as none
PAIR_COLUMNS = (
    "first", "second", "draws", "difference", "low", "high", "simultaneous_low",
    "simultaneous_high", "clear", "gain_of_means", "gain_of_means_low", "gain_of_means_high",
    "first_wins", "first_wins_low", "first_wins_high",
)  # fmt: skip
RANK_COLUMNS = (
    "name", "expected_mse", "standard_error", "best_rank", "worst_rank", "difference", "low", "high"
)  # fmt: skip


@dataclass
class Pair:
    """Statistics of the errors of two sets on the same draws, which are added block by block.

    Parameters
    ----------
    difference : Moments
        Moments of the first error less the second; each of them less its control, if it has one.
    errors : Pairs
        Moments of the first error (x) and the second (y), also less their controls.
    first_wins : int
        Number of draws in which the first error is the lower.
    """

    difference: Moments = field(default_factory=Moments)
    errors: Pairs = field(default_factory=Pairs)
    first_wins: int = 0

    def add(
        self, first: Array, second: Array, controlled: tuple[Array, Array] | None = None
    ) -> None:
        """Add a block of draws; the same blocks in the same order give the same bits.

        Parameters
        ----------
        first, second : array of float64, (D,)
            Per-draw MSE of both sets on the same draws.
        controlled : pair of such arrays, optional
            Both less their controls.
        """
        self.errors.has_control = controlled is not None
        x, y = controlled or (first, second)
        with np.errstate(invalid="ignore"):  # infinite errors have no difference
            self.difference.add(x - y)
        self.errors.add(x, y)
        self.first_wins += int(np.sum(first < second))

    def columns(self, confidence: float, exact: tuple[float, float] | None) -> dict[str, Any]:
        """The columns of `PAIR_COLUMNS` without the names.

        Parameters
        ----------
        confidence : float
            Confidence of the columns ``simultaneous_low`` and ``simultaneous_high``, with which the
            intervals of all pairs hold together with 95 %.
        exact : (float, float) or None
            Both expected MSEs, if the engine is exact. Then the difference and the gain of means
            are exact, and their limits are equal.
        """
        found = self.difference.estimate
        difference, interval, together = found.value, found.interval(), found.interval(confidence)
        mean, other_mean = exact or (self.errors.x.mean, self.errors.y.mean)
        ratio = mean / other_mean if other_mean and not self.errors.too_few else math.nan
        ratio_interval = self.errors.ratio_interval()
        if exact is not None:
            difference = exact[0] - exact[1]
            if abs(difference) <= _ROUNDING * max(map(abs, exact)):
                difference = 0.0
            interval = together = (difference, difference)
            ratio_interval = (ratio, ratio)
        count = self.difference.count
        wins = (
            self.first_wins / count if count else math.nan,
            *wilson_interval(self.first_wins, count),
        )
        values = (
            count, difference, *interval, *together, together[0] > 0.0 or together[1] < 0.0,
            1.0 - ratio, 1.0 - ratio_interval[1], 1.0 - ratio_interval[0], *wins,
        )  # fmt: skip
        return dict(zip(PAIR_COLUMNS[2:], values, strict=True))


def pairs_table(
    names: Sequence[str], blocks: Iterable[Array], exact: Mapping[str, float]
) -> pd.DataFrame:
    """A row for each pair of sets, with the columns of the table ``pairs``.

    Parameters
    ----------
    names : sequence of str
        Names of S sets.
    blocks : iterable of arrays of float64, (D, S) or (D, 2 S)
        Per-draw MSE of each set, then its control if there is one, block by block.
    exact : mapping of str to float
        Expected MSEs of an exact engine, by the name of the set.
    """
    pairs = {places: Pair() for places in combinations(range(len(names)), 2)}
    for block in blocks:
        mse, controlled = columns_of(block, len(names))
        for (place, other), pair in pairs.items():
            both = None if controlled is mse else (controlled[place], controlled[other])
            pair.add(mse[place], mse[other], both)
    confidence = 1.0 - (1.0 - CONFIDENCE) / max(1, len(pairs))  # Bonferroni
    rows = []
    for places, pair in pairs.items():
        first, second = (names[place] for place in places)
        exact_pair = (exact[first], exact[second]) if first in exact and second in exact else None
        rows.append({"first": first, "second": second} | pair.columns(confidence, exact_pair))
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    return pd.DataFrame(rows, columns=list(PAIR_COLUMNS))


def ranks_table(pairs: pd.DataFrame, errors: Mapping[str, tuple[float, float]]) -> pd.DataFrame:
    """A row for each set, the lowest expected MSE first, with its interval of ranks.

    Two sets differ clearly if the simultaneous interval of their difference does not contain 0.
    The best rank of a set is 1 plus the number of sets that are clearly better. The worst rank is
    the number of all sets less those that are clearly worse, and less those that are exactly equal.
    The true rank is 1 plus the number of sets with a lower expected MSE. All simultaneous intervals
    hold together with 95 %, so the true ranks of all sets lie within these ranks with at least
    95 %.

    Parameters
    ----------
    pairs : DataFrame
        The result of `pairs_table`.
    errors : mapping of str to (float, float)
        Expected MSE and standard error of each set by name.

    Returns
    -------
    DataFrame
        The columns of the table ``ranks``.
    """
    order = sorted(errors, key=lambda name: (math.isnan(errors[name][0]), errors[name][0]))
    # For each set: the number of sets that are clearly better, and the number of sets that are
    # clearly worse or exactly equal.
    better, worse = dict.fromkeys(errors, 0), dict.fromkeys(errors, 0)
    to_best = {order[0]: (0.0, 0.0, 0.0)}
    for pair in pairs.to_dict("records"):
        first, second = pair["first"], pair["second"]
        if pair["clear"]:
            winner, loser = (first, second) if pair["difference"] < 0 else (second, first)
            better[loser] += 1
            worse[winner] += 1
        elif pair["simultaneous_low"] == pair["simultaneous_high"] == 0.0:  # exactly equal
            worse[first] += 1
            worse[second] += 1
        if second == order[0]:
            to_best[first] = (pair["difference"], pair["low"], pair["high"])
        elif first == order[0]:
            to_best[second] = (-pair["difference"], -pair["high"], -pair["low"])
    rows = [
        (name, *errors[name], 1 + better[name], len(errors) - worse[name], *to_best[name])
        for name in order
    ]
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    return pd.DataFrame(rows, columns=list(RANK_COLUMNS))


# --- of a run -------------------------------------------------------------------------------------


def pairs_of(run: StoredRun) -> pd.DataFrame:
    """A row for each pair of compared sets, on the same draws.

    The columns are first and second (names); draws; difference (expected MSE of the first less
    that of the second) with low and high (95 %, Student's t); simultaneous_low and
    simultaneous_high (of all pairs together, by Bonferroni); clear (whether these leave out 0);
    gain_of_means (the share by which the first is lower) with gain_of_means_low and
    gain_of_means_high (Fieller's); first_wins (share of the draws in which the first has the lower
    MSE) with first_wins_low and first_wins_high (Wilson's).
    """
    return pairs_table(run.names, (block for block, *_ in errors_of(run)), exact_errors(run))


def ranks_of(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set, the lowest expected MSE first.

    The columns are name; expected_mse and standard_error; best_rank and worst_rank, between which
    all true ranks lie with 95 %; difference (expected MSE less that of the first row) with low and
    high (95 %, of this pair alone).
    """
    statistics = statistics_of(run)
    estimates = {name: statistics.estimate(name) for name in run.names}
    errors = {name: (each.value, each.standard_error) for name, each in estimates.items()}
    errors |= {name: (error, 0.0) for name, error in exact_errors(run).items()}
    return ranks_table(pairs_of(run), errors)
