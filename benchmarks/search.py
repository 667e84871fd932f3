"""All searches on five problems: the excess over the best known cost, and the work.

The work includes all that a search does, with the shortlist. All sets found for a problem, and the
sets in ``best_known.csv``, then filter the same fresh draws. The excess is the difference from the
best of these sets, which a race on other draws determines.

The benchmark takes half an hour on two cores. When a search ends, its row is kept in
``results/search.csv``, and the search is not run again. To measure it anew, delete its rows.
"""

import json
import sys
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from benchmarks.search_runs import best_known, fresh_costs, search
from pfdist import Job, load_job
from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_key
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.filters.proposal import PLAIN
from pfdist.pages.style import COLUMN_INCHES, GREEN, GREY, RED
from pfdist.problem.search_section import CommonNoiseSettings
from pfdist.problem.sections import Execution
from pfdist.runner.build import build, make_pool
from pfdist.runner.identity import estimations

TITLE = "Searches"
TABLES: tuple[str, ...] = ("search", "search_sets")

HERE = Path(__file__).parent
KEPT = HERE / "results" / "search.csv"
SEEDS, MORE_SEEDS = 5, 10
ROUNDS = 40  # largest number of rounds of fresh draws, until standard errors are small

PROBLEMS: dict[str, list[str]] = {
    "paper": [],
    "tumour": [],
    "linear_gaussian": [],
    "linear_gaussian, short": ["problem.horizon=25", "problem.measurement_budget=5"],
    "sharp_sensor": [],
}
"""Jobs, from the folders below, and changes of their keys."""
FOLDERS = ("jobs", "tests/oracles")
EXACT = ("linear_gaussian", "linear_gaussian, short")  # costs are known without draws
SHORT = ("linear_gaussian, short", "sharp_sensor")  # every set can be evaluated
SMALL = ["problem.horizon=14", "problem.measurement_budget=4", "evaluation.draws=50"]


def _common(method: str, *draws: int, **settings: Any) -> list[dict[str, Any]]:
    common = {"noise": "common", "resampling": "systematic"}
    return [
        {"method": method, **settings, "evaluation": {"draws": each, **common}} for each in draws
    ]


SEARCHES: dict[str, list[dict[str, Any]]] = {
    "relaxation": [
        {"method": "relaxation"},
        *({"method": "relaxation", "evaluation": {"draws": draws}} for draws in (240, 1920)),
    ],
    "survivors": [
        *({"method": "survivors", "survivors": m} for m in (1, 2, 4)),
        {"method": "survivors", "survivors": 3, "by_previous": True},
        {"method": "survivors", "survivors": 2, "evaluation": {"draws": 1200}},
    ],
    "exchange": _common("exchange", 100, 600),
    "random trials": [
        *_common("random", 300, evaluations=300),
        *_common("random", 300, evaluations=1250),
    ],
    "genetic, common noise": _common("genetic", 150, 600),
    "genetic, as in the paper": [{"method": "genetic"}],
    "exhaustive": [{"method": "exhaustive"}],
}
"""For each search, settings with different amounts of work, so that searches can be compared at
equal work."""
OF_TEN_SEEDS = ("relaxation", "survivors")
BY_CHANCE = ("random trials", "genetic, as in the paper")
"""Searches that depend on the seed even if costs are exact."""

LOOKS = {
    "relaxation": ("black", "o"),
    "survivors": (RED, "o"),
    "exchange": (GREEN, "s"),
    "random trials": (GREY, "X"),
    "genetic, common noise": (GREY, "*"),
    "genetic, as in the paper": ("black", "*"),
    "exhaustive": ("black", "h"),
}


