"""Lower bounds of finished runs, against brute force and where a filter fools itself."""

import json
import math
from pathlib import Path

import pytest

import pfdist
from pfdist import Job, load_job
from pfdist.api.bound import LEAST_DRAWS, bound
from pfdist.cli.main import main
from pfdist.errors import JobError, ModelError, StoreError
from pfdist.evaluation.problem import Problem

SHARP = Path(__file__).parents[1] / "oracles" / "sharp_sensor.toml"
QUICK = ["search.random.evaluations=3", "search.genetic.generations=1", "comparison.draws=20"]
EXACT = ["model.name=random_walk", "filter.engine=kalman"]
OUTLIERS = """
from pfdist import StateSpaceModel, where
import numpy as np

def log_likelihood(y, x, t, p):
    d = y[0] - x[0]
    sharp = 0.9 / 0.01 * np.exp(-0.5 * (d / 0.01) ** 2)
    return np.log(sharp + 0.1 / 3 * np.exp(-0.5 * (d / 3) ** 2) + 1e-300)

model = StateSpaceModel(
    name="outliers",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (x[0] + 0.5 * w[0],),
    measurement=lambda x, t, v, p: (x[0] + where(v[1] < 0.9, 0.01, 3.0) * v[0],),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal", "uniform"),
)
"""


def _run(job: Job, folder: Path, *changes: str) -> pfdist.Run:
    return pfdist.run(job.with_changes([*QUICK, *changes]), folder, figures=False)


@pytest.mark.parametrize("window", [1, 2, 5])
def test_where_everything_is_known_it_lies_below_the_optimum(
    small_job: Job, tmp_path: Path, window: int
) -> None:
    found = bound(_run(small_job, tmp_path / "run", *EXACT).path, window=window)
    job = small_job.with_changes(EXACT)
    problem = Problem(pfdist.load_model("random_walk"), 12, engine="kalman")
    optimum = min(problem.expected_mse(list(job.problem.feasible.every())))
    assert found.draws == found.particles == 0
    for gap in found.gaps:
        assert gap.bound.value <= optimum * (1 + 1e-12)
        assert gap.bound.standard_error == 0.0
        assert gap.gap == gap.gap_at_most
        assert gap.gap * gap.expected_mse.value == pytest.approx(
            gap.expected_mse.value - gap.bound.value
        )
    if window == 5:  # nothing is added to 4 measurements, and no gap is too long
        assert found.gaps[0].bound.value == pytest.approx(optimum)


def test_with_particles_it_lies_below_the_optimum_but_for_its_error(
    small_job: Job, tmp_path: Path
) -> None:
    run = _run(small_job, tmp_path / "run", "model.name=random_walk", "filter.particles=200")
    found = bound(run.path, LEAST_DRAWS)
    problem = Problem(pfdist.load_model("random_walk"), 12, engine="kalman")
    optimum = min(problem.expected_mse(list(small_job.problem.feasible.every())))
    for gap in found.gaps:
        assert not gap.reason
        assert gap.bound.value < optimum + 4 * gap.bound.standard_error
        assert gap.bound.value > 0.9 * optimum
        assert gap.gap < gap.gap_at_most < gap.gap + 0.1
        parts = gap.relaxation.value + gap.estimate.value + gap.filter_model.value
        assert parts == pytest.approx(gap.gap * gap.expected_mse.value)
        assert gap.filter_model.value == 0.0
    assert bound(run.path, LEAST_DRAWS).as_json() == found.as_json()


def test_a_wrong_model_of_the_filter_is_a_part_of_the_gap(small_job: Job, tmp_path: Path) -> None:
    wrong = ["model.name=random_walk", "model.filter.parameters.step_sd=5.0"]
    found = bound(_run(small_job, tmp_path / "run", *wrong).path, LEAST_DRAWS)
    for gap in found.gaps:
        assert gap.filter_model.value > 4 * gap.filter_model.standard_error > 0


@pytest.mark.parametrize("sharp", [0.03, 0.01])
def test_a_filter_that_fools_itself_gives_no_false_bound(sharp: float, tmp_path: Path) -> None:
    """The "bound" by squared errors would be 3.45 for 0.03, above a set that costs 1.00."""
    changes = [f"model.parameters.sharp={sharp}", "comparison.draws=1000"]
    run = pfdist.plan(load_job(SHARP, changes), tmp_path / "run", figures=False)
    for gap in bound(run.path, LEAST_DRAWS).gaps:
        assert gap.reason or gap.bound.value < 1.0


def test_a_sensor_with_outliers_gives_no_false_bound(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "outliers.py").write_text(OUTLIERS)
    run = _run(small_job, tmp_path / "run", "model.name=outliers.py:model", "filter.particles=500")
    for gap in bound(run.path, LEAST_DRAWS).gaps:
        assert "falls" in gap.reason
        assert "2000 particles in the place of 500" in gap.reason
        assert math.isnan(gap.bound.value)
        assert math.isnan(gap.gap_at_most)


INFLATED = """
from dataclasses import replace
from pfdist import load_model
walk = load_model("random_walk")
model = replace(walk, log_likelihood=lambda y, x, t, p:
    -0.5 * ((y[0] - x[0]) / (1.2 * p.measurement_sd)) ** 2, linear_gaussian=False)
"""
STATIC = """
from pfdist import StateSpaceModel, where
import numpy as np

def log_likelihood(y, x, t, p):
    d = y[0] - x[0]
    sharp = np.log(0.9 / 0.01 * np.exp(-0.5 * (d / 0.01) ** 2)
        + 0.1 / 30 * np.exp(-0.5 * (d / 30) ** 2) + 1e-300)
    return where(t % 2 == 0, -0.5 * d**2, sharp)

model = StateSpaceModel(
    name="static",
    initial=lambda w, p: (3 * w[0],),
    transition=lambda x, t, w, p: (x[0],),
    measurement=lambda x, t, v, p: (
        x[0] + where(t % 2 == 0, 1.0, where(v[1] < 0.9, 0.01, 30.0)) * v[0],
    ),
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal", "uniform"),
)
"""


