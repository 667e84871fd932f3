"""Online planning: how much accuracy it gains, against how long a plan takes.

For each setting a planner chooses the times of the same simulated systems. Its error is compared
with that of the times fixed before, on the same systems and with the same noise of the filter. The
latency is the processor time of `update` and `next_time` together, on one core.
"""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import pfdist
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from benchmarks.search_runs import best_known
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_key
from pfdist.filters.work import FilterWork
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREY, RED
from pfdist.plugins.online.planner import Planner
from pfdist.runner.build import Built, build

TITLE = "Online planning"
TABLES: tuple[str, ...] = ("online",)

HERE = Path(__file__).parent
SYSTEMS = 200
PROBLEMS = {"paper": "online", "tumour": "tumour-online"}
"""Jobs by the name of the problem in ``best_known.csv``."""
DEFAULT = "default"
_DRAWS, _PARTICLES = (f"online.search.evaluation.{key}" for key in ("draws", "particles"))
SETTINGS: dict[str, list[str]] = {
    "16 draws": [f"{_DRAWS}=16"],
    DEFAULT: [],
    "256 draws": [f"{_DRAWS}=256"],
    "reach 1": ["online.search.reach=1.0"],
    "reach 3": ["online.search.reach=3.0"],
    "4 rounds": ["online.search.rounds=4"],
    "2 survivors": ["online.search.survivors=2"],
    "128 particles": [f"{_PARTICLES}=128"],
    "128 judging draws": ["online.judging_draws=128"],
    "4,096 judging draws": ["online.judging_draws=4096"],
}
SMALL = ["problem.horizon=14", "problem.measurement_budget=4", "filter.particles=50"]


def measure(quick: bool, say: Say) -> Tables:
    """Let planners with each setting choose the times of the same systems.

    Parameters
    ----------
    quick : bool
        Small problems, four systems, two settings.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        online: a row for each problem and setting, with problem, setting, systems, regular and
        fixed (expected MSE of regular times and of the times fixed before), mse, difference (from
        fixed), difference_error, median, high (the 95 % quantile, both in ms), changed (share of
        plans that were replaced).
    """
    settings = dict(list(SETTINGS.items())[:2]) if quick else SETTINGS
    rows = []
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        wanted = [(problem, name, quick) for problem in PROBLEMS for name in settings]
        for row in pool.map(_measured, wanted):
            rows.append(row)
            say(f"{row['problem']}, {row['setting']}: {row['difference']:.2f} ± "
                f"{row['difference_error']:.2f}, {row['median']:.0f} ms")  # fmt: skip
    return {"online": pd.DataFrame(rows)}


def _measured(wanted: tuple[str, str, bool]) -> dict[str, object]:
    """Measure one setting on one problem."""
    problem, setting, quick = wanted
    changes = [*(SMALL if quick else []), *SETTINGS[setting], "online.draws=2"]
    built = build(pfdist.load_job(HERE.parent / "jobs" / f"{PROBLEMS[problem]}.toml", changes))
    feasible = built.job.problem.feasible
    fixed = feasible.regular() if quick else best_known(problem)[0]
    _planned(built, fixed, 0)  # compiled before the clock runs
    mse, latencies, plans, changed = [], [], 0, 0
    for system in range(4 if quick else SYSTEMS):
        chosen, seconds, replaced = _planned(built, fixed, system)
        latencies += seconds
        plans, changed = plans + len(seconds), changed + replaced
        mse.append(_errors(built, system, (chosen, fixed, feasible.regular())))
    online, before, regular = np.array(mse).T
    difference = online - before
    milliseconds = 1000 * np.array(latencies)
    return {
        "problem": problem,
        "setting": setting,
        "systems": len(mse),
        "regular": regular.mean(),
        "fixed": before.mean(),
        "mse": online.mean(),
        "difference": difference.mean(),
        "difference_error": difference.std(ddof=1) / np.sqrt(len(mse)),
        "median": np.median(milliseconds),
        "high": np.quantile(milliseconds, 0.95),
        "changed": changed / plans,
    }


