"""Plans beside evenly spaced times and the linearized design, on the same fresh draws.

Each system has the search's own opponent, the set of least linearized error, the plan of version
3488e69a, whose filters forgot constants, and the plan of this version. All are judged by the filter
that ``filter.proposal = "auto"`` takes.
"""

import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import Problem
from pfdist.common.estimate import Estimate
from pfdist.errors import ModelError
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from oracles.unknown import (
    GLUCOSE_MINUTES,
    HOURS,
    MINUTES,
    drug,
    emax,
    epidemic,
    level_and_slope,
    logistic,
    minimal_model,
    remifentanil,
)

TITLE = "Plans and linearized designs"
TABLES: tuple[str, ...] = ("designs",)

_DRAWS = 4000
# The plans of version 3488e69a.
BEFORE: Mapping[str, tuple[float, ...]] = {
    "drug, error 3 %": (2, 8, 10, 12, 16, 24),
    "drug, error 15 %": (0.5, 2, 3, 6, 8, 24),
    "plateau, 4 constants": (12, 18, 20, 24, 30),
    "growth, 3 constants": (7, 13, 19, 23, 24),
    "minimal model": (8, 50, 80, 120, 180),
    "epidemic, 2 rates": (12, 48, 54, 60),
    "remifentanil, 6 constants": (60, 90, 120, 180),
    "level and slope, noise": (9, 14, 18, 22, 26, 31),
    "shipped: drug with noise": (0, 3, 4, 6, 10, 11),
    "shipped: predator and prey": (11, 15, 20, 28, 31, 35),
    "paper's growth model": (
        1, 2, 3, 7, 11, 12, 16, 19, 20, 23, 24, 32, 33, 37, 41, 44, 45, 49, 53, 54, 58,
    ),
}  # fmt: skip
EVEN, LINEARIZED, PLAN, OLD = "evenly spaced", "linearized", "plan", "plan before"


def problems() -> dict[str, Problem]:
    """The problems by the names of their systems."""
    afterwards: dict[str, Any] = {"estimate": "smoothed"}
    drugs = {"times": [*HOURS], "measurement_budget": 6, **afterwards}
    return {
        "drug, error 3 %": Problem(drug(0.03), **drugs),
        "drug, error 15 %": Problem(drug(0.15), **drugs),
        "plateau, 4 constants": Problem(
            emax(), horizon=30, time_step=2, measurement_budget=5, **afterwards
        ),
        "growth, 3 constants": Problem(
            logistic(), horizon=24, time_step=1, measurement_budget=5, **afterwards
        ),
        "minimal model": Problem(
            minimal_model(), times=[*GLUCOSE_MINUTES], measurement_budget=5, **afterwards
        ),
        "epidemic, 2 rates": Problem(
            epidemic(), horizon=60, time_step=6, measurement_budget=4, **afterwards
        ),
        "remifentanil, 6 constants": Problem(
            remifentanil(), times=[*MINUTES], measurement_budget=4, **afterwards
        ),
        "level and slope, noise": Problem(
            level_and_slope(0.02, 0.05), horizon=40, measurement_budget=6
        ),
        "shipped: drug with noise": Problem(
            "pharmacokinetics", horizon=24, time_step=1, measurement_budget=6
        ),
        "shipped: predator and prey": Problem("lotka_volterra", horizon=40, measurement_budget=6),
        "paper's growth model": Problem("ungm", horizon=60, measurement_budget=21),
    }


def measure(quick: bool, say: Say) -> Tables:
    """Give the expected MSE of each set of each system.

    Parameters
    ----------
    quick : bool
        Few draws and two systems.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        designs: a row for each system and set, with t (the times), mse, mse_error, and above (how
        far it lies above the plan's, as a fraction of that) with above_error.
    """
    rows = list[dict[str, Any]]()
    for name, problem in [*problems().items()][: 2 if quick else None]:
        rows += _of_system(name, problem, quick)
        say(name)
    return {"designs": pd.DataFrame(rows)}


def planned(problem: Problem, draws: int = 1000, **search: Any) -> dict[str, Any]:
    """The best evenly spaced times, and those of the plan."""
    own = {"method": "relaxation", **search}
    job = problem.job(search=[own], comparison={"draws": draws})
    with tempfile.TemporaryDirectory() as folder:
        run = pfdist.run(job, Path(folder) / "run", figures=False, report=False)
        return {EVEN: run.sets["evenly_spaced"], PLAN: run.sets["relaxation"]}


def _of_system(name: str, problem: Problem, quick: bool) -> list[dict[str, Any]]:
    draws = 200 if quick else _DRAWS
    few: dict[str, Any] = {"evaluation": {"draws": 24}} if quick else {}
    sets: dict[str, Any] = planned(problem, 100 if quick else 1000, **few)
    with suppress(ModelError):  # formulas without derivatives
        sets[LINEARIZED] = pfdist.evaluate(problem, "linearized", draws=2).measurement_times
    if name in BEFORE:
        sets[OLD] = BEFORE[name]
    found = pfdist.evaluate(problem, sets, draws=draws)
    plan = found[PLAN]
    rows = list[dict[str, Any]]()
    for key, each in found.items():
        above = Estimate.of_mean(each.mse - plan.mse).times(1.0 / plan.expected_mse)
        rows.append({
            "system": name, "times": key, "t": ", ".join(f"{t:g}" for t in sets[key]),
            "mse": each.expected_mse, "mse_error": each.standard_error,
            "above": above.value, "above_error": above.standard_error,
        })  # fmt: skip
    return rows


def summary(tables: Tables) -> str:
    """Give a summary in Markdown: a row for each system."""
    table, rows = tables["designs"], list[list[str]]()
    for name, of_system in table.groupby("system", sort=False):
        by_set = of_system.set_index("times")
        cells = [str(name), f"{float(by_set['mse'][PLAN]):.4g} at {by_set['t'][PLAN]}"]
        for key in (EVEN, LINEARIZED, OLD):
            cells.append("no derivatives" if key == LINEARIZED else "")
            if key in by_set.index:
                above, error = (float(by_set[each][key]) for each in ("above", "above_error"))
                cells[-1] = f"{100 * above:+.1f} ± {100 * error:.1f} %"
        rows.append(cells)
    head = ("system", "plan: expected MSE, times", EVEN, LINEARIZED, OLD)
    return (
        f"How far the expected MSE of other sets lies above that of the plan, on {_DRAWS:,} fresh "
        f"draws, with its standard error. Plans before are those of version 3488e69a.\n\n"
        f"{markdown(head, rows)}"
    )


def plot(tables: Tables) -> Figure:
    """Draw how far evenly spaced times and linearized designs lie above plans."""
    table = tables["designs"]
    names = [*dict.fromkeys(table["system"])]
    figure = Figure(figsize=(2 * COLUMN_INCHES, COLUMN_INCHES), layout="constrained")
    axes = figure.add_subplot()
    for key, color, shift in ((EVEN, RED, -0.15), (LINEARIZED, BLUE, 0.15)):
        own = table[table["times"] == key]
        places = [names.index(name) + shift for name in own["system"]]
        axes.errorbar(
            100 * own["above"], places, xerr=200 * own["above_error"], fmt="o", ms=3, color=color,
            label=key,
        )  # fmt: skip
    axes.axvline(0.0, color="0.5", lw=0.6)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.set(xscale="symlog", xlabel="expected MSE above that of the plan [%], ± 2 standard errors")
    axes.legend()
    return figure
