"""The sets that no search found, in words: the reference, and those that a job names."""

from collections.abc import Mapping, Sequence
from typing import Any

from pfdist.job.problem_section import ProblemSection
from pfdist.job.sections import REFERENCE
from pfdist.times.clock import Time
from pfdist.times.measurement_times import REGULAR


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
    feasible, instants = problem.feasible, problem.clock.instants(times)
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


def label(name: str) -> str:
    """The reference of this name as figures and summaries call it."""
    if name == REGULAR:
        return "regular times"
    return f"the {name}" if name == REFERENCE else f"the times of {name}"
