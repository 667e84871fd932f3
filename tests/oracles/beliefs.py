"""Rules and policies on a two-state chain, exactly: all beliefs that its measurements can lead to.

The state stays with probability 0.9, and a sensor names it with probability 0.95 at odd t, and 0.6
at even t. z is the state, 0 or 1, so its variance given a belief b is b (1 - b).
"""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from pfdist import StateSpaceModel, where
from pfdist.kernels.rules import Thresholds

HORIZON, BUDGET = 8, 3
STAYS, SHARP, BLUNT = 0.9, 0.95, 0.6


def accuracy(t: int) -> float:
    return BLUNT + (SHARP - BLUNT) * (t % 2)


CHAIN = StateSpaceModel(
    "two states",
    initial=lambda w, p: (where(w[0] < 0.5, 1.0, 0.0),),
    transition=lambda x, t, w, p: (where(w[0] < STAYS, x[0], 1.0 - x[0]),),
    measurement=lambda x, t, v, p: (where(v[0] < accuracy(t), x[0], 1.0 - x[0]),),
    log_likelihood=lambda y, x, t, p: np.log(
        where(abs(y[0] - x[0]) < 0.5, accuracy(t), 1.0 - accuracy(t))
    ),
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("uniform",),
    process_noise=("uniform",),
    measurement_noise=("uniform",),
)


def moved(belief: float) -> float:
    return belief * STAYS + (1.0 - belief) * (1.0 - STAYS)


def after(belief: float, t: int) -> Iterator[tuple[float, float]]:
    """Probability of each measurement, and the belief after it, which is rounded."""
    for likelihood in (accuracy(t), 1.0 - accuracy(t)):
        share = belief * likelihood + (1.0 - belief) * (1.0 - likelihood)
        yield share, round(belief * likelihood / share, 12)


def errors(goes: Callable[[int, float, int], bool]) -> tuple[float, float]:
    """Expected MSE and mean number of measurements of a policy of t, belief and number spent."""
    states, error, number = {(0.5, 0): 1.0}, 0.0, 0.0
    for t in range(HORIZON + 1):
        following = dict[tuple[float, int], float]()
        for (before, spent), share in states.items():
            belief = moved(before) if t else before
            branches = [(1.0, belief)]
            if goes(t, belief, spent):
                branches, number = [*after(belief, t)], number + share
            for chance, b in branches:
                key = b, spent + (len(branches) > 1)
                following[key] = following.get(key, 0.0) + share * chance
                error += share * chance * b * (1.0 - b)
        states = following
    return error / (HORIZON + 1), number


def of_rule(rule: Thresholds) -> tuple[float, float]:
    def goes(t: int, belief: float, spent: int) -> bool:
        return bool(np.sqrt(belief * (1 - belief)) > rule.levels([t], HORIZON + 1 - t, spent)[0])

    return errors(goes)


def of_set(times: tuple[int, ...]) -> float:
    return errors(lambda t, belief, spent: t in times)[0]


def best_policy(limit: int) -> float:
    """The least expected MSE of all policies that never measure more than so many times."""

    @cache
    def least(t: int, before: float, left: int) -> float:
        if t > HORIZON:
            return 0.0
        belief = moved(before) if t else before
        waits = belief * (1 - belief) + least(t + 1, belief, left)
        if not left:
            return waits
        goes = sum(s * (b * (1 - b) + least(t + 1, b, left - 1)) for s, b in after(belief, t))
        return min(waits, goes)

    return least(0, 0.5, limit) / (HORIZON + 1)


def average_bound(number: float, prices: np.ndarray) -> float:
    """A lower bound for policies that measure so many times on average: the largest dual value."""

    def dual(price: float) -> float:
        @cache
        def least(t: int, before: float) -> float:
            if t > HORIZON:
                return 0.0
            belief = moved(before) if t else before
            goes = sum(s * (b * (1 - b) + least(t + 1, b)) for s, b in after(belief, t))
            return min(belief * (1 - belief) + least(t + 1, belief), price + goes)

        return (least(0, 0.5) - price * number) / (HORIZON + 1)

    return max(map(dual, prices.tolist()))
