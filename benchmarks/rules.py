"""Rules that measure where the filter is unsure, against the plans of shipped jobs."""

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.common.rounding import with_error
from pfdist.kernels.rules import ALWAYS, NEVER
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREY, RED

TITLE = "Rules"
TABLES: tuple[str, ...] = ("rules",)

ROOT = Path(__file__).parents[1]
JOBS = (
    "plan", "lorenz63", "lotka_volterra", "stochastic_volatility", "tumour", "pharmacokinetics"
)  # fmt: skip


def measure(quick: bool, say: Say) -> Tables:
    """Plan each job, and tune a rule with and without a hard limit.

    Parameters
    ----------
    quick : bool
        Only the first job.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        rules: a row for each job and kind of rule.
    """
    rows = list[dict[str, Any]]()
    with tempfile.TemporaryDirectory(prefix="rules-") as folder:
        for job in JOBS[: 1 if quick else None]:
            path = Path(folder) / job
            pfdist.plan(ROOT / "jobs" / f"{job}.toml", path, bound_draws=0, figures=False)
            rows += rows_of(job, path)
            say(f"{job}: {rows[-1]}")
    return {"rules": pd.DataFrame(rows)}


def rows_of(job: str, run: Path) -> Iterator[dict[str, Any]]:
    """The two rows of a finished run."""
    for is_hard in (False, True):
        found = pfdist.rule(pfdist.open_run(run), hard=is_hard, figures=False)
        others = [name for name in found.labels if name not in (found.plan, "online")]
        errors = {"rule": "rule", "plan": found.plan, "even": others[0]}
        own = [c for c in found.rule.thresholds if ALWAYS < c < NEVER] or [math.nan]
        row: dict[str, Any] = {
            "job": job, "budget": found.budget, "threshold": float(np.median(own)),
            "exponent": found.rule.exponent, "limit": found.rule.limit,
        }  # fmt: skip
        row |= {"draws": len(found.table), "numbers": found.spent.value,
                "numbers_error": found.spent.standard_error,
                "numbers_deviation": found.table["measurements"].std()}  # fmt: skip
        for kind, name in errors.items():
            error = found.error(name)
            row |= {f"{kind}_mse": error.value, f"{kind}_error": error.standard_error}
        gain, low, high = found.gain(found.plan)
        yield row | {"excess": -gain, "excess_low": -high, "excess_high": -low}


def summary(tables: Tables) -> str:
    """Give the errors in Markdown."""
    rows = (
        [f"{row['job']}{', hard limit' * (row['limit'] > 0)}",
         *(with_error(row[f"{kind}_mse"], row[f"{kind}_error"])
           for kind in ("rule", "plan", "even"))]
        for row in tables["rules"].to_dict("records")
    )  # fmt: skip
    return markdown(["job", "rule", "plan", "evenly spaced"], rows)


def plot(tables: Tables) -> Figure:
    """Draw how far the error of each rule lies above that of the plan."""
    rows = tables["rules"]
    canvas = Figure(figsize=(COLUMN_INCHES, 2.4), layout="constrained")
    ax = canvas.subplots()
    for is_hard, colour, label in ((False, RED, "on average"), (True, BLUE, "hard limit")):
        own = rows[(rows["limit"] > 0) == is_hard]
        ax.plot(100 * own["excess"], own["job"], "o", color=colour, label=label)
    ax.axvline(0.0, color=GREY, ls=":")
    ax.set_xlabel("error of the rule above that of the plan [%]")
    ax.legend()
    return canvas
