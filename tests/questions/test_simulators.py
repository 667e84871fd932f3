"""Batched models in whole runs: a user's file with a helper, every pool, every question."""

import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Run
from pfdist.errors import EngineWarning, ModelError, RunMismatchError
from pfdist.plugins.check import model_checks as checks_of_models
from pfdist.plugins.check.model_checks import check_loaded
from pfdist.questions.run_page import page_of

pytestmark = pytest.mark.plugins("online", "why")

HELPER = """
import numpy as np

def drift(x, t):
    return x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * t)
"""
MODEL = """
from helper import drift
from pfdist import BatchedModel

def transition(x, t, w, p):
    {line}
    return drift(x, t) + w

model = BatchedModel(
    "growth", lambda w, p: 5 * w, transition, version="{version}", files=("helper.py",),
    measurement=lambda x, t, v, p: x**2 / 20 + v,
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0] ** 2 / 20) ** 2,
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal",), process_noise=("normal",), measurement_noise=("normal",), {more}
)
"""
JOB = """
seed = 3
[model]
name = "simulator.py:model"
[problem]
horizon = 8
measurement_budget = 3
[filter]
particles = 40
[evaluation]
draws = 40
[[search]]
method = "random"
evaluations = 5
[comparison]
draws = 60
[online]
draws = 4
"""
DECLARED = "ignore:model growth is declared:pfdist.errors.EngineWarning"


def written(
    folder: Path, version: str = "1", line: str = "pass", more: str = "together=500"
) -> Path:
    """A job whose model stands in a file with a helper beside it."""
    folder.mkdir(exist_ok=True)
    (folder / "helper.py").write_text(HELPER, encoding="utf-8")
    text = MODEL.format(version=version, line=line, more=more)
    (folder / "simulator.py").write_text(text, encoding="utf-8")
    (folder / "job.toml").write_text(JOB, encoding="utf-8")
    return folder / "job.toml"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A finished run on the serial pool."""
    folder = tmp_path_factory.mktemp("simulator")
    job = written(folder)
    with pytest.warns(EngineWarning, match="model growth is declared as version 1, helper.py "):
        return pfdist.run(job, folder / "run", pool="serial", figures=False)


@pytest.mark.slow
@pytest.mark.filterwarnings(DECLARED)
def test_processes_give_the_same_bytes(finished: Run, tmp_path: Path) -> None:
    """Workers get the functions by value: their processes have neither file."""
    job = written(tmp_path / "here")
    run = pfdist.run(job, tmp_path / "run", pool="processes", workers=1, figures=False)
    assert hashes(run.path) == hashes(finished.path)


@pytest.mark.filterwarnings(DECLARED)
def test_its_questions_are_answered(finished: Run) -> None:
    folder = finished.path
    assert len(pfdist.open_run(folder).table("online")) == 4
    page = str(page_of(pfdist.open_run(folder)))
    assert "declared as version 1, helper.py " in page
    with pytest.raises(ModelError, match="a run does not contain the functions of a batched model"):
        pfdist.why(folder, draws=50, figures=False)


@pytest.mark.slow
@pytest.mark.filterwarnings(DECLARED)
def test_its_gap_and_the_worth_of_its_measurements_are_computed(
    finished: Run, tmp_path: Path
) -> None:
    job, folder = finished.path.parent / "job.toml", shutil.copytree(finished.path, tmp_path / "a")
    bound = pfdist.bound(job, draws=480, results=folder, figures=False, report=False)
    assert all(0.0 <= gap.gap_at_most <= 1.0 for gap in bound.gaps)
    why = pfdist.why(job, results=folder, draws=50, figures=False)
    assert why.profile["error"].notna().all()


@pytest.mark.filterwarnings(DECLARED)
def test_a_run_is_not_resumed_with_another_identity(finished: Run, tmp_path: Path) -> None:
    job = written(tmp_path / "here", version="2")
    with pytest.raises(RunMismatchError, match=r"transition.*declared as version 1.*-> version 2"):
        pfdist.run(job, finished.path, pool="serial", figures=False)


@pytest.mark.filterwarnings(DECLARED)
@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("1 / (t - 4)", "transition failed: ZeroDivisionError: division by zero at t = 4"),
        ("x = x[:, 1:]; w = w[:, 1:]", "transition must give an array"),
        ("x[0] = 0.0", "transition failed: ValueError: assignment destination is read-only"),
        ("x = x + (np.nan if t == 5 else 0.0)", "name 'np' is not defined"),
        (
            "x = x + (float('nan') if t == 5 else 0.0)",
            r"must stay finite, got x\[0\] = nan at t = 6",
        ),
    ],
)
def test_a_function_that_is_wrong_is_one_line(tmp_path: Path, line: str, says: str) -> None:
    with pytest.raises(ModelError, match=says) as refused:
        pfdist.run(written(tmp_path / "here", line=line, more=""), tmp_path / "run", figures=False)
    assert "\n" not in str(refused.value)
    assert "simulator.py:6" in str(refused.value) or "must" in str(refused.value)


@pytest.mark.fault
@pytest.mark.filterwarnings(DECLARED)
def test_a_simulator_that_crashes_is_a_failed_task(tmp_path: Path) -> None:
    line = "import os; w.shape[1] < 1000 or os.abort()"
    with pytest.raises(pfdist.PfdistError, match="its worker ended"):
        pfdist.run(written(tmp_path / "here", line=line, more=""), tmp_path / "run", figures=False)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("pass", r"the functions can be traced: \S+ ns a particle-step instead of \S+ ns; write"),
        ("x = x[:1, :]", r"ns a particle-step on arrays; the functions cannot be traced"),
    ],
)
def test_check_model_names_the_faster_engine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, says: str
) -> None:
    monkeypatch.setattr(checks_of_models, "_LONGEST", 0.1)  # no larger numbers are tried
    monkeypatch.setattr(checks_of_models, "_DRAWS", 50)
    job = written(tmp_path / "here", line=line)
    name = f"{job.with_name('simulator.py')}:model"
    checks = {each.name: each for each in check_loaded(partial(pfdist.load_model, name), 8, 40)}
    assert re.search(says, checks["engines"].text)
    assert not any(each.state == "wrong" for each in checks.values())


@pytest.mark.parametrize(("power", "is_asked"), [(1, True), (0, False)])
def test_check_model_asks_for_smaller_arrays_of_a_slow_simulator(
    power: int, is_asked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Few draws do not fill an array, and the time may grow with its particles, or may not."""
    monkeypatch.setattr(
        checks_of_models,
        "seconds_a_step",
        lambda evaluator, *_: 1e-6 * (getattr(evaluator.model, "together", 1) / 1e4) ** power,
    )
    monkeypatch.setattr(checks_of_models, "enough_particles", lambda *given: given[-1])
    monkeypatch.setattr(checks_of_models, "_DRAWS", 50)
    name = f"{written(tmp_path / 'here', more='').with_name('simulator.py')}:model"
    checks = {each.name: each for each in check_loaded(partial(pfdist.load_model, name), 8, 40)}
    assert ("together" in checks) == is_asked
    if is_asked:
        assert checks["together"].state == "note"
        assert "together=40)" in checks["together"].text


