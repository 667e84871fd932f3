"""The test of log-likelihoods: right ones are never called wrong, and most wrong ones are found."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from oracles.in_turn import in_turn
from pfdist import StateSpaceModel, densities, load_model, where
from pfdist.filters.draws import Draws
from pfdist.filters.plain import simulate
from pfdist.models import installed_models
from pfdist.runner.likelihood import Within, likelihood

Formula = Callable[[Any, Any], Any]
LAST = 9
# Draws before a run, and in check-model.
EITHER = pytest.mark.parametrize("draws", [10, pytest.param(1000, marks=pytest.mark.slow)])


def model_of(measured: Formula, log_likelihood: Formula, *noise: str) -> StateSpaceModel:
    """A walk from N(0, 25), of which y = measured(x, v), with a log-likelihood of y and x."""
    return replace(
        load_model("random_walk"),
        initial=lambda w, p: (5 * w[0],),
        transition=lambda x, t, w, p: (x[0] + w[0],),
        measurement=lambda x, t, v, p: measured(x[0], v),
        log_likelihood=lambda y, x, t, p: log_likelihood(y, x[0]),
        measurement_noise=noise or ("normal",),
        linear_gaussian=False,
        y_names=(),
    )


def looked(model: StateSpaceModel, draws: int = 1000) -> tuple[str, str]:
    with np.errstate(all="ignore"):
        return likelihood(model, simulate(model, LAST, range(draws), 0))


def normal(sd: float, level: Callable[[Any], Any] = lambda x: x) -> Formula:
    return lambda y, x: -0.5 * ((y[0] - level(x)) / sd) ** 2


def with_noise(sd: float, level: Callable[[Any], Any] = lambda x: x) -> Formula:
    return lambda x, v: (level(x) + sd * v[0],)


def logistic(x: Any) -> Any:
    return 1 / (1 + np.exp(-x))


def clutter(share: float) -> Formula:
    parts = (share, 1 - share)
    return lambda y, x: densities.mixture_logpdf(
        (densities.normal_logpdf(y[0], 0.0, 30.0), densities.normal_logpdf(y[0], x, 1.0)), parts
    )


def cluttered(share: float) -> Formula:
    return lambda x, v: (where(v[1] < share, 30 * v[2], x + v[0]),)


def student(df: float) -> Formula:
    return lambda x, v: (densities.student_t_draw(v[0], v[1], df, x, 1.0),)


def student_density(df: float) -> Formula:
    return lambda y, x: densities.student_t_logpdf(y[0], df, x, 1.0)


def counted(size: float) -> Formula:
    return lambda x, v: (densities.negative_binomial_draw(v[0], v[1], 5 * np.exp(x), size),)


def counts(size: float) -> Formula:
    return lambda y, x: densities.negative_binomial_logpmf(y[0], 5 * np.exp(x), size)


def rounded_density(y: Any, x: Any) -> Any:
    low, high = (densities.erfc((x - y[0] - side) / math.sqrt(2)) for side in (0, 1))
    return np.log(np.maximum(high - low, 1e-300))


TWO, CLUTTER = ("uniform",) * 2, ("normal", "uniform", "normal")
TOGETHER = model_of(
    lambda x, v: (x + v[0], x + 0.8 * v[0] + 0.6 * v[1]),
    lambda y, x: -0.5 * ((y[0] - x) ** 2 + ((y[1] - x - 0.8 * (y[0] - x)) / 0.6) ** 2),
    *("normal", "normal"),
)
WIDTH = model_of(
    lambda x, v: (np.exp(x) * v[0],), lambda y, x: where(y[0] <= np.exp(x), -x, -np.inf), "uniform"
)
RIGHT = {
    "counts near zero": model_of(counted(0.5), counts(0.5), *TWO),
    "binomial near both ends": model_of(
        lambda x, v: (densities.binomial_draw(v[0], 20.0, logistic(x)),),
        lambda y, x: densities.binomial_logpmf(y[0], 20.0, logistic(x)),
        "uniform",
    ),
    "no mean": model_of(
        lambda x, v: (densities.student_t_draw(v[0], v[1], 1.0, 0.0, np.exp(x)),),
        lambda y, x: densities.student_t_logpdf(y[0], 1.0, 0.0, np.exp(x)),
        *TWO,
    ),
    "lognormal": model_of(
        lambda x, v: (np.exp(x + 0.3 * v[0]),),
        lambda y, x: -0.5 * ((np.log(y[0]) - x) / 0.3) ** 2,
    ),
    "support that depends on x": WIDTH,
    "clutter": model_of(cluttered(0.1), clutter(0.1), *CLUTTER),
    "dropouts": model_of(
        lambda x, v: (where(v[1] < 0.3, 0.0, x + v[0]),),
        lambda y, x: where(y[0] == 0.0, 0.0, -0.5 * (y[0] - x) ** 2),
        *("normal", "uniform"),
    ),
    "heard or not": model_of(
        lambda x, v: (where(v[0] < logistic(x), 1.0, 0.0),),
        lambda y, x: np.log(where(y[0] > 0.5, logistic(x), logistic(-x))),
        "uniform",
    ),
    "whole numbers": model_of(lambda x, v: (np.floor(x + v[0]),), rounded_density),
    "very sharp": model_of(with_noise(1e-6), normal(1e-6)),
    "volatility": model_of(
        lambda x, v: (np.exp(x / 2) * v[0],), lambda y, x: -0.5 * (x + y[0] ** 2 * np.exp(-x))
    ),
    "a sign": model_of(with_noise(0.8, np.sign), normal(0.8, np.sign)),
    "an angle that winds with x": model_of(
        lambda x, v: (densities.von_mises_draw(v[0], x, 4.0),),
        lambda y, x: densities.von_mises_logpdf(y[0], x, 4.0),
        "uniform",
    ),
    "noise in common": TOGETHER,
    "a part of y": replace(TOGETHER, log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2),
}
WRONG = {
    "deviation 20 % too small": model_of(with_noise(1.0), normal(0.8)),
    "deviation 20 % too large": model_of(with_noise(0.5), normal(0.6)),
    "deviation 5 % too small": model_of(with_noise(1.0), normal(0.95)),
    "a sign, deviation too small": model_of(with_noise(0.8, np.sign), normal(0.7, np.sign)),
    "a sign and a term that depends on it": model_of(
        with_noise(0.8, np.sign), lambda y, x: normal(0.8, np.sign)(y, x) + 0.2 * np.sign(x)
    ),
    "no normaliser": model_of(
        lambda x, v: (np.exp(x / 2) * v[0],), lambda y, x: -0.5 * y[0] ** 2 * np.exp(-x)
    ),
    "no normaliser of bounded support": replace(
        WIDTH, log_likelihood=lambda y, x, t, p: np.log(y[0] <= np.exp(x[0]))
    ),
    "the measurement's sign": model_of(with_noise(1.0, lambda x: -x), normal(1.0)),
    "the sign of the logarithm": model_of(with_noise(1.0), lambda y, x: 0.5 * (y[0] - x) ** 2),
    "degrees of freedom": model_of(student(3.0), student_density(10.0), *TWO),
    "normal for Laplace of the same deviation": model_of(
        lambda x, v: (densities.laplace_draw(v[0], x, math.sqrt(0.5)),), normal(1.0), "uniform"
    ),
    "a tenth of a deviation aside": model_of(with_noise(1.0, lambda x: x + 0.1), normal(1.0)),
    "Poisson for overdispersed counts": model_of(
        counted(5.0), lambda y, x: densities.poisson_logpmf(y[0], 5 * np.exp(x)), *TWO
    ),
    "noise in common forgotten": replace(
        TOGETHER,
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) ** 2 + (y[1] - x[0]) ** 2),
    ),
}
# 24 pairs of 20,000 y cannot show these. With uniform noise, y excludes a state or says nothing.
CANNOT_TELL = {
    "uniform, right": (
        model_of(
            lambda x, v: (x + 2 * v[0] - 1,), lambda y, x: np.log(abs(y[0] - x) <= 1), "uniform"
        ),
        "note",
    ),
    "uniform, too wide": (
        model_of(
            lambda x, v: (x + 2 * v[0] - 1,), lambda y, x: np.log(abs(y[0] - x) <= 1.1), "uniform"
        ),
        "note",
    ),
    "levels 20 deviations apart": (
        model_of(with_noise(0.05, np.floor), normal(0.04, np.floor)),
        "note",
    ),
    "1 % clutter forgotten": (model_of(cluttered(0.01), normal(1.0), *CLUTTER), "ok"),
}


@EITHER
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * ("counts" in name)) for name in RIGHT]
)
def test_a_right_likelihood_agrees(name: str, draws: int) -> None:
    state, text = looked(RIGHT[name], draws)
    assert state == "ok", text
    assert int(text.split()[5]) >= 20, text


@EITHER
@in_turn("name", WRONG)
def test_a_wrong_likelihood_is_found(name: str, draws: int) -> None:
    state, text = looked(WRONG[name], draws)
    assert state == "wrong", text
    assert "must be the log-density of measurement" in text


@in_turn("name", CANNOT_TELL)
def test_what_cannot_be_told_is_not_called_wrong(name: str) -> None:
    model, state = CANNOT_TELL[name]
    found, text = looked(model)
    assert found == state, text
    assert ("cannot be checked" in text) == (state == "note"), text


@pytest.mark.parametrize(
    ("level", "state", "says"),
    [
        # The states are N(0, 25 + t): about 1 % of them are above 12.
        (lambda x: np.where(x > 12.0, 2.0, 0.0), "ok", "it agrees with"),
        (lambda x: 0 * x, "note", "it does not depend on x: it is the same in"),
    ],
    ids=["rare", "without x"],
)
def test_a_level_that_rarely_or_never_changes(level: Any, state: str, says: str) -> None:
    found, text = looked(model_of(with_noise(0.8, level), normal(0.8, level)))
    assert (found, text[: len(says)]) == (state, says)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.zoo] * (name not in ("ungm", "epidemic_counts")))
        for name in sorted(installed_models())
    ],
)
def test_each_model_that_ships_agrees_at_24_pairs(name: str) -> None:
    model = load_model(name)
    if model.reads_clock:
        model = model.on_clock(tuple(map(float, range(LAST + 1))))
    for way in model.ways:
        assert looked(way.model) == ("ok", "it agrees with measurement at 24 pairs of states")


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.5, 2.0, 20.0])
def test_counts_of_almost_nothing_and_of_many_agree(size: float) -> None:
    """At x = -6.5 nearly all counts are 0, and the ratio of likelihoods has a rare heavy tail."""
    model = model_of(counted(size), counts(size), *TWO)
    draws = simulate(model, LAST, range(1000), 0)
    x = np.broadcast_to(np.where(np.arange(1000) % 2, -6.5, 2.2)[:, None, None], draws.x.shape)
    state, text = likelihood(model, Draws(model, draws.index, x, draws.y, draws.z))
    assert state == "ok", text


def test_a_state_that_takes_whole_numbers_is_never_between_two() -> None:
    """A regime is 0 or 1: there the log-likelihood is right, and between them it is not."""
    model = replace(
        model_of(with_noise(0.01, lambda x: where(x > 0.5, 1.0, 0.0)), normal(0.01)),
        initial=lambda w, p: (where(w[0] > 0, 1.0, 0.0),),
        transition=lambda x, t, w, p: x,
    )
    state, text = looked(model)
    assert state == "note", text


def test_the_result_does_not_depend_on_chance() -> None:
    model = WRONG["deviation 5 % too small"]
    draws = simulate(model, LAST, range(1000), 0)
    assert likelihood(model, draws) == likelihood(model, draws)


def test_without_time_one_pair_is_compared_and_the_rest_is_said_to_be_left_out() -> None:
    model, none, enough = RIGHT["clutter"], Within(0.0), Within(1000.0)
    draws = simulate(model, LAST, range(1000), 0)
    assert likelihood(model, draws, none)[1].endswith("at 1 pair of states")
    assert none.text == " (shortened: all would take longer than 0 s)"
    assert likelihood(model, draws, enough)[1].endswith("at 24 pairs of states")
    assert enough.text == ""
