"""A work whole, in pieces and in single draws: no bit of a draw depends on its company.

So the tables of a run do not depend on workers, which decide how draws are cut into tasks.
"""

import random
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

from oracles.kalman import SCALAR
from oracles.limits import limits
from pfdist import Sensor, StateSpaceModel, densities, where
from pfdist.common.sensing import Sensing
from pfdist.constraints.setup import Setup
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW, SUMS
from pfdist.filters.proposal import PLAIN
from pfdist.filters.variants import for_estimation
from pfdist.filters.work import BLOCK, Estimation, sum_of_draws
from pfdist.kernels import rules
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.rules import Applied, Thresholds
from pfdist.kernels.schemes import ALL_SCHEMES, ALWAYS, CONDITIONAL
from pfdist.models.sensed import sensed
from pfdist.plugins.guided.proposal import GUIDED

HORIZON, DRAWS = 9, 45
APART = tuple(t + 2 for t in range(HORIZON + 1))
WALK = StateSpaceModel(
    name="walk",
    initial=lambda w, p: (2.0 * w[0],),
    transition=lambda x, t, w, p: (x[0] + w[0],),
    measurement=lambda x, t, v, p: (x[0] + 0.7 * v[0],),
    # some measurements tell nothing, and no particle explains others
    log_likelihood=lambda y, x, t, p: where(
        abs(y[0]) < 0.5, 0.0, where(y[0] > 5.0, -np.inf, densities.normal_logpdf(y[0], x[0], 0.7))
    ),
    log_tails=lambda y, x, t, p: densities.normal_log_tails(y[0], x[0], 0.7),
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
)
OWN = ("measurement", "log_likelihood", "log_tails", "measurement_noise")
SENSOR = Sensor(**{name: getattr(WALK, name) for name in OWN})
TWO = replace(
    WALK,
    sensors={"plain": SENSOR, "late": SENSOR},
    **{name: StateSpaceModel.__dataclass_fields__[name].default for name in OWN},
)
SENSINGS = {  # of each sensor
    "as it is": {"": Sensing()},
    "limits": {"": Sensing(low=-1.0, high=1.0)},
    "fails": {"": Sensing(fails=0.4)},
    "repeats": {"": Sensing(repeats=9)},
    "delay": {"": Sensing(delay=2)},
    "all": {"": Sensing(-1.0, 1.0, 0.4, 2, 1)},
    "two sensors": {"plain": Sensing(fails=0.4), "late": Sensing(repeats=2, delay=1)},
}
# of each instant, or one for all
LEVELS = (rules.ALWAYS, 1.5, rules.NEVER, 1.0, 2.0, 1.2, rules.ALWAYS, 3.0, 1.0, 1.5)
RULES = None, Thresholds((1.5,)), Thresholds((1.0,), 0.5, 3.0), Thresholds(LEVELS, 0.3, 6.0)
FOLLOWS = {  # what may follow with so many sensors
    "anything": lambda ways: {},
    "limits": lambda ways: {
        "apart": APART, "required": (2 * ways,), "most": (3,) * ways, "own_apart": (APART,) * ways
    },
    "visits": lambda ways: {
        "visits": Setup(
            ends=tuple(ways * (t + 3) for t in range(HORIZON + 1) for _ in range(ways)),
            price=1, most=2,
        ),
        "install": (1,) * ways, "required": (5 * ways,),
    },
}  # fmt: skip
LAGS = 0, 3, HORIZON, (0, 3, 2, 1) * 2 + (1, 0)
SETTINGS: dict[str, tuple[Any, ...]] = {
    "sensing": tuple(SENSINGS),
    "lag": LAGS,
    "resampling": tuple(ALL_SCHEMES),
    "threshold": (ALWAYS, 0.6),
    "proposal": (PLAIN.name, GUIDED.name),
    "rule": RULES,
    "follows": tuple(FOLLOWS),
    "flipped": (None, 6),
    "estimator": tuple(ESTIMATORS),
}


def possible(sensing: str, **given: Any) -> bool:
    """Whether a job can ask for these settings together."""
    if any(each.repeats > 1 for each in SENSINGS[sensing].values()) and given["threshold"] < ALWAYS:
        return False
    weights = ESTIMATORS[given["estimator"]].weights
    if weights.evidence and (given["lag"] != 0 or given["threshold"] < ALWAYS):
        return False
    if given["rule"] and (ESTIMATORS[given["estimator"]].filters > 1 or weights.evidence):
        return False
    if not given["rule"] and (given["follows"] != "anything" or given["flipped"]):
        return False
    is_own = given["resampling"] != CONDITIONAL.name
    return is_own or (given["rule"] is None and given["threshold"] == ALWAYS)


