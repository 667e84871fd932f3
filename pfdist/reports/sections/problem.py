"""The question: the system, the measurements that can be afforded, and where they may lie."""

from collections.abc import Iterator, Mapping
from typing import Any

from pfdist.analysis import read_recorded
from pfdist.common.told_times import told_time, told_times
from pfdist.job.problem_section import ProblemSection
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
    yield from _named_components(read_recorded(subject.run.path)[0]["model"])
    yield "instants", _instants(subject)
    yield from _weights(asked, subject.run.problem)
    yield "measurements", _measurements(job)
    for key, name in (
        ("forbidden", "not measured at"),
        ("required", "always measured at"),
    ):
        if asked.get(key):
            yield name, told_spelling(asked[key], subject.unit)
    if asked.get("minimum_spacing"):
        what = "time" if subject.run.problem.has_clock else "instants"
        spacing = told_spelling(asked["minimum_spacing"], subject.unit)
        yield f"{what} between measurements, at least", spacing
    filtering = job["filter"]
    particles = f"particle filter with {number_of(filtering['particles'], 'particle')}"
    yield "filter", "Kalman filter (exact)" if subject.is_exact else particles


def _model(section: Mapping[str, Any]) -> str:
    changed = ", ".join(f"{key} = {value}" for key, value in section["parameters"].items())
    name = without_folder(section["name"])
    return f"{name} ({changed})" if changed else name


def _named_components(meaning: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Give the names and units of z and y, where the model of the run has them."""
    for key, what in (("z_names", "quantity of interest"), ("y_names", "what is measured")):
        if meaning.get(key):
            yield what, str(meaning[key])


def _measurements(job: Mapping[str, Any]) -> str:
    asked, budget = job["problem"], job.get("budget")
    if budget:
        return f"every number from {budget['least']} to {budget['most']}"
    if asked.get("total_cost"):
        return f"as many as a total cost of {asked['total_cost']:,} allows"
    return str(asked["measurement_budget"])


def _instants(subject: Subject) -> str:
    clock = subject.run.problem.clock
    ends = f"t = {told_time(clock.times[0])} to {told_times(clock.times[-1:], clock.unit)}"
    if clock.counts:
        return ends
    if clock.is_even:
        step = told_times([clock.times[1] - clock.times[0]], clock.unit)
        return f"{ends}, in steps of {step}"
    return f"{len(clock.times)} instants, {ends}"


def _weights(asked: Mapping[str, Any], section: ProblemSection) -> Iterator[tuple[str, str]]:
    """Say how the errors of instants are weighted in the MSE, if they are."""
    weights = section.weights
    if weights is None:
        return
    least, most = (f"{weight:.4g}" for weight in (min(weights), max(weights)))
    if asked.get("instant_weights"):
        told = f"given by the job, from {least} to {most}; their mean is 1"
    else:
        told = f"by the trapezoidal rule, because the steps differ, from {least} to {most}"
    yield "weights of instants in the MSE", told


def told_spelling(value: Any, unit: str) -> str:
    """Give times as the job spells them, with the unit."""
    entries = value if isinstance(value, list | tuple) else [value]
    text = ", ".join(map(str, entries))
    return f"{text} {unit}" if unit else text
