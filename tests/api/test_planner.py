"""The planner of one system, and the time to measure next by a run and a table."""

import re
from pathlib import Path

import numpy as np
import pytest

import oracles.kalman
import pfdist
from pfdist import Job, Planner
from pfdist.cli.main import main
from pfdist.common.streams import stream_of
from pfdist.errors import JobError, MeasurementsError, MeasurementTimesError
from pfdist.filters.simulation import simulate

JOB = """
seed = 3
[problem]
horizon = 14
measurement_budget = 5
[filter]
particles = 50
[comparison]
draws = 20
[online]
draws = 2
judging_draws = 32
[online.search]
method = "corridor"
rounds = 1
evaluation = { draws = 16, particles = 16 }
[execution]
pool = "serial"
"""
PLAN = (0, 3, 7, 10, 14)
Y = simulate(pfdist.load_model("ungm"), 14, range(3), 5).y


@pytest.fixture
def job(tmp_path: Path) -> Job:
    path = tmp_path / "job.toml"
    path.write_text(JOB)
    return pfdist.load_job(path)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> pfdist.Run:
    """A run that has compared the plan."""
    folder = tmp_path_factory.mktemp("planner")
    path = folder / "job.toml"
    path.write_text(JOB.replace("[online]\ndraws = 2\n", "[online]\ndraws = 2\n"))
    changes = ['search=[{method="survivors", evaluation={draws=20}}]']
    return pfdist.run(path, folder / "run", changes=changes, figures=False)


def measured(planner: Planner, system: int = 0, most: int = 99) -> list[tuple[int, ...]]:
    """Measure as planned, and give the plans after each measurement."""
    plans = [planner.plan()]
    while (time := planner.next_time()) is not None and len(plans) <= most:
        planner.update(Y[system, time], time)
        plans.append(planner.plan())
    return plans


def test_it_measures_the_whole_budget_and_keeps_the_constraints(job: Job) -> None:
    changed = job.with_changes(["problem.minimum_spacing=2", "problem.forbidden=[6, 7]"])
    planner = Planner(changed, times=(0, 3, 8, 10, 14))
    measured(planner)
    assert planner.plan() == ()
    assert changed.problem.feasible.accepts(planner.measured)


def test_it_replans_from_what_was_measured(job: Job) -> None:
    chosen = {measured(Planner(job, PLAN, draw=system), system)[-2] for system in range(3)}
    plans = {Planner(job, PLAN, draw=system).plan() for system in range(3)}
    assert plans == {PLAN}
    assert len(chosen) > 1


def test_a_planner_that_was_killed_goes_on_from_its_measurements(job: Job) -> None:
    whole = measured(Planner(job, PLAN))
    for killed in range(1, 5):
        before = Planner(job, PLAN)
        measured(before, most=killed)
        again = Planner(job, PLAN)  # another process, that is told the same
        for time in before.measured:
            again.update(Y[0, time], time)
        assert [before.plan(), *measured(again)] == whole[killed : killed + 1] + whole[killed:]


def test_its_estimates_are_those_of_the_filter(job: Job) -> None:
    planner, filtering = Planner(job, PLAN), pfdist.Filter(
        "ungm", 50, job.seed, resampling="multinomial"
    )  # fmt: skip
    for time in (0, 3):
        found, wanted = planner.update(Y[0, time], time), filtering.update(time, Y[0, time])
        np.testing.assert_array_equal(found.mean, wanted.mean)
    np.testing.assert_array_equal(planner.estimate(5).mean, filtering.predict(5).mean)
    assert planner.estimate().t == 3
    assert filtering.stream == stream_of("filter", job.seed)


def test_a_missed_measurement_may_be_made_later(job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 0], 0)
    missed = planner.next_time()
    assert missed is not None
    planner.missed()
    assert len(planner.plan()) == 4
    assert planner.plan()[0] > missed
    planner.missed(12)  # two instants are left
    assert planner.plan() == (13, 14)


def test_planned_times_that_are_passed_over_count_as_missed(job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 5], 5)
    assert planner.measured == (5,)
    assert len(planner.plan()) == 4
    assert planner.plan()[0] > 5


