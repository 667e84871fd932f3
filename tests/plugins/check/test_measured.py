"""Declarations for real measurements are checked: a density, and missing components."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oracles.clocked import with_clock
from oracles.systems import one_state
from pfdist import StateSpaceModel, load_model
from pfdist.filters import plain
from pfdist.models import installed_models
from pfdist.plugins.check.measured import missing_components, normalised
from pfdist.plugins.check.model_checks import check_loaded
from pfdist.runner.likelihood import Within

SHIPPED = [name for name, (module, _) in installed_models().items() if "pfdist" in module]
HALF_LOG_2_PI = math.log(2 * math.pi) / 2


def _normal(apart: Any, sd: Any) -> Any:
    return -0.5 * (apart / sd) ** 2 - np.log(sd) - HALF_LOG_2_PI


def _model(measurement: Any, log_likelihood: Any, *noise: str, **fields: Any) -> StateSpaceModel:
    return one_state(
        "mine",
        transition=lambda x, t, w, p: (0.9 * x[0] + w[0],),
        measurement=measurement,
        log_likelihood=log_likelihood,
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


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.zoo] * (name in ("robot", "bearings_only")))
        for name in SHIPPED
    ],
)
def test_a_model_that_ships_is_normalised_if_it_says_so_and_only_then(name: str) -> None:
    for _, model, *_ in with_clock(load_model(name), 12).ways:  # one for each sensor
        is_one = _looked(normalised, model)[0] == "ok"
        # A robot measures angles: the integral over a circle is 1, and over all numbers more.
        assert is_one is model.normalised or (is_one and name == "robot")


@pytest.mark.parametrize(
    ("measurement", "says"),
    [
        (
            lambda x, t, v, p: (np.maximum(x[0] + v[0], 0.5),),
            "over y cannot be checked: component 0 has a point mass at",
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


def test_check_model_looks_at_what_a_model_declares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfdist.plugins.check.model_checks._DRAWS", 50)
    monkeypatch.setattr(
        "pfdist.plugins.check.model_checks.enough_particles", lambda *given: given[-1]
    )
    text = "from dataclasses import replace\nfrom pfdist.models.library.ungm import model as ungm\n"
    text += "model = replace(ungm, normalised=True, missing_components=True)\n"
    (tmp_path / "mine.py").write_text(text)
    found = check_loaded(lambda: load_model("mine.py:model", tmp_path), 12, 20)
    checks = {check.name: check for check in found}
    assert checks["normalised"].state == "wrong"
    assert checks["missing components"].state == "note"
    assert "expected MSE" in checks
