"""Additions that a user makes from outside the package, without touching a file of it.

A scratch package declares additions, and its metadata names them as entry points, as an installed
package does.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WORKING = {
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
    linear_gaussian=True,
)
""",
    "figures": """
from pfdist.plots.figure import Plot, figure


@figure("spacing", each_set=True)
def spacing(tables, name):
    '''Numbers of instants between the measurements of a set.'''
    times = tables.run.compared().set_index("name")["measurement_times"][name]
    title = f"The longest gap of {name} is {max(times[1:] - times[:-1])} instants."

    def draw(panels):
        panels[0].plot(times[:-1], times[1:] - times[:-1], "o")

    return Plot(2.0, draw, title=title)
""",
    "pools": """
from concurrent.futures import ThreadPoolExecutor

from pfdist.pools.base import do
from pfdist.pools.kinds import POOLS, PoolKind


class ThreadPool:
    workers = 1

    def __init__(self, make_function):
        self.make_function = make_function

    def __enter__(self):
        self.function = self.make_function()
        self.threads = ThreadPoolExecutor(1)
        return self

    def __exit__(self, *_):
        self.threads.shutdown()

    def run(self, tasks):
        for task in tasks:
            yield self.threads.submit(do, self.function, task).result()


POOLS.declare("thread", PoolKind("Thread", "on a thread", "added.pools:ThreadPool"))
""",
    "commands": """
from pfdist.cli.arguments import add_run
from pfdist.cli.command import command


@command("times", add_run)
def times(options):
    '''List the measurement times of a run.'''
    from pfdist.analysis import open_run

    for name, result in open_run(options.run).summary()["results"].items():
        print(name, *result["measurement_times"])
""",
}
# Each declares an addition, and breaks the contract of such additions in one way.
BROKEN = {
    "searches": WORKING["searches"]
    .replace("shifted", "broken")
    .replace("Candidate(times)", "Candidate(times[::-1])"),
    "figures": """
from pfdist.plots.figure import Plot, figure


@figure("broken")
def broken(tables):
    '''Nothing at all.'''
    return Plot(2.0, lambda panels: None)
""",
    "pools": WORKING["pools"]
    .replace('"thread"', '"broken"')
    .replace("in tasks", "in [*tasks][1:]"),
    "commands": """
from pfdist.cli.command import command


@command("broken", lambda parser: parser.add_argument("--option"))
def broken(options):
    '''Do nothing with an option that no help describes.'''
""",
}
CONTRACTS = {
    "searches": ("test_optimiser.py", "test_it_asks_for_sorted_sets"),
    "figures": ("test_figure.py", "test_it_is_drawn_into"),
    "pools": ("test_pool.py", "test_every_task_has_one_outcome"),
    "commands": ("test_command.py", "test_every_argument_is_described"),
}
JOB = """
seed = 1
[model]
name = "added_walk"
[problem]
horizon = 12
measurement_budget = 4
[filter]
particles = 50
engine = "kalman"
[[search]]
method = "shifted"
shifts = 2
[search.evaluation]
draws = 20
[comparison]
draws = 40
[execution]
pool = "thread"
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


def _python(installed: Environment, *words: object) -> Done:
    return subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        env=installed, cwd=ROOT, capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return _install(WORKING, tmp_path_factory.mktemp("working") / "site")


@pytest.fixture(scope="module")
def run(installed: Environment, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    """A run with everything that the package adds."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "mine.toml").write_text(JOB)
    command = ("pfdist", "run", folder / "mine.toml", "--json", "--results", folder / "run")
    done = _python(installed, *command)
    assert done.returncode == 0, done.stderr
    return folder / "run", done


def test_a_model_and_a_search_of_an_installed_package_are_run(run: tuple[Path, Done]) -> None:
    results = json.loads(run[1].stdout)["results"]
    assert results["shifted"]["measurement_times"][1:3] in ([4, 8], [5, 9])


def test_a_pool_of_an_installed_package_computes_a_run(run: tuple[Path, Done]) -> None:
    assert "Thread is ready: 1 worker in " in run[1].stderr


def test_a_figure_of_an_installed_package_is_drawn_beside_the_others(
    run: tuple[Path, Done],
) -> None:
    names = {file.name for file in (run[0] / "figures").iterdir()}
    assert {"spacing-shifted.png", "spacing-shifted.svg", "cost.svg"} <= names


def test_a_command_of_an_installed_package_is_called_and_helps(
    run: tuple[Path, Done], installed: Environment
) -> None:
    done = _python(installed, "pfdist", "times", run[0])
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("regular 0 4 8 12\nshifted ")
    text = _python(installed, "pfdist", "--help").stdout
    assert re.search(r"^ +times +List the measurement times of a run\.$", text, re.MULTILINE)
    assert "thread, on a thread" in " ".join(
        _python(installed, "pfdist", "run", "-h").stdout.split()
    )


def test_an_addition_that_breaks_its_contract_fails_the_tests_by_its_name(tmp_path: Path) -> None:
    installed = _install(BROKEN, tmp_path / "site")
    files = [f"tests/contracts/{file}" for file, _ in CONTRACTS.values()]
    tests = " or ".join(test for _, test in CONTRACTS.values())
    options = ("-n", "0", "-p", "no:cacheprovider", "-k", f"broken and ({tests})")
    done = _python(installed, "pytest", *options, *files)
    failed = re.findall(r"^FAILED \S*/(\w+\.py)::(\w+)\[(\S+)\]", done.stdout, re.MULTILINE)
    assert {file for file, _, _ in failed} == {file for file, _ in CONTRACTS.values()}, done.stdout
    assert {name.partition("-")[0] for _, _, name in failed} == {"broken"}


@pytest.mark.parametrize("group", ["searches", "figures", "pools", "commands"])
def test_an_addition_that_cannot_be_loaded_is_named_in_one_line(group: str, tmp_path: Path) -> None:
    installed = _install({group: "import nothing_of_this_name"}, tmp_path / "site")
    words = {"commands": ("--help",), "figures": ("plot", "tests/assets/schema-2")}
    line = ("evaluate", "tests/small.toml", "--times", "0,3")
    done = _python(installed, "pfdist", *words.get(group, line))
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        f"pfdist: cannot load 'mine', which an installed package adds to pfdist.{group} as "
        f"added.{group}: ModuleNotFoundError: No module named 'nothing_of_this_name'\n"
    )
