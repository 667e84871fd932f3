"""Every key of a sensor means the same on the job's clock and on that of a table.

The oracle is a particle filter on the clock: a time that is moved by a millionth of a step changes
nothing that could be seen. A key that is lost changes a mean by a fifth or more of its deviation.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import pfdist
from pfdist import Problem, StateSpaceModel
from pfdist.models.twin import twin_of
from pfdist.problem.sensing_section import SensingSection
from pfdist.problem.sensor_section import SensorSection
from pfdist.runner.build import build
from pfdist.runner.replicates import evaluator_on

pytestmark = pytest.mark.usefixtures("no_figures")

KEYS: dict[str, Any] = {
    "limit": 0.5, "limits": [-1.0, 0.5], "fails": 0.2, "repeats": 2, "delay": 1, "price": 2,
    "install": 3, "together": "room", "forbidden": [2], "allowed": [0, 1, 4], "most": 3,
    "minimum_spacing": 2, "most_within": {"number": 2, "time": 2},
}  # fmt: skip
CHANGES_MODEL = ("limit", "limits", "fails", "repeats")  # a delay needs the job's instants
MODEL = """
import numpy as np
from pfdist import Sensor, StateSpaceModel
from pfdist.densities import normal_log_tails, normal_logpdf


def transition(x, t, w, p):
    kept = np.exp(-0.3 * p.dt[t])
    return (kept * x[0] + np.sqrt(1 - kept**2) * w[0],)


def sensor(noise):
    return {
        "measurement": lambda x, t, v, p: (x[0] + noise * v[0],),
        "log_likelihood": lambda y, x, t, p: normal_logpdf(y[0], x[0], noise),
        "measurement_noise": ("normal",),
        "log_tails": lambda y, x, t, p: normal_log_tails(y[0], x[0], noise),
    }


