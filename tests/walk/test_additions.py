"""What a user adds from outside the package, without touching a file of it.

A scratch package declares additions, and its metadata names them as entry points, as an installed
package does.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ADDITIONS = {
    "searches": """
from collections.abc import Sequence
from dataclasses import dataclass

from pfdist.search import Candidate
from pfdist.search.methods import method
from pfdist.search.section import Count


@method("shifted")
@dataclass(frozen=True)
class Shifted:
    '''Regular times and sets shifted by one instant.'''

    feasible: object
    shifts: Count = 3
    generations = 1

    @property
    def evaluations(self):
        return self.shifts

    def init(self):
        return ()

    def ask(self, state, rng):
        regular = self.feasible.regular()
        shifted = [tuple(t + k for t in regular[:-1]) + regular[-1:] for k in range(self.shifts)]
        return [Candidate(times) for times in shifted]

    def tell(self, state, evaluations):
        return tuple(evaluations)

    def done(self, state):
        return bool(state)

    def finalists(self, state):
        return sorted(state, key=lambda evaluation: evaluation.cost)[:1]
""",
    "models": """
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="a walk",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (x[0] + w[0],),
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
)
""",
}
ENTRY_POINTS = """
[pfdist.searches]
shifted = added.searches

[pfdist.models]
added_walk = added.models:model
"""
JOB = """
seed = 1
[model]
name = "added_walk"
[problem]
horizon = 12
measurement_budget = 4
[filter]
particles = 50
[[search]]
method = "shifted"
shifts = 2
[search.evaluation]
draws = 20
[comparison]
draws = 40
"""


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """The environment of a process in which the additions are installed."""
    package, metadata = tmp_path / "site" / "added", tmp_path / "site" / "added-1.0.dist-info"
    for folder in (package, metadata):
        folder.mkdir(parents=True)
    (package / "__init__.py").touch()
    for name, text in ADDITIONS.items():
        (package / f"{name}.py").write_text(text)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: added\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)
    paths = [str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}


def test_a_model_and_a_search_of_an_installed_package_are_run(
    installed: dict[str, str], tmp_path: Path
) -> None:
    job = tmp_path / "mine.toml"
    job.write_text(JOB)
    command = [sys.executable, "-m", "pfdist", "run", str(job), "--pool", "serial", "--json"]
    run = subprocess.run(
        [*command, "--results", str(tmp_path / "run")],
        env=installed, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    results = json.loads(run.stdout)["results"]
    assert results["shifted"]["measurement_times"][1:3] in ([4, 8], [5, 9])
