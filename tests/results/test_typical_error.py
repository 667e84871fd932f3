"""The typical error is the root of the expected MSE, in the unit of each component of z."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

import pfdist
from pfdist import Job, Problem, StateSpaceModel
from pfdist.common.component_names import named_component
from pfdist.filters.other_estimate import SMOOTHED
from pfdist.problem.problem_section import ProblemSection
from pfdist.questions.evaluate import Evaluated, Evaluation, evaluated
from pfdist.questions.subject import Subject
from pfdist.results.columns import Row

WALKS = StateSpaceModel(
    name="walks",
    initial=lambda w, p: (w[0], w[1]),
    transition=lambda x, t, w, p: (x[0] + w[0], x[1] + 0.1 * w[1]),
    measurement=lambda x, t, v, p: (x[0] + v[0], x[1] + v[1]),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2),
    quantity_of_interest=lambda x, t, p: (x[0], x[1]),
    initial_noise=("normal", "normal"),
    process_noise=("normal", "normal"),
    measurement_noise=("normal", "normal"),
    z_names=("place [m]", "angle"),
)


def _run(model: StateSpaceModel, folder: Path, **problem: object) -> pfdist.Run:
    asked = Problem(model=model, horizon=8, measurement_budget=3, **problem)
    sets = {"early": [0, 1, 2], "regular": "regular"}
    return pfdist.compare(asked, times=sets, results=folder, draws=100, figures=False)


def test_components_share_the_expected_error(tmp_path: Path) -> None:
    run = _run(WALKS, tmp_path / "run")
    for row in Subject(run).rows.values():
        first, second = row.typical_error
        assert first**2 + second**2 == pytest.approx(row.expected_mse)
        assert first > second > 0  # the second walk has a tenth of the noise
        assert Subject(run).typical_errors(row) == f"place {first:.3g} m, angle {second:.3g}"


def test_an_angle_has_a_circular_deviation(tmp_path: Path) -> None:
    model = dataclasses.replace(WALKS, circular=("angle",))
    run = _run(model, tmp_path / "run")
    rows = run.table("trajectories")
    z, estimate = (rows[f"{start}angle"] for start in ("z_", "estimate_early_"))
    mean_cosine = float(np.cos(z - estimate).mean())
    row = Subject(run).rows["early"]
    assert row.typical_error[1] == pytest.approx(math.sqrt(-2 * math.log(mean_cosine)), rel=0.05)
    assert Subject(run).typical_errors(row).endswith(" rad")
    # 1 - cos of a direction of which nothing is known is 1 on average: it has no deviation.
    some, none = (Row(typical_error=[1.0, angle]) for angle in (0.5, math.inf))
    assert (
        Subject(run).typical_errors(some, none) == "place 1.00 m (no difference), angle 0.500 rad"
    )
    assert Subject(run).typical_errors(none, some) == ""
    share = dataclasses.replace(WALKS, z_names=("place [%]", "angle"))  # no share of the place
    row = Subject(shared := _run(share, tmp_path / "share")).rows["early"]
    assert " percentage points, angle " in Subject(shared).typical_errors(row)


@pytest.mark.parametrize("others", [{}, {"b": math.inf}, {"b": 1.0}])
def test_no_headline_says_infinite(others: dict[str, float]) -> None:
    sets = {
        name: Evaluation((0,), np.full(2, mse)) for name, mse in {"": math.inf, **others}.items()
    }
    quantity = named_component("place [m]")
    problem = ProblemSection(horizon=4, measurement_budget=1)
    beside, broken = {SMOOTHED: sets}, dict.fromkeys(sets, ())
    page = Evaluated(sets, beside, problem, broken, (), 1.0, quantity)._page()
    assert "not finite" in page.sections[0].blocks[0].text
    assert "infinite" not in page.sections[0].blocks[0].text


def test_it_is_unknown_where_errors_are_not_squares_in_the_unit_of_z(tmp_path: Path) -> None:
    own = dataclasses.replace(WALKS, error=lambda z, e, t, p: abs(z[0] - e[0]))
    run = _run(own, tmp_path / "own")
    assert Subject(run).rows["early"].typical_error is None
    assert Subject(run).typical_errors(Subject(run).rows["early"]) == ""


def test_components_share_a_weighted_error_by_their_weighted_errors(tmp_path: Path) -> None:
    run = _run(WALKS, tmp_path / "run", instant_weights=[0.0] * 8 + [1.0])
    rows = run.table("trajectories")
    last = rows[rows["t"] == 8]
    errors = [
        float(((last[f"z_{each}"] - last[f"estimate_early_{each}"]) ** 2).mean())
        for each in ("place", "angle")
    ]
    row = Subject(run).rows["early"]
    shares = [error / sum(errors) * row.expected_mse for error in errors]
    assert row.typical_error == pytest.approx(np.sqrt(shares).tolist())


def test_evaluate_says_it_unless_errors_are_scaled(small_job: Job) -> None:
    scenarios = "scenarios.parameters=[{process_sd=1.0}, {process_sd=2.0}]"
    for scales, is_said in (("[1.0, 1.0]", True), ("[1.0, 4.0]", False)):
        changes = [scenarios, f"scenarios.scales={scales}"]
        answer = evaluated(str(small_job.path), times={"": "0,4,8"}, draws=50, changes=changes)
        assert ("typical error" in repr(answer._page())) is is_said
