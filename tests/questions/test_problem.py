"""A problem that is handed over in Python is the problem of a job file."""

import inspect
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.in_turn import in_turn
from oracles.systems import one_state
from pfdist import Problem, Run, StateSpaceModel
from pfdist.common.section import keys_of_section
from pfdist.errors import PfdistError, RunMismatchError, StoreError
from pfdist.models.library import epidemic
from pfdist.models.recorded import differences
from pfdist.problem.job import job_toml, load_job
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.sections import FilterSection
from pfdist.runner.build import build

IN_NUMPY = {"horizon": 10, "measurement_budget": 3, "particles": 30, "engine": "numpy"}
"""For tests in which the engine makes no difference: nothing is compiled."""
SHORT = {"horizon": 10, "measurement_budget": 3, "particles": 30}
SECTIONS: dict[str, Any] = {
    "search": [{"method": "random", "evaluations": 3}],
    "comparison": {"draws": 40},
    "evaluation": {"draws": 10},
}


def robot_of(gain: float, sd: float = 0.7) -> StateSpaceModel:
    """A model whose formulas are closures over an array and a function."""
    table = np.array([gain, 0.3])

    def steered(x: Any) -> Any:
        return table[0] * x + table[1] * np.sin(x)

    return one_state(
        "robot",
        transition=lambda x, t, w, p: (steered(x[0]) + p.sd * w[0],),
        measurement=lambda x, t, v, p: (x[0] + 0.5 * v[0],),
        log_likelihood=lambda y, x, t, p: -2.0 * (y[0] - x[0]) ** 2,
        parameters={"sd": sd},
    )


def finished(problem: Problem, path: Path) -> Run:
    return pfdist.run(problem.job(**SECTIONS), path, pool="serial", figures=False)


def test_a_shipped_model_makes_the_run_of_the_job_file(tmp_path: Path) -> None:
    (tmp_path / "same.toml").write_text(
        'seed = 3\nmodel = {name = "ungm", parameters = {process_sd = 2.0}}\n'
        'problem = {horizon = 10, measurement_budget = 3, forbidden = ["4-6", 9]}\n'
        "filter = {particles = 30}\ncomparison = {draws = 40}\nevaluation = {draws = 10}\n"
        'search = [{method = "random", evaluations = 3}]\n'
    )
    of_file = load_job(tmp_path / "same.toml")
    model = pfdist.load_model("ungm").with_parameters({"process_sd": 2.0})
    problem = Problem(model, **SHORT, forbidden=[range(4, 7), np.int64(9)])
    job = problem.job(seed=3, **SECTIONS)
    assert job_toml(job.identity()) == job_toml(of_file.identity())
    here, there = tmp_path / "here", tmp_path / "there"
    pfdist.run(job, here, pool="serial", figures=False)
    pfdist.run(of_file, there, pool="serial", figures=False)
    assert hashes(here) == hashes(there)
    assert pfdist.run(of_file, here, pool="serial", figures=False).state == "finished"


def test_every_key_of_the_sections_is_an_argument() -> None:
    arguments = set(inspect.signature(Problem).parameters)
    keys = {*keys_of_section(ProblemSection), *keys_of_section(FilterSection)}
    assert arguments == keys | {"model", "filter_model", "scenarios"}
    doc = inspect.getdoc(Problem)
    assert doc is not None
    assert all(key in doc for key in keys)


@in_turn(
    ("forbidden", "section"),
    [
        (range(4, 7), ("4-6",)),
        (range(0, 6, 2), (0, 2, 4)),
        (range(1), (0,)),
        (np.array([4, 5]), (4, 5)),
        (pd.Series([4, 5]), (4, 5)),
        (["4-6", range(8, 10)], ("4-6", "8-9")),
        ({5, "7-8", np.int64(4), range(1, 3)}, (1, 2, 4, 5, "7-8")),
        (None, None),
    ],
)
def test_times_may_be_ranges_arrays_and_lists(forbidden: Any, section: Any) -> None:
    assert Problem("ungm", **SHORT, forbidden=forbidden).job().problem.forbidden == section


def test_on_a_clock_a_range_of_python_means_the_numbers_that_it_lists() -> None:
    """The text "2-4" would mean the half hours between them, too."""
    for forbidden, times in (
        (range(2, 5), {2, 3, 4}),
        ([range(2, 4), 7], {2, 3, 7}),
        ({3, "6-7", np.int64(2)}, {2, 3, 6, 6.5, 7}),
    ):
        problem = Problem("ungm", **SHORT, time_step=0.5, forbidden=forbidden).job().problem
        assert set(problem.clock.times_of(problem.feasible.forbidden)) == times


