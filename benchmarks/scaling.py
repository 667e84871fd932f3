"""The speed of a real run with 1 and 2 workers, for several numbers of draws, and the cost of Ray.

The time of the search starts at the last outcome of the first generation, in which workers start
and compile. It ends at the last outcome of the last generation. So it includes commits, the work of
the driver between generations, and waiting for the end of a generation. The time of the whole run
ends at the last outcome of the comparison, during which the tables of the search are written.
"""

import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks import ray_costs
from benchmarks.bare_processes import measure_rate
from benchmarks.measure import Say
from benchmarks.results import Tables, markdown, with_range
from pfdist import load_job, run
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREEN, GREY, OCHRE, RED
from pfdist.runner.comparison_phase import TRAJECTORIES
from pfdist.runner.progress import Progress

TITLE = "Workers"
TABLES: tuple[str, ...] = ("scaling", "ray_costs")

JOB = Path(__file__).parents[1] / "jobs" / "paper.toml"
PAPERS_DRAWS = 1000
GENERATIONS = {250: 8, PAPERS_DRAWS: 25}  # by draws of an evaluation; the first is not timed
REPEATS = 3
RUNS = (("threads", 1), ("threads", 2), ("ray", 1), ("ray", 2))
BARE_SECONDS = 2.0
BARE = "bare processes"
_KIND = ["draws", "pool"]


def measure(quick: bool, say: Say) -> Tables:
    """Give the speeds of the paper's genetic search on different pools, measured in turns.

    Parameters
    ----------
    quick : bool
        Only the smallest tasks, once.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        scaling: a row for each run, with repeat, draws, pool, workers, tasks, task_seconds (mean in
        a worker), and the particle-steps in a second: rate of the search, run_rate of the whole
        run; ray_costs: see `ray_costs.measure_ray`.
    """
    sizes = dict(list(GENERATIONS.items())[:1]) if quick else GENERATIONS
    costs = ray_costs.measure_ray(1 if quick else 2, 100 if quick else 1000, say)
    rows: list[dict[str, Any]] = []
    with ray_costs.session(cores=2):
        for repeat in range(1 if quick else REPEATS):
            for draws, generations in sizes.items():
                for pool, workers in RUNS:
                    found = _search(pool, workers, draws, generations)
                    rows.append({"repeat": repeat, "draws": draws, **found})
                    say(f"{pool} {workers}, {draws} draws: {found['rate'] / 1e9:.3f}e9 steps a s")
            for workers in (1, 2):
                rate = measure_rate(workers, PAPERS_DRAWS, BARE_SECONDS)
                about = {"pool": BARE, "workers": workers, "draws": PAPERS_DRAWS}
                rows.append({"repeat": repeat, **about, "rate": rate})
                say(f"{BARE} {workers}: {rate / 1e9:.3f}e9 steps a s")
    return {"scaling": pd.DataFrame(rows), "ray_costs": costs}


def _search(pool: str, workers: int, draws: int, generations: int) -> dict[str, Any]:
    search = f"search=[{{method='genetic', population=50, generations={generations}}}]"
    job = load_job(JOB, [search, f"evaluation.draws={draws}"])
    warm = searched = end = 0.0

    def report(progress: Progress) -> None:
        nonlocal warm, searched, end
        end = perf_counter()
        if progress.generation == 1:
            warm = end
        if progress.phase == "genetic":
            searched = end

    with tempfile.TemporaryDirectory(prefix="run-") as folder:
        done = run(job, results=folder, pool=pool, workers=workers, progress=report)
        evaluated, tasks = done.table("evaluations")["generation"], done.table("timings")["seconds"]
    a_draw = (job.problem.feasible.horizon + 1) * job.filter.particles
    steps = int((evaluated > 0).sum()) * draws * a_draw
    compared = len(done.names) * (job.comparison.draws + TRAJECTORIES) * a_draw
    return {
        "pool": pool,
        "workers": workers,
        "tasks": len(tasks),
        "task_seconds": float(tasks.mean()),
        "rate": steps / (searched - warm),
        "run_rate": (steps + compared) / (end - warm),
    }


