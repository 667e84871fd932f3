"""Plans for one guess, for the mean of scenarios and for the worst of them, on the same draws."""

import tempfile
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.plots.style import BLUE, COLUMN_INCHES, RED

TITLE = "Robust plans"
TABLES: tuple[str, ...] = ("robust",)

JOB = Path(__file__).parents[1] / "jobs" / "two_compartments.toml"
DRAWS = 12_000
_PLANS = {
    "the nominal clearance alone": "nominal",
    "the mean of the scenarios": "mean",
    "the worst scenario": "worst",
}


def measure(quick: bool, say: Say) -> Tables:
    """Make three plans for the two compartments, and compare them.

    Parameters
    ----------
    quick : bool
        Few draws.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        robust: a row for each plan, with planned_for, times, expected_mse and standard_error (mean
        over the scenarios), and worst_mse and worst_error (of the worst scenario).
    """
    draws = 240 if quick else DRAWS
    with tempfile.TemporaryDirectory(prefix="robust-") as name:
        folder, sets = Path(name), dict[str, list[str | float]]()
        for criterion in _PLANS.values():
            job = folder / f"{criterion}.toml"
            job.write_text(_with_criterion(JOB.read_text(encoding="utf-8"), criterion))
            few = ["comparison.draws=240"]
            run = pfdist.plan(job, folder / criterion, changes=few, bound_draws=0, report=False)
            sets[criterion] = list(run.best.measurement_times)
            say(f"{criterion}: {sets[criterion]}")
        compared = pfdist.compare(
            JOB, times=sets, results=folder / "compared", draws=draws, report=False
        )
        means, of_scenarios = compared.summary().results, compared.table("scenarios")
    rows = []
    for planned_for, criterion in _PLANS.items():
        own = of_scenarios[of_scenarios["name"] == criterion]
        worst = own.sort_values("expected_mse").iloc[-1]
        rows.append(
            {
                "planned_for": planned_for,
                "times": ", ".join(map(str, sets[criterion])),
                "expected_mse": means[criterion].expected_mse,
                "standard_error": means[criterion].standard_error,
                "worst_mse": worst["expected_mse"],
                "worst_error": worst["standard_error"],
            }
        )
    return {"robust": pd.DataFrame(rows)}


def _with_criterion(job: str, criterion: str) -> str:
    """The text of the job with another criterion; without scenarios for the nominal plan."""
    if criterion == "nominal":
        before, _, rest = job.partition("[scenarios]")
        return before + "[problem]" + rest.partition("[problem]")[2]
    return job.replace('criterion = "mean"', f'criterion = "{criterion}"')


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    rows = [
        [planned_for, times, f"{mse:.3f} ± {error:.3f}", f"{worst:.2f} ± {worst_error:.2f}"]
        for planned_for, times, mse, error, worst, worst_error in tables["robust"].itertuples(
            index=False
        )
    ]
    return markdown(("planned for", "times, h", "mean error", "error in the worst scenario"), rows)


def plot(tables: Tables) -> Figure:
    """Give the figure: the mean error and the error in the worst scenario of each plan."""
    canvas = Figure(figsize=(COLUMN_INCHES, 2.0), layout="constrained")
    ax, plans = canvas.subplots(), tables["robust"]
    for column, error, colour, label in (
        ("expected_mse", "standard_error", BLUE, "mean over the scenarios"),
        ("worst_mse", "worst_error", RED, "worst scenario"),
    ):
        ax.errorbar(plans[column], plans["planned_for"], xerr=1.96 * plans[error], fmt="o",
                    color=colour, label=label)  # fmt: skip
    ax.invert_yaxis()
    ax.set_xlim(0)
    ax.set_xlabel("expected MSE, with 95 % intervals")
    canvas.legend(loc="outside upper right", ncols=2)
    return canvas
