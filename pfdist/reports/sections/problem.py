"""The question: the system, the measurements that can be afforded, and where they may lie."""

from collections.abc import Iterator, Mapping
from typing import Any

from pfdist.reports.parts import Facts, Section, Text
from pfdist.reports.subject import Subject, number_of, without_folder

_WHAT = (
    "A filter follows a quantity that it cannot see, by a few measurements and a model of the "
    "system. This report says at which times to measure so that the filter's error is least on "
    "average: the mean squared error (MSE) of its estimate over all instants. A draw is one "
    "simulated system with its measurements. The errors are averages over draws that were "
    "simulated afresh, after the times had been chosen."
)


def problem(subject: Subject) -> Section:
    """Give the question of a run's job."""
    return Section("What was asked", [Text(_WHAT), Facts(list(_facts(subject)))])


def _facts(subject: Subject) -> Iterator[tuple[str, str]]:
    job, asked = subject.run.job, subject.problem
    yield "system", _model(job["model"])
    if job["model"].get("filter", {}).get("name"):
        yield "model of the filter", _model(job["model"]["filter"])
    yield "instants", f"t = 0 to {asked['horizon']}"
    yield "measurements", _measurements(job)
    for key, name in (
        ("forbidden", "not measured at"),
        ("required", "always measured at"),
        ("minimum_spacing", "instants between measurements, at least"),
    ):
        if asked.get(key):
            yield name, _text(asked[key])
    filtering = job["filter"]
    particles = f"particle filter with {number_of(filtering['particles'], 'particle')}"
    yield "filter", "Kalman filter (exact)" if subject.is_exact else particles


def _model(section: Mapping[str, Any]) -> str:
    changed = ", ".join(f"{key} = {value}" for key, value in section["parameters"].items())
    name = without_folder(section["name"])
    return f"{name} ({changed})" if changed else name


def _measurements(job: Mapping[str, Any]) -> str:
    asked, budget = job["problem"], job.get("budget")
    if budget:
        return f"every number from {budget['least']} to {budget['most']}"
    if asked.get("total_cost"):
        return f"as many as a total cost of {asked['total_cost']:,} allows"
    return str(asked["measurement_budget"])


def _text(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
