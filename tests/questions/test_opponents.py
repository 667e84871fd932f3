"""The gain over the best opponent: of situations in which a restricted list made it too large."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.even import even_instants
from pfdist import Sensor, StateSpaceModel
from pfdist.questions.run_page import answer_of

T = 24


def _systems() -> tuple[StateSpaceModel, StateSpaceModel]:
    """A scalar system with random variances at each instant, with one sensor and with two."""
    rng = np.random.default_rng(0)
    variances = [rng.uniform(low, high, T + 1) for low, high in ((0.05, 1.5), *[(0.2, 2.5)] * 2)]
    q, r, s = (tuple(np.sqrt(np.round(each**2, 3)).tolist()) for each in variances)
    common: dict[str, Any] = {
        "initial": lambda w, p: (2.0 * w[0],),
        "transition": lambda x, t, w, p: (0.95 * x[0] + p.q[t] * w[0],),
        "quantity_of_interest": lambda x, t, p: (x[0],),
        "initial_noise": ("normal",),
        "process_noise": ("normal",),
        "parameters": {"q": q, "r": r, "s": s},
        "linear_gaussian": True,
    }
    a = Sensor(
        lambda x, t, v, p: (x[0] + p.r[t] * v[0],),
        lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.r[t]) ** 2,
        ("normal",),
    )
    b = Sensor(
        lambda x, t, v, p: (x[0] + p.s[t] * v[0],),
        lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.s[t]) ** 2,
        ("normal",),
    )
    single = StateSpaceModel(
        name="one", measurement=a.measurement, log_likelihood=a.log_likelihood,
        measurement_noise=("normal",), **common,
    )  # fmt: skip
    return single, StateSpaceModel(name="two", sensors={"a": a, "b": b}, **common)


def _season() -> StateSpaceModel:
    """A scalar system whose noise, and that of its sensor, change with the season."""
    rng, t = np.random.default_rng(0), np.arange(25)
    phase, period = rng.uniform(0, 6.28), rng.uniform(5, 12)
    q = 0.5 + 0.45 * np.sin(2 * np.pi * t / period + phase)
    r = np.abs(0.8 + 0.6 * np.sin(2 * np.pi * t / period * rng.uniform(0.8, 1.3)))
    return replace(
        ONE, name="season", parameters={"q": tuple(q.tolist()), "r": tuple(r.tolist())},
    )  # fmt: skip


ONE, TWO = _systems()
WALK: dict[str, Any] = {"horizon": 10, "measurement_budget": 3}
SITUATIONS: dict[str, tuple[Any, dict[str, Any], float]] = {
    "two sensors": (TWO, {"horizon": T, "measurement_budget": 5}, 0.13595),
    "prices": (ONE, {"horizon": T, "price": [1] * 12 + [2] * 13, "total_price": 8}, 0.038650),
    "repeats": ("random_walk", {**WALK, "sensor": {"repeats": 2}}, 0.0),
    "a model that ships": (
        "two_compartments",
        {**WALK, "time_step": 1, "sensors": ["immunoassay", "chromatography"]},
        0.0,
    ),
    # 0, 7, 15, 23 are every 7.5 from 0.
    "a tie": (
        _season(), {"horizon": 24, "measurement_budget": 4, "estimate": "smoothed"}, 0.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("situation", SITUATIONS)
def test_the_gain_is_that_over_the_best_evenly_spaced_set(situation: str, tmp_path: Path) -> None:
    """Two independent enumerations with exact errors found these gains."""
    model, keys, gain = SITUATIONS[situation]
    problem = pfdist.Problem(model, engine="kalman", **keys)
    run = pfdist.plan(
        problem, tmp_path / "run", changes=["comparison.draws=2"], bound_draws=0, figures=False
    )
    plan = run.table("sets").set_index("label").loc["plan"]
    assert plan["gain_of_means"] == pytest.approx(gain, abs=1e-5)


def test_the_headline_names_the_best_of_all_opponents(tmp_path: Path) -> None:
    """The best of given sets and evenly spaced ones is chosen; it has its label."""
    best, worse = [0, 1, 6, 11], [1, 2, 3, 4]
    problem = pfdist.Problem("random_walk", engine="kalman", horizon=11, measurement_budget=4)
    for given, is_best in ((worse, False), ([0, 3, 6, 9], False), (best, None)):
        changes = [f"comparison.sets={{hand={given}}}", "comparison.labels={hand='as others do'}",
                   "comparison.draws=2"]  # fmt: skip
        path = tmp_path / "-".join(map(str, given))
        run = pfdist.plan(problem, path, changes=changes, bound_draws=0, figures=False)
        rows = run.table("sets").set_index("name")
        least = rows.loc[["hand", "evenly_spaced"], "expected_mse"].idxmin()
        assert run.names[0] == (least if is_best is None else "evenly_spaced")
        assert rows.loc["hand", "label"] == "as others do"


def test_a_given_set_that_is_better_than_evenly_spaced_ones_is_the_reference(
    tmp_path: Path,
) -> None:
    problem = pfdist.Problem(TWO, engine="kalman", horizon=T, measurement_budget=5)
    sets = "{hand=['1 b', '7 a', '11 b', '16 b', '20 b']}"
    changes = [f"comparison.sets={sets}", "comparison.labels={hand='as others do'}",
               "comparison.draws=2"]  # fmt: skip
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    assert run.names[:2] == ["hand", "evenly_spaced"]
    assert {*run.references.values()} == {"hand"}
    text = re.sub(r"\s+", " ", str(answer_of(run)))
    assert 'with "as others do" (the best opponent)' in text


def test_evenly_spaced_times_contain_the_required_ones(tmp_path: Path) -> None:
    """0, 7, 8 is not evenly spaced: 0, 7, 14 is. Gaps of 7 and 1 differ by more than a rounding."""
    problem = pfdist.Problem(
        ONE, engine="kalman", horizon=T, measurement_budget=3, required=[7]
    )  # fmt: skip
    changes = ["comparison.draws=2"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    even = [*map(int, run.sets["evenly_spaced"])]
    assert 7 in even
    assert abs((even[2] - even[1]) - (even[1] - even[0])) <= 1
    sets = [each for each in even_instants(range(T + 1), 3) if 7 in each]
    errors = [pfdist.evaluate(problem, each).expected_mse for each in sets]
    rows = run.table("sets").set_index("name")
    assert rows.loc["evenly_spaced", "expected_mse"] == pytest.approx(min(errors), rel=1e-9)


def test_where_no_evenly_spaced_times_contain_the_required_ones_regular_times_are_the_reference(
    tmp_path: Path,
) -> None:
    keys = {"horizon": 60, "measurement_budget": 6, "required": [0, 1, 2, 40]}
    problem = pfdist.Problem("random_walk", engine="kalman", **keys)
    changes = ["comparison.draws=2"]
    run = pfdist.plan(problem, tmp_path / "run", changes=changes, bound_draws=0, figures=False)
    assert run.names[0] == "regular"
    said = " ".join(str(answer_of(run)).split())
    assert "instead of" in said
    assert "with regular times" in said
    assert "No evenly spaced times include all required ones." in said
    job = pfdist.Problem("random_walk", horizon=60, measurement_budget=24, required=[6]).job()
    assert job.comparison.reference == "evenly spaced"


def test_labels_name_given_sets() -> None:
    problem = pfdist.Problem("random_walk", horizon=11, measurement_budget=4)
    with pytest.raises(pfdist.PfdistError, match=r"comparison.labels must name sets .* 'mine'"):
        problem.job().with_changes(["comparison.labels={mine='hers'}"])


@pytest.mark.parametrize("engine", ["kalman", "compiled"])
def test_where_no_evenly_spaced_set_is_possible_the_plan_is_still_found(
    engine: str, tmp_path: Path
) -> None:
    """Four measurements at three instants: all of one sensor, and the only one of the other."""
    problem = pfdist.Problem(
        TWO, horizon=T, measurement_budget=4, allowed=[20, 21, 22], engine=engine, particles=50,
        sensors={"a": {"most": 1}, "b": {}},
    )  # fmt: skip
    run = pfdist.plan(
        problem, tmp_path / "run", pool="serial", bound_draws=0,
        changes=["comparison.draws=240"], figures=False, report=False,
    )  # fmt: skip
    assert run.best is not None
    measured = sorted(run.best.measurement_times)
    assert [each for each in measured if "b" in each] == ["20 b", "21 b", "22 b"]