system = {
    "name": "level", "initial": lambda w, p: (w[0],), "transition": transition,
    "quantity_of_interest": lambda x, t, p: (x[0],), "initial_noise": ("normal",),
    "process_noise": ("normal",), "parameters": {"level": 0.0}, "normalised": True,
}
one = StateSpaceModel(**system, **sensor(0.4))
two = StateSpaceModel(**system, sensors={"a": Sensor(**sensor(0.4)), "b": Sensor(**sensor(0.8))})
"""


def models() -> dict[str, StateSpaceModel]:
    names: dict[str, Any] = {}
    exec(MODEL, names)  # the same text is the file of a job
    return {name: names[name] for name in ("one", "two")}


def formulas(model: StateSpaceModel, t: int) -> Iterator[np.ndarray]:
    """The measurement and the log-likelihood of each sensor at some values."""
    x, y = (np.linspace(-2, 2, 9),) * model.components[0], (np.array([-1.2, 0.3, 0.7] * 3),)
    for way in twin_of(model, range(t, t + 1)).ways:
        v = tuple(np.linspace(0.1, 0.9, 9) for _ in way.model.measurement_noise)
        yield np.asarray(way.model.measurement(x, t, v, model.p)[0])
        yield np.asarray(way.model.log_likelihood(y, x, t, model.p))


def test_the_list_of_keys_is_whole() -> None:
    assert {*SensingSection.model_fields} | {*SensorSection.model_fields} == {*KEYS}


@pytest.mark.parametrize("key", KEYS)
def test_a_sensor_is_the_same_at_other_times(key: str) -> None:
    budget = {"total_price": 9} if key in ("price", "install") else {"measurement_budget": 2}
    given = {"horizon": 5, "time_step": 1, "engine": "numpy", **budget}
    plain = {"price": 1} if "total_price" in budget else {}
    section = {**plain, key: KEYS[key]}
    problems = [(models()["two"], {"sensors": {"a": section, "b": plain}})]
    if key in SensingSection.model_fields:
        problems.append((models()["one"], {"sensor": {key: KEYS[key]}}))
    for model, sensors in problems:
        built = build(Problem(model, **given, **sensors).job(search=[{"method": "random"}]))
        own = built.job.problem.clock
        clock = replace(own, times=tuple(sorted([*own.times, 2.5])))
        before, after = built.evaluator.believed, evaluator_on(built, clock).believed
        assert [*after.sensors] == [*before.sensors]
        assert after.missing_components == before.missing_components
        for mine, other in zip(formulas(before, 4), formulas(after, 5), strict=True):
            assert np.array_equal(mine, other, equal_nan=True)
        if key in CHANGES_MODEL[:3]:
            twins = zip(formulas(before, 4), formulas(model.on_clock(own.times), 4), strict=True)
            assert not all(np.array_equal(*pair, equal_nan=True) for pair in twins)


JOB = """
seed = 1
search = []
[model]
name = "level.py:{name}"
[problem]
horizon = 9
time_step = 1
measurement_budget = 2
{sensors}
[filter]
particles = 1000
[comparison]
draws = 2
reference = "regular"
[comparison.sets]
mine = {times}
[execution]
pool = "serial"
"""
CASES = {
    "one": "[problem.sensor]\nlimits = [-1.0, 0.5]\nfails = 0.2\nrepeats = 2",
    "two": "[problem.sensors.a]\nlimit = 0.5\nrepeats = 2\n[problem.sensors.b]\nfails = 0.3",
}
TIMES = {"one": '["0 a", "3 a"]', "two": '["2 b", "3 a_a"]'}
ROWS = [
    (t, sensor, y)
    for t, y in enumerate([1.1, 0.2, 1.2, 0.2, -1.3, 0.4, 0.9, 0.1, -0.4, 0.2])
    for sensor, y in (("a", y), ("b", np.nan if t == 3 else y + 0.3))
] + [(3, "a", 0.3)]


@pytest.mark.plugins("backtest", "filter", "fit", "online")
@pytest.mark.filterwarnings("ignore::pfdist.errors.PfdistWarning")
@pytest.mark.parametrize("name", ["one", pytest.param("two", marks=pytest.mark.slow)])
def test_all_questions_give_the_same_answer_at_other_times(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Log evidences of 1,000 particles have a standard error of 0.03, means one of 0.02."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "level.py").write_text(MODEL)
    text = JOB.format(name=name, sensors=CASES[name], times=TIMES[name])
    (tmp_path / "job.toml").write_text(text)
    run = pfdist.run("job.toml")
    rows = [row for row in ROWS if name == "two" or row[1] == "a"]
    table = pd.DataFrame(rows, columns=["t", "sensor", "y0"]).assign(id="s", t=lambda a: 1.0 * a.t)
    if name == "one":
        table = table.drop(columns="sensor")
    moved = table.assign(t=table.t + 1e-5 * table.t.isin([1, 4]))
    answers = []
    for each, job in ((table, "job.toml"), (moved, "job.toml"), (moved, run.path)):
        first = each[each.t < 3].drop(columns="id")
        found = pfdist.filter_measurements(job, first, planned="mine", report=False)
        answers.append([found.log_evidence, *found.table["mean_0"].iloc[-3:]])
        if each is moved and job == "job.toml":
            continue  # two quick jobs of four questions are enough
        after = pfdist.next_time(job, first, planned="mine")
        fitted = pfdist.fit(job, each, ["level"], replicate="id", evaluations=2)
        both = pd.concat([each, each.assign(id="r", y0=each.y0 + 0.1)])
        judged = pfdist.backtest(job, both, replicate="id", planned="mine", report=False)
        answers[-1] += [
            after.expected.expected_mse, fitted.started_at,
            judged.table["real"].mean(), judged.table["foreseen"].mean(),
        ]  # fmt: skip
    limits = [0.15, 0.1, 0.1, 0.1, 0.1, 0.3, 0.1, 0.1]
    for other in answers[1:]:
        apart = np.abs(np.subtract(other, answers[0][: len(other)]))
        assert (apart < limits[: len(other)]).all(), answers
