"""Columns of tables as parameters of a job: values, identity, errors in one line."""

from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pandas as pd
import pytest

import pfdist
from oracles.model_text import MEASURED
from pfdist import Problem, load_job, load_model
from pfdist.errors import JobError, ModelError
from pfdist.problem.job_schema import job_schema

RAIN = [0.0, 2.5, 0.5, 1.0, 0.0, 0.25, 4.0]
SUN = [7.0, 1.0, 3.0, 3.5, 8.0, 6.0, 0.0]
MODEL = (
    """
from pfdist import StateSpaceModel
model = StateSpaceModel(
    name="lake",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (0.8 * x[0] + p.rain[t] - 0.1 * p.sun[t] + w[0],),
"""
    + MEASURED
    + """    parameters={"rain": (0.0,), "sun": (0.0,)},
)
"""
)
JOB = """seed = 1
[model]
name = "lake.py:model"
[model.parameters]
rain = {{ file = "data/weather.{suffix}" }}
sun = {{ file = "data/weather.{suffix}", column = "hours of sun" }}
[problem]
horizon = 6
measurement_budget = 2
[filter]
engine = "numpy"
particles = 20
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "data").mkdir()
    (tmp_path / "lake.py").write_text(MODEL)
    weather = pd.DataFrame({"day": list("abcdefg"), "rain": RAIN, "hours of sun": SUN})
    weather.to_csv(tmp_path / "data" / "weather.csv", index=False)
    weather.to_parquet(tmp_path / "data" / "weather.parquet")
    for suffix in ("csv", "parquet"):
        (tmp_path / f"{suffix}.toml").write_text(JOB.format(suffix=suffix))
    return tmp_path


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_job_has_the_values_of_columns(folder: Path, suffix: str) -> None:
    job = load_job(folder / f"{suffix}.toml")
    assert job.model.parameters == {"rain": tuple(RAIN), "sun": tuple(SUN)}


def test_the_identity_has_the_values_and_not_the_file(folder: Path) -> None:
    first, same = (load_job(folder / f"{suffix}.toml").identity() for suffix in ("csv", "parquet"))
    assert first == same
    assert first["model"]["parameters"]["rain"] == RAIN
    written = load_job(folder / "csv.toml", ["model.parameters.rain=[1, 2, 3, 4, 5, 6, 7]"])
    assert written.identity() != first


@pytest.mark.plugins("simulate")
def test_formulas_read_each_column_at_t(folder: Path) -> None:
    # The mean of x(t) without noise follows from the columns.
    draws = pfdist.simulate(folder / "csv.toml", draws=20_000)
    mean, expected = 0.0, [0.0]
    for rain, sun in zip(RAIN[:-1], SUN[:-1], strict=True):
        mean = 0.8 * mean + rain - 0.1 * sun
        expected.append(mean)
    means = draws.groupby("t")["z_0"].mean().to_numpy()
    np.testing.assert_allclose(means, expected, atol=4.5 * np.sqrt(1 / (1 - 0.64) / 20_000))


def test_a_run_needs_the_table_no_more(folder: Path) -> None:
    changes = ['search=[{method="random", evaluations=2}]', "comparison.draws=20"]
    run = pfdist.run(
        folder / "csv.toml", folder / "run", changes=changes, pool="serial", figures=False
    )
    (folder / "data" / "weather.csv").unlink()
    assert load_job(run.path / "job.toml").model.parameters["rain"] == tuple(RAIN)
    again = pfdist.run(run.path / "job.toml", folder / "run", pool="serial", figures=False)
    assert again.state == "finished"


@pytest.mark.parametrize("given", [pd.Series(RAIN, list("abcdefg")), np.array(RAIN), tuple(RAIN)])
def test_a_model_takes_columns_of_a_data_frame(folder: Path, given: Any) -> None:
    lake = load_model(f"{folder / 'lake.py'}:model")
    assert lake.with_parameters({"rain": given}).parameters["rain"] == tuple(RAIN)
    weather = pd.DataFrame({"rain": RAIN, "sun": SUN})
    both = lake.with_parameters({**weather})
    assert (both.parameters["rain"], both.parameters["sun"]) == (tuple(RAIN), tuple(SUN))
    job = Problem(both, horizon=6, measurement_budget=2, engine="numpy").job()
    assert job.model.parameters["sun"] == tuple(SUN)


def test_a_section_in_python_takes_a_series(folder: Path) -> None:
    settings = {"model": {"parameters": {"rain": pd.Series(RAIN)}}}
    assert load_job(folder / "csv.toml", settings=settings).model.parameters["rain"] == tuple(RAIN)


OF_SENSOR = ("fails", "price")


@pytest.mark.parametrize(
    ("key", "column"),
    [
        ("price", "open"),
        ("store.income", "rain"),
        ("sensor.fails", "cloudy"),
        ("instant_weights", "open"),
        *((f"sensors.price.{name}", "cloudy") for name in OF_SENSOR),
        ("sensors.other.fails", "cloudy"),
    ],
)
def test_what_varies_with_time_may_be_a_column(folder: Path, key: str, column: str) -> None:
    """As the numbers in the job; by default the column has the name of the key."""
    values = {"open": [2, 1, 1, 3, 1, 1, 2], "rain": RAIN, "cloudy": [0.1, 0.5, 0.9] + [0.2] * 4}
    own = key.rpartition(".")[2]
    pd.DataFrame({**values, own: values[column]}).to_csv(folder / "data" / "times.csv", index=False)
    problem: dict[str, Any] = {"horizon": 6, "measurement_budget": 2}
    if "price" in key:
        problem = {"horizon": 6, "total_price": 3}
    if key == "store.income":
        problem["store"] = {"capacity": 3}
    if key.startswith("sensors"):
        sensors = {
            "price": {} if key.endswith("price.price") else {"price": 1},
            "other": {"price": 1},
        }
        problem = {"horizon": 6, "total_price": 3, "sensors": sensors}
    (folder / "bare.toml").write_text("seed = 1\n")
    given = {"problem": problem}
    file = 'file = "data/times.csv"'
    found = [
        load_job(folder / "bare.toml", [f"problem.{key}={value}"], settings=given).identity()
        for value in (f'{{{file}, column = "{column}"}}', f"{{{file}}}", values[column])
    ]
    assert found[0] == found[1] == found[2]
    assert str(values[column][1]) in str(found[0]["problem"])
    wrong = f'problem.{key}={{{file}, column = "clouds"}}'
    message = rf"^problem\.{key}: the table has no column 'clouds'"
    with pytest.raises(JobError, match=message):
        load_job(folder / "bare.toml", [wrong], settings=given)
    editors = jsonschema.Draft202012Validator(job_schema())
    part = given["problem"]
    *sections, name = key.split(".")
    for section in sections:
        part = part.setdefault(section, {})
    part[name] = {"file": "times.csv", "column": column}
    assert editors.is_valid({"seed": 1, **given})
    part[name] = {"file": "times.csv", "colum": column}
    assert not editors.is_valid({"seed": 1, **given})


RAIN_OF = "model.parameters.rain="
TABLE = '{file="data/weather.csv", '
WRONG = [
    (
        TABLE + 'column="rian"}',
        r"^model\.parameters\.rain: the table has no column 'rian'; did you mean 'rain'\? Columns: "
        r"day, rain, hours of sun \(.*weather\.csv\) \(",
    ),
    (
        '{file="data/wether.csv"}',
        r"rain: cannot read .*wether\.csv: No such .*; did you mean '.*weather\.csv'",
    ),
    (TABLE + 'column="day"}', r"column 'day' in row 1 must be a number, got 'a' \("),
    (TABLE + 'colum="rain"}', r"rain must be numbers, or a column of a table, as \{file"),
    ("{column=3}", r"rain must be numbers, or a column of a table"),
    ('"wet"', r"rain must be a number or a list, got 'wet'"),
]


@pytest.mark.parametrize(("value", "message"), WRONG)
def test_a_wrong_column_is_named(folder: Path, value: str, message: str) -> None:
    with pytest.raises(JobError, match=message):
        load_job(folder / "csv.toml", [RAIN_OF + value])


@pytest.mark.parametrize("wrong", ["", "nan", "inf"])
@pytest.mark.parametrize("part", ["model", "model.filter"])
def test_a_value_that_is_not_finite_is_named_with_its_row(
    folder: Path, wrong: str, part: str
) -> None:
    (folder / "gap.csv").write_text(f"rain\n1\n2.5\n{wrong or ','}\n4\n".replace(",\n", '""\n'))
    with pytest.raises(
        JobError, match=r"^" + part + r"\.parameters\.rain: .* got (nan|inf) in row 3"
    ):
        load_job(folder / "csv.toml", [f'{part}.parameters.rain={{file="gap.csv"}}'])
    model = load_model(f"{folder / 'lake.py'}:model")
    with pytest.raises(ModelError, match=r"rain must be a finite number .*, got nan for t = 2$"):
        model.with_parameters({"rain": [1.0, 2.0, float("nan")]})


def test_a_wrong_length_is_named(folder: Path) -> None:
    (folder / "short.csv").write_text("rain\n1\n2\n3\n4\n")
    words = r"model\.parameters\.rain needs 7 values, one for each instant, got 4"
    with pytest.raises(ModelError, match=words):
        pfdist.evaluate(load_job(folder / "csv.toml", [RAIN_OF + '{file="short.csv"}']), [1])


def test_a_filter_may_believe_another_forecast(folder: Path) -> None:
    (folder / "forecast.csv").write_text("rain\n" + "1\n" * 7)
    job = load_job(folder / "csv.toml", ['model.filter.parameters.rain={file="forecast.csv"}'])
    assert job.model.filter.parameters == {"rain": (1.0,) * 7}
