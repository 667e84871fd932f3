"""Models that name the components of x, y and z, and what columns, figures and reports make of it.

The model has the same formulas with and without names, so all numbers must be the same.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import pfdist
from oracles.walks import WALK
from pfdist import plots
from pfdist.errors import JobError, MeasurementsError, PriorError, RunMismatchError
from pfdist.filters.user_prior import read_prior
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import read_measurements
from pfdist.questions.run_page import page_of
from pfdist.runner.build import build

NAMES = """
    x_names=("Tumour mass [mg]", "plasma"),
    y_names=("marker [U/ml]", "weight [kg]"),
    z_names=("Tumour mass [mg]", "change of mass"),
"""
MODEL = """
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="tumour_mass",
    initial=lambda w, p: (5.0 + w[0], w[1]),
    transition=lambda x, t, w, p: (0.9 * x[0] + w[0], 0.5 * x[1] + w[1]),
    measurement=lambda x, t, v, p: (x[0] + v[0], x[1] + v[1]),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2),
    quantity_of_interest=lambda x, t, p: (x[0], x[0] - x[1]),
    initial_noise=("normal", "normal"),
    process_noise=("normal", "normal"),
    measurement_noise=("normal", "normal"),
    {names}
)
"""
JOB = """
seed = 1
[model]
name = "mass.py:model"
[problem]
horizon = 9
measurement_budget = 3
[filter]
particles = 40
engine = "numpy"
[[search]]
method = "random"
name = "mine_too"
evaluations = 3
[evaluation]
draws = 10
[comparison]
draws = 12
reference = "regular"
[execution]
pool = "serial"
"""
Z = ("tumour_mass", "change_of_mass")


def _job(folder: Path, names: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "mass.py").write_text(MODEL.format(names=names))
    (folder / "job.toml").write_text(JOB)
    return folder / "job.toml"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> pfdist.Run:
    folder = tmp_path_factory.mktemp("named")
    return pfdist.run(_job(folder, NAMES), folder / "run", figures=False)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> pfdist.Run:
    """The run of the model without names."""
    folder = tmp_path_factory.mktemp("plain")
    return pfdist.run(_job(folder, ""), folder / "run", figures=False)


def test_columns_of_trajectories_have_the_names_and_the_numbers_of_the_run_without(
    run: pfdist.Run, plain: pfdist.Run
) -> None:
    def columns(z: tuple[str, ...], y: tuple[str, ...]) -> list[str]:
        estimates = [f"estimate_{name}_{end}" for name in ("regular", "mine_too") for end in z]
        return ["draw", "t", *(f"z_{end}" for end in z), *(f"y_{end}" for end in y), *estimates]

    named = pd.read_parquet(run.path / "tables" / "trajectories")
    numbered = pd.read_parquet(plain.path / "tables" / "trajectories")
    assert list(named) == columns(Z, ("marker", "weight"))
    assert list(numbered) == columns(("0", "1"), ("0", "1"))
    np.testing.assert_array_equal(named.to_numpy(), numbered.to_numpy())
    assert run.sets == plain.sets


def test_units_and_labels_are_in_the_metadata_and_in_attributes(
    run: pfdist.Run, plain: pfdist.Run
) -> None:
    (file,) = (run.path / "tables" / "trajectories").glob("*.parquet")
    metadata = {field.name: field.metadata for field in pq.read_schema(file)}
    assert metadata["z_tumour_mass"][b"unit"] == b"mg"
    assert metadata["estimate_mine_too_tumour_mass"][b"label"] == b"Tumour mass [mg]"
    assert metadata["z_change_of_mass"][b"unit"] == b"z"  # no unit is given
    labels = run.table("trajectories").attrs["labels"]
    assert (labels["y_marker"], labels["z_change_of_mass"]) == ("marker [U/ml]", "change of mass")
    assert "labels" not in plain.table("trajectories").attrs


def test_axes_have_names_and_units(run: pfdist.Run, plain: pfdist.Run) -> None:
    assert plots.one_draw(run).get_ylabel() == "Tumour mass [mg]"
    assert plots.one_draw(run, component=1).get_ylabel() == "change of mass"
    assert plots.one_draw(plain, component=1).get_ylabel() == "$z_{1}$"
    table = pd.read_parquet(run.path / "tables" / "trajectories")
    table.attrs.clear()  # as after a CSV file: the column's own name is left
    ax = plots.one_draw(table, run.sets, component=1)
    assert ax.get_ylabel() == "change_of_mass"


def test_a_long_label_has_several_lines_and_keeps_its_dollar_signs() -> None:
    columns = ("z_price", "estimate_a_price", "estimate_b_price")
    table = pd.DataFrame({name: [1.0, 2.0] for name in columns}).assign(t=[0, 1])
    table.attrs["labels"] = {"z_price": "price of electricity at noon [$/MWh]"}
    ax = plots.one_draw(table, {"a": [0], "b": [1]})
    assert ax.get_ylabel() == "price of electricity at\nnoon [\\$/MWh]"


def test_the_report_of_a_run_uses_the_names(run: pfdist.Run, plain: pfdist.Run) -> None:
    text = str(page_of(run))
    assert "quantity of interest" in text
    assert "Tumour mass [mg], change of mass" in text
    assert "marker [U/ml], weight [kg]" in text
    assert "what is measured" not in str(page_of(plain))


@pytest.mark.plugins("filter")
@pytest.mark.parametrize(
    "columns", [pytest.param(("y0", "y1"), marks=pytest.mark.slow), ("y_marker", "y_weight")]
)
def test_filter_reads_both_kinds_of_columns_and_writes_names(
    run: pfdist.Run, plain: pfdist.Run, tmp_path: Path, columns: tuple[str, str]
) -> None:
    measured = {"t": [1, 4, 8], columns[1]: [0.1, 0.2, 0.3], columns[0]: [5.0, 4.0, 3.0]}
    pd.DataFrame(measured).to_csv(tmp_path / "mine.csv", index=False)
    found = pfdist.filter_measurements(run, tmp_path / "mine.csv", out=tmp_path)
    written = pd.read_csv(found.files[0])
    assert [name for name in written if name.startswith("mean_")] == [f"mean_{end}" for end in Z]
    assert {"sd_tumour_mass", "q05_change_of_mass"} <= set(written)
    numbered = pd.DataFrame({"t": [1, 4, 8], "y0": [5.0, 4.0, 3.0], "y1": [0.1, 0.2, 0.3]})
    same = pfdist.filter_measurements(plain, numbered).table
    np.testing.assert_array_equal(found.table.to_numpy(float), same.to_numpy(float))
    assert "mean_0" in same
    ax = plots.belief(found)
    assert ax.get_ylabel() == "Tumour mass [mg]"
    report = " ".join(found.files[2].read_text().split())
    assert "mean of Tumour mass [mg]" in report
    assert re.search(r"The last estimate of Tumour mass is [\d.]+ mg \(90 % band ", report)


def test_wrong_columns_are_told_with_all_that_is_allowed(run: pfdist.Run) -> None:
    believed = build(pfdist.load_job(run.path / "job.toml")).evaluator.believed
    mixed = pd.DataFrame({"t": [1], "y0": [1.0], "Weight": [2.0]})
    words = "must be t, y0, y1 or t, y_marker, y_weight, got 't, y0, Weight'"
    with pytest.raises(MeasurementsError, match=words):
        read_measurements(mixed, believed, Clock.counting(9))
    with pytest.raises(PriorError, match=r"must be x0, x1 or x_tumour_mass, x_plasma, and may be"):
        read_prior(pd.DataFrame({"x0": [1.0], "x_plasma": [1.0]}), believed)


def test_a_prior_may_have_the_names_of_states(run: pfdist.Run) -> None:
    believed = build(pfdist.load_job(run.path / "job.toml")).evaluator.believed
    rows = pd.DataFrame({"x_plasma": [1.0, 2.0], "x_tumour_mass": [3.0, 4.0], "weight": [1, 3]})
    np.testing.assert_array_equal(read_prior(rows, believed).x, [[3.0, 4.0], [1.0, 2.0]])


def test_another_name_or_unit_is_another_run_and_the_error_names_it(
    run: pfdist.Run, tmp_path: Path
) -> None:
    path = _job(tmp_path, NAMES.replace('"change of mass"', '"change [mg]"'))
    with pytest.raises(RunMismatchError) as caught:
        pfdist.run(path, run.path, figures=False)
    assert caught.value.differences == (
        "model.z_names: Tumour mass [mg], change of mass -> Tumour mass [mg], change [mg]",
    )


def test_the_filters_model_takes_the_names_of_the_truth(tmp_path: Path) -> None:
    path = _job(tmp_path, NAMES)
    other = MODEL.format(names='z_names=("a", "b"), x_names=("c", "d")')
    (tmp_path / "other.py").write_text(other)
    job = pfdist.load_job(path, ['model.filter.name="other.py:model"'])
    believed = build(job).evaluator.believed
    assert believed.z_names == ("Tumour mass [mg]", "change of mass")
    assert believed.x_names == ("c", "d")


def test_two_estimates_in_one_column_are_refused_before_the_run(tmp_path: Path) -> None:
    path = _job(tmp_path, 'z_names=("mass", "too mass"),')
    more = '[[search]]\nmethod = "random"\nname = "mine"\nevaluations = 3\n[evaluation]'
    path.write_text(JOB.replace("[evaluation]", more))
    with pytest.raises(JobError, match="'estimate_mine_too_mass' for 'mass' of the set 'mine_too'"):
        build(pfdist.load_job(path))


@pytest.mark.plugins("check")
@pytest.mark.parametrize(("unit", "notes"), [("kg", 1), ("mg", 0), ("", 0)])
def test_errors_in_two_units_that_are_added_up_are_noted(unit: str, notes: int) -> None:
    """East in m and heading in rad: their sum says nothing unless z has weights."""
    namespace: dict[str, pfdist.StateSpaceModel] = {}
    exec(
        MODEL.format(names=NAMES.replace("change of mass", f"change [{unit}]" * bool(unit) or "c")),
        namespace,
    )
    checks = pfdist.check_model(namespace["model"], horizon=3, particles=20).set_index("check")
    assert [*checks.index].count("units") == notes
    assert not notes or "in mg and kg, are added up: give" in checks.loc["units", "text"]


@pytest.mark.plugins("filter", "simulate")
def test_a_simulated_system_is_filtered_as_it_was_written() -> None:
    """Without names, `pfdist.simulate` writes y_0, and `filter` reads y0 and y, too."""
    walk = pfdist.Problem(WALK, horizon=6, measurement_budget=2)
    simulated = pfdist.simulate(walk, 1, seed=3)
    assert "y_0" in simulated
    own, *renamed = (
        pfdist.filter_measurements(walk, table, report=False, say=lambda _: None).table
        for table in (simulated.rename(columns={"y_0": name}) for name in ("y_0", "y0", "y"))
    )
    assert all(own.equals(each) for each in renamed)
    assert own["measured"].all()