def test_ranges_arrays_and_mappings_may_stand_for_numbers() -> None:
    def problem(**keys: Any) -> Any:
        return Problem("ungm", **keys).job().problem

    assert problem(measurement_budget=3, times=range(25)).clock.times == tuple(range(25))
    weights = problem(measurement_budget=3, horizon=3, instant_weights=range(4)).weights
    assert weights == (0.0, 2 / 3, 4 / 3, 2.0)
    for written, given in (
        ("first", (4, 0, 0, 0)),
        ("last", (0, 0, 0, 4)),
        ({0: 0, "1:2": 1, "3": 2}, (0, 1, 1, 2)),
    ):
        short = problem(measurement_budget=3, horizon=3, instant_weights=written)
        long = problem(measurement_budget=3, horizon=3, instant_weights=given)
        assert short.weights == long.weights
    for price, prices in (
        (range(1, 5), (1, 2, 3, 4)),
        (np.ones(4, int), (1, 1, 1, 1)),
        ({0: 1, "1-3": 2}, (1, 2, 2, 2)),
    ):
        assert problem(horizon=3, total_price=9, price=price).feasible.price == prices


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: Problem("ungm", **SHORT, forbidden=range(-5, 0)), r"must lie in 0\.\.10, got -5"),
        (lambda: Problem("ungm", **SHORT).job(filter={}), "unknown section 'filter', allowed: "),
        (lambda: pfdist.evaluate("job.toml", [0]), "'python:robot' was given as an object in Py"),
    ],
)
def test_a_mistake_is_named(
    call: Callable[[], object], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("job.toml").write_text(
        'seed = 3\nmodel.name = "python:robot"\nproblem = {horizon = 10, measurement_budget = 3}\n'
    )
    with pytest.raises(PfdistError, match=words):
        call()


def test_a_problem_is_frozen_shown_and_can_be_changed_into_another() -> None:
    problem = Problem("ungm", **SHORT)
    with pytest.raises(AttributeError, match="frozen"):
        problem.horizon = 3  # type: ignore[attr-defined]
    longer = problem.with_changes(horizon=20)
    assert (problem.job().problem.horizon, longer.job().problem.horizon) == (10, 20)
    assert problem == longer.with_changes(horizon=10) != longer
    assert "<td>ungm</td>" in problem._repr_html_()


def test_a_problem_computes_with_the_model_as_it_is() -> None:
    """A constant that changes between two calls is another model, as Python has it."""
    table = np.array([0.5])
    model = replace(robot_of(0.5), transition=lambda x, t, w, p: (table[0] * x[0] + w[0],))
    problem = Problem(model, **IN_NUMPY)
    first = build(problem.job()).evaluator.model
    table[0] = 0.9
    changed = dict(differences(first, build(problem.job()).evaluator.model))
    assert changed == {"transition": "the constant 0.5 -> 0.9"}


def test_equal_objects_for_truth_and_filter_are_the_true_model() -> None:
    alike = Problem(robot_of(0.8), **SHORT, filter_model=robot_of(0.8))
    evaluator = build(alike.job()).evaluator
    assert evaluator.believed == evaluator.model
    assert evaluator.variance_is_error


@pytest.mark.plugins("online", "why")
@pytest.mark.slow
def test_questions_about_a_problem_find_its_run_and_need_no_object(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def job_of(model: StateSpaceModel) -> pfdist.Job:
        return Problem(model, **IN_NUMPY).job(**SECTIONS, execution={"pool": "serial"})

    monkeypatch.chdir(tmp_path)
    job = job_of(robot_of(0.8))
    with pytest.raises(StoreError, match=r"run of this job in results/robot.*run\(problem\)"):
        pfdist.why(job, draws=20)
    run = pfdist.run(job, figures=False)
    found = pfdist.why(job, draws=20, figures=False)
    assert found.run == Path("results/robot").absolute()
    assert set(found.sets["name"]) == {"evenly_spaced", "random"}
    pd.testing.assert_frame_equal(found.worth, pfdist.why(run, draws=20, figures=False).worth)
    measured = pd.DataFrame({"t": [0], "y0": [0.3]})
    assert pfdist.next_time(job, measured).measured == (0,)

    assert 'name = "python:robot"' in (run.path / "job.toml").read_text()
    for file in run.path.rglob("*"):
        assert not file.is_file() or b"cloudpickle" not in file.read_bytes()
    of_folder = pfdist.why(run.path, draws=20, figures=False)
    pd.testing.assert_frame_equal(found.worth, of_folder.worth)
    with pytest.raises(RunMismatchError, match=r"model\.transition: .* \S+ -> \S+$"):
        pfdist.why(job_of(robot_of(0.9)))
    with pytest.raises(RunMismatchError, match=r"model\.parameters\.sd: 0\.7 -> 0\.6$"):
        pfdist.why(job_of(robot_of(0.8, sd=0.6)))
    with pytest.raises(RunMismatchError, match=r"model\.transition"):
        pfdist.run(job_of(robot_of(0.9)), figures=False)


def test_the_bound_of_an_objects_run_is_proved(tmp_path: Path) -> None:
    linear = replace(
        robot_of(0.8),
        transition=lambda x, t, w, p: (0.8 * x[0] + p.sd * w[0],),
        linear_gaussian=True,
    )
    problem = Problem(linear, horizon=10, measurement_budget=3, engine="kalman")
    run = finished(problem, tmp_path / "run")
    job = problem.job(**SECTIONS)
    for proved in (pfdist.bound(run), pfdist.bound(job, results=run.path)):
        assert {gap.name for gap in proved.gaps} == {"evenly_spaced", "random"}
        assert all(gap.bound.value <= gap.expected_mse.value for gap in proved.gaps)


EPIDEMIC: dict[str, Any] = {"horizon": 6, "time_unit": "d", "measurement_budget": 3}


def with_fewer_days() -> pfdist.StateSpaceModel:
    """The epidemic that ships, with another value of a parameter."""
    return replace(epidemic.model, parameters={**epidemic.model.parameters, "infectious_days": 5.0})


def test_an_installed_model_is_known_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(epidemic, "SUBSTEPS", 1)  # two steps are traced more slowly than one
    for model in (epidemic.model, with_fewer_days(), pfdist.load_model("epidemic")):
        assert Problem(model, **EPIDEMIC).job().model.name == "epidemic"


@pytest.mark.plugins("simulate")
def test_simulated_draws_are_a_tidy_table_and_begin_alike() -> None:
    problem = Problem(robot_of(0.8), **IN_NUMPY)
    many, few = (pfdist.simulate(problem, draws=draws) for draws in (50, 20))
    assert list(many) == ["draw", "t", "x_0", "y_0", "z_0"]
    assert many.groupby("draw")["t"].apply(list).map(lambda t: t == list(range(11))).all()
    pd.testing.assert_frame_equal(many[many["draw"] < 20], few)
    assert (many["x_0"] == many["z_0"]).all()
    noise = pfdist.simulate(problem, draws=2000)
    error = (noise["y_0"] - noise["x_0"]).std()
    assert error == pytest.approx(0.5, abs=5 * 0.5 / np.sqrt(2 * len(noise)))
    assert not many.equals(pfdist.simulate(problem, draws=50, seed=1))


@pytest.mark.plugins("check")
def test_a_wrong_model_is_a_row_of_the_checks() -> None:
    diverging = replace(robot_of(0.8), transition=lambda x, t, w, p: (x[0] / 0.0 + w[0],))
    assert pfdist.check_model(diverging, horizon=10)["state"].tolist()[-1] == "wrong"


@pytest.mark.plugins("filter", "online")
def test_measurements_and_priors_may_be_data_frames(tmp_path: Path) -> None:
    run = finished(Problem("ungm", **SHORT), tmp_path / "run")
    table = pd.DataFrame({"t": [0, 4], "y0": [0.3, 1.2]})
    table.to_csv(tmp_path / "mine.csv", index=False)
    prior = pd.DataFrame({"x0": [0.1, 0.2, 0.4]})
    prior.to_csv(tmp_path / "prior.csv", index=False)
    for question in (pfdist.filter_measurements, pfdist.next_time):
        quiet = {"report": False} if question is pfdist.filter_measurements else {}
        of_frame = question(run, table, prior=prior, **quiet).as_json()
        files = tmp_path / "mine.csv", tmp_path / "prior.csv"
        of_file = question(run, files[0], prior=files[1], **quiet).as_json()
        for file in ("table", "figure", "report"):
            assert of_frame.pop(file, None) is None
            of_file.pop(file, None)
        of_frame.pop("measurements", None), of_file.pop("measurements", None)
        assert of_frame == of_file
    named = pfdist.filter_measurements(run, table.set_index("t"), out=tmp_path, prior=prior)
    assert [file.name for file in named.files] == [
        f"measurements.filtered.{ending}" for ending in ("csv", "png", "html")
    ]
    means = [pfdist.Filter("ungm", 3, prior=each).now.mean for each in (prior, prior.T.to_numpy())]
    assert means[0] == means[1]
