"""The check that a log-likelihood fits the measurement.

Its result is a state, "ok", "note" or "wrong", and a text.
"""

import math
import time
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfdist.common.stopping import check
from pfdist.filters.draws import Draws
from pfdist.kernels.variates import TRUTH_MEASUREMENT, variates
from pfdist.models import StateSpaceModel

Array = NDArray[np.float64]
T = TypeVar("T")

MEASUREMENTS = 20_000  # simulated at one state, to compare with the log-likelihood
_PAIRS = 8  # of states, at each of a few instants
VALUES = 3 * 3 * _PAIRS * MEASUREMENTS  # of formulas, about: y, and its likelihoods at two states
_FEW = 1000  # measurements by which the second state of a pair is chosen
_MUCH, _LITTLE = 0.02, 0.001  # see `_shown`: normal noise reaches 0.037
_PROOF = 14.5  # exp(-14.5) * 2 = 1 in 10^6 of right models is blamed for each number


def instants_of_draws(draws: Draws) -> list[int]:
    """A few instants before the last one."""
    last = draws.x.shape[1] - 2
    return sorted({0, last // 3, last})


def values_of_formula(
    model: StateSpaceModel, name: str, arguments: tuple[Any, ...], size: int
) -> Array:
    """The values of a formula, (components, size)."""
    with np.errstate(all="ignore"):
        value = getattr(model, name)(*arguments)
    components = value if isinstance(value, tuple) else (value,)
    return np.stack([np.broadcast_to(np.asarray(part, float), (size,)) for part in components])


class Within:
    """Items of loops, at least the first of each, until some seconds have passed.

    If items were left out, `text` says so.
    """

    def __init__(self, seconds: float = math.inf) -> None:
        self.seconds, self.start, self.text = seconds, time.perf_counter(), ""

    def __call__(self, items: Iterable[T]) -> Iterator[T]:
        """Give items until the time is over."""
        for number, item in enumerate(items):
            check()
            if number and time.perf_counter() - self.start > self.seconds:
                self.text = f" (shortened: all would take longer than {self.seconds:.0f} s)"
                return
            yield item


ENDLESS = Within()


def likelihood(model: StateSpaceModel, draws: Draws, within: Within = ENDLESS) -> tuple[str, str]:
    """State and text of the check that the log-likelihood fits `measurement`.

    A fair coin chooses one of two states a and b, and y is measured there. Given y, the state is b
    with the probability r = p(y | b) / (p(y | a) + p(y | b)); a factor that depends on y alone
    cancels. So the number of y from b, and the number of y from the more likely state, are sums of
    independent choices with known probabilities. Bernstein's inequality bounds both for any two
    states, also with heavy tails, jumps, and y that are impossible at one of them.

    "wrong" means that the likelihood is proved wrong; "note", that no pair of states can reveal a
    mistake. A likelihood that uses only part of y can be right.
    """
    rng, compared, same = np.random.default_rng(0), 0, True
    for pair, t in within(product(range(_PAIRS), instants_of_draws(draws))):
        i, other = rng.choice(len(draws.index), size=2, replace=False)
        a, is_b = draws.x[i, t], rng.random(MEASUREMENTS) < 0.5
        b = _telling(model, draws.x[:, t], t, i, other, measured(model, a, t, 2 * pair, _FEW))
        y = measured(model, np.where(is_b, b[:, None], a[:, None]), t, 2 * pair + 1)
        at_a, at_b = (_log_likelihood(model, y, t, x) for x in (a, b))
        impossible = 1 - np.mean(np.isfinite(at_a[~is_b]))
        if impossible:
            return "wrong", (
                f"log_likelihood must be finite for y measured at x, got NaN or infinity for "
                f"{impossible:.2%} of y measured at x = {formatted_state(a)}, t = {t}"
            )
        r = share_of(at_b, at_a)
        compared += _shown(r) > _LITTLE
        same &= np.allclose(r, 0.5)
        for which, is_true, probability in (
            ("second", is_b, r),
            ("more likely", is_b == (r > 0.5), np.maximum(r, 1 - r)),
        ):
            if (counted := miscounted(is_true, probability)) is not None:
                got, implied, deviation = counted
                states = f"x = {formatted_state(a)} and x = {formatted_state(b)} at t = {t}"
                return "wrong", (
                    "log_likelihood must be the log-density of measurement, up to a term that "
                    f"does not depend on x; but of {MEASUREMENTS:,} y, each measured at one of "
                    f"{states}, {got:,} come from the {which} state, where log_likelihood "
                    f"implies {implied:,.0f} ± {deviation:,.0f} "
                    "(a wrong deviation, or a term left out that depends on x?)"
                )
    if compared:
        pairs = f"{compared} pair" + "s" * (compared > 1)
        return "ok", f"it agrees with measurement at {pairs} of states"
    if same:
        return "note", f"it does not depend on x: it is the same in all {len(draws.index)} draws"
    return "note", (
        "it cannot be checked: y hardly distinguishes the two states of the draws at which it was "
        "measured, or distinguishes them almost perfectly"
    )


def measured(
    model: StateSpaceModel, x: Array, t: int, draw: int, count: int = MEASUREMENTS
) -> tuple[Array, ...]:
    """Simulated measurements at one state, or at many, (n, count); each draw has other noise."""
    v = tuple(
        variates(kind, count, 2, draw, t, TRUTH_MEASUREMENT, component)
        for component, kind in enumerate(model.measurement_noise)
    )
    return tuple(values_of_formula(model, "measurement", (tuple(x), t, v, model.p), count))


def _log_likelihood(model: StateSpaceModel, y: tuple[Array, ...], t: int, x: Array) -> Array:
    size = max(np.size(x[0]), np.size(y[0]))
    (values,) = values_of_formula(model, "log_likelihood", (y, tuple(x), t, model.p), size)
    return np.asarray(values, np.float64)


def miscounted(is_true: NDArray[np.bool_], probability: Array) -> tuple[int, float, float] | None:
    """The number of true choices, the implied number and its standard deviation, if they differ.

    The choices are independent, with known probabilities. None if the number may be right.
    """
    got, implied = int(is_true.sum()), float(probability.sum())
    square, difference = float((probability * (1 - probability)).sum()), abs(got - implied)
    is_proved = difference**2 > 2 * _PROOF * (square + difference / 3)
    return (got, implied, math.sqrt(square)) if is_proved else None


def share_of(log_p: Array, log_q: Array) -> Array:
    """The share p / (p + q); NaN where both are 0."""
    with np.errstate(invalid="ignore"):
        share: Array = (1 + np.tanh((log_p - log_q) / 2)) / 2
    return share


def _telling(
    model: StateSpaceModel, states: Array, t: int, i: int, other: int, y: tuple[Array, ...]
) -> Array:
    """A state at which the y measured at state i show best whether the log-likelihood is right.

    It lies towards another state, or towards that where the log-likelihood of the first y differs
    most: it may jump, and few states may be beyond. Components that are whole numbers in all states
    remain whole.
    """
    whole, a = (states == np.round(states)).all(axis=0), states[i]
    at_first = _log_likelihood(model, tuple(part[:1] for part in y), t, states.T)
    unlike = np.abs(at_first - at_first[i])
    unlike = np.nan_to_num(unlike, posinf=np.finfo(float).tiny)  # an impossible y comes last
    at_a, best, chosen = _log_likelihood(model, y, t, a), (0.0, 0.0), states[other]
    for target, step in product((other, unlike.argmax()), 2.0 ** -np.arange(40)):
        b = a + step * (states[target] - a)
        b = np.where(whole, np.round(b), b)
        r = share_of(_log_likelihood(model, y, t, b), at_a)
        uncertain = float(np.mean(r * (1 - r)))  # of uniform noise r is 0, 1/2 or 1
        shown = round(_shown(r), 3), uncertain * (1 - 4 * uncertain)
        if shown > best:
            best, chosen = shown, b
        if shown[0] > _MUCH:
            break
    return np.asarray(chosen, np.float64)


def _shown(r: Array) -> float:
    """Variance of the difference that a mistake makes, such as another deviation; below 1/16."""
    return float(np.mean(r * (1 - r) * (2 * r - 1) ** 2))


def formatted_state(x: Array) -> str:
    """A state as text for messages."""
    return f"({', '.join(f'{value:.4g}' for value in x)})"