def test_without_times_a_search_makes_the_first_plan(job: Job) -> None:
    planner = Planner(job)
    assert job.problem.feasible.accepts(planner.plan())
    assert planner.plan() == Planner(job).plan()


def test_the_expected_error_of_an_exact_engine(tmp_path: Path) -> None:
    (tmp_path / "model.py").write_text(
        "from pfdist import linear_gaussian\n"
        "model = linear_gaussian('walk', initial_noise=[[1.0]], transition=[[0.9]],\n"
        "    process_noise=[[0.6]], measurement=[[1.0]], measurement_noise=[[0.4]],\n"
        "    quantity_of_interest=[[1.0]])\n"
    )
    (tmp_path / "job.toml").write_text(
        JOB.replace("seed = 3", 'seed = 3\n[model]\nname = "model.py:model"').replace(
            "particles = 50", 'engine = "kalman"'
        )
    )
    planner = Planner(tmp_path / "job.toml", PLAN)
    scalar = oracles.kalman.LinearGaussian(
        *(np.array([[value]]) for value in (0.9, 0.6, 1.0, 0.4, 1.0, 1.0))
    )
    (expected,) = planner.expected()
    assert expected.expected_mse == pytest.approx(oracles.kalman.riccati_cost(scalar, 14, PLAN))
    planner.update(0.3)
    (left,) = planner.expected((3, 7))
    kept = oracles.kalman.riccati_cost(scalar, 14, (0, 3, 7))  # from t = 0 on, as before
    assert left.expected_mse == pytest.approx(kept)
    assert left.standard_error == 0


def test_the_expected_error_is_that_of_the_comparison_before_anything_is_measured(
    job: Job,
) -> None:
    (found,) = Planner(job, PLAN).expected(draws=4000)
    wanted = pfdist.evaluate(job, PLAN, draws=4000)
    error = np.hypot(found.standard_error, wanted.standard_error)
    assert abs(found.expected_mse - wanted.expected_mse) < 4 * error


def test_wrong_times_are_named(job: Job) -> None:
    planner = Planner(job, PLAN)
    planner.update(Y[0, 3], 3)
    with pytest.raises(MeasurementsError, match=r"t must be at least 4, .* got 3"):
        planner.update(1.0, 3)
    with pytest.raises(MeasurementsError, match=r"t must lie in 0..14, got 15"):
        planner.update(1.0, 15)
    with pytest.raises(MeasurementsError, match="must be a number, got None"):
        planner.update(None)
    with pytest.raises(ValueError, match="at least 2, got 0"):
        planner.expected(draws=0)
    with pytest.raises(MeasurementTimesError, match=r"must be at least 4, got 2"):
        planner.expected((2, 9))
    planner.missed(6)
    with pytest.raises(MeasurementsError, match=r"t must be at least 7, .* got 6"):
        planner.update(1.0, 6)
    with pytest.raises(MeasurementTimesError, match=r"times\)|0..14"):
        Planner(job, (3, 15))
    with pytest.raises(MeasurementTimesError, match=r"problem.measurement_budget is 5, got 2"):
        Planner(job, (3, 9))
    planner = Planner(job, PLAN)
    measured(planner)
    with pytest.raises(MeasurementsError, match="no measurement is left"):
        planner.update(1.0)


# --- pfdist next --------------------------------------------------------------------------------


def write(path: Path, times: tuple[int, ...], missed: tuple[int, ...] = ()) -> Path:
    """Write a table of simulated measurements."""
    rows = [(t, f"{t},{float(Y[0, t, 0])!r}") for t in times] + [(t, f"{t},") for t in missed]
    path.write_text("t,y0\n" + "".join(f"{line}\n" for _, line in sorted(rows)))
    return path


def test_next_says_what_a_planner_says(run: pfdist.Run, tmp_path: Path) -> None:
    (planned,) = [times for name, times in run.sets().items() if name == "survivors"]
    planner = Planner(run.path / "job.toml", planned)
    times = []
    for _ in range(3):
        times.append(planner.next_time())
        planner.update(Y[0, times[-1]])
        found = pfdist.next_time(run, write(tmp_path / "y.csv", tuple(times)))
        assert (found.plan, found.next) == (planner.plan(), planner.next_time())
        assert found.measured == tuple(times)
    planner.missed()
    found = pfdist.next_time(run, write(tmp_path / "y.csv", tuple(times), missed=(found.next,)))
    assert found.plan == planner.plan()
    (expected,) = planner.expected()
    assert found.expected.expected_mse == expected.expected_mse


