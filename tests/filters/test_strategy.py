"""Strategies: one loop asks any class that decides, and gives it a filter with what has arrived."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import pfdist
from oracles.kalman import SCALAR
from pfdist.filters.one_filter import Followed
from pfdist.filters.strategy import Strategy, follow

Y = np.array([0.4, -0.2, 1.3, 0.7, 0.1, -0.9, 0.3, 0.2])[:, None]


class Unsure:
    """Measure if the filter is unsure: a strategy as a user writes it."""

    def __init__(self, most: float) -> None:
        self.most, self.asked = most, list[tuple[int, int]]()

    def decide(self, belief: Followed, t: int) -> Sequence[str]:
        assert isinstance(belief, pfdist.Filter)
        self.asked.append((t, len(belief.seen)))
        return ["level"] * (belief.predict(t).spread > self.most)


def test_a_strategy_decides_from_what_has_arrived() -> None:
    """For a linear-Gaussian model the times follow from the Riccati equation, whatever y is."""
    model, horizon = SCALAR.as_model(), len(Y) - 1
    deviations, wanted = pfdist.Filter(model, engine="kalman"), list[int]()
    for t in range(horizon + 1):
        if deviations.predict(t).spread > 1.5:
            deviations.update(t, 0.0)
            wanted.append(t)
    strategy, belief = Unsure(1.5), pfdist.Filter(model, engine="kalman")
    follow(strategy, belief, lambda t, _: Y[t], range(horizon + 1), {})
    assert 1 < len(wanted) < horizon
    assert [t for t, _ in belief.seen] == wanted
    assert [number for _, number in strategy.asked] == [
        sum(each < t for each in wanted) for t in range(horizon + 1)
    ]


def test_a_value_that_arrives_later_is_given_when_it_arrives() -> None:
    """The values of two instants are on their way before the first one arrives."""
    arrived = list[tuple[int, Sequence[str]]]()

    def look(t: int, sensors: Sequence[str]) -> NDArray[np.float64]:
        arrived.append((t, sensors))
        return Y[t]

    strategy, belief = Unsure(0.0), pfdist.Filter(SCALAR.as_model(), engine="kalman")
    asked: Strategy = strategy
    follow(asked, belief, look, range(5), {"level": 2})
    assert arrived == [(2, ["level"]), (3, ["level"]), (4, ["level"])]
    assert strategy.asked == [(0, 0), (1, 0), (2, 0), (3, 1), (4, 2)]
