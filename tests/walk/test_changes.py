"""Changes that need one existing file: tried in a scratch copy of the package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import pfdist

PACKAGE = Path(pfdist.__file__).parent
JOB = """
seed = 1
[model]
name = "random_walk"
[problem]
horizon = 6
measurement_budget = 2
[filter]
particles = 20
[evaluation]
draws = 10
[[search]]
method = "random"
evaluations = 3
[comparison]
draws = 20
"""
ESTIMATOR = """
ESTIMATORS["half_of_each"] = Estimator(
    "half_of_each", ErrorWeights(squared_error=0.5, variance=0.5), "The mean of two estimates."
)
"""
MEAN_OF_BOTH = """
import numpy as np
from pfdist import load_model
from pfdist.evaluation.engines import ENGINES
from pfdist.filters.simulation import simulate
from pfdist.filters.settings import FilterSettings

model = load_model("random_walk")
draws = simulate(model, 6, range(10), 1)
for engine in ("compiled", "numpy"):
    found = {
        name: ENGINES[engine].filter_checked_sets(
            model, draws, [(0, 3)], [6], 2, FilterSettings(20, estimator=name)
        )
        for name in ("half_of_each", "squared_error", "filter_variance")
    }
    both = (found["squared_error"] + found["filter_variance"]) / 2
    np.testing.assert_allclose(found["half_of_each"], both, rtol=1e-9)
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package, and a job beside it."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, tmp_path / "pfdist", ignore=ignored)
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path / "pfdist"


def _python(copy: Path, *arguments: str) -> None:
    """Run Python with the copy in the place of the package."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=copy.parent, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(copy.parent)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def _run(copy: Path, *changes: str) -> pd.DataFrame:
    """Evaluations of a run of the job with the copy."""
    results = copy.parent / "run"
    options = ["--pool", "serial", "--results", str(results), "--set", "seed=2", *changes]
    _python(copy, "-m", "pfdist", "run", "job.toml", *options)
    return pd.read_parquet(results / "tables" / "evaluations")


@pytest.mark.slow
def test_an_estimator_needs_its_record_alone(copy: Path) -> None:
    file = copy / "kernels" / "estimators.py"
    text = file.read_text()
    file.write_text(text.replace("ALL_ESTIMATORS = ", f"{ESTIMATOR}\nALL_ESTIMATORS = "))
    _python(copy, "-c", MEAN_OF_BOTH)
    rows = _run(copy, "evaluation.estimator=half_of_each")
    assert "half_of_each" in set(rows["estimator"])  # a probe may refute it


@pytest.mark.slow
def test_a_column_of_the_evaluations_needs_its_declaration_alone(copy: Path) -> None:
    file = copy / "store" / "schema.py"
    last = '        _column("degenerate_draws", pa.int32(), "", "of them, degenerate"),\n'
    column = '        _column("resampling", pa.string(), "", "scheme of the filter"),\n'
    text = file.read_text()
    assert text.count(last) == 1
    file.write_text(text.replace(last, last + column))
    assert set(_run(copy)["resampling"]) == {"multinomial"}