def test_it_is_the_filter_of_the_same_formulas(
    finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The growth model with noise of constant size, as formulas: the same noise, to 9 digits."""
    # The opponent of a batched model has no least work, because a simulator may be slow.
    monkeypatch.setattr("pfdist.runner.opponent._LEAST_STEPS", 0.0)
    formulas = MODEL.replace("BatchedModel", "StateSpaceModel").replace("x**2", "x[0]**2")
    formulas = formulas.replace('version="{version}", files=("helper.py",),', "")
    formulas = formulas.replace("return drift(x, t) + w", "return (drift(x[0], t) + w[0],)")
    formulas = formulas.replace("5 * w", "(5 * w[0],)").replace("/ 20 + v,", "/ 20 + v[0],")
    formulas = formulas.replace("x[0]**2 / 20 + v[0],", "(x[0]**2 / 20 + v[0],),")
    job = written(tmp_path / "here")
    text = formulas.format(line="pass", more="")
    job.with_name("simulator.py").write_text(text, encoding="utf-8")
    run = pfdist.run(job, tmp_path / "run", pool="serial", figures=False)
    for name in ("mse_evenly_spaced", "mse_random"):
        found, expected = (each.table("comparison")[name] for each in (finished, run))
        np.testing.assert_allclose(found, expected, rtol=1e-7)


@pytest.mark.needs("jax")
@pytest.mark.filterwarnings(DECLARED)
def test_workers_have_the_precision_of_jax_that_the_models_file_sets(tmp_path: Path) -> None:
    """They do not run the file, and float32 plus float64 noise would be float64 all the same."""
    job = written(tmp_path / "here", line="x = np.asarray(np_of_jax(x) * 0.9)")
    file = job.with_name("simulator.py")
    lines = (
        "import jax",
        "import numpy as np",
        'jax.config.update("jax_enable_x64", True)',
        "np_of_jax = jax.jit(lambda x: x * 1.1)",
    )
    file.write_text("\n".join((*lines, file.read_text(encoding="utf-8"))), encoding="utf-8")
    runs = [
        pfdist.run(job, tmp_path / pool, pool=pool, figures=False)
        for pool in ("serial", "processes")
    ]
    assert hashes(runs[0].path) == hashes(runs[1].path)
