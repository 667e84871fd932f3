"""From a job to the problem: the filter's model, and the engine."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.every_set import every_set
from oracles.in_turn import in_turn
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import ModelError, RunMismatchError
from pfdist.filters.variants import knowing_truth
from pfdist.filters.work import Estimation
from pfdist.kernels import cached
from pfdist.problem.sections import Execution
from pfdist.runner.block_sums import BlockSums, Counted
from pfdist.runner.build import build, chosen_pool

OTHER = """
import numpy as np
import scipy.special
import pfdist.densities
from pfdist import StateSpaceModel
from pfdist.models.library.ungm import measurement, log_likelihood, quantity_of_interest, initial

def transition(x, t, w, p):
    return (FORMULA,)

model = StateSpaceModel(
    name="other", initial=initial, transition=transition, measurement=measurement,
    log_likelihood=log_likelihood, quantity_of_interest=QUANTITY, initial_noise=("normal",),
    process_noise=("normal",), measurement_noise=("normal",),
    parameters={"initial_sd": 5.0, "process_sd": 1.0, "measurement_sd": 1.0},
)
"""


def job_with(tmp_path: Path, *lines: str, formula: str = "0.5 * x[0]", quantity: str = "") -> Job:
    text = OTHER.replace("FORMULA", formula)
    text = text.replace("QUANTITY", quantity or "quantity_of_interest")
    (tmp_path / "other.py").write_text(text)
    small = (Path(__file__).parents[1] / "small.toml").read_text()
    (tmp_path / "small.toml").write_text("\n".join([small, *lines]))
    return load_job(tmp_path / "small.toml")


def test_the_filters_parameters_are_the_models_but_for_those_that_are_given(tmp_path: Path) -> None:
    model = ["[model.parameters]", "process_sd = 2.0", "measurement_sd = 3.0"]
    knowing = build(job_with(tmp_path, *model)).evaluator
    assert knowing_truth(knowing) is knowing
    assert knowing.believed.p.process_sd == 2.0
    built = build(job_with(tmp_path, *model, "[model.filter.parameters]", "measurement_sd = 4.0"))
    p, believed = built.evaluator.model.p, built.evaluator.believed.p
    assert (p.process_sd, p.measurement_sd) == (2.0, 3.0)
    assert (believed.process_sd, believed.measurement_sd) == (2.0, 4.0)
    assert built.feasible == built.job.problem.feasible  # where measurements are counted


@pytest.mark.parametrize(
    ("believed", "smaller"), [({"step_sd": 1.0}, False), ({"step_sd": 2.0}, True)]
)
def test_all_affordable_sets_are_searched_if_the_filter_is_wrong(
    small_job: Job, tmp_path: Path, believed: dict[str, float], smaller: bool
) -> None:
    """To a filter that trusts its sensor too much, further measurements do harm."""
    constraints: dict[str, Any] = {"horizon": 5, "price": [1, 2] * 3, "total_price": 5}
    truth = {"name": "random_walk", "parameters": {"step_sd": 1.0}, "filter": {}}
    truth["filter"] = {"parameters": believed | ({"measurement_sd": 0.2} if smaller else {})}
    truth["parameters"] |= {"measurement_sd": 6.0, "initial_sd": 2.0}
    search = [{"method": "exhaustive"}]
    sections = {"problem": constraints, "model": truth, "search": search}
    run = pfdist.run(small_job.with_changes(sections=sections), tmp_path / "run", figures=False)
    evaluated = run.table("evaluations").query("phase == 'exhaustive'")
    costs = {tuple(row.measurement_times): row.expected_mse for row in evaluated.itertuples()}
    maximal = every_set(**constraints)
    assert sorted(costs) == every_set(**constraints, smaller=smaller)
    assert (min(costs, key=lambda times: costs[times]) in maximal) != smaller
    assert (run.sets["exhaustive"] in maximal) != smaller
    assert run.sets["regular"] in maximal


def test_sums_of_errors_of_other_instants_have_another_id(tmp_path: Path) -> None:
    built, sets = build(job_with(tmp_path)), ((0, 4), (0, 8))
    spans = [([0, 0], [7, 12]), ([4, 0], [7, 12]), ([0, 0], [7, 11])]
    ids = {
        BlockSums(built, Counted(sets, np.array(first), np.array(ends)), (1, 1), Estimation(40)).id
        for first, ends in spans
    }
    assert len(ids) == len(spans)


NO_SCALAR = "model.name=bearings_only"
REFUSED = [  # changes of the job, and what the error says
    (["model.name=ungn"], r"^model\.name: the model: got 'ungn'; did you mean 'ungm'"),
    (["model.parameters.sd=1"], r"^model\.parameters: .*unknown parameter 'sd', allowed: "),
    (["model.parameters.process_sd=-1"], r"^model\.parameters: .* 0\.\.inf, got -1\.0$"),
    (["model.filter.name=ungn"], r"^model\.filter\.name: the model: got 'ungn'; did you mean"),
    (["model.filter.parameters.sd=1"], "model.filter: .*unknown parameter 'sd'"),
    (["model.filter.name=other.py:model"], "as many components of z as .* 1, got 2"),
]


@in_turn("engine", ["auto", "numpy"])
@in_turn(("changes", "message"), REFUSED)
def test_what_does_not_fit_together_is_refused_with_the_key_of_the_job(
    changes: list[str], message: str, engine: str, tmp_path: Path
) -> None:
    job = job_with(tmp_path, quantity="lambda x, t, p: (x[0], x[0])")
    with pytest.raises(ModelError, match=message):
        build(job.with_changes([*changes, f"filter.engine={engine}"]))


def test_a_search_has_its_own_particles_and_its_race_the_jobs(tmp_path: Path) -> None:
    job = job_with(tmp_path).with_changes(["search.random.evaluation.particles=9"])
    genetic, trials = build(job).searches
    assert genetic.settings.estimation == Estimation(40, "multinomial", "squared_error")
    assert trials.settings.estimation == Estimation(9, "multinomial", "squared_error")
    for search in (genetic, trials):
        assert search.racing.estimation == Estimation(40, "multinomial", "squared_error")


OWN = ["[model]", 'name = "other.py:model"']


@pytest.mark.parametrize("engine", ["auto", "numpy"])
def test_a_formula_that_cannot_be_traced_is_one_line_that_names_batched_models(
    engine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job_with(tmp_path, *OWN, formula="scipy.special.erf(0.5 * x[0])")
    words = ["--times", "0,4,8,12", "--set", f"filter.engine={engine}"]
    assert main(["evaluate", str(tmp_path / "small.toml"), *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.match(r".*transition cannot be traced at t = 0: .*erf.*other\.py:\d+\); ", line)
    assert line.endswith("functions of arrays as a pfdist.BatchedModel, see docs/simulators.md")


@pytest.mark.slow
def test_ray_workers_load_what_the_driver_has_compiled(tmp_path: Path, ray_cluster: None) -> None:
    def kept() -> dict[str, int]:
        files = cached._folder(Path(cached.__file__).parent).rglob("*.nbc")
        return {file.name: file.stat().st_ino for file in files}

    job = job_with(tmp_path, *OWN)
    build(job)
    before = kept()
    pfdist.run(job, tmp_path / "run", pool="ray", workers=2, figures=False)
    assert len(before) >= 2  # the simulation and the filter
    assert before == kept()  # a worker that compiled would have saved, and so replaced it


def test_the_engine_is_part_of_what_a_run_is(small_job: Job, small_run: pfdist.Run) -> None:
    with pytest.raises(RunMismatchError, match="engine: compiled -> numpy"):
        pfdist.run(small_job.with_changes(["filter.engine=numpy"]), small_run.path, figures=False)


@pytest.mark.parametrize("name", ["epidemic", "pharmacokinetics"])
def test_a_model_that_reads_the_clock_needs_one_before_anything_is_compiled(name: str) -> None:
    problem = {"horizon": 12, "measurement_budget": 3}
    words = r"^model: .* reads the clock: p\.time.* and there is none: g"
    with pytest.raises(ModelError, match=words):  # and a warning about Numba would be an error
        build(Job(seed=1, model={"name": name}, problem=problem))
    with pytest.raises(ModelError, match=r"^model\.filter: .* reads the clock: "):
        build(Job(seed=1, model={"filter": {"name": name}}, problem=problem))


@pytest.mark.parametrize(
    ("address", "environment", "threaded", "pool", "reason"),
    [
        ("", "", True, "threads", "no cluster is given"),
        ("", "", False, "processes", "functions that are not compiled hold Python's lock"),
        ("local", "", True, "ray", "an address is given"),
        ("", "10.0.0.1:6379", True, "ray", "RAY_ADDRESS is set"),
    ],
)
def test_auto_is_ray_where_a_cluster_is_at_hand_and_else_threads(
    address: str,
    environment: str,
    threaded: bool,
    pool: str,
    reason: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("RAY_ADDRESS", environment)
    monkeypatch.delitem(sys.modules, "ray", raising=False)  # another test may have joined one
    execution, why = chosen_pool(Execution(address=address), threaded=threaded)
    assert (execution.pool, why) == (pool, reason)
    assert execution.address == ("auto" if environment else address)
    assert chosen_pool(execution, threaded=threaded) == (execution, "")
