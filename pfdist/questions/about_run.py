"""The question of a run, how it was computed, how to load its tables, and how to cite."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from shlex import quote
from typing import Any

from pfdist.common.parts import Code, Facts, Section, Text
from pfdist.common.rounding import unrounded
from pfdist.filters.engines import is_exact
from pfdist.problem.job import job_toml
from pfdist.problem.problem_section import ProblemSection
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
_TIMES = {
    "forbidden": "forbidden times",
    "allowed": "allowed times",
    "required": "required times",
}
_MOST_VALUES = 8  # of a parameter that are shown
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
    z = ", ".join(each.name for each in subject.quantities if each.name) or "the estimate"
    first, last = map(problem.clock.formatted, (0, problem.clock.horizon))
    between, form = f"between t = {first} and {last}", subject.criterion
    give = f"give the lowest {form.label} of {z}?"
    if form.sign < 0:
        give = f"give the most {form.label} about the path?"
    if "budget" in job:
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
    day = f"{started.day} {started:%B %Y}"
    return f"Run {run.path.name}, {day}, pfdist {version_of(run)}."


def _facts(subject: Subject) -> Iterator[tuple[str, str]]:
    job, problem = subject.run.job, subject.run.job["problem"]
    yield "system", _model(job["model"])
    if job["model"].get("filter", {}).get("name"):
        yield "model of the filter", _model(job["model"]["filter"])
    names = provenance_of(subject.run).get("names", {})
    for key, what in (("z", "quantity of interest"), ("y", "what is measured")):
        if names.get(key):
            yield what, ", ".join(names[key])
    yield "instants", _instants(subject)
    yield from _weights(problem, problem_of(subject.run))
    yield "measurements", _measurements(job)
    dated, unit = subject.clock.has_dates, subject.clock.unit
    if problem_of(subject.run).instants_of_lag:
        later = f"until {_spelled(problem['lag'], unit)} later" if "lag" in problem else "all"
        yield "measurements that an estimate uses", later
    for key, name in _TIMES.items():
        if problem.get(key):
            yield name, _spelled(problem[key], unit, dated=dated)
    if problem.get("minimum_spacing"):
        spacing = _spelled(problem["minimum_spacing"], unit)
        yield "distance of measurements, at least", spacing
    for name, keys in problem.get("sensors", {}).items():
        text = "; ".join(f"{key} {_spelled(value, '')}" for key, value in keys.items())
        yield f"sensor {name}", text or "no price"
    filtering = job["filter"]
    particles = f"particle filter with {number_of(filtering['particles'], 'particle')}"
    yield "filter", "Kalman filter (exact)" if is_exact(filtering["engine"]) else particles


def _model(section: Mapping[str, Any]) -> str:
    changed = ", ".join(f"{key} = {_values(value)}" for key, value in section["parameters"].items())
    name = without_folder(section["name"])
    return f"{name} ({changed})" if changed else name


def _values(value: Any) -> str:
    """A parameter of a job; the number and the range of many values.

    >>> _values(0.5), _values([0.0, 80.0]), _values([0.0, 80.0, 25.0] * 16)
    ('0.5', '[0.0, 80.0]', '48 values from 0 to 80')
    """
    if not isinstance(value, list | tuple) or len(value) <= _MOST_VALUES:
        return str(value)
    return f"{len(value)} values from {min(value):g} to {max(value):g}"


def _measurements(job: Mapping[str, Any]) -> str:
    problem, budget = job["problem"], job.get("budget")
    if budget and budget.get("numbers"):
        return ", ".join(map(str, budget["numbers"]))
    if budget:
        return f"every number from {budget['least']} to {budget['most']}"
    if problem.get("total_price"):
        return f"as many as a total price of {problem['total_price']:,} allows"
    return str(problem["measurement_budget"])


def _instants(subject: Subject) -> str:
    clock = problem_of(subject.run).clock
    ends = f"t = {clock.text(clock.times[0])} to {clock.formatted(clock.horizon)}"
    if clock.calendar and clock.calendar.start.tzinfo:
        ends += f" ({clock.calendar.start.tzinfo})"
    if clock.counts:
        return ends
    if clock.is_even:
        step = f"{unrounded(clock.times[1] - clock.times[0])} {clock.unit}".rstrip()
        return f"{ends}, in steps of {step}"
    return f"{len(clock.times)} instants, {ends}"


def _weights(problem: Mapping[str, Any], section: ProblemSection) -> Iterator[tuple[str, str]]:
    """How the errors of instants are weighted in the MSE, if they are."""
    weights = section.weights
    if weights is None:
        return
    least, most = (f"{weight:.4g}" for weight in (min(weights), max(weights)))
    if problem.get("instant_weights"):
        text = f"given by the job, from {least} to {most}; their mean is 1"
    else:
        text = f"by the trapezoidal rule, because the steps differ, from {least} to {most}"
    yield "weights of instants in the MSE", text


def _spelled(value: Any, unit: str, *, dated: bool = False) -> str:
    """Times as the job spells them, with the unit; or dates."""
    entries = value if isinstance(value, list | tuple) else [value]
    if dated:
        return ", ".join(map(str, entries))
    text = ", ".join(str(entry).replace(":", " to ", 1).replace(":", " by ") for entry in entries)
    return f"{text} {unit}" if unit else text


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


def by_hand(subject: Subject) -> Section:
    """The command with which a reader moves the times by hand."""
    text = "This command opens a page where you drag the measurements and see the error at once."
    command = f"pfdist explore {quote(subject.run.path.name)}"
    return Section("How to move the times by hand", [Text(text), Code(command)])


def tables(subject: Subject) -> Section:
    """Code that loads the tables."""
    name = subject.run.path.name
    quoted = {"name": _quoted(name), "table": _quoted(f"{name}/tables/comparison")}
    return Section("How to load the tables", [Code(_LOAD.format(**quoted))])


def citation(subject: Subject) -> Section:
    """References for the method and the program."""
    version = version_of(subject.run)
    text = "Please cite the paper whose method pfdist implements, and the program."
    return Section("How to cite", [Text(text), Code(_CITE.format(version=version))])


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
    seconds = rows.groupby("session")["seconds"].sum()
    workers = rows[["node", "worker"]].drop_duplicates()
    facts = [("time of all workers", _seconds(seconds.sum()))]
    facts.append(("workers", f"{len(workers)}"))
    if len(seconds) > 1:
        *earlier, _ = seconds.sort_index()
        starts = number_of(len(seconds), "start")
        facts.append(("saved by resuming", f"{_seconds(sum(earlier))}, in {starts} of the program"))
    failures = int(rows["failures"].sum())
    if failures:
        facts.append(("failed tasks, repeated", f"{failures:,}"))
    return facts


def _sendable(job: dict[str, Any]) -> dict[str, Any]:
    """A job whose models are named without folders of this machine."""
    model = {**job["model"], "name": without_folder(job["model"]["name"])}
    if "filter" in model:
        model["filter"] = {**model["filter"], "name": without_folder(model["filter"]["name"])}
    return {**job, "model": model}


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _seconds(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min {rest:.0f} s" if minutes else f"{rest:.1f} s"
