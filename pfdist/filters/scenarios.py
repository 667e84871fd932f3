"""Scenarios: models with other parameters, of which each draw has one.

Draws come in blocks of 24. Draw j of block b has the scenario in which the cumulative share reaches
the fractional part of j / 24 + u, where u is a uniform number with the key of the stream and of b.
So each draw has each scenario with the probability of its share, a whole block is a systematic
sample of the scenarios, and the scenario of a draw is a pure function of its key.

Source: Cochran, "Sampling techniques", 3rd edition, 1977, chapter 8 (systematic sampling).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from pfdist.common.streams import stream_key
from pfdist.filters.cloud import Indices
from pfdist.filters.work import BLOCK
from pfdist.kernels.variates import TRUTH_INITIAL, variates


def scenarios_of_draws(shares: Sequence[float], stream: int, draws: range) -> Indices:
    """The number of each draw's scenario, (D,), for shares (C,) with the sum 1."""
    index = np.arange(draws.start, draws.stop)
    block, place = np.divmod(index, BLOCK)
    key = stream_key(stream, "scenarios")
    begins, of_block = np.unique(block, return_inverse=True)
    first = variates("uniform", 1, key, begins, 0, TRUTH_INITIAL, 0)[:, 0]
    position = (place / BLOCK + first[of_block]) % 1.0
    numbers: Indices = np.searchsorted(np.cumsum(shares)[:-1], position, side="right")
    return numbers


def stretches(numbers: Indices, first: int) -> Iterator[tuple[int, tuple[int, int]]]:
    """Yield the runs of successive draws with one scenario: its number, and the range of draws.

    >>> list(stretches(np.array([1, 1, 0]), 5))
    [(1, (5, 7)), (0, (7, 8))]
    """
    ends = [*(np.flatnonzero(np.diff(numbers)) + 1).tolist(), len(numbers)]
    for begin, end in zip([0, *ends], ends, strict=False):
        yield int(numbers[begin]), (first + begin, first + end)
