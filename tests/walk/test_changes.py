"""A scratch package adds a search, a model and a criterion by entry points, as if installed."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import pytest

from oracles.model_text import MEASURED

ROOT = Path(__file__).parents[2]


def _example(name: str, page: str) -> str:
    """A file of the manual."""
    found = re.search(rf"# {name}\n(.*?)```", (ROOT / "docs" / page).read_text(), re.DOTALL)
    return found[1] if found else ""


WORKING = {
    "searches": _example("greedy.py", "searches.md"),
    "criteria": _example("exceedance.py", "criteria.md"),
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


@pytest.mark.slow
def test_a_model_and_a_search_of_an_installed_package_are_run(tmp_path: Path) -> None:
    installed = _install(WORKING, tmp_path / "site")
    (tmp_path / "job.toml").write_text(JOB)
    search = "search=[{method='greedy', kept=2, evaluation={draws=20}}]"
    regular = "comparison.reference=regular"
    changes = ("model.name=added_walk", "filter.engine=kalman", search, regular)
    command = ("run", tmp_path / "job.toml", "--json", "--results", tmp_path / "run")
    done = _python(installed, "-m", "pfdist", *command, "--set", *changes)
    assert done.returncode == 0, done.stderr
    regular, greedy = json.loads(done.stdout)["sets"]
    assert greedy["expected_mse"] < regular["expected_mse"]


@pytest.mark.slow
def test_a_criterion_of_an_installed_package_is_minimised_and_told(tmp_path: Path) -> None:
    """The share of draws above a limit is that of the table of draws, and decides."""
    assert len(WORKING["criteria"].splitlines()) <= 60
    installed = _install({"criteria": WORKING["criteria"]}, tmp_path / "site")
    (tmp_path / "job.toml").write_text(JOB)
    changes = ("comparison.draws=400", "problem.criterion=exceedance 0.8")
    command = ("plan", tmp_path / "job.toml", "--json", "--results", tmp_path / "run")
    done = _python(installed, "-m", "pfdist", *command, "--bound-draws", "0", "--set", *changes)
    assert done.returncode == 0, done.stderr
    sets, rows = (
        json.loads(done.stdout)["sets"],
        pd.read_parquet(tmp_path / "run/tables/comparison"),
    )
    shares = [(rows[f"mse_{each['name']}"] > 0.8).mean() for each in sets]
    assert [each["exceedance"] for each in sets] == pytest.approx(shares)
    assert min(shares) == pytest.approx(sets[-1]["criterion_value"])
    command = tuple(each for each in command if each != "--json")
    page = _python(installed, "-m", "pfdist", *command, "--bound-draws", "0", "--set", *changes)
    assert "share of draws with an MSE above 0.8" in page.stdout


def test_a_search_that_cannot_be_loaded_is_named_in_one_line(tmp_path: Path) -> None:
    installed = _install({"searches": "import nothing_of_this_name"}, tmp_path / "site")
    done = _python(installed, "-m", "pfdist", "evaluate", "tests/small.toml", "--times", "0,3")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "pfdist: cannot load 'mine', which an installed package adds to pfdist.searches as "
        "added.searches: ModuleNotFoundError: No module named 'nothing_of_this_name'\n"
    )
