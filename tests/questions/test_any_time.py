"""Tables with times, columns and repeats of their own, against a scalar Kalman filter."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist.cli.main import main
from pfdist.errors import MeasurementsError, ModelError, PfdistWarning
from pfdist.models.recorded import is_of_any_time
from pfdist.problem.measurements import Reading

pytestmark = [
    pytest.mark.usefixtures("no_figures"),
    pytest.mark.plugins("filter", "fit", "online"),
]

RATE, SD, NOISE = 0.3, 2.0, 0.5
MODEL = """
import numpy as np
import pfdist


def transition(x, t, w, p):
    kept = np.exp(-p.rate * p.dt[t])
    return (kept * x[0] + p.sd * np.sqrt(1 - kept**2) * w[0],)


def made(transition, **others):
    return pfdist.StateSpaceModel(
        name="level",
        initial=lambda w, p: (p.sd * w[0],),
        transition=transition,
        measurement=lambda x, t, v, p: (x[0] + p.noise * v[0],),
        log_likelihood=lambda y, x, t, p: pfdist.densities.normal_logpdf(y[0], x[0], p.noise),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"rate": 0.3, "sd": 2.0, "noise": 0.5, **others},
        linear_gaussian=True,
        normalised=True,
    )


model = made(transition)
flow = made(pfdist.ode(lambda x, t, p: (-p.rate * x[0],)))
rain = made(
    lambda x, t, w, p: (x[0] + p.rain[t] * p.dt[t] + p.sd * np.sqrt(p.dt[t]) * w[0],),
    rain=[0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0],
)
season = made(lambda x, t, w, p: (x[0] + np.sin(t) * p.dt[t] + w[0],))
numbers = made(lambda x, t, w, p: (x[0] * float(np.exp(-float(p.dt[t]))) + w[0],))
table = made(lambda x, t, w, p: (x[0] + (3.0, 1.0)[t % 2] * p.dt[t] + w[0],))
"""
ROWS = [(0.52, 1.25), (1.97, 0.75), (1.97, 0.8), (3.0, -0.2), (4.81, 2.0)]
ASSAYS = pd.DataFrame(ROWS, columns=["hours", "conc"]).assign(tube="a")
NAMES = {"t": "hours", "y0": "conc"}


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "level.py").write_text(MODEL)
    for name in ("model", "flow", "rain", "numbers"):
        (tmp_path / f"{name}.toml").write_text(
            f"""
