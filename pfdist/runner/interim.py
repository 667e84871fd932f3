"""Interim gains of a comparison: from the blocks of draws before the first gap.

Tasks end in any order. Only whole blocks without a gap before them count, so that the interim gains
do not depend on the order, and the comparison stops after the same draws in every run.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pfdist.analysis import BLOCK, ComparisonStatistics
from pfdist.runner.progress import Found


class InterimGains:
    """Accumulates the gains of a comparison, and says when its draws are enough.

    Parameters
    ----------
    names : list of str
        Names of the compared sets.
    references : mapping of str to str
        The set over which each other set gains, by name.
    draws : int
        Draws of the whole comparison; the last block may be shorter than the others.
    half_width : float
        Half width of the widest interval at which the draws are enough; 0 for never.

    Attributes
    ----------
    enough : int
        Number of draws that were enough; 0 as long as they are not.
    """

    def __init__(
        self, names: list[str], references: Mapping[str, str], draws: int, half_width: float
    ) -> None:
        self._statistics = ComparisonStatistics(names, references=references)
        self._draws, self._half_width = draws, half_width
        self._waiting: dict[int, _Block] = {}
        self.enough = 0

    def found(self) -> tuple[Found, ...]:
        """The gain of each set over the reference so far."""
        return tuple(
            Found(
                name,
                gain.relative.mean,
                gain.interval,
                gain.positive / gain.relative.count,
                gain.of_means,
                gain.of_means_interval,
            )
            for name, gain in self._statistics.gains.items()
            if gain.relative.count
        )

    def learn(self, index: range, values: NDArray[np.float64]) -> None:
        """Add the MSE of draws, (D, S), and then every whole block that has no gap before it."""
        draws = np.array(index)
        for number in np.unique(draws // BLOCK).tolist():
            in_block = draws // BLOCK == number
            if number not in self._waiting:
                size = min(BLOCK, self._draws - number * BLOCK)
                self._waiting[number] = _Block(size, values.shape[1])
            self._waiting[number].take(draws[in_block] - number * BLOCK, values[in_block])
        while not self.enough and (following := self._next()) is not None:
            self._statistics.add(following)
            if self._half_width and self._statistics.half_width() <= self._half_width:
                self.enough = self._statistics.draws

    def _next(self) -> NDArray[np.float64] | None:
        number = self._statistics.draws // BLOCK
        if number in self._waiting and not self._waiting[number].lacks_draws:
            return self._waiting.pop(number).values
        return None


class _Block:
    """A block of draws that arrive in any order."""

    def __init__(self, draws: int, sets: int) -> None:
        self.values, self.missing = np.empty((draws, sets)), np.ones(draws, np.bool_)

    @property
    def lacks_draws(self) -> bool:
        return bool(self.missing.any())

    def take(self, places: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        self.values[places], self.missing[places] = values, False
