"""The Python interface: every exported name exists, is documented, and does what it says."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import pfdist
from oracles.in_turn import in_turn
from pfdist import Job
from pfdist.questions.options import Chosen


@in_turn("name", pfdist.__all__)
def test_every_exported_name_is_documented(name: str) -> None:
    exported = getattr(pfdist, name)
    doc = inspect.getdoc(exported)
    assert doc
    if inspect.isfunction(exported):
        for parameter in inspect.signature(exported).parameters:
            assert re.search(rf"^(\w+, )*{parameter}(, \w+)* : ", doc, re.MULTILINE)
        assert "Returns" in doc


def test_the_help_of_plan_fits_a_screen_and_names_its_options() -> None:
    """The options of execution are described once, by `pfdist.Options`."""
    text = inspect.getdoc(pfdist.plan) or ""
    assert len(text.splitlines()) <= 45
    assert "see `pfdist.Options`" in text
    assert all(f"{name} : " in (pfdist.Options.__doc__ or "") for name in Chosen.model_fields)


def _printed(code: str) -> str:
    """Give the output of a new process."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


def test_a_worker_does_not_wait_for_what_it_does_not_need() -> None:
    imports = "import sys, pfdist.pools.ray_pool, pfdist.runner.build"
    heavy = "{'pandas', 'pyarrow', 'matplotlib', 'scipy.stats'}"
    assert _printed(f"{imports}; print({heavy} & {{*sys.modules}})") == "set()\n"


def test_a_plan_loads_pandas_when_it_reads_tables() -> None:
    heavy = "{'pandas', 'matplotlib', 'jinja2', 'ray', 'scipy.stats', 'scipy.special'}"
    imports = "import sys, pfdist; pfdist.plan, pfdist.run"
    assert _printed(f"{imports}; print({heavy} & {{*sys.modules}})") == "set()\n"


def test_evaluate_is_a_function_of_its_arguments(small_job: Job) -> None:
    once, again = (pfdist.evaluate(small_job, [8, 0, 4]) for _ in range(2))
    np.testing.assert_array_equal(once.mse, again.mse)
    assert once.measurement_times == (0, 4, 8)
    assert once.expected_mse == np.mean(once.mse)
    assert (once.draws, once.degenerate_draws, once.mse.shape) == (30, 0, (30,))
    from_file = pfdist.evaluate(small_job.path, (0, 4, 8))
    np.testing.assert_array_equal(once.mse, from_file.mse)
    other = pfdist.evaluate(small_job, (0, 4, 8), draws=40, particles=10, seed=2)
    assert other.draws == 40
    assert other.expected_mse != once.expected_mse


def test_more_draws_begin_with_the_same_draws(small_job: Job) -> None:
    few, many = (pfdist.evaluate(small_job, (0, 4), draws=draws).mse for draws in (10, 30))
    np.testing.assert_array_equal(few, many[:10])


def test_common_noise_compares_sets_on_the_same_draws(small_job: Job) -> None:
    correlations = {}
    for noise in ("fresh", "common"):
        job = small_job.with_changes([f"evaluation.noise={noise}"])
        a, b = (pfdist.evaluate(job, times, draws=400).mse for times in ((2, 5), (2, 6)))
        correlations[noise] = np.corrcoef(a, b)[0, 1]
    assert abs(correlations["fresh"]) < 4 / np.sqrt(400)
    assert correlations["common"] > 0.5


def test_load_model_takes_a_path_and_a_name(tmp_path: Path) -> None:
    assert pfdist.load_model("ungm").name == "ungm"
    path = tmp_path / "mine.py"
    path.write_text("from pfdist.models.library.ungm import model as mine\n")
    assert pfdist.load_model(f"{path}:mine").components == (1, 1, 1)