def test_a_likelihood_that_is_not_the_truths_gives_no_bound(small_job: Job, tmp_path: Path) -> None:
    """A likelihood with a larger sd than the noise: its variance exceeds the squared error."""
    (small_job.path.parent / "inflated.py").write_text(INFLATED)
    changes = ("model.name=inflated.py:model", "filter.particles=200")
    for gap in bound(_run(small_job, tmp_path / "run", *changes).path, LEAST_DRAWS).gaps:
        assert "exceeds their squared error" in gap.reason or "costs less" in gap.reason


def test_the_guard_looks_where_the_path_does_not_go(small_job: Job, tmp_path: Path) -> None:
    """A sharp sensor with outliers at odd instants; few particles make it look worthless."""
    (small_job.path.parent / "static.py").write_text(STATIC)
    changes = ("model.name=static.py:model", "filter.particles=200")
    for gap in bound(_run(small_job, tmp_path / "run", *changes).path, LEAST_DRAWS).gaps:
        assert "falls" in gap.reason


def test_a_reference_that_is_not_feasible_has_no_gap(small_job: Job, tmp_path: Path) -> None:
    changes = ("comparison.reference=[1, 3, 6, 9]", "problem.forbidden=[3, 4]")
    found = bound(_run(small_job, tmp_path / "run", *EXACT, *changes).path)
    reasons = {gap.name: gap.reason for gap in found.gaps}
    assert reasons == {"reference": "the set is not feasible", "genetic": "", "random": ""}


def test_where_nothing_is_unknown_the_gap_is_zero(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "known.py").write_text(
        "from pfdist import linear_gaussian\n"
        "model = linear_gaussian('known', initial_noise=[[0.0]], transition=[[1.0]],\n"
        "    process_noise=[[0.0]], measurement=[[1.0]], measurement_noise=[[1.0]],\n"
        "    quantity_of_interest=[[1.0]])\n"
    )
    changes = ("model.name=known.py:model", "filter.engine=kalman")
    for gap in bound(_run(small_job, tmp_path / "run", *changes).path).gaps:
        assert (gap.gap, gap.gap_at_most, gap.reason) == (0.0, 0.0, "")


def test_a_set_with_degenerate_draws_has_no_gap(small_job: Job, tmp_path: Path) -> None:
    (small_job.path.parent / "cut.py").write_text(
        "from dataclasses import replace\n"
        "import numpy as np\n"
        "from pfdist import load_model, where\n"
        "walk = load_model('random_walk')\n"
        "model = replace(walk, log_likelihood=lambda y, x, t, p:\n"
        "    where(abs(y[0] - x[0]) > 3.5, -np.inf, -0.5 * (y[0] - x[0]) ** 2))\n"
    )
    changes = ("model.name=random_walk", "model.filter.name=cut.py:model")
    leave_out = ("evaluation.degenerate_draws=leave_out", "filter.particles=5")
    for gap in bound(_run(small_job, tmp_path / "run", *changes, *leave_out).path).gaps:
        assert gap.reason == "a draw is degenerate or infinite with the set itself"


def test_the_command_says_how_much_is_left(
    small_job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _run(small_job, tmp_path / "run", *EXACT)
    assert main(["bound", str(run.path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert list(answer["sets"]) == ["regular", "genetic", "random"]
    assert answer == bound(run.path).as_json()
    assert main(["bound", str(run.path)]) == 0
    text = capsys.readouterr().out
    for name, gap in answer["sets"].items():
        assert f"{name}: 4 measurements" in text
        percent = f"{100 * gap['gap']:.2g} %"
        assert f"no other 4 times can lower the error by more than {percent}" in text


def test_an_unfinished_run_and_wrong_numbers_are_refused(small_job: Job, tmp_path: Path) -> None:
    def stop(progress: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pfdist.run(small_job, tmp_path / "run", report=stop, figures=False)
    with pytest.raises(StoreError, match="is not finished"):
        bound(tmp_path / "run")
    for wrong in ({"draws": LEAST_DRAWS - 1}, {"particles": 0}, {"window": 0}, {"window": 7}):
        (name,) = wrong
        with pytest.raises(JobError, match=f"{name} must be"):
            bound(tmp_path / "run", **wrong)  # type: ignore[arg-type]


def test_where_no_bound_is_known_one_line_says_why(small_job: Job, tmp_path: Path) -> None:
    text, costs = small_job.path.read_text(), [3 + t % 2 for t in range(13)]
    path = small_job.path.with_name("priced.toml")
    path.write_text(text.replace("measurement_budget = 4", f"total_cost = 20\ncost = {costs}"))
    priced = load_job(path)
    with pytest.raises(JobError, match="measurements have costs"):
        bound(_run(priced, tmp_path / "priced").path)
    mine = small_job.path.parent / "mine.py"
    mine.write_text(
        "from dataclasses import replace\n"
        "from pfdist import load_model\n"
        "model = replace(load_model('ungm'), error=lambda z, e, t, p: abs(z[0] - e[0]))\n"
    )
    with pytest.raises(ModelError, match="squared Euclidean norm"):
        bound(_run(small_job, tmp_path / "own", "model.name=mine.py:model").path)