def _planned(built: Built, fixed: Times, system: int) -> tuple[Times, list[float], int]:
    """Choose the times of one system: the times, seconds of each step, and plans replaced."""
    y = built.evaluator.draws(range(system, system + 1), stream_key(0, "benchmark", "draws")).y[0]
    planner, seconds, replaced = Planner(built, fixed, draw=system), [], 0
    time = planner.next_time()
    while time is not None:
        before = planner.plan()[1:]
        start = process_time()
        planner.update(y[time])
        time = planner.next_time()
        seconds.append(process_time() - start)
        replaced += planner.plan() != before
    return planner.feasible.points.read(planner.measured), seconds, replaced


def _errors(built: Built, system: int, sets: tuple[Times, ...]) -> NDArray[np.float64]:
    """MSE of one system with each set, with the same noise of the filter."""
    work = FilterWork(
        measurement_times=sets,
        ends=(built.evaluator.horizon,) * len(sets),
        filter_streams=(stream_key(0, "benchmark", "filter"),) * len(sets),
        draws_stream=stream_key(0, "benchmark", "draws"),
        draws=(system, system + 1),
        estimation=built.comparing,
    )
    errors: NDArray[np.float64] = built.evaluator.filtered(work).mse[0]
    return errors


def summary(tables: Tables) -> str:
    """Give a table for each problem in Markdown."""
    parts = [
        "A planner with each setting chooses the times of the same simulated systems. "
        "[docs/online.md](../../docs/online.md) has the default settings; each other setting "
        "changes one of them. Difference: expected MSE of online times less that of the best "
        "known fixed times, with the standard error of the paired difference. Latency: "
        "processor time of `update` and `next_time` together, on one core, median and 95 % "
        "quantile. Replaced: the share of measurements after which the plan changed."
    ]
    for problem, rows in tables["online"].groupby("problem", sort=False):
        first = rows.iloc[0]
        parts.append(
            f"Problem {problem}, {first['systems']} systems. Expected MSE of regular times: "
            f"{first['regular']:.2f}; of the best known times: {first['fixed']:.2f}.\n\n"
            + markdown(
                ["setting", "expected MSE", "difference", "median latency", "95 %", "replaced"],
                [
                    [
                        str(row["setting"]),
                        f"{row['mse']:.2f}",
                        f"{row['difference']:z.2f} ± {row['difference_error']:.2f}",
                        f"{row['median']:.0f} ms",
                        f"{row['high']:.0f} ms",
                        f"{100 * row['changed']:.0f} %",
                    ]
                    for row in rows.to_dict("records")
                ],
            )
        )
    return "\n\n".join(parts)


def plot(tables: Tables) -> Figure:
    """Draw the difference of the expected MSE beside the latency, the quickest setting on top."""
    groups = list(tables["online"].groupby("problem", sort=False))
    figure = Figure(figsize=(COLUMN_INCHES, 2.2 * len(groups)), layout="constrained")
    panels = figure.subplots(len(groups), 2, sharey="row", squeeze=False)
    for (left, right), (problem, rows) in zip(panels, groups, strict=True):
        _plot(left, right, rows.sort_values("median"))
        left.set_title(str(problem))
    return figure


def _plot(left: Axes, right: Axes, rows: pd.DataFrame) -> None:
    for place, row in enumerate(rows.to_dict("records")):
        colour = RED if row["setting"] == DEFAULT else BLUE
        bar = 1.96 * row["difference_error"]
        left.errorbar(row["difference"], place, xerr=bar, fmt="o", ms=3, lw=0.8, color=colour)
        right.plot([row["median"], row["high"]], [place, place], lw=0.8, color=colour)
        right.plot(row["median"], place, "o", ms=3, color=colour)
    left.axvline(0.0, color=GREY, lw=0.6)
    for axes in (left, right):
        axes.locator_params(axis="x", nbins=5)
    left.set_yticks(range(len(rows)), [str(setting) for setting in rows["setting"]])
    left.invert_yaxis()
    left.set_xlabel("MSE less that of the\nbest known times (95 %)")
    right.set_xlim(left=0.0)
    right.tick_params(axis="y", left=False)
    right.set_xlabel("latency, ms\n(median to 95 %)")