def measure(quick: bool, say: Say) -> Tables:
    """Run every search that has no row yet, then evaluate all found sets on fresh draws.

    Parameters
    ----------
    quick : bool
        Small problems, one seed, the first settings of each search; no row is kept.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        search: a row for each run, with problem, search, way (the settings), seed, job (a hash of
        the job), steps, seconds, believed, times;
        search_sets: a row for each set, with problem and the columns of `fresh_costs`.
    """
    rows, sets = [], []
    for problem in PROBLEMS:
        jobs = _jobs(problem, quick)
        built = build(jobs[0][1])
        execution = Execution(pool="serial" if quick or problem in EXACT else "ray")
        with make_pool(execution) as pool:
            for about, job in jobs:
                row = None if quick else _kept(about)
                if row is None:
                    found = search(job, pool)
                    row = {**about, **found, "times": _text(found["times"])}
                    say(" ".join(str(row[key]) for key in ("problem", "search", "way", "seed")))
                    if not quick:
                        _keep(row)
                rows.append(row)
            texts = [row["times"] for row in rows if row["problem"] == problem]
            known = [] if quick else [*map(_text, best_known(problem))]
            texts = list(dict.fromkeys([*texts, *known]))
            fresh = fresh_costs(built, pool, list(map(_times, texts)), 2 if quick else ROUNDS)
            sets.append(fresh.assign(problem=problem, times=texts))
            say(f"{problem}: {len(texts)} sets on fresh draws")
    return {"search": pd.DataFrame(rows), "search_sets": pd.concat(sets)}


def _jobs(problem: str, quick: bool) -> list[tuple[dict[str, Any], Job]]:
    """Give all runs of a problem."""
    name = f"{problem.partition(',')[0]}.toml"
    file = next(file for folder in FOLDERS if (file := HERE.parent / folder / name).exists())
    changes = [*PROBLEMS[problem], "comparison.draws=2", *(SMALL if quick else [])]
    # The default number of searches with common noise; the paper's searches have another default.
    own = load_job(file).filter
    particles = CommonNoiseSettings().particles_of(own.particles, PLAIN.name)
    jobs = []
    for seed in range(1, 2 if quick else MORE_SEEDS + 1):
        for name in SEARCHES:
            if seed > SEEDS and name not in OF_TEN_SEEDS:
                continue
            if seed > 1 and problem in EXACT and name not in BY_CHANCE:
                continue
            ways = _ways(problem, name)
            for settings in ways[: 1 if quick else None]:
                section = dict(settings)
                if "evaluation" in section:
                    section["evaluation"] = {**section["evaluation"], "particles": particles}
                job = load_job(file, [*changes, f"seed={seed}", f"search=[{_toml(section)}]"])
                about = {"problem": problem, "search": name, "way": _label(settings, ways)}
                key = f"{stream_key(KERNEL_VERSION, job.identity(), estimations(build(job))):016x}"
                jobs.append(({**about, "seed": seed, "job": key}, job))
    return jobs


def _ways(problem: str, name: str) -> list[dict[str, Any]]:
    if name == "exhaustive" and problem not in SHORT:
        return []
    if problem not in EXACT:
        return [way for way in SEARCHES[name] if not way.get("by_previous")]  # too slow
    if name == "genetic, common noise":  # exact costs have no noise
        return []
    ways = [{k: v for k, v in way.items() if k != "evaluation"} for way in SEARCHES[name]]
    return [way for place, way in enumerate(ways) if way not in ways[:place]]


def _label(way: dict[str, Any], ways: list[dict[str, Any]]) -> str:
    """Give the settings in which a way differs from the other ways of a search."""
    here, *others = ({**way, **way.get("evaluation", {})} for way in (way, *ways))
    keys = [
        key for key in here if key != "evaluation" and any(here[key] != o.get(key) for o in others)
    ]
    return ", ".join(f"{key} = {here[key]}" for key in keys)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(entry)}" for key, entry in value.items()) + "}"
    return json.dumps(value)


def _kept(about: dict[str, Any]) -> dict[str, Any] | None:
    if not KEPT.exists():
        return None
    rows = pd.read_csv(KEPT, comment="#")
    same = rows[(rows["job"] == about["job"]) & (rows["search"] == about["search"])]
    return {**same.iloc[-1].to_dict(), **about} if len(same) else None


def _keep(row: dict[str, Any]) -> None:
    KEPT.parent.mkdir(exist_ok=True)
    pd.DataFrame([row]).to_csv(KEPT, mode="a", header=not KEPT.exists(), index=False)


def _text(times: Times) -> str:
    return " ".join(map(str, times))


