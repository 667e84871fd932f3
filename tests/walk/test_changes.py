"""Additions of one file each, and changes that need one existing file.

A scratch package declares a search and a model, and its metadata names them as entry points, as an
installed package does. Files with other additions, and changes, are made in a scratch copy of
pfdist.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import pytest

from oracles.model_text import MEASURED

ROOT = Path(__file__).parents[2]
GREEDY = re.search(r"# greedy\.py\n(.*?)```", (ROOT / "docs/searches.md").read_text(), re.DOTALL)
WORKING = {
    "searches": GREEDY[1] if GREEDY else "",  # the example of the manual
    "models": (
        """
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="a walk",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (x[0] + w[0],),
"""
        + MEASURED
        + "    linear_gaussian=True,\n)\n"
    ),
}
# Each is appended to a file, declares an addition, and breaks the contract of additions in one way.
BROKEN = {
    "search/broken.py": WORKING["searches"]
    .replace("greedy", "broken")
    .replace("Candidate(larger)", "Candidate(larger[::-1])"),
    "pages/broken.py": """
from pfdist.pages.figure import Plot, figure


@figure("broken")
def broken(tables):
    '''Nothing at all.'''
    return Plot(2.0, lambda panels: None)
""",
    "pools/kinds.py": """
from concurrent.futures import ThreadPoolExecutor

from pfdist.pools.base import Outcome, do


class ThreadPool:
    workers = 1

    def __enter__(self):
        self.threads = ThreadPoolExecutor(1)
        return self

    def __exit__(self, *_):
        self.threads.shutdown()

    def run(self, tasks):
        for task in [*tasks][1:]:
            yield Outcome(task, *self.threads.submit(do, task.function, task.work).result())


POOLS["broken"] = PoolKind("Thread", "on a thread", f"{__name__}:ThreadPool")
""",
    "cli/commands.py": """

def broken(*, seed: int = 1):
    '''Do nothing with an option that no help describes.'''


COMMANDS["broken"] = Command(
    f"{__name__}:broken", "Do nothing with an option that no help describes.", {}
)
""",
}
CONTRACTS = {
    "test_optimiser.py": "test_it_asks_for_sorted_sets",
    "test_figure.py": "test_it_is_drawn_into",
    "test_pool.py": "test_every_task_has_one_outcome",
    "test_command.py": "test_every_argument_is_described",
}
ESTIMATOR = """

ESTIMATORS["half_of_each"] = Estimator(
    "half_of_each", ErrorWeights(squared_error=0.5, variance=0.5)
)
"""
MEAN_OF_BOTH = """
import numpy as np
from pfdist import load_model
from pfdist.filters.engines import ENGINES
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation

model = load_model("random_walk")
draws = simulate(model, 6, range(10), 1)
for engine in ("compiled", "numpy"):
    found = {
        name: ENGINES[engine].filters.filter_checked_sets(
            model, draws, [(0, 3)], [6], 2, Estimation(20, estimator=name)
        )[0]
        for name in ("half_of_each", "squared_error", "filter_variance")
    }
    both = (found["squared_error"] + found["filter_variance"]) / 2
    np.testing.assert_allclose(found["half_of_each"], both, rtol=1e-9)
