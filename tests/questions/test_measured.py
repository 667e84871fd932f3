"""Declarations for real measurements are checked: a density, and missing components."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oracles.clocked import with_clock
from oracles.guided import echoes, growth, sharp_walk
from pfdist import StateSpaceModel, load_model
from pfdist.filters import plain
from pfdist.models import installed_models
from pfdist.questions.measured import missing_components, normalised, proposal
from pfdist.questions.model_checks import check_loaded
from pfdist.runner.likelihood import MEASUREMENTS, Within

SHIPPED = [name for name, (module, _) in installed_models().items() if "pfdist" in module]
HALF_LOG_2_PI = math.log(2 * math.pi) / 2


def _normal(apart: Any, sd: Any) -> Any:
    return -0.5 * (apart / sd) ** 2 - np.log(sd) - HALF_LOG_2_PI


def _model(measurement: Any, log_likelihood: Any, *noise: str, **fields: Any) -> StateSpaceModel:
    return StateSpaceModel(
        name="mine",
        initial=lambda w, p: (w[0],),
        transition=lambda x, t, w, p: (0.9 * x[0] + w[0],),
        measurement=measurement,
        log_likelihood=log_likelihood,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=noise,
        **{"normalised": True, **fields},
    )


def _looked(look: Any, model: StateSpaceModel) -> tuple[str, str]:
    draws = plain.simulate(model, 12, range(200), 0)
    with np.errstate(all="ignore"):
        found: tuple[str, str] = look(model, draws, Within())
    assert "\n" not in found[1]
    return found


def _share(x: Any) -> Any:
    return 0.98 / (1 + np.exp(-x))


BEARINGS = load_model("bearings_only")
DENSITIES = {
    "normal": _model(
        lambda x, t, v, p: (x[0] + np.exp(0.1 * x[0]) * v[0],),
        lambda y, x, t, p: _normal(y[0] - x[0], np.exp(0.1 * x[0])),
        "normal",
    ),
    "Cauchy": _model(
        lambda x, t, v, p: (x[0] + np.tan(np.pi * (v[0] - 0.5)),),
        lambda y, x, t, p: -np.log(np.pi * (1 + (y[0] - x[0]) ** 2)),
        "uniform",
    ),
    "uniform": _model(
        lambda x, t, v, p: (x[0] + v[0],),
        lambda y, x, t, p: np.log((y[0] >= x[0]) & (y[0] <= x[0] + 1)),
        "uniform",
    ),
    "an angle": replace(
        BEARINGS,
        normalised=True,
        log_likelihood=lambda y, x, t, p: (
            BEARINGS.log_likelihood(y, x, t, p) - np.log(p.bearing_sd) - HALF_LOG_2_PI
        ),
    ),
    "coin": _model(
        lambda x, t, v, p: (np.where(v[0] < _share(x[0]), 1.0, 0.0),),
        lambda y, x, t, p: np.log(np.where(y[0] > 0.5, _share(x[0]), 1 - _share(x[0]))),
        "uniform",
    ),
    "geometric": _model(
        lambda x, t, v, p: (np.floor(np.log(v[0]) / np.log(_share(x[0]))),),
        lambda y, x, t, p: y[0] * np.log(_share(x[0])) + np.log(1 - _share(x[0])),
        "uniform",
    ),
    "two that depend on each other": _model(
        lambda x, t, v, p: (x[0] + v[0], x[0] + v[0] + 0.01 * v[1]),
        lambda y, x, t, p: _normal(y[0] - x[0], 1.0) + _normal(y[1] - y[0], 0.01),
        *("normal", "normal"),
    ),
    "a count and a number": _model(
        lambda x, t, v, p: (np.where(v[0] < _share(x[0]), 1.0, 0.0), x[0] + v[1]),
        lambda y, x, t, p: (
            np.log(np.where(y[0] > 0.5, _share(x[0]), 1 - _share(x[0]))) + _normal(y[1] - x[0], 1.0)
        ),
        *("uniform", "normal"),
    ),
    "four": _model(
        lambda x, t, v, p: tuple(x[0] + (k + 1) * v[k] for k in range(4)),
        lambda y, x, t, p: sum(_normal(y[k] - x[0], k + 1.0) for k in range(4)),
        *["normal"] * 4,
    ),
}
LITTLE = 0.1  # added to a log-likelihood


@pytest.mark.parametrize("name", DENSITIES)
def test_a_density_has_the_integral_1_and_a_model_that_lies_is_found(name: str) -> None:
    model = DENSITIES[name]
    state, text = _looked(normalised, model)
    assert (state, text[:14]) == ("ok", "as it declares")
    assert ("add up to 1" in text) == (name in ("coin", "geometric"))
    lying = replace(
        model, log_likelihood=lambda y, x, t, p: model.log_likelihood(y, x, t, p) + LITTLE
    )
    state, text = _looked(normalised, lying)
    assert state == "wrong"
    found = re.search(r"must have the integral 1 over y, .* got (\S+) ± (\S+) at x = ", text)
    assert found is not None
    ratio, error = map(float, found.groups())
    assert abs(ratio - math.exp(LITTLE)) < 5 * error


@pytest.mark.parametrize("name", SHIPPED)
def test_a_model_that_ships_is_normalised_if_it_says_so_and_only_then(name: str) -> None:
    for _, model, *_ in with_clock(load_model(name), 12).parts:  # one for each sensor
        is_one = _looked(normalised, model)[0] == "ok"
        # A robot measures angles: the integral over a circle is 1, and over all numbers more.
        assert is_one is model.normalised or (is_one and name == "robot")


@pytest.mark.parametrize(
    ("measurement", "says"),
    [
        (
            lambda x, t, v, p: (np.maximum(x[0] + v[0], 0.5),),
            "over y cannot be checked: component 0 has few values",
        ),
        (lambda x, t, v, p: (x[0] + v[0], x[0] + v[0]), "a component follows from the others"),
        (lambda x, t, v, p: (np.floor(1e9 * v[0]),), "too many whole numbers"),
        (
            lambda x, t, v, p: (x[0] + v[0], x[0] + v[0] ** 2, np.floor(v[0])),
            "more than two components, and whole numbers among them",
        ),
    ],
)
def test_what_cannot_be_integrated_is_said(measurement: Any, says: str) -> None:
    model = _model(measurement, lambda y, x, t, p: _normal(y[0] - x[0], 1.0), "normal")
    state, text = _looked(normalised, model)
    assert state == "note"
    assert says in text


def _two_sensors(second: Any) -> StateSpaceModel:
    return _model(
        lambda x, t, v, p: (x[0] + v[0], x[0] + 0.3 * v[1]),
        lambda y, x, t, p: (
            np.where(np.isnan(y[0]), 0.0, _normal(y[0] - x[0], 1.0)) + second(y[1], x[0])
        ),
        *("normal", "normal"),
        missing_components=True,
        y_names=("first", "second"),
    )


@pytest.mark.parametrize(
    ("second", "state", "says"),
    [
        (
            lambda y, x: np.where(np.isnan(y), 0.0, _normal(y - x, 0.3)),
            "ok",
            "each of 2 components of y may be NaN",
        ),
        (lambda y, x: _normal(y - x, 0.3), "wrong", r"y\[1\] is missing .* got NaN or infinity"),
        (
            lambda y, x: np.where(np.isnan(y), -0.5 * x**2, _normal(y - x, 0.3)),
            "wrong",
            r"y\[1\] is missing .* must be the log-density of measurement",
        ),
        (
            lambda y, x: np.where(np.isnan(y), 0.2, _normal(y - x, 0.3)),
            "wrong",
            r"y\[1\] is missing .* must have the integral 1",
        ),
    ],
)
def test_the_log_likelihood_without_a_component_is_that_of_the_others(
    second: Any, state: str, says: str
) -> None:
    found, text = _looked(missing_components, _two_sensors(second))
    assert found == state
    assert re.search(says, text), text


def test_a_single_component_cannot_be_missing() -> None:
    model = replace(DENSITIES["normal"], missing_components=True)
    assert _looked(missing_components, model)[0] == "note"


def test_check_model_looks_at_what_a_model_declares(tmp_path: Path) -> None:
    text = "from dataclasses import replace\nfrom pfdist.models.library.ungm import model as ungm\n"
    text += "model = replace(ungm, normalised=True, missing_components=True)\n"
    (tmp_path / "mine.py").write_text(text)
    found = check_loaded(lambda: load_model("mine.py:model", tmp_path), 12, 20)
    checks = {check.name: check for check in found}
    assert checks["normalised"].state == "wrong"
    assert checks["missing components"].state == "note"
    assert "expected MSE" in checks


# --- proposals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "model", [growth, sharp_walk(1), sharp_walk(3), echoes], ids=lambda each: each.name
)
def test_right_proposals_are_accepted_with_their_effective_sample_sizes(
    model: StateSpaceModel,
) -> None:
    state, text = _looked(proposal, model)
    assert state == "ok", text
    assert "effective sample size" in text


WRONG_PROPOSALS = {
    "a wider deviation": lambda u, w: (0.5 * u[0], _normal(w[0], 0.6)),
    "another mean": lambda u, w: (0.5 * u[0], _normal(w[0] - 0.2, 0.5)),
    "no constant": lambda u, w: (u[0], -0.5 * w[0] ** 2),
}


@pytest.mark.parametrize("name", WRONG_PROPOSALS)
def test_a_density_that_is_not_that_of_the_proposal_is_found(name: str) -> None:
    pair = WRONG_PROPOSALS[name]
    model = _model(
        lambda x, t, v, p: (x[0] + v[0],),
        lambda y, x, t, p: _normal(y[0] - x[0], 1.0),
        "normal",
        proposal=lambda x, y, t, u, p: (pair(u, u)[0],),
        proposal_log_density=lambda w, x, y, t, p: pair(w, w)[1],
    )
    state, text = _looked(proposal, model)
    assert (state, "exp(proposal_log_density)" in text) == ("wrong", True), text


SHARP, PUSH = 0.02, 0.7  # deviations of the sensor and of the process noise
BEST = SHARP / math.hypot(PUSH, SHARP)  # deviation of w given x and y


def _near(y: Any, x: Any) -> Any:
    """Mean of w given x and y."""
    return PUSH / (PUSH**2 + SHARP**2) * (y[0] - 0.9 * x[0])


def _sharp(draw: Any, log_density: Any, *noise: str) -> StateSpaceModel:
    """A sharp sensor, with a proposal of (w less its best mean) over its best deviation."""
    model = _model(
        lambda x, t, v, p: (x[0] + SHARP * v[0],),
        lambda y, x, t, p: _normal(y[0] - x[0], SHARP),
        "normal",
        proposal=lambda x, y, t, u, p: (_near(y, x) + BEST * draw(u[0]),),
        proposal_log_density=lambda w, x, y, t, p: (
            log_density((w[0] - _near(y, x)) / BEST) - math.log(BEST)
        ),
        proposal_noise=noise,
    )
    return replace(model, transition=lambda x, t, w, p: (0.9 * x[0] + PUSH * w[0],))


@pytest.mark.parametrize(
    ("deviation", "mean"), [(1.0, 0.0), (0.5, 0.0), (0.25, 0.0), (1.0, 3.0), (20.0, 0.0)]
)
def test_right_proposals_are_accepted_even_if_weights_have_heavy_tails(
    deviation: float, mean: float
) -> None:
    """A normal density covers all noise, but weights of one that is too narrow have no variance."""
    model = _sharp(lambda u: mean + deviation * u, lambda s: _normal(s - mean, deviation), "normal")
    for seed in range(8):
        draws = plain.simulate(model, 12, range(50), seed)
        state, text = proposal(model, draws, Within())
        assert state == "ok", text
        assert re.search("covers the noise that fits y at [6-9] of them", text), text


@pytest.mark.parametrize(("low", "high"), [(-0.5, 0.5), (-1.5, 1.5), (0.0, 30.0), (-40.0, -0.5)])
def test_a_proposal_whose_support_is_too_small_is_found_with_the_share_that_it_misses(
    low: float, high: float
) -> None:
    """E_q[p(y | x') p(w) / q(w)] is less than E_p[p(y | x')] by the share outside."""
    model = _sharp(
        lambda u: low + (high - low) * u,
        lambda s: np.where((s >= low) & (s <= high), -math.log(high - low), -np.inf),
        "uniform",
    )
    state, text = _looked(proposal, model)
    assert state == "wrong"
    found = re.search(r"density is 0 for (\d+)% of the w that fit y, at x = ", text)
    assert found is not None, text
    missed = 1 - (math.erf(high / math.sqrt(2)) - math.erf(low / math.sqrt(2))) / 2
    fitting = MEASUREMENTS * BEST / 20  # at least so many draws count, even where w is rare
    error = math.sqrt(missed * (1 - missed) / fitting) + 0.005  # and rounding
    assert abs(float(found[1]) / 100 - missed) < 4 * error


def test_a_density_that_is_too_large_where_nothing_is_drawn_is_found() -> None:
    model = _sharp(lambda u: u - 0.5, lambda s: 0.0 * s, "uniform")
    state, text = _looked(proposal, model)
    assert state == "wrong"
    assert "of what proposal draws, also far from it; but of 20,000 w" in text


def test_a_sensor_too_sharp_for_the_noise_leaves_the_support_open() -> None:
    """No draw of the noise in three dimensions fits the measurement; the text says so."""
    assert "that fits y at 0 of them" in _looked(proposal, sharp_walk(3))[1]


def test_check_model_checks_every_formula_of_a_proposal() -> None:
    checks = {each.name: each for each in check_loaded(lambda: growth, 8, 50)}
    assert checks["proposal"].state == "ok", checks["proposal"].text
    failing = replace(growth, proposal=lambda x, y, t, u, p: (u[0] / (t < 3),))
    found = [each.text for each in check_loaded(lambda: failing, 8, 50) if each.state == "wrong"]
    assert "from proposal" in found[0]