def _times(text: str) -> Times:
    return tuple(map(int, text.split()))


def _found(tables: Tables) -> pd.DataFrame:
    """Give means and ranges over the seeds, a row for each search and its settings."""
    rows = tables["search"].merge(tables["search_sets"], on=["problem", "times"])
    bias = 100 * (rows["believed"] / rows["cost"] - 1)
    rows = rows.assign(bias=bias, way=rows["way"].fillna(""))
    ways = rows.groupby(["problem", "search", "way"], sort=False)
    found = ways[["steps", "excess", "bias"]].mean()
    return found.join(ways["excess"].agg(["min", "max", "size"])).reset_index()


def summary(tables: Tables) -> str:
    """Give a summary of excess and work of each search in Markdown."""
    found, sets = _found(tables), tables["search_sets"]
    parts = [
        "Excess over the best set known, in per cent of its expected MSE: mean over the seeds, in "
        "brackets the least and the largest; measured on fresh draws common to all sets of a "
        f"problem, with standard errors of at most {sets['excess_error'].max():.2f}. Work is that "
        "of the whole search and its shortlist, in particle-steps, or in steps of the Kalman "
        "filter, whose errors are exact. Bias is by how much the search's own estimate differs "
        "from the expected MSE on fresh draws: the winner's curse, and that of fewer particles."
    ]
    for problem in found["problem"].unique():
        ways = found[found["problem"] == problem].set_index(["search", "way"])
        best = sets[(sets["problem"] == problem) & sets["best"]].iloc[0]
        lines = [
            [
                ", ".join(filter(None, name)),
                f"{row['size']:.0f}",
                f"{row['steps']:.2g}",
                f"{row['excess']:.2f} ({row['min']:.2f} to {row['max']:.2f})",
                f"{row['bias']:+.1f}",
            ]
            for name, row in ways.iterrows()
        ]
        header = [problem, "seeds", "work", "excess, %", "bias, %"]
        parts.append(
            f"{markdown(header, lines)}\n\nBest known: {best['times']}; expected MSE "
            f"{best['cost']:.5g} ± {best['standard_error']:.2g}."
        )
    return "\n\n".join(parts)


def plot(tables: Tables) -> Figure:
    """Draw excess against work, with mean and range over the seeds, a panel for each problem."""
    found = _found(tables)
    problems = list(found["problem"].unique())
    size = (2 * COLUMN_INCHES, 2.6 * COLUMN_INCHES)
    figure = Figure(figsize=size, layout="constrained")
    for place, problem in enumerate(problems):
        axes = figure.add_subplot((len(problems) + 1) // 2, 2, place + 1)
        _panel(axes, found[found["problem"] == problem])
        axes.set_title(problem)
        axes.set_xlabel("steps of the Kalman filter" if problem in EXACT else "particle-steps")
        axes.set_ylabel("excess over the best known, %")
    handles = {
        label: handle
        for axes in figure.axes
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    shown = [name for name in LOOKS if name in handles]
    figure.legend([handles[name] for name in shown], shown, loc="outside lower center", ncols=4)
    return figure


def _panel(axes: Axes, found: pd.DataFrame) -> None:
    for name, (colour, marker) in LOOKS.items():
        ways = found[found["search"] == name].sort_values("steps")
        if len(ways):
            below, above = ways["excess"] - ways["min"], ways["max"] - ways["excess"]
            spread = below.clip(lower=0), above.clip(lower=0)  # a mean of equal values is rounded
            axes.errorbar(
                ways["steps"], ways["excess"], spread, label=name, color=colour, marker=marker,
                ms=5 if marker == "*" else 3.5, lw=0.7, elinewidth=0.6, capsize=1.5,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1, linscale=0.6)
    ticks = [0, 0.5, 1, 2, 5, 10, 20, 50]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)
    axes.set_ylim(min(-0.3, 1.3 * found["min"].min()), max(1.0, 1.3 * found["max"].max()))
    axes.grid(axis="y", lw=0.3, color=GREY, alpha=0.4)


if __name__ == "__main__":
    from benchmarks.__main__ import main

    sys.exit(main(["search", *sys.argv[1:]]))
