"""Commands do as much work as `work.csv` says: whoever makes one dearer changes a number there.

Each command runs in a process of its own, whose work `oracles.worked` counts: particle-steps by
what they are for (instants of sets for an exact engine), tasks, commits, files, formulas traced,
code that is compiled or loaded, and calls of functions of pfdist. Jobs have few particles: numbers
of steps are in proportion. `pytest -m golden -k work --keep-golden` writes the table anew.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).with_name("work.csv")
COUNTS = ROOT / "tests" / "oracles" / "worked.py"
CALLS = 0.1  # by which their number may differ

_PLAN = "plan {jobs}/plan.toml --set filter.particles=30 --results {run}"
COMMANDS = {
    "quick plan": "plan {jobs}/quick.toml --set filter.particles=30 --results {run}",
    "quick blood": (
        "plan {jobs}/blood.toml --bound-draws 0 --set filter.particles=30 --results {run}"
    ),
    "quick evaluate": "evaluate {jobs}/plan.toml --times 0:60:3 --draws 2000",
    "quick exact": (
        "run {jobs}/linear_gaussian.toml --set search.genetic.generations=5"
        " --set comparison.draws=2000 --results {run}"
    ),
    "plan": _PLAN,
    "smoothed": f"{_PLAN} --bound-draws 0 --set problem.estimate=smoothed",
    "two sensors": (
        "plan {jobs}/two_compartments.toml --set filter.particles=30 --set comparison.draws=2000"
        " --results {run}"
    ),
    "run": "run {jobs}/quick.toml --set filter.particles=30 --results {run}",
    "budget": (
        "budget {jobs}/plan.toml --measurements 5:20:5 --set filter.particles=30"
        " --draws 2000 --results {run}"
    ),
    "compare": (
        "compare {jobs}/plan.toml --times a=0:60:3 --times b=0:20 --set filter.particles=30"
        " --results {run}"
    ),
    "rule": "rule {jobs}/quick.toml --set filter.particles=30 --draws 1000 --results {run}",
    "next": "next {jobs}/quick.toml {measurements} --set filter.particles=30 --results {run}",
}
_OF_A_RUN = ("rule", "next")
_WITHOUT_POOL = ("evaluate", "next")


@pytest.mark.golden
@pytest.mark.parametrize("name", COMMANDS)
def test_the_work_of_a_command_is_that_of_the_table(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    now = _worked(name, tmp_path)
    if request.config.getoption("--keep-golden"):
        _keep(name, now)
    kept = _table()[name]
    assert now == {
        what: pytest.approx(number, rel=CALLS * (what == "calls"), abs=0)
        for what, number in kept.items()
    }


def _worked(name: str, folder: Path) -> dict[str, int]:
    measurements, counts = folder / "measured.csv", folder / "counts.json"
    measurements.write_text("t,y0\n2,1.5\n5,3.0\n")
    places = {"jobs": ROOT / "jobs", "run": folder / "run", "measurements": measurements}
    if name in _OF_A_RUN:
        _count(COMMANDS["run"].format(**places), counts)
    _count(COMMANDS[name].format(**places), counts)
    found: dict[str, int] = json.loads(counts.read_text())
    return found


def _count(command: str, counts: Path) -> None:
    word, *words = command.split()
    options = ["--no-report"] * (word not in (*_OF_A_RUN, *_WITHOUT_POOL))
    options += ["--pool", "serial"] * (word not in _WITHOUT_POOL)
    program = [sys.executable, COUNTS, counts, word, *words, *options]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def _table() -> dict[str, dict[str, int]]:
    found = dict[str, dict[str, int]]()
    with KEPT.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(row["command"], {})[row["work"]] = int(row["number"])
    return found


def _keep(name: str, numbers: dict[str, int]) -> None:
    everything = _table() | {name: numbers}
    with KEPT.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("command", "work", "number"))
        for command in filter(everything.get, COMMANDS):
            rows.writerows((command, *each) for each in everything[command].items())
