"""The sets that no search found: references, and those that a job names."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.common.clock import Time
from pfdist.common.measurement_times import REGULAR
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.sections import REFERENCE


def described(job: Mapping[str, Any], name: str, times: Sequence[Time]) -> dict[str, Any]:
    """A description of a set that the job gives, and the constraints of the job that it breaks.

    Parameters
    ----------
    job : mapping
        The run's resolved job.
    name : str
        Name of the set.
    times : sequence of int or float
        Measurement times of the set, on the clock of the job.

    Returns
    -------
    dict
        ``description``, a phrase, and ``broken_constraints``, a list of sentences.
    """
    problem = ProblemSection.model_validate(job["problem"])
    feasible, instants = problem.feasible, problem.clock.measurements(times)
    number = f"N = {len(times)}"
    if not feasible.counted:
        number += f", spends {feasible.cost_of(instants)} of {feasible.total_cost}"
    if name in (job.get("comparison", {}).get("sets") or {}) and name != REGULAR:
        phrase = f"the set that comparison.sets.{name} gives ({number})"
    elif name != REGULAR:
        phrase = f"the set that comparison.reference names ({number})"
    elif feasible.is_regular(instants):
        phrase = f"regular times ({number})"
    elif feasible.counted:
        phrase = f"the feasible set nearest to regular times ({number})"
    else:
        phrase = f"nearest to regular times of the sets with the most measurements ({number})"
    return {"description": phrase, "broken_constraints": problem.broken(times)}


def without_number(name: str, job: Mapping[str, Any]) -> str:
    """Name of a search or a reference, of which a set has the name.

    A budget curve adds the number of measurements: ``regular_05`` is a set of ``regular``.

    Parameters
    ----------
    name : str
        Name of a compared set.
    job : mapping
        The run's resolved job.
    """
    return name.rpartition("_")[0] if "budget" in job else name


def references_of(names: Sequence[str], job: Mapping[str, Any]) -> dict[str, str]:
    """The reference of each compared set that is no reference, by name.

    It has as many measurements as the set, if the job has a budget curve.

    Parameters
    ----------
    names : sequence of str
        Names of the compared sets, a reference first.
    job : mapping
        The run's resolved job.
    """
    bases = {name: without_number(name, job) for name in names}
    reference = bases[names[0]]
    return {
        name: reference + name.removeprefix(base)
        for name, base in bases.items()
        if base != reference
    }


def label(name: str) -> str:
    """The reference of this name as figures and summaries call it."""
    if name == REGULAR:
        return "regular times"
    return f"the {name}" if name == REFERENCE else f"the times of {name}"
