"""The reference of a run in words."""

from collections.abc import Mapping
from typing import Any

from pfdist.job.problem_section import ProblemSection
from pfdist.times.measurement_times import REGULAR, Times


def described(job: Mapping[str, Any], name: str, times: Times) -> dict[str, Any]:
    """A description of a run's reference, and the constraints of the job that it breaks.

    Parameters
    ----------
    job : mapping
        The run's resolved job.
    name : str
        Name of the reference.
    times : tuple of int
        Measurement times of the reference.

    Returns
    -------
    dict
        ``description``, a phrase, and ``broken_constraints``, a list of sentences.
    """
    problem = ProblemSection.model_validate(job["problem"])
    feasible = problem.feasible
    number = f"N = {len(times)}"
    if not feasible.counted:
        number += f", spends {feasible.cost_of(times)} of {feasible.total_cost}"
    if name != REGULAR:
        phrase = f"the set that comparison.reference names ({number})"
    elif feasible.is_regular(times):
        phrase = f"regular times ({number})"
    elif times != feasible.regular():  # an older run, whose reference followed another rule
        phrase = f"a set near to regular times ({number})"
    elif feasible.counted:
        phrase = f"the feasible set nearest to regular times ({number})"
    else:
        phrase = f"nearest to regular times of the sets with the most measurements ({number})"
    return {"description": phrase, "broken_constraints": problem.broken(times)}


def label(name: str) -> str:
    """The reference of this name as figures and summaries call it."""
    return "regular times" if name == REGULAR else f"the {name}"
