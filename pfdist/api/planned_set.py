"""The compared set of a run that a user has planned to measure."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pfdist.analysis import Run
from pfdist.errors import JobError, shown
from pfdist.times.measurement_times import Times


def planned_set(run: Run, name: str = "") -> tuple[str, Times]:
    """Give the name and the times of the set that was planned.

    Parameters
    ----------
    run : Run
    name : str, optional
        Name of a compared set; by default the found set with the lowest expected MSE.

    Raises
    ------
    JobError
        The run has no set of this name, or sets of several numbers of measurements and no name.
    """
    sets = run.sets()
    if name in sets:
        return name, sets[name]
    if name:
        raise JobError(
            f"times must be a compared set of {run.path}, {', '.join(sets)}, got {shown(name)}",
            argument="times",
        )
    if run.has_budget:
        raise JobError(
            f"{run.path} has times of several numbers of measurements: times must say which were "
            f"planned, for instance {list(sets)[-1]}",
            argument="times",
        )
    results = run.summary()["results"]
    best = min(run.names[1:], key=lambda found: _cost(results[found]))
    return best, sets[best]


def _cost(result: Mapping[str, Any]) -> float:
    mse = result["expected_mse"]
    return np.inf if mse is None else float(mse)
