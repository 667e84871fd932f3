"""The question of a run, how it was computed, how to load its tables, and how to cite."""

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Any

from pfdist.common.parts import Block, Code, Facts, Section, Text
from pfdist.errors import relative
from pfdist.filters.engines import is_exact
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.job import job_toml
from pfdist.questions.subject import Subject, number_of, without_folder
from pfdist.results.stored_run import about_of, problem_of, provenance_of, version_of
from pfdist.store import run_key

_WHAT = (
    "A particle filter estimates a quantity from a few measurements and a model of the system. Its "
    "error is the mean squared error (MSE) of the estimate over all instants; the typical error is "
    "the root of the expected MSE. A draw is one simulated system with its measurements. No "
    "real measurement was used: all results hold as far as the model is right. Errors are means "
    "over new draws, which were simulated after the times had been chosen."
)
_LOAD = """\
import pfdist

run = pfdist.open_run({name})  # the folder of the run
run.table("sets")  # a row for each set of times
run.table("gains").describe()  # a row for each draw

# The tables are plain Parquet, so pandas alone reads them, too:
import pandas as pd

pd.read_parquet({table})
"""
_CITE = """\
A. Aspeel, A. Gouverneur, R. M. Jungers, B. Macq, "Optimal measurement budget allocation for
particle filtering", IEEE International Conference on Image Processing (ICIP), 2020.

The pfdist developers, "pfdist: when to measure", version {version}.
"""


def problem(subject: Subject) -> Section:
    """The question of a run's job."""
    return Section("What was asked", [Text(_WHAT), Facts(list(_facts(subject)))])


def question(subject: Subject) -> str:
    """The question of a run in a sentence."""
    job, problem = subject.run.job, problem_of(subject.run)
    z = ", ".join(each.name for each in subject.quantities if each.name) or "z"
    first, last = map(problem.clock.formatted, (0, problem.clock.horizon))
    between, form = f"between t = {first} and {last}", subject.criterion
    give = f"give {form.aim(z)}?"
    if has_amounts(job):
        return f"How many measurements {between} are enough to estimate {z}?"
    if not subject.found_rows and subject.rows:
        return f"Which of these times {between} {give}"
    if problem.total_price is not None:
        which = f"Which times {between}, for a total price of at most {problem.total_price:,},"
    else:
        number = number_of(problem.feasible.measurements, "time")
        which = f"Which {number} of {problem.clock.horizon + 1} {between}"
    return f"{which} {give}"


def made_by(subject: Subject) -> str:
    """The name of a run, the day on which it was started, and the version of pfdist."""
    run = subject.run
    started = datetime.fromisoformat(provenance_of(run)["started"])
    return f"Run {run.path.name}, {started.date()}, pfdist {version_of(run)}."


def _facts(subject: Subject) -> Iterator[tuple[str, str]]:
    job = subject.run.job
    yield "system", without_folder(job["model"]["name"])
    if job["model"].get("filter", {}).get("name"):
        yield "model of the filter", without_folder(job["model"]["filter"]["name"])
    names = provenance_of(subject.run)["names"]
    for key, what in (("z", "quantity of interest"), ("y", "what is measured")):
        if names[key]:
            yield what, ", ".join(names[key])
    section = problem_of(subject.run)
    if section.weights is not None:
        given = "given by the job" if job["problem"].get("instant_weights") else ""
        how = given or "by the trapezoidal rule, because the steps differ"
        yield "weights of instants in the MSE", how
    if section.instants_of_lag:
        until = f"{job['problem'].get('lag', '')} {subject.clock.unit}".strip()
        later = f"until {until} later" if "lag" in job["problem"] else "all"
        yield "measurements that an estimate uses", later
    filtering = job["filter"]
    particles = f"particle filter with {number_of(filtering['particles'], 'particle')}"
    yield "filter", "Kalman filter (exact)" if is_exact(filtering["engine"]) else particles


def computed(subject: Subject) -> Section:
    """Versions, seeds, processor and time of a run, and its job."""
    about, job = about_of(subject.run), subject.run.job
    identity = [
        ("seed", str(job["seed"])),
        ("engine", about["engine"]),
        ("identity of the run", str(run_key(subject.run.path))),
    ]
    return Section(
        "How it was computed",
        [
            Facts([*_versions(about), *_work(subject), *identity]),
            Code(job_toml(_sendable(job)), "The job, with all its defaults"),
        ],
    )


def using(subject: Subject) -> Section:
    """How to move the times by hand, to load the tables, and to cite."""
    path = Path(relative(str(subject.run.path.absolute())))
    name = subject.run.path.name if path.is_absolute() else str(path)  # the report may be sent
    quoted = {"name": _quoted(name), "table": _quoted(f"{name}/tables/comparison")}
    explored = "On this page you drag the measurements and see the error at once:"
    by_hand: list[Block] = [Text(explored), Code(f"pfdist explore {quote(name)}")]
    rest: list[Block] = [
        Text("The tables of the run in Python:"),
        Code(_LOAD.format(**quoted)),
        Text("Please cite the paper whose method pfdist implements, and the program."),
        Code(_CITE.format(version=version_of(subject.run))),
    ]
    is_budget = has_amounts(subject.run.job)
    return Section("How to use and cite it", rest if is_budget else [*by_hand, *rest])


def _versions(about: dict[str, Any]) -> list[tuple[str, str]]:
    provenance = about["provenance"]
    libraries = ", ".join(f"{name} {version}" for name, version in provenance["libraries"].items())
    processor = provenance["processor"]
    declared = [
        (f"model {name}", f"declared as {text}; its code is not part of the identity")
        for name, text in provenance.get("declared", {}).items()
    ]
    return [
        *declared,
        ("pfdist", f"{about['pfdist']}, kernel {about['kernel']}"),
        ("Python and libraries", f"Python {provenance['python']}, {libraries}"),
        ("processor", f"{processor['model']} ({processor['compiled_for']})"),
        ("started", provenance["started"]),
    ]


def _work(subject: Subject) -> list[tuple[str, str]]:
    if "timings" not in subject.run.tables:
        return []
    rows = subject.run.table("timings")
    workers = rows[["node", "worker"]].drop_duplicates()
    minutes, rest = divmod(float(rows["seconds"].sum()), 60)
    seconds = f"{minutes:.0f} min {rest:.0f} s" if minutes else f"{rest:.1f} s"
    return [("time of all workers", seconds), ("workers", f"{len(workers)}")]


def _sendable(job: dict[str, Any]) -> dict[str, Any]:
    """A job whose models are named without folders of this machine."""
    model = {**job["model"], "name": without_folder(job["model"]["name"])}
    if "filter" in model:
        model["filter"] = {**model["filter"], "name": without_folder(model["filter"]["name"])}
    return {**job, "model": model}


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
