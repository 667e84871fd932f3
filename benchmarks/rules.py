"""Rules against the plans of shipped jobs, a constant threshold, replanning and the bound."""

import math
import tempfile
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist.common.rounding import rounded, with_error
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.rules import Thresholds
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREY, RED
from pfdist.plugins.rule import ruling

TITLE = "Rules"
TABLES: tuple[str, ...] = ("rules", "decisions")

ROOT = Path(__file__).parents[1]
DRAWS = {"plan": 20_000} | dict.fromkeys(
    ("lorenz63", "lotka_volterra", "stochastic_volatility", "tumour", "pharmacokinetics", "blood"),
    4000,
)
"""Draws of the comparison of each job."""
ONLINE_DRAWS = 2000  # of the first job, which are also replanned
KINDS = ("opponent", "plan", "constant", "rule", "online")
"""Whose errors a row has."""


def measure(quick: bool, say: Say) -> Tables:
    """Plan each job, and tune rules with and without a hard limit.

    Parameters
    ----------
    quick : bool
        Only the first job, without replanning.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        rules: a row for each job and kind of budget, and one for replanning; decisions: see
        `decisions`.
    """
    rows = list[dict[str, Any]]()
    with tempfile.TemporaryDirectory(prefix="rules-") as folder:
        for job in list(DRAWS)[: 1 if quick else None]:
            file, path = ROOT / "jobs" / f"{job}.toml", Path(folder) / job
            fewer = [f"comparison.draws={DRAWS[job]}", "comparison.control=false"]
            given: Any = {"changes": fewer, "figures": False, "report": False}
            pfdist.plan(file, path, bound_draws=0, **given)
            rows += [row_of(job, path, is_hard=is_hard) for is_hard in (False, True)]
            if job == "plan" and not quick:
                pfdist.online(file, path / "online", ONLINE_DRAWS, reuse=path, **given)
                rows.append(row_of(job, path / "online", is_hard=True))
            say(f"{job}: {rows[-1]}")
    return {"rules": pd.DataFrame(rows), "decisions": decisions()}


def decisions() -> pd.DataFrame:
    """The processor time of a decision by a number, in microseconds: the least of ten systems."""
    instants, rows = 61, list[dict[str, Any]]()
    deviations = np.random.default_rng(0).exponential(7.0, instants)
    dense = StepLimits(prices=(1.0, 2.0, 3.0) * instants, delays=(0, 0, 2))
    for kind, limits, limit, sensors in (
        ("on average", StepLimits(), 0.0, ["y"]), ("hard limit", StepLimits(), 21.0, ["y"]),
        ("three sensors with prices and a delay", dense, 30.0, ["a", "b", "c"]),
    ):  # fmt: skip
        seconds = list[float]()
        for _ in range(10):
            thresholds = Thresholds((6.0,) * instants * len(sensors), 0.5 * (limit > 0), limit)
            rule, start = pfdist.Rule(thresholds, limits, sensors), process_time()
            for t in range(instants):
                rule.decide(float(deviations[t]), t)
            seconds.append(process_time() - start)
        rows.append({"kind": kind, "microseconds": 1e6 * min(seconds) / instants})
    return pd.DataFrame(rows)


def row_of(job: str, path: Path, *, is_hard: bool) -> dict[str, Any]:
    """The errors of all kinds for a finished run, and how far the rule's lies above the others."""
    run = pfdist.open_run(path)
    given: Any = {"hard": is_hard, "figures": False}
    with patch.multiple(ruling, _SWEEPS=(), _CLEARLY=-np.inf):
        constant = pfdist.rule(run, **given)
    found = pfdist.rule(run, **given)
    opponent = next(name for name in found.labels if name not in {found.plan, "online"})
    names = {"opponent": opponent, "plan": found.plan, "online": "online"}
    mse: dict[str, Any] = {
        kind: found.table.get(f"mse_{name}", pd.Series(np.nan, found.table.index))
        for kind, name in names.items()
    }
    mse |= {"constant": constant.table["mse_rule"], "rule": found.table["mse_rule"]}
    row = {"job": job, "budget": found.budget, "is_hard": is_hard, "draws": len(found.table),
           "numbers": found.spent.value, "numbers_error": found.spent.standard_error,
           "bound": found.at_least}  # fmt: skip
    for kind in KINDS:
        values, ratio = mse[kind], mse["rule"].mean() / mse[kind].mean()
        apart = mse["rule"] - ratio * values  # the delta method, on paired draws
        errors = {"mse": values.mean(), "error": error_of(values), "excess": ratio - 1.0,
                  "excess_error": error_of(apart) / values.mean()}  # fmt: skip
        row |= {f"{kind}_{name}": value for name, value in errors.items()}
    return row


def error_of(values: Any) -> float:
    """The standard error of a mean."""
    return float(np.std(values, ddof=1) / math.sqrt(len(values)))


def lines(tables: Tables) -> tuple[list[str], list[list[str]]]:
    """The head and the rows of the table of all errors."""
    head = [
        "job, N, draws", *(f"{kind} ± SE" for kind in KINDS[:-1]), "bound (95 %)",
        "measurements ± SE", "rule less plan, % ± SE", "rule less constant, % ± SE",
    ]  # fmt: skip
    rows = [
        [f"`{row['job']}`, {row['budget']:g}{' at most' * row['is_hard']}, {row['draws']:,}",
         *(with_error(row[f"{kind}_mse"], row[f"{kind}_error"]) for kind in KINDS[:-1]),
         rounded(row["bound"]), with_error(row["numbers"], row["numbers_error"]),
         *(with_error(100 * row[f"{kind}_excess"], 100 * row[f"{kind}_excess_error"])
           for kind in ("plan", "constant"))]
        for row in tables["rules"].to_dict("records")
    ]  # fmt: skip
    return head, rows


def summary(tables: Tables) -> str:
    """Give the errors in Markdown."""
    told = [
        f"Replanning, on {row['draws']:,} draws with at most {row['budget']:g} measurements: "
        f"{with_error(row['online_mse'], row['online_error'])}; the rule's error is "
        f"{with_error(100 * abs(row['online_excess']), 100 * row['online_excess_error'])} % "
        f"{'above' if row['online_excess'] > 0 else 'below'}."
        for row in tables["rules"].dropna(subset="online_mse").to_dict("records")
    ]
    each = tables["decisions"].to_dict("records")
    told += ["Processor time of a decision by `pfdist.Rule`: " + ", ".join(
        f"{row['microseconds']:.0f} µs ({row['kind']})" for row in each
    ) + "."]  # fmt: skip
    return "\n\n".join([markdown(*lines(tables)), *told])


def plot(tables: Tables) -> Figure:
    """Draw how far the error of each rule lies above that of the plan."""
    rows = tables["rules"]
    canvas = Figure(figsize=(COLUMN_INCHES, 2.4), layout="constrained")
    ax = canvas.subplots()
    for is_hard, colour, label in ((False, RED, "on average"), (True, BLUE, "hard limit")):
        own = rows[rows["is_hard"] == is_hard]
        ax.plot(100 * own["plan_excess"], own["job"], "o", color=colour, label=label)
    ax.axvline(0.0, color=GREY, ls=":")
    ax.set_xlabel("error of the rule above that of the plan [%]")
    ax.legend()
    return canvas