def efficiencies(rows: pd.DataFrame, rate: str = "rate") -> pd.DataFrame:
    """Give the parallel efficiency, rate(2) / (2 rate(1)), of each pair of runs.

    Parameters
    ----------
    rows : DataFrame
        The table scaling.
    rate : {"rate", "run_rate"}

    Returns
    -------
    DataFrame
        draws, pool, repeat, efficiency.
    """
    wide = rows.pivot_table(index=["draws", "pool", "repeat"], columns="workers", values=rate)
    return (wide[2] / (2 * wide[1])).dropna().rename("efficiency").reset_index()


def summary(tables: Tables) -> str:
    """Give a summary of the rates, the efficiency and the cost of Ray in Markdown."""
    rows = tables["scaling"]
    both: list[dict[Any, pd.Series]] = [
        dict(list(efficiencies(rows, rate).groupby(_KIND)["efficiency"]))
        for rate in ("rate", "run_rate")
    ]
    lines = []
    for kind, runs in rows.groupby(_KIND):
        task = runs["task_seconds"].min()
        by_workers = (runs["rate"] / 1e9).groupby(runs["workers"])
        rates = [with_range(rate, ".3f") for _, rate in by_workers]
        lines.append(
            [
                "{:,} draws, {}".format(*kind),
                "" if np.isnan(task) else f"{task * 1e3:.1f} ms",  # bare processes have no tasks
                *rates,
                *[""] * (2 - len(rates)),
                *(with_range(by_kind[kind], ".1%") if kind in by_kind else "" for by_kind in both),
            ]
        )
    costs = tables["ray_costs"].groupby("what")["seconds"].median()
    header = ["draws an evaluation, pool", "a task", "1 worker", "2 workers", "efficiency"]
    header.append("of the whole run")
    return (
        "The search of `jobs/paper.toml`, everything but Ray's start and compilation counted: 1e9 "
        "particle-steps a second, and efficiency, rate(2) / (2 rate(1)); and that of the whole "
        "run, in which the search's tables are written while the workers compare. "
        f"Median of {rows['repeat'].max() + 1} repeats in turns, in brackets the least and the "
        "largest. Bare processes filter the same with nobody to hand out tasks: what the machine "
        "allows.\n\n"
        f"{markdown(header, lines)}\n\n"
        f"Ray starts in {costs['start']:.1f} s; a call to a worker costs {costs['call'] * 1e3:.2f} "
        f"ms in a stream of tasks, and {costs['round trip'] * 1e3:.2f} ms there and back alone."
    )


def plot(tables: Tables) -> Figure:
    """Draw the rates by the size of a task, and the efficiency."""
    rows = tables["scaling"]
    figure = Figure(figsize=(2 * COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (pool, workers), colour in zip(RUNS, (OCHRE, GREEN, BLUE, RED), strict=True):
        chosen = rows[(rows["pool"] == pool) & (rows["workers"] == workers)]
        rates = chosen.groupby("draws")["rate"].agg(["median", "min", "max"]) / 1e9
        kind = "Ray, {} worker{}" if pool == "ray" else "{} thread{}"
        name = kind.format(workers, "s" * (workers - 1))
        left.plot(rates.index, rates["median"], color=colour, marker="o", ms=2.5, label=name)
        left.fill_between(rates.index, rates["min"], rates["max"], color=colour, alpha=0.2, lw=0)
    left.set_ylabel(r"$10^9$ particle-steps a second")
    left.set_ylim(bottom=0)
    left.legend()
    found = efficiencies(rows)
    kinds = (
        ("threads", GREEN, "search on threads", 0.93),
        ("ray", RED, "search on Ray", 1.0),
        (BARE, GREY, BARE, 1.07),
    )
    for pool, colour, name, aside in kinds:
        pairs = 100 * found[found["pool"] == pool].set_index("draws")["efficiency"]
        each = pairs.groupby("draws").agg(["median", "min", "max"])
        spread = each["median"] - each["min"], each["max"] - each["median"]
        places, middle = each.index * aside, each["median"]
        right.errorbar(places, middle, spread, color=colour, marker="o", ms=3, label=name)
    right.axhline(100, color=GREY, lw=0.6, ls=":")
    right.set_ylabel("parallel efficiency, %")
    right.set_ylim(0, 115)
    right.legend(loc="lower right")
    for axes in (left, right):
        axes.set_xscale("log")
        sizes = sorted(rows["draws"].unique())
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.minorticks_off()
        axes.set_xlabel("draws an evaluation, $K$")
    return figure
