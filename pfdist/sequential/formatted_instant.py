"""Instants as errors name them: by their times on the clock of the job, if there is one."""

from pfdist.common.formatted_times import formatted_time
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import CLOCK


def formatted_instant(model: StateSpaceModel, t: int) -> str:
    """The time of an instant as text: p.time[t] of a model on a clock, else the number t."""
    on_clock = all(name in model.parameters for name in CLOCK)
    times = model.parameters["time"] if on_clock else ()
    return formatted_time(times[t]) if isinstance(times, tuple) and t < len(times) else str(t)