def test_before_anything_is_measured_next_is_the_plan(run: pfdist.Run, tmp_path: Path) -> None:
    found = pfdist.next_time(run, write(tmp_path / "y.csv", ()), planned="regular")
    assert found.plan == found.planned_before == run.sets()["regular"]
    assert found.expected.expected_mse == found.expected_before.expected_mse


def test_time_that_has_passed_replaces_the_plan(run: pfdist.Run, tmp_path: Path) -> None:
    table = write(tmp_path / "y.csv", (0,))
    found = pfdist.next_time(run, table, now=9, planned="regular")
    assert found.plan[0] > 9
    assert len(found.plan) == 4
    assert found.now == 9
    for now in (15, -1):
        with pytest.raises(MeasurementsError, match=r"now must lie in 0..14"):
            pfdist.next_time(run, table, now=now)
    with pytest.raises(JobError, match="planned must be a compared set"):
        pfdist.next_time(run, table, planned="nothing")


def test_the_command_says_when(
    run: pfdist.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write(tmp_path / "y.csv", (0, 3))
    assert main(["next", str(run.path / "job.toml"), str(table), "--now", "5"]) == 0
    told = capsys.readouterr().out
    found = pfdist.next_time(run, table, now=5)
    assert told.startswith(f"measure next at t = {found.next}; then about ")
    assert "2 measurements so far" in told
    assert "from t = " in told
    assert main(["next", str(run.path / "job.toml"), str(table), "--now", "99"]) == 1
    assert "now must lie in 3..14, got 99 (--now)" in capsys.readouterr().err


def test_a_first_plan_that_is_no_longer_possible_is_not_compared(
    run: pfdist.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would cost less than any plan that can be made, because it breaks a constraint."""
    job = tmp_path / "job.toml"
    job.write_text(JOB.replace("horizon = 14", "horizon = 14\nminimum_spacing = 3"))
    changes = ['search=[{method="survivors", evaluation={draws=20}}]']
    spaced = pfdist.run(job, tmp_path / "run", changes=changes, figures=False)
    second = spaced.sets()["survivors"][1]
    table = write(tmp_path / "y.csv", (second - 1,))
    found = pfdist.next_time(spaced, table)
    assert found.planned_before[0] == second
    assert found.expected_before is None
    assert found.as_json()["expected_mse_before"] is None
    assert main(["next", str(spaced.path / "job.toml"), str(table)]) == 0
    assert "no longer possible" in capsys.readouterr().out


def test_measurements_that_contradict_the_model_are_told(
    run: pfdist.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "y.csv"
    table.write_text("t,y0\n0,3000.0\n")
    found = pfdist.next_time(run, table)
    assert found.is_improbable
    assert main(["next", str(run.path / "job.toml"), str(table)]) == 0
    assert "it may be wrong about this system" in capsys.readouterr().out


def test_a_first_plan_that_has_no_time_left_is_said_in_a_sentence(
    run: pfdist.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last planned time was missed, and the budget allows a measurement after it."""
    (planned,) = [times for name, times in run.sets().items() if name == "survivors"]
    table = write(tmp_path / "y.csv", planned[:-1])
    assert main(["next", str(run.path / "job.toml"), str(table), "--now", str(planned[-1])]) == 0
    out = capsys.readouterr().out
    assert out.startswith("measure next at t = ")
    assert re.search(r"^  survivors +plans no further measurement$", out, re.MULTILINE)


def test_why_no_measurement_is_left(
    run: pfdist.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for times, why in (((0, 3, 7, 10, 13), "the budget is spent"), ((14,), "no further")):
        table = write(tmp_path / "y.csv", times)
        assert main(["next", str(run.path / "job.toml"), str(table)]) == 0
        assert why in capsys.readouterr().out