"""
JOB = """
seed = 1
[model]
name = "random_walk"
[problem]
horizon = 12
measurement_budget = 4
[filter]
particles = 20
[evaluation]
draws = 10
[[search]]
method = "random"
evaluations = 3
[comparison]
draws = 20
[execution]
pool = "serial"
"""

Environment = dict[str, str]
Done = subprocess.CompletedProcess[str]


def _install(additions: Mapping[str, str], site: Path) -> Environment:
    """Give the environment of a process in which a package with these additions is installed."""
    package, metadata = site / "added", site / "added-1.0.dist-info"
    for folder in (package, metadata):
        folder.mkdir(parents=True)
    (package / "__init__.py").touch()
    entry_points = ""
    for name, text in additions.items():
        (package / f"{name}.py").write_text(text)
        value = "added_walk = added.models:model" if name == "models" else f"mine = added.{name}"
        entry_points += f"[pfdist.{name}]\n{value}\n"
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: added\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(entry_points)
    paths = [str(site), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def _python(environment: Environment, *words: object, folder: Path = ROOT) -> Done:
    return subprocess.run(
        [sys.executable, *map(str, words)],
        env=environment, cwd=folder, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package, and a job beside it."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "pfdist", tmp_path / "pfdist", ignore=ignored)
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path / "pfdist"


def _using(copy: Path) -> Environment:
    """Give the environment of a process with the copy in the place of the package."""
    return os.environ | {"PYTHONPATH": str(copy.parent)}


@pytest.mark.slow
def test_a_model_and_a_search_of_an_installed_package_are_run(tmp_path: Path) -> None:
    installed = _install(WORKING, tmp_path / "site")
    (tmp_path / "job.toml").write_text(JOB)
    search = "search=[{method='greedy', kept=2, evaluation={draws=20}}]"
    changes = ("model.name=added_walk", "filter.engine=kalman", search)
    command = ("run", tmp_path / "job.toml", "--json", "--results", tmp_path / "run")
    done = _python(installed, "-m", "pfdist", *command, "--set", *changes)
    assert done.returncode == 0, done.stderr
    regular, greedy = json.loads(done.stdout)["sets"]
    assert greedy["expected_mse"] < regular["expected_mse"]


@pytest.mark.slow
def test_an_addition_that_breaks_its_contract_fails_the_tests_by_its_name(copy: Path) -> None:
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "tests", copy.parent / "tests", ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", copy.parent)
    for path, text in BROKEN.items():
        with (copy / path).open("a") as file:
            file.write(text)
    options = ("-n", "0", "-p", "no:cacheprovider")
    tests = " or ".join(CONTRACTS.values())
    files = [f"tests/contracts/{file}" for file in CONTRACTS]
    command = ("-m", "pytest", *options, "-k", f"broken and ({tests})", *files)
    done = _python(_using(copy), *command, folder=copy.parent)
    failed = re.findall(r"^FAILED \S*/(\w+\.py)::(\w+)\[(\S+)\]", done.stdout, re.MULTILINE)
    assert {file for file, _, _ in failed} == set(CONTRACTS), done.stdout
    assert {name.partition("-")[0] for _, _, name in failed} == {"broken"}


def test_a_search_that_cannot_be_loaded_is_named_in_one_line(tmp_path: Path) -> None:
    installed = _install({"searches": "import nothing_of_this_name"}, tmp_path / "site")
    done = _python(installed, "-m", "pfdist", "evaluate", "tests/small.toml", "--times", "0,3")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "pfdist: cannot load 'mine', which an installed package adds to pfdist.searches as "
        "added.searches: ModuleNotFoundError: No module named 'nothing_of_this_name'\n"
    )


def _run(copy: Path) -> pd.DataFrame:
    """Evaluations of a run of the job with the copy."""
    results = copy.parent / "run"
    command = ("-m", "pfdist", "run", "job.toml", "--results", results, "--set", "seed=2")
    done = _python(_using(copy), *command, folder=copy.parent)
    assert done.returncode == 0, done.stderr
    return pd.read_parquet(results / "tables" / "evaluations")


@pytest.mark.slow
def test_an_estimator_needs_its_record_alone(copy: Path) -> None:
    with (copy / "kernels" / "estimators.py").open("a") as file:
        file.write(ESTIMATOR)
    done = _python(_using(copy), "-c", MEAN_OF_BOTH, folder=copy.parent)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_column_of_the_evaluations_needs_its_declaration_alone(copy: Path) -> None:
    file = copy / "store" / "schema.py"
    last = '        _column("degenerate_draws", pa.int32(), "", "of them, degenerate"),\n'
    column = '        _column("resampling", pa.string(), "", "scheme of the filter"),\n'
    text = file.read_text()
    assert text.count(last) == 1
    file.write_text(text.replace(last, last + column))
    assert set(_run(copy)["resampling"]) == {"multinomial"}