seed = 1
[model]
name = "level.py:{name}"
[problem]
horizon = 6
time_step = 1
time_unit = "h"
measurement_budget = 5
[filter]
engine = "kalman"
[[search]]
method = "random"
evaluations = 3
[comparison]
draws = 50
[execution]
pool = "serial"
"""
        )
    return tmp_path


def exact(
    rows: Iterable[tuple[float, float]], at: float, *, still: bool = False, noise: float = NOISE
) -> tuple[float, float, float]:
    """Mean and variance at a time, and the log evidence of all rows until then."""
    mean, variance, now, evidence = 0.0, SD**2, 0.0, 0.0

    def moved(until: float) -> tuple[float, float]:
        kept = math.exp(-RATE * (until - now))
        return kept * mean, kept**2 * variance + (0.0 if still else SD**2 * (1 - kept**2))

    for t, y in rows:
        mean, variance = moved(t)
        now, total = t, variance + noise**2
        evidence -= ((y - mean) ** 2 / total + math.log(2 * math.pi * total)) / 2
        mean, variance = (
            mean + variance / total * (y - mean),
            variance * noise**2 / total,
        )
    return (*moved(at), evidence)


@pytest.mark.filterwarnings("ignore::pfdist.errors.PfdistWarning")
@pytest.mark.parametrize("name", ["model", "flow"])
def test_a_filter_is_exact_at_the_times_of_a_table(name: str, jobs: Path) -> None:
    run = pfdist.run(f"{name}.toml")
    before = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    still = name == "flow"
    for source in (f"{name}.toml", run.path):  # with the model's code, and without
        found = pfdist.filter_measurements(source, ASSAYS, columns=NAMES, report=False)
        table = found.table.set_index("t")
        assert [*table.index] == [0, 0.52, 1, 1.97, 2, 3, 4, 4.81, 5, 6]
        for at in (0.52, 1.97, 4.81, 6.0):
            rows = [row for row in ROWS if row[0] <= at]
            mean, variance, _ = exact(rows, at, still=still)
            assert table["mean_0"][at] == pytest.approx(mean, abs=1e-7)
            assert table["sd_0"][at] == pytest.approx(math.sqrt(variance), abs=1e-7)
        assert found.log_evidence == pytest.approx(exact(ROWS, 6, still=still)[2], abs=1e-6)
        assert found.measured == (0.52, 1.97, 3, 4.81)
    after = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    assert after == before  # the job and the run stay as they are


def test_planned_times_count_as_measured_at_the_nearest_instant(jobs: Path) -> None:
    pfdist.run("model.toml")
    seconds = pd.DataFrame({"t": np.arange(6) + 0.002, "y0": 0.5})
    found = pfdist.filter_measurements("model.toml", seconds, planned="random", report=False)
    assert len(found.measured) == 6
    assert not found.missing
    assert len(found.extra) == 1 + len(found.to_come)  # six measurements, five planned times


def test_the_next_time_follows_from_the_exact_filter(jobs: Path) -> None:
    pfdist.run("model.toml")
    rows = pd.DataFrame(ROWS[:2], columns=["t", "y0"])
    found = pfdist.next_time("model.toml", rows)
    assert (found.measured, found.now, found.left) == ((0.52, 1.97), 2, 3)
    assert found.plan
    assert found.plan[0] >= 2
    variance, errors = exact(ROWS[:2], 2.0)[1], []
    for t in range(2, 7):
        if t in found.plan:
            variance *= NOISE**2 / (variance + NOISE**2)
        errors.append(variance)
        kept = math.exp(-2 * RATE)
        variance = kept * variance + SD**2 * (1 - kept)
    assert found.expected.expected_mse == pytest.approx(np.mean(errors), rel=1e-9)
    later = pfdist.next_time("model.toml", rows, now=4)
    assert later.now == 4
    assert later.plan[0] == 5


@pytest.mark.filterwarnings("ignore:.* rows repeat")
def test_repeats_and_own_times_are_fitted_exactly(jobs: Path) -> None:
    """Published case: a data set of R, with its index, other names, and a dose of each subject."""
    table = pd.DataFrame([(name, *row) for name in "ab" for row in ROWS], columns=["id", "t", "y0"])
    with pytest.warns(PfdistWarning, match="are not read: nois; did you mean 'noise'"):
        found = pfdist.fit("model.toml", table.assign(nois="x"), {"sd": (2.0, 2.0)})
    assert found.log_likelihood == pytest.approx(2 * exact(ROWS, 6)[2], abs=1e-9)
    names = {"id": "Subject", "t": "Time", "y0": "conc"}
    of_r = table.rename(columns=names).assign(Wt=79.6, Noise=[0.5] * 5 + [5.0] * 5)
    (jobs / "r.csv").write_text(of_r.to_csv())
    columns = {"t": "Time", "y0": "conc", "noise": "Noise"}
    with pytest.warns(PfdistWarning, match="not read: one without a name, Wt"):
        again = pfdist.fit(
            "model.toml", "r.csv", {"sd": (2.0, 2.0)}, columns=columns, replicate="Subject"
        )
    both = exact(ROWS, 6)[2] + exact(ROWS, 6, noise=5.0)[2]
    assert again.log_likelihood == pytest.approx(both, abs=1e-9)


@pytest.mark.filterwarnings("ignore::pfdist.errors.PfdistWarning")
def test_covariates_stay_from_an_instant_to_the_next(jobs: Path) -> None:
    """Rain falls at a constant rate, so cutting an hour in two changes nothing at its end."""
    pfdist.run("rain.toml")
    tables = [pd.DataFrame({"t": t, "y0": [1.0] * len(t)}) for t in ([1, 4], [1, 2.25, 2.75, 4])]
    tables[1].loc[1:2, "y0"] = np.nan  # nothing was measured at these times
    answers = [pfdist.filter_measurements("rain.toml", each, report=False) for each in tables]
    assert "At t = 4 h: z = " in repr(answers[0])  # the model has no names
    whole, cut = (each.table.set_index("t")["mean_0"] for each in answers)
    np.testing.assert_allclose(cut[whole.index], whole, rtol=1e-12)
    assert cut[2.25] == pytest.approx(whole[2] + 0.25 * 2)


def test_only_a_model_that_reads_its_clock_alone_has_further_instants(jobs: Path) -> None:
    times = [0.0, 1.0, 2.5, 3.0, 4.5]
    named = {name: pfdist.load_model(f"level.py:{name}") for name in
             ("model", "flow", "season", "numbers", "table")}  # fmt: skip
    known = {name: is_of_any_time(each.on_clock(times)) for name, each in named.items()}
    assert known == {
        "model": True, "flow": True, "season": False, "numbers": True, "table": False,
    }  # fmt: skip
    assert not is_of_any_time(pfdist.load_model("random_walk").on_clock(times))


def test_a_run_with_values_of_the_clock_in_its_programs_needs_the_job(jobs: Path) -> None:
    run, table = pfdist.run("numbers.toml"), pd.DataFrame({"t": [0.5], "y0": [1.0]})
    found = pfdist.filter_measurements("numbers.toml", table, report=False)
    assert found.measured == (0.5,)
    with pytest.raises(
        ModelError, match=r"dt cannot be changed here, .* give the job, whose model"
    ):
        pfdist.filter_measurements(run.path, table)


def test_a_step_that_is_an_instant_moves_times(
    jobs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (jobs / "walk.toml").write_text(
        (jobs / "model.toml").read_text().replace("level.py:model", "random_walk")
    )
    pfdist.run("walk.toml")
    (jobs / "off.csv").write_text("Time;conc\n0,9;1,25\n2,05;0,75\n")
    arguments = ["filter", "walk.toml", "off.csv", "--columns", "t=Time,y0=conc", "--no-report"]
    assert main(arguments) == 0
    out, said = capsys.readouterr()
    assert "At t = 2 h" in out
    assert "count at the nearest instants, at most 6 min away" in said
    assert main([*arguments, "--within", "0.07"]) == 1
    assert "got 0.9, 6 min from the nearest: allow more (--within)" in capsys.readouterr().err


def test_seconds_since_1970_are_read_if_they_can_be_nothing_else(jobs: Path) -> None:
    (jobs / "well.toml").write_text(
        (jobs / "model.toml").read_text().replace('time_step = 1\ntime_unit = "h"', "")
        + '[problem.clock]\nstart = 2026-10-24T00:00:00\nstep = "1 h"\ntimezone = "Europe/Berlin"\n'
    )
    pfdist.run("well.toml")
    for t in (
        [1792792800, 1792796407],
        ["2026-10-24 00:00", "2026-10-24T01:00:07"],
        [0, 3607 / 3600],
        pd.to_datetime(["2026-10-23T22:00:00Z", "2026-10-23T23:00:07Z"]).tz_convert("US/Pacific"),
    ):
        table, lines = pd.DataFrame({"t": t, "y0": [1.0, 2.0]}), list[str]()
        found = pfdist.filter_measurements("well.toml", table, report=False, say=lines.append)
        assert found.measured == ("2026-10-24T00:00", "2026-10-24T01:00:07")
        assert any("read as seconds since 1970" in line for line in lines) is (t[0] == 1792792800)
    far = pd.DataFrame({"t": [1792792800.0, 5e12], "y0": [1.0, 2.0]})
    with pytest.raises(MeasurementsError, match=r"got '5000000000000' \(row 2\); .* are sec"):
        pfdist.filter_measurements("well.toml", far)


def test_parameters_in_a_table_must_be_those_of_the_job(jobs: Path) -> None:
    pfdist.run("model.toml")
    table = pd.DataFrame({"t": [1], "y0": [1.0], "rate": [0.3]})
    assert pfdist.filter_measurements("model.toml", table, report=False).measured == (1,)
    with pytest.raises(MeasurementsError, match="column rate: the filter has the job's value"):
        pfdist.filter_measurements("model.toml", table.assign(rate=0.4))


def test_readings_below_the_limit_are_cells_that_say_so(tmp_path: Path) -> None:
    """``<1.0``, or an empty cell beside 1 in ``y0_below``; another limit is refused."""
    model = pfdist.load_model("random_walk")
    model = replace(
        model,
        linear_gaussian=False,
        log_tails=lambda y, x, t, p: pfdist.densities.normal_log_tails(
            y[0], x[0], p.measurement_sd
        ),
    )
    problem = pfdist.Problem(
        model, horizon=6, measurement_budget=2, particles=200, sensor={"limit": 1.0}
    )
    run = pfdist.plan(
        problem, tmp_path / "run", bound_draws=0, changes=["comparison.draws=100"], figures=False
    )
    tables = [
        pd.DataFrame({"t": [1, 4], "y0": ["2.5", "<1.0"]}),
        pd.DataFrame({"t": [1, 4], "y0": ["2.5", "< 1"]}),
        pd.DataFrame({"t": [1, 4], "y0": [2.5, math.nan], "y0_below": [0, 1]}),
        pd.DataFrame({"t": [1, 4], "y0": [2.5, 1.0]}),
        pd.DataFrame({"t": [1, 4], "y0": [2.5, 0.0]}),  # as many laboratories write it
    ]
    means = [
        pfdist.filter_measurements(run.path, each).table["mean_level"].to_numpy() for each in tables
    ]
    for each in means[1:]:
        np.testing.assert_array_equal(each, means[0])
    with pytest.raises(MeasurementsError, match="must be that of all sensors, <1, got '<2'"):
        pfdist.filter_measurements(run.path, pd.DataFrame({"t": [1], "y0": ["<2"]}))
    for text in ("BLQ", "1_0", "0x1", "\u0661"):
        with pytest.raises(
            MeasurementsError, match=f"got '{text}'.*; a reading below the limit is <1"
        ):
            pfdist.filter_measurements(run.path, pd.DataFrame({"t": [1], "y0": [text]}))


def test_rows_of_several_systems_are_named_where_one_is_filtered() -> None:
    """Times that begin anew and repeat are those of other systems, not repeats."""
    said = list[str]()
    Reading(note=said.append).repeated(6, [1, 5, 9] * 3)
    Reading(note=said.append).repeated(1, [1, 5, 9, 5])
    each = "of the table: the filter weighs each row"
    several = "; t begins 3 times: give the rows of one system"
    assert said == [f"6 rows repeat a time {each}{several}", f"1 row repeats a time {each}"]