def check(evaluator: Evaluator, settings: Estimation) -> None:
    """Compare all arrays of the filter with those of pieces of 37 and of single draws."""
    points = range(evaluator.points.first(HORIZON + 1))
    sets = [tuple(points), tuple(points[1::5]), tuple(points[1::3]), ()]
    sets = sets[:1] if settings.rule else sets

    def found(draws: range) -> Iterator[FilterArrays]:
        drawn = evaluator.draws(draws, 7)
        ends = [HORIZON] * len(sets)
        yield evaluator.filter_sets(drawn, sets, ends, 9, settings, EACH_DRAW)
        yield from evaluator.filter_each(drawn, sets[-2:][:1], [9], settings)

    def sums(draws: range) -> Any:
        drawn, ends = evaluator.draws(draws, 7), [HORIZON] * len(sets)
        return evaluator.filter_sets(drawn, sets, ends, 9, settings, SUMS).errors

    if not settings.rule:
        singles = [sums(range(draw, draw + 1)) for draw in range(BLOCK)]
        assert sum_of_draws(singles).tobytes() == sums(range(BLOCK)).tobytes(), "sums"

    whole = [*found(range(DRAWS))]
    for size in (37, 1):
        pieces = [[*found(range(d, min(d + size, DRAWS)))] for d in range(0, DRAWS, size)]
        for arrays, parts in zip(whole, zip(*pieces, strict=True), strict=True):
            for name, array in arrays._asdict().items():
                if array.size and name != "work":  # that of all draws
                    axis = array.shape.index(DRAWS)
                    joined = np.concatenate([getattr(part, name) for part in parts], axis)
                    assert joined.tobytes() == array.tobytes(), (name, size)


def check_settings(sensing: str, **given: Any) -> None:
    """The same for one choice of each of `SETTINGS`."""
    each = SENSINGS[sensing]
    model = sensed(WALK if "" in each else TWO, each)
    evaluator = Evaluator(model, HORIZON, lag=given.pop("lag"))
    of_parts = [each for each in each.values() for _ in range(each.repeats)]
    ways, follows, flipped = len(of_parts), StepLimits(), given.pop("flipped")
    if own_limits := FOLLOWS[given.pop("follows")](ways):
        numbers = tuple(of_parts.index(part) + 1 for part in of_parts)
        delays = tuple(part.delay for part in of_parts)
        follows = limits(ways * (HORIZON + 1), **own_limits, numbers=numbers, delays=delays)
    if given["rule"] is not None:
        levels = tuple(np.repeat(given["rule"].thresholds, ways).tolist())
        rule = given["rule"]._replace(thresholds=levels)
        given["rule"] = Applied(rule, follows, flipped and ways * flipped)
    settings = Estimation(40, **given)
    try:
        check(for_estimation(evaluator, settings, knows_truth=False), settings)
    except AssertionError as error:
        error.add_note(f"{sensing}, lag {evaluator.lag}, {settings}")
        raise


def choices_at_random() -> list[dict[str, Any]]:
    choices = (dict(zip(SETTINGS, values, strict=True)) for values in product(*SETTINGS.values()))
    shuffled = [choice for choice in choices if possible(**choice)]
    random.Random(1).shuffle(shuffled)
    return shuffled


def test_no_bit_of_a_draw_depends_on_the_draws_beside_it() -> None:
    """Choices at random, until they have most pairs of values of two settings; and what failed."""
    first = {name: values[0] for name, values in SETTINGS.items()}
    check_settings(**first | {"sensing": "all", "estimator": "evidence"})
    met = set[frozenset[tuple[str, str]]]()
    for choice in choices_at_random():
        items = [(name, str(value)) for name, value in choice.items()]
        pairs = {frozenset(pair) for pair in combinations(items, 2)}
        is_limited = any(each.high < np.inf for each in SENSINGS[choice["sensing"]].values())
        takes_long = choice["proposal"] == GUIDED.name and is_limited
        if len(pairs - met) >= 11 and not takes_long:  # to derive
            met |= pairs
            check_settings(**choice)


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_no_bit_depends_on_company_with_many_settings_together(part: int) -> None:
    for choice in choices_at_random()[part:400:4]:
        check_settings(**choice)


@pytest.mark.parametrize(
    ("engine", "lag"),
    [
        ("numpy", 3),
        ("kalman", 3),
        *(pytest.param(e, 0, marks=pytest.mark.slow) for e in ("numpy", "kalman")),
    ],
)
def test_no_bit_depends_on_company_with_the_other_engines(engine: str, lag: int) -> None:
    model = replace(SCALAR.as_model(), linear_gaussian=True)
    check(Evaluator(model, HORIZON, engine=engine, lag=lag), Estimation(4))
