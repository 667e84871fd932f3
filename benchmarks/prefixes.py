"""The work saved by filtering a common part of several sets only once, under common noise.

The sets come from real searches with ``evaluation.noise = "common"``. The new sets of a generation
are filtered together, as in the search, and separately.
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import load_job, load_model, run
from pfdist.common.measurement_times import Times
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_checked_sets, filter_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.prefixes import plan_prefixes
from pfdist.pages.style import COLUMN_INCHES, GREY, SERIES

TITLE = "Prefixes"
TABLES: tuple[str, ...] = ("prefixes",)

JOB = Path(__file__).parents[1] / "jobs" / "paper.toml"
EVERY = 4  # every fourth generation is timed
DRAWS = 50
REPEATS = 5


def measure(quick: bool, say: Say) -> Tables:
    """Give the remaining work of generations of the paper's two searches with common noise.

    Parameters
    ----------
    quick : bool
        A small search, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        prefixes: a row for each search and generation, with sets, steps (the remaining share of
        particle-steps) and time (the remaining share of processor time).
    """
    changes = ["evaluation.noise='common'", "comparison.draws=2"]
    if quick:
        changes += ["search.genetic.generations=2", "search.random.evaluations=60"]
        changes += ["evaluation.draws=20"]
    job = load_job(JOB, changes)
    with tempfile.TemporaryDirectory(prefix="run-") as folder:
        evaluations = run(job, results=folder, pool="serial").table("evaluations")
    say(f"{len(evaluations)} evaluations")
    evaluations = evaluations.drop_duplicates("evaluation")  # copies were evaluated once
    horizon, particles = job.problem.feasible.horizon, job.filter.particles
    draws = simulate(load_model("ungm"), horizon, range(DRAWS), stream=1)
    evaluations = evaluations[evaluations["generation"] % EVERY == 0]
    generations: dict[Any, list[Times]] = {
        key: [tuple(times) for times in generation["measurement_times"]]
        for key, generation in evaluations.groupby(["phase", "generation"])
    }
    functions: dict[Any, Callable[[], object]] = {}
    for key, sets in generations.items():
        functions["alone", key] = partial(_one_by_one, draws, sets, particles)
        ends, settings = [horizon] * len(sets), Estimation(particles)
        functions["together", key] = partial(
            filter_checked_sets, draws.model, draws, sets, ends, 2, settings
        )
    with one_core():
        timings = take_turns(functions, 2 if quick else REPEATS, say)
    rows = [
        {
            "search": key[0],
            "generation": key[1],
            "sets": len(sets),
            "steps": _share_of_steps(sets, horizon),
            "time": min(timings["together", key].processor) / min(timings["alone", key].processor),
        }
        for key, sets in generations.items()
    ]
    return {"prefixes": pd.DataFrame(rows)}


def _one_by_one(draws: Draws, sets: list[Times], particles: int) -> None:
    for times in sets:
        filter_draws(draws.model, draws, times, particles, 2)


def _share_of_steps(sets: list[Times], horizon: int) -> float:
    planned = plan_prefixes(tuple(sets), horizon + 1).plan
    return float((planned.ends - planned.begins).sum() / (len(sets) * (horizon + 1)))


def summary(tables: Tables) -> str:
    """Give a summary of the remaining work in Markdown."""
    rows = tables["prefixes"]
    lines = [
        [
            str(search),
            f"{generations['sets'].mean():.0f}",
            *(_of_all(generations, what) for what in ("steps", "time")),
        ]
        for search, generations in rows.groupby("search")
    ]
    header = ["search", "sets a generation", "particle-steps that remain", "time that remains"]
    return (
        "The paper's searches under common noise: each generation's new sets, filtered together, "
        "against the same one by one (which gives the same bits).\n\n" + markdown(header, lines)
    )


def _of_all(rows: pd.DataFrame, what: str) -> str:
    return f"{np.average(rows[what], weights=rows['sets']):.0%}"


def plot(tables: Tables) -> Figure:
    """Draw the remaining time of each generation."""
    rows = tables["prefixes"]
    figure = Figure(figsize=(COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    for colour, (search, generations) in zip(SERIES, rows.groupby("search"), strict=False):
        axes.plot(
            generations["generation"],
            100 * generations["steps"],
            color=colour,
            ls=":",
            label=f"{search}, steps",
        )
        axes.plot(
            generations["generation"],
            100 * generations["time"],
            color=colour,
            marker="o",
            ms=3,
            label=f"{search}, time",
        )
    axes.axhline(100, color=GREY, lw=0.6, ls=":")
    axes.set_ylim(0, 115)
    axes.set_xlabel("generation")
    axes.set_ylabel("what remains, %")
    axes.legend()
    return figure
